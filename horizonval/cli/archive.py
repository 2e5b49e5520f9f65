"""The archive of a run: list, check, export, clean and rescore frames and images."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from horizonval.cli.options import ALL, EntryOptions, Json, Workers, estimators, selects
from horizonval.cli.output import print_json, print_summary, resumable, watched
from horizonval.core import atomic
from horizonval.core.errors import UserError, command_line, printable

archive_app = typer.Typer(help="The archive of a run: list, verify, export, clean, score again.", rich_markup_mode=None)

Archive = Annotated[Path, typer.Argument(metavar="FOLDER", help="An archive, or the folder of a run.")]
Kind = Annotated[str | None, typer.Option(help="frame or image.")]


@archive_app.command("ls")
@selects
def archive_ls(folder: Archive, kind: Kind = None, options: EntryOptions = ALL, as_json: Json = False) -> None:
    """List the frames and images of an archive from its index, after an update of the index."""
    from dataclasses import asdict

    from horizonval.store.named import open_archive

    store = open_archive(folder)
    entry_filter = options.filter(kind)
    with watched("reading headers") as progress:
        entries = store.index.select(entry_filter, progress)
    if as_json:
        print_json([asdict(entry) for entry in entries])
        return
    for e in entries:
        camera_name = f"{e.camera}.{e.head}" if e.head else e.camera
        seed_text = f" seed {e.seed}" if e.seed else ""
        print(
            printable(
                f"{e.address[:16]}  {e.kind:8} {e.size_bytes / 1e6:7.2f} MB  {e.epoch_utc[:19]:19}  {camera_name:24} "
                f"{','.join(e.bands):12} {e.scene}{seed_text}"
            )
        )
    if not entries and (count := len(store.index.select())):
        print(f"horizonval: none of {count} entries is wanted", file=sys.stderr)


@archive_app.command("show")
def archive_show(
    folder: Annotated[Path, typer.Argument(help="An archive, the folder of a run, or one EXR file of ours.")],
    address: Annotated[str | None, typer.Argument(help="Of an archive: an address, or how it begins.")] = None,
    as_json: Json = False,
) -> None:
    """Content of one file: standard attributes with units, our attributes, channels; with --json also the truth."""
    from horizonval.store.entry import shown

    content = shown(_file(folder, address))
    if as_json:
        print_json(content)
        return
    for group in ("file", "standard", "horizonval"):
        for key, (value, unit) in content[group].items():
            numbers = value if isinstance(value, list) else [value]
            text = " ".join(f"{v:.9g}" if isinstance(v, float) else str(v) for v in numbers)
            print(printable(f"{key:32} {text}{f' {unit}' if unit else ''}"))
    print(printable(f"{'channels':32} {' '.join(content['channels'])}"))


@archive_app.command("verify")
def archive_verify(folder: Archive, as_json: Json = False) -> int:
    """Read everything and compare it with checksums, index and results, including those of the run's folder.

    Also for the folder of a night or of rescored results. Exit status 1 after any error.
    """
    from horizonval.store.folder import RunFolder
    from horizonval.store.named import archive_of_results, named_addresses, open_archive, run_folder_of
    from horizonval.store.verify import is_results_folder, verify_folder

    whole = is_results_folder(folder)
    store = archive_of_results(folder) if whole else open_archive(folder)
    own = RunFolder(folder)
    run_folder = own if store is None or store.root == own.archive else run_folder_of(store.root)
    named = named_addresses(run_folder) if run_folder else {}
    with watched("verifying") as progress:
        findings = verify_folder(folder, progress) if whole else []
    if store is not None:
        with watched("verifying") as progress:
            findings += store.verify(named, progress)
    count = 0 if store is None else store.count()
    if as_json:
        problems = [
            {"path": str(f.path), "problem": f.problem, "address": f.address, "message": f.message} for f in findings
        ]
        print_json({"entries": count, "problems": problems})
    else:
        for finding in findings:
            print(f"{finding.problem}: {finding.message}")
        print(f"{count} entries, {len(findings)} problem{'' if len(findings) == 1 else 's'}")
        if store is not None and not store.index.path.exists() and not named:
            print(
                "without an index nobody knows of files that are gone; "
                + command_line("archive", "reindex", store.root)
                + " makes one"
            )
    return 1 if findings else 0


@archive_app.command("reindex")
def archive_reindex(folder: Archive) -> None:
    """Rebuild the index from the headers alone. Missing files are no longer reported afterwards."""
    from horizonval.store.named import open_archive

    store = open_archive(folder, follow=False)
    with watched("reading headers") as progress:
        count = store.index.rebuild(progress)
    print(f"{store.index.path}: {count} entries")


@archive_app.command("export")
@selects
def archive_export(
    source: Annotated[Path, typer.Argument(help="An archive, the folder of a run, or one EXR file of ours.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the files; created if missing.")],
    fits: Annotated[bool, typer.Option("--fits", help="FITS, with units, camera and celestial coordinates.")] = False,
    png: Annotated[bool, typer.Option("--png", help="PNG of 16 bits; unit, scale and truth in a JSON file.")] = False,
    tiff: Annotated[bool, typer.Option("--tiff", help="TIFF of 16 bits; radiances as floats.")] = False,
    npz: Annotated[bool, typer.Option("--npz", help="Arrays of NumPy, camera and truth as text.")] = False,
    coco: Annotated[
        bool, typer.Option("--coco", help="PNG of the frames, and one COCO file of the masks of Earth and limb.")
    ] = False,
    aem: Annotated[
        bool, typer.Option("--aem", help="Of a run: what each estimator claimed, as a CCSDS attitude message.")
    ] = False,
    zipped: Annotated[
        bool, typer.Option("--exr", help="EXR compressed by ZIP, for programs with an OpenEXR before 3.4.")
    ] = False,
    mcap: Annotated[
        bool, typer.Option("--mcap", help="One MCAP file of ROS 2 messages, in the order of time.")
    ] = False,
    address: Annotated[list[str] | None, typer.Option(help="Only this one, by its beginning; repeatable.")] = None,
    kind: Kind = None,
    options: EntryOptions = ALL,
) -> None:
    """Export frames and images to files of other programs."""
    from horizonval.bridges.attitudes import write_attitudes
    from horizonval.bridges.mcap import write_mcap
    from horizonval.store.export import Format, export_file, write_masks
    from horizonval.store.named import open_archive, run_folder_of

    wanted: dict[Format, bool] = {"fits": fits, "png": png or coco, "tiff": tiff, "npz": npz}
    formats = [name for name, is_wanted in wanted.items() if is_wanted]
    each = bool(formats) or zipped
    if not (each or mcap or aem):
        raise UserError("which format?", where="archive export", expected="--fits, --png, --mcap, --aem or another")
    entry_filter = options.filter(kind)
    if not source.is_dir():
        _refuse_filters(address, entry_filter)
        paths, store = [source], None
    else:
        store = open_archive(source)
        if out.resolve().is_relative_to(store.root.resolve()):
            raise UserError("lies inside the archive", where=str(out), expected="a folder outside it")
        addresses = {store.find(start) for start in address or ()}
        entries = [e for e in store.index.select(entry_filter) if not addresses or e.address in addresses]
        in_time = sorted(entries, key=lambda e: (e.epoch_utc, e.camera, e.head, e.address)) if mcap else entries
        paths = [store.path(e.address) for e in in_time if e.kind != "missing"]
    if not paths:
        raise UserError("nothing to export", where=str(source), fix=f"see {command_line('archive', 'ls', source)}")
    run_folder = None if store is None else run_folder_of(store.root)
    if aem and (store is None or run_folder is None):
        raise UserError("no run", where="--aem", expected="the folder of a run, which knows what was claimed")
    atomic.make_folder(out)
    count, messages = 0, dict[Path, str]()
    with watched("exporting") as progress:
        progress.start(len(paths) * (each + mcap), 0)
        for path in paths if each else []:
            count += len(export_file(path, out, formats, zipped=zipped))
            progress.done(path.name)
        if coco:
            write_masks(out / "masks.json", paths)
            count += 1
        if aem and store is not None and run_folder is not None:
            messages = write_attitudes(run_folder.root, store, out)
            count += len(messages)
        if mcap:
            write_mcap(out / f"{source.stem if source.is_file() else 'archive'}.mcap", paths, progress)
            count += 1
    for message, held in messages.items():
        print(printable(f"{message}: {held}"))
    print(f"{out}: {count} files of {len(paths)} {'entry' if len(paths) == 1 else 'entries'}")


@archive_app.command("gc")
def archive_gc(
    folder: Annotated[Path, typer.Argument(help="The folder of a run, or its archive.")],
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Remove without asking.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be removed, and leave it.")] = False,
) -> int:
    """Remove files that no result of the run names, such as frames of other code; never during a run."""
    from horizonval.store.named import garbage, open_archive, remove, run_folder_of

    store = open_archive(folder, follow=False)
    run_folder = run_folder_of(store.root)
    if run_folder is None:
        raise UserError(
            "no run.json next to it, so that nothing says what is in use",
            where=str(store.root),
            expected="the archive of a run",
        )
    with run_folder.locked():
        rubbish = garbage(run_folder)
        what = f"{len(rubbish.files)} file{'' if len(rubbish.files) == 1 else 's'}, {rubbish.size_bytes / 1e6:.2f} MB"
        if not rubbish.files:
            print(f"nothing to remove, {rubbish.kept} entries are in use")
            return 0
        for path in rubbish.files:
            print(printable(str(path.relative_to(store.root))))
        if dry_run:
            print(f"{what} would be removed, {rubbish.kept} entries are in use")
            return 0
        if not yes and not _agreed(f"remove {what}? {rubbish.kept} entries are in use and stay [y/N] "):
            print("nothing was removed")
            return 0
        remove(rubbish, run_folder)
        print(f"{what} removed, {rubbish.kept} entries are in use")
    return 0


@archive_app.command("rescore")
@selects
def archive_rescore(
    folder: Archive,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the results; created if missing.")],
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            help="Repeatable; by default those of the run (`horizonval list estimators`).", autocompletion=estimators
        ),
    ] = None,
    workers: Workers = None,
    time_limit: Annotated[float, typer.Option(min=0.1, metavar="S", help="Processor time of one estimate.")] = 60.0,
    options: EntryOptions = ALL,
    as_json: Json = False,
) -> int:
    """Estimate and score the archived images again, without rendering: results, summary and report in OUT.

    The same command resumes after an interruption. Exit status 1 if an image is damaged.
    """
    from horizonval.jobs.pool import available_cpus
    from horizonval.plugins.supervisor import Limits
    from horizonval.store.named import open_archive
    from horizonval.suites.rescore import rescore

    store, entry_filter, limits = open_archive(folder), options.filter("image"), Limits(time_s=time_limit)
    with resumable("rescore", "cases") as progress:
        processes = workers or available_cpus()
        done = rescore(store, out, tuple(estimator or ()), entry_filter, processes, limits, progress)
    if as_json:
        print_json(done.summary)
    else:
        print_summary(done.summary)
        print(f"report: {done.report}")
    for name, why in done.failed.items():
        print(printable(f"horizonval: {name}: {why}"), file=sys.stderr)
    return 1 if done.failed else 0


def _file(folder: Path, address: str | None) -> Path:
    """Return the file that an archive and an address name, or a path alone."""
    if not folder.is_dir():
        if address is not None:
            raise UserError("is a file, which needs no address", where=str(folder))
        return folder
    if address is None:
        raise UserError(
            "which entry?", where=str(folder), expected=f"an address, see {command_line('archive', 'ls', folder)}"
        )
    from horizonval.store.named import open_archive

    store = open_archive(folder)
    return store.path(store.find(address))


def _refuse_filters(address: list[str] | None, entry_filter: Any) -> None:
    """Refuse filters of an archive where one file is named."""
    filters = {"address": address, **vars(entry_filter)}
    for name, value in filters.items():
        if value:
            raise UserError("used with one file", where=f"--{name}", expected="an archive, or the folder of a run")


def _agreed(question: str) -> bool:
    if not sys.stdin.isatty():
        raise UserError("nobody is there to ask", where="archive gc", fix="add --yes, or look with --dry-run first")
    try:
        return input(question).strip().lower() in ("y", "yes")
    except (EOFError, KeyboardInterrupt):
        print()
        return False
