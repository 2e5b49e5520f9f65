"""The command line: parse, call, print. No physics.

Heavy packages are imported inside the commands that need them, so that ``--help``, ``list`` and ``estimate`` start
without the renderer.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from horizonval.errors import UserError

app = typer.Typer(
    name="horizonval",
    help="Physically based rendering validation of Earth horizon sensors.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
archive_app = typer.Typer(help="The archive of a run: list, verify, export, clean, score again.", rich_markup_mode=None)
app.add_typer(archive_app, name="archive")
baseline_app = typer.Typer(help="The accepted baseline of the nightly regression.", rich_markup_mode=None)
app.add_typer(baseline_app, name="baseline")

Archive = Annotated[Path, typer.Argument(metavar="FOLDER", help="An archive, or the folder of a run.")]
Kind = Annotated[str | None, typer.Option(help="frame or image.")]
SceneGlob = Annotated[str | None, typer.Option("--scene", help="Name of the scene; `*` and `?` stand for others.")]
CameraGlob = Annotated[str | None, typer.Option("--camera", help="Name of the camera; `*` and `?` likewise.")]
HeadGlob = Annotated[str | None, typer.Option("--head", help="Name of the camera's head; `*` and `?` likewise.")]
BandName = Annotated[str | None, typer.Option("--band", help="Name of a spectral band.")]
SeedText = Annotated[str | None, typer.Option("--seed", help="Of an image's noise.")]
Since = Annotated[str | None, typer.Option("--since", help="Not before: a date or time, UTC by default.")]
Until = Annotated[str | None, typer.Option("--until", help="Not after.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Head = Annotated[str | None, typer.Option(help="Of a camera with several heads: a name, or all of them (`all`).")]


def main() -> None:
    """Run the command line; a user's mistake is one line on standard error and exit status 2."""
    # One thread for linear algebra, before numpy loads: the last bit of a result must not depend on the machine.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    sys.exit(run_command_line(sys.argv[1:]))


def run_command_line(arguments: list[str]) -> int:
    """Run one command line and return its exit status."""
    try:
        status = app(arguments or ["--help"], prog_name="horizonval", standalone_mode=False)
        sys.stdout.flush()
    except UserError as e:
        return _fail(e.line())
    except BrokenPipeError:
        # The reader has gone (``| head``); nothing is wrong, and nothing more may be written.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 0
    except OSError as e:
        return _fail(": ".join(str(part) for part in (e.filename, e.strerror or e) if part))
    except Exception as e:
        # The parser's own errors (unknown option, missing argument) have this method; anything else is a defect.
        if hasattr(e, "format_message"):
            return _fail(" ".join(e.format_message().split()) + " (see --help)")
        raise
    if status == 130:
        print("horizonval: interrupted", file=sys.stderr)
    return int(status or 0)


def _fail(line: str) -> int:
    print(f"horizonval: error: {line}", file=sys.stderr)
    return 2


def _print_json(data: object) -> None:
    print(json.dumps(data, indent=1, allow_nan=False))


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        from horizonval import __version__

        print(f"horizonval {__version__}")
        raise typer.Exit


@app.command()
def run(
    suite: Annotated[str, typer.Argument(help="A suite file, or the name of a shipped suite.")] = "quick",
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the run; made if need be.")] = ...,  # type: ignore[assignment]
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; by default as many as processors.")] = None,
    shard: Annotated[
        str | None, typer.Option(metavar="I/N", help="Only every N-th frame from the I-th on; then run without it.")
    ] = None,
    merge: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="Take over the results of another folder's run; repeatable."),
    ] = None,
    dask: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler in place of own processes, or local:N.")
    ] = None,
    time_limit: Annotated[
        float | None, typer.Option(min=0.1, metavar="S", help="Of one estimate; in place of the suite's time_limit_s.")
    ] = None,
    keep: Annotated[
        str | None, typer.Option(metavar="WHAT", help="Frames in the archive: all, failures or none; see suite.keep.")
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="In place of suite.frames, of a suite that draws shares of it."),
    ] = None,
    as_json: Json = False,
) -> int:
    """Main job: render, observe, estimate, score, report; and the study of the infrared horizon a suite asks for.

    The same command again, after whatever interrupted it, finishes what is missing. Shards (`--shard 2/8`) may share a
    folder, at the same time or not; the command without --shard then makes what is missing and the report. Another
    --frames goes on in the same folder. Exit status 1 if a frame failed.
    """
    from horizonval.campaign.plan import parse_shard
    from horizonval.campaign.progress import Terminal
    from horizonval.campaign.run import Where, run_suite
    from horizonval.campaign.suite import load_suite, with_options

    where = Where(workers, None if shard is None else parse_shard(shard), dask, tuple(merge or ()))
    loaded = with_options(load_suite(suite, frames), time_limit, keep)
    try:
        with Terminal(f"suite {loaded.name}") as progress:
            result = run_suite(loaded, out, progress=progress, where=where)
    except KeyboardInterrupt:
        print("horizonval: interrupted; finished frames are kept, the same command goes on from here", file=sys.stderr)
        raise SystemExit(130) from None
    if as_json:
        _print_json(result.summary)
    elif result.report is None:
        print(f"shard {shard} is done, {result.missing} results of others are missing; run without --shard to conclude")
    else:
        _print_summary(result.summary)
        if result.summary.get("stability"):
            _print_study(result.summary["stability"])
        print(f"report: {result.report}")
    if result.failed:
        names = ", ".join(result.failed)
        study = loaded.stability
        total = len(loaded.cases) + (len(study.band) * len(study.months) if study else 0)
        what = "frames and months" if study else "frames"
        print(f"horizonval: {len(result.failed)} of {total} {what} failed: {names}", file=sys.stderr)
    return 1 if result.failed else 0


@app.command()
def render(
    scene: Annotated[str, typer.Argument(help="A scene file, or the name of a shipped scene.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="The frame, an EXR file.")],
    reference: Annotated[bool, typer.Option("--reference", help="By Monte Carlo, in stock Mitsuba.")] = False,
    spp: Annotated[int | None, typer.Option(min=2, help="With --reference: samples per pixel and node.")] = None,
    reference_size: Annotated[
        str | None, typer.Option(metavar="WxH", help="With --reference: the image in fewer, larger pixels.")
    ] = None,
    head: Head = None,
) -> None:
    """Render one frame: radiance, truth maps, header.

    Of a camera with several heads, the one that the scene or --head names; `all` writes FRAME.<head>.exr for each.

    --reference is the cross-check: stock Mitsuba's Monte Carlo with the scene's orders of scattering by molecules and
    particles, ozone, and a uniform Lambert ground; without the Sun's disc and glare, surface map and clouds. Its
    standard error lies beside the radiance.
    """
    from horizonval.spec.load import load_frames, load_scene

    if not reference:
        if spp is not None or reference_size is not None:
            raise UserError("used without --reference", where="--spp" if spp is not None else "--reference-size")
        frames = load_frames(scene, head)
        names = [case.scene.camera.head for case in frames]
        targets = [out] if len(frames) == 1 else [out.with_name(f"{out.stem}.{name}{out.suffix}") for name in names]
        for target in targets:
            _check_target(target)
        from horizonval.campaign.progress import Tables
        from horizonval.render.frame import render_frame

        for case, target in zip(frames, targets, strict=True):
            start = time.perf_counter()
            with Tables() as tables:
                frame = render_frame(case.scene, case.camera, tables.advance)
            _write_frame(target, frame, start)
        return
    spec, camera = load_scene(scene, head)
    _check_target(out)
    from horizonval.campaign.progress import Terminal
    from horizonval.render.reference import DEFAULT_SPP, HOLDS, LEAVES_OUT, check_sunlight, render_reference, resized

    check_sunlight(camera, spec.camera.file)
    if reference_size is not None:
        camera = resized(camera, *_size(reference_size, "--reference-size"), where="--reference-size")
    start = time.perf_counter()
    with Terminal("reference", "passes") as progress:
        frame = render_reference(spec, camera, spp or DEFAULT_SPP, progress=progress)
    _write_frame(out, frame, start)
    noise = ", ".join(f"{band} {100 * e:.2g} %" for band, e in frame.render["relative_standard_error"].items())
    print(f"standard error of a lit pixel: {noise} ({frame.render['spp']} samples)")
    print(f"holds: {HOLDS}\nleaves out: {LEAVES_OUT}")


@app.command()
def mitsuba(
    scene: Annotated[str, typer.Argument(help="A scene file, or the name of a shipped scene.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="A new or empty folder.")],
    head: Annotated[str | None, typer.Option(help="Of a camera with several heads, the name of one.")] = None,
) -> None:
    """Write a scene as files that Mitsuba opens.

    scene.xml is the deterministic frame and needs this package's plugins; reference.xml needs nothing but Mitsuba 3.
    """
    from horizonval.spec.load import load_scene

    spec, camera = load_scene(scene, head)
    _check_folder(out)
    from horizonval.render.export import export_scene

    for path in export_scene(spec, camera, out):
        print(f"{path}: {path.stat().st_size / 1e3:.1f} kB")


@app.command()
def observe(
    frame: Annotated[Path, typer.Argument(help="A frame, as `render` or a run's archive has them.")],
    out: Annotated[
        str,
        typer.Option("-o", "--out", help="EXR file; of several {seed}, {exposure}, {band} in its name, or a folder."),
    ],
    seed: Annotated[
        list[str] | None,
        typer.Option("--seed", "--seeds", help="Replicates, such as 3 or 0-9 or 1,4; each another draw of all noise."),
    ] = None,
    exposure: Annotated[
        list[str] | None, typer.Option(help="Seconds, such as 1e-3,2e-3; by default the camera file's own.")
    ] = None,
    band: Annotated[list[str] | None, typer.Option(help="Spectral bands; the camera's first by default.")] = None,
    camera: Annotated[
        str | None, typer.Option(help="Another camera file or name of the same image geometry and bands.")
    ] = None,
) -> None:
    """Detector images of a stored frame, without rendering again: one for every seed, exposure and band."""
    from horizonval.archive.exr import read_frame, write_image
    from horizonval.campaign.observing import plans
    from horizonval.sensor.observe import observe as observe_frame
    from horizonval.spec.camera import CameraSpec
    from horizonval.spec.load import load_camera

    stored = read_frame(frame)
    spec = CameraSpec.model_validate(stored.truth.camera) if camera is None else load_camera(camera)
    todo = plans(out, seed or [], exposure or [], band or [], spec)
    if todo[0].path.parent == Path(out):
        Path(out).mkdir(exist_ok=True)
    for plan in todo:
        _check_target(plan.path, frame)
    for plan in todo:
        image = observe_frame(stored, plan.camera(spec), band=plan.band, seed=plan.seed)
        write_image(plan.path, image)
        size = f"{image.dn.shape[1]} x {image.dn.shape[0]}"
        print(f"{plan.path}: band {image.band}, seed {plan.seed}, {size}, full scale {image.full_scale}")


@app.command()
def sheet(
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGE...", help="Detector images (EXR), or folders of finished runs.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The sheet, a PNG file.")],
    columns: Annotated[int, typer.Option(min=1, max=40, help="Images in a row.")] = 5,
) -> None:
    """Contact sheet: detector images side by side in one picture, to look at."""
    from horizonval.report.contact_sheet import contact_sheet, tiles_of

    tiles = tiles_of(images)
    _check_target(out)
    for image in images:
        if image.is_file():
            _check_target(out, image)
    out.write_bytes(contact_sheet(tiles, columns))
    print(f"{out}: {len(tiles)} images")


@app.command()
def estimate(
    image: Annotated[
        list[Path],
        typer.Argument(help="EXR, PNG, TIFF or JPEG, 8 or 16 bit; for a method of several heads one EXR for each."),
    ],
    estimator: Annotated[str, typer.Option(help="Its name; see `horizonval list estimators`.")],
    camera: Annotated[str | None, typer.Option(help="Camera file or shipped name; our own EXR carry theirs.")] = None,
    as_json: Json = False,
) -> None:
    """One estimator on any image, also a real photograph.

    A refusal (any status other than `valid`) is a result like any other: exit status 0.
    """
    from horizonval.campaign.estimate import estimate_file, estimate_heads
    from horizonval.spec.load import load_camera

    spec = load_camera(camera) if camera is not None else None
    if len(image) == 1:
        report = estimate_file(image[0], estimator, spec, camera or "")
    elif spec is not None:
        raise UserError("used with several images", where="--camera", expected="our own EXR, which carry theirs")
    else:
        report = estimate_heads(image, estimator)
    if as_json:
        _print_json(report)
        return
    for key, value in report.items():
        if value is not None:
            print(f"{key:20} {_text(value)}")


@app.command()
def radiance(
    rays: Annotated[Path, typer.Argument(help="CSV: obs_x_km .. obs_z_km, dir_x .. dir_z, sun_x .. sun_z.")],
    atmosphere: Annotated[str, typer.Option(help="Atmosphere file (JSON), or the name of a shipped one.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="CSV: the input and one column per band.")],
    orders: Annotated[str, typer.Option(help="Orders of scattering: single or all.")] = "single",
    thermal: Annotated[bool, typer.Option("--thermal", help="Emission instead of scattered sunlight.")] = False,
    refraction: Annotated[
        bool, typer.Option("--refraction", help="Bend light by the atmosphere file's `refractivity`.")
    ] = False,
) -> None:
    """Radiance along given rays in a given atmosphere: the integrator alone.

    1/sr for unit solar irradiance; with --thermal W m-2 sr-1 um-1 at each band's wavelength.
    """
    if orders not in ("single", "all"):
        raise UserError(f"found {orders!r}", where="--orders", expected="single or all")
    from horizonval.campaign.rays import check_above_ground, read_rays, write_radiance
    from horizonval.earth.atmosphere_file import file_model, read_atmosphere
    from horizonval.spec.files import find

    table = read_rays(rays)
    path = find("atmosphere", atmosphere)
    file = read_atmosphere(path)
    check_above_ground(table, file.planet_radius_m, rays)
    _check_target(out)
    model = file_model(file, thermal=thermal, refracted=str(path) if refraction else "")
    values: dict[str, Any] = {band.name: [] for band in file.bands}
    if table.rows:
        from horizonval.render.backend import activate

        activate()
        from horizonval.campaign.progress import Tables
        from horizonval.render.multiple_scattering import FINE
        from horizonval.render.radiance import radiance_along_rays

        scattering = FINE if orders == "all" else None
        with Tables() as progress:
            values = radiance_along_rays(
                model,
                file.planet_radius_m,
                table.observer_m,
                table.direction,
                table.sun,
                scattering=scattering,
                progress=progress.advance,
            )
    write_radiance(out, table, values)
    print(f"{out}: {len(table.rows)} rays, bands {', '.join(values)}")


@app.command()
def report(run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]) -> None:
    """Make the report of a run again."""
    from horizonval.report import build_report

    if not run_folder.is_dir():
        raise UserError("no such folder", where=str(run_folder), expected="the folder of a run")
    print(f"report: {build_report(run_folder)}")
    if (run_folder / "study.json").is_file():
        from horizonval.report.study_page import write_page

        print(f"designs: {write_page(run_folder)}")


@app.command()
def study(
    study: Annotated[str, typer.Argument(help="A study file, the name of a shipped study, or a study's folder.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the study; made if need be.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; by default as many as processors.")] = None,
    shard: Annotated[
        str | None, typer.Option(metavar="I/N", help="Only every N-th frame from the I-th on; then run without it.")
    ] = None,
    merge: Annotated[
        list[Path] | None, typer.Option(metavar="DIR", help="Take over the frames of another folder; repeatable.")
    ] = None,
    dask: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler in place of own processes, or local:N.")
    ] = None,
    frames: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Frames of a design, in place of the study's number.")
    ] = None,
    compare: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="A B", help="Two designs, by name or number, frame by frame; with a study's folder."),
    ] = None,
    error_deg: Annotated[
        float | None, typer.Option(min=1e-6, help="Ask for another error than the study's; with its folder.")
    ] = None,
    availability: Annotated[
        float | None, typer.Option(min=1e-6, max=0.999999, help="The same for the availability, such as 0.95.")
    ] = None,
    as_json: Json = False,
) -> int:
    """Trade study: designs compared on the same frames; accuracy, availability, cost, and the cheapest that will do.

    With a file and --out it runs, or goes on, or adds what is new in the file: finished frames are kept. With the
    folder of a finished study it tells the cheapest design for an --error-deg and --availability, or compares two.
    Exit status 1 if a frame failed.
    """
    if out is None:
        running = {"--workers": workers, "--shard": shard, "--merge": merge, "--dask": dask, "--frames": frames}
        used = [name for name, value in running.items() if value]
        if used or not Path(study).is_dir():
            raise UserError(
                "missing", where="--out", expected="the folder of the study, or a folder in place of the file"
            )
        return _ask_study(Path(study), compare, error_deg, availability, as_json)
    for name, value in {"--compare": compare, "--error-deg": error_deg, "--availability": availability}.items():
        if value is not None:
            raise UserError(
                f"used with --out {out}", where=name, fix=f"run the study, then `horizonval study {out} {name}`"
            )
    from horizonval.campaign.plan import parse_shard
    from horizonval.campaign.progress import Terminal
    from horizonval.campaign.run import Where
    from horizonval.study.run import run_study

    where = Where(workers, None if shard is None else parse_shard(shard), dask, tuple(merge or ()))
    try:
        with Terminal("study") as progress:
            done = run_study(study, out, where=where, progress=progress, frames=frames)
    except KeyboardInterrupt:
        print("horizonval: interrupted; finished frames are kept, the same command goes on from here", file=sys.stderr)
        raise SystemExit(130) from None
    if as_json:
        _print_json(done.result)
    elif done.page is None:
        print(f"shard {shard} is done, {done.missing} results of others are missing; run without --shard to conclude")
    else:
        from horizonval.study.words import design_lines

        print("\n".join(design_lines(done.result, done.costs)))
        by = done.result["study"]["cheapest_by"]
        print((done.result if by == "pixel_rate" else done.costs)["query"]["text"])
        print(f"report: {done.page}")
    if done.failed:
        print(f"horizonval: {len(done.failed)} frames failed: {', '.join(done.failed)}", file=sys.stderr)
    return 1 if done.failed else 0


def _ask_study(
    folder: Path,
    compare: tuple[str, str] | None,
    error_deg: float | None,
    availability: float | None,
    as_json: bool,
) -> int:
    from horizonval.study.run import ask, conclude_again, open_study
    from horizonval.study.words import comparison_lines

    data = open_study(folder)
    changes = {"error_deg": error_deg, "availability": availability}
    wanted = {key: value for key, value in changes.items() if value is not None}
    requirement = data.plan.requirement.model_copy(update=wanted)
    if compare is not None:
        found = data.compare(*compare, requirement.error_deg)
        if as_json:
            _print_json(found)
        else:
            print("\n".join(comparison_lines(found)))
        return 0
    answer = ask(data, conclude_again(folder), requirement)
    if as_json:
        _print_json(answer)
    else:
        print(answer["text"])
    return 0


@app.command()
def reproduce(
    systems: Annotated[
        list[str] | None, typer.Argument(metavar="[A|B|C|D|E|all]...", help="Published systems; all by default.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the pages; made if need be.")] = ...,  # type: ignore[assignment]
    seed: Annotated[int, typer.Option(min=0, help="Of all noise in the experiments.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; by default as many as processors.")] = None,
    as_json: Json = False,
) -> int:
    """Published experiments done again: OUT/<X>.json and a page for each, published figures beside measured ones.

    The same command again, after whatever interrupted it, finishes what is missing. Exit status 1 if a bar is missed.
    """
    from horizonval.campaign.progress import Terminal
    from horizonval.reproduce.book import printed_rows
    from horizonval.reproduce.run import reproduce_systems

    done = {}
    try:
        with Terminal("reproduce", unit="items") as progress:
            for content in reproduce_systems(systems or [], out, seed=seed, workers=workers, progress=progress):
                done[content["system"]] = content
                if not as_json:
                    print("\n".join(printed_rows(content)), flush=True)
    except KeyboardInterrupt:
        print("horizonval: interrupted; the same command goes on from here", file=sys.stderr)
        raise SystemExit(130) from None
    if as_json:
        _print_json(done)
    else:
        print(f"pages: {out / 'README.md'}")
    return int(any(row["holds"] is False for content in done.values() for row in content["rows"]))


@archive_app.command("ls")
def archive_ls(
    folder: Archive,
    kind: Kind = None,
    scene: SceneGlob = None,
    camera: CameraGlob = None,
    head: HeadGlob = None,
    band: BandName = None,
    seed: SeedText = None,
    since: Since = None,
    until: Until = None,
    as_json: Json = False,
) -> None:
    """List the frames and images of an archive, from its index, which catches up with the files first."""
    from dataclasses import asdict

    store = _store(folder)
    wanted = _filter(kind, scene, camera, head, band, seed, since, until)
    entries = store.index.select(wanted, _told("reading headers"))
    if as_json:
        _print_json([asdict(entry) for entry in entries])
        return
    for e in entries:
        camera_name = f"{e.camera}.{e.head}" if e.head else e.camera
        seed_text = f" seed {e.seed}" if e.seed else ""
        print(
            f"{e.address[:16]}  {e.kind:8} {e.size_bytes / 1e6:7.2f} MB  {e.epoch_utc[:19]:19}  {camera_name:24} "
            f"{','.join(e.bands):12} {e.scene}{seed_text}"
        )
    if not entries and (count := len(store.index.known() or ())):
        print(f"horizonval: none of {count} entries is wanted", file=sys.stderr)


@archive_app.command("show")
def archive_show(
    folder: Annotated[Path, typer.Argument(help="An archive, the folder of a run, or one EXR file of ours.")],
    address: Annotated[str | None, typer.Argument(help="Of an archive: an address, or how it begins.")] = None,
    as_json: Json = False,
) -> None:
    """What one file says: standard attributes with their units, our own, channels; with --json the truth as well."""
    from horizonval.archive.show import shown

    content = shown(_file(folder, address))
    if as_json:
        _print_json(content)
        return
    for group in ("file", "standard", "horizonval"):
        for key, (value, unit) in content[group].items():
            numbers = value if isinstance(value, list) else [value]
            text = " ".join(f"{v:.9g}" if isinstance(v, float) else str(v) for v in numbers)
            print(f"{key:32} {text}{f' {unit}' if unit else ''}")
    print(f"{'channels':32} {' '.join(content['channels'])}")


@archive_app.command("verify")
def archive_verify(folder: Archive, as_json: Json = False) -> int:
    """Read everything and compare with checksums, index and the run's results; exit status 1 if anything is wrong."""
    from horizonval.campaign.named import named_addresses, run_folder_of

    store = _store(folder)
    run_folder = run_folder_of(store.root)
    named = named_addresses(run_folder) if run_folder else {}
    findings = store.verify(named, _told("verifying"))
    count = sum(1 for _ in store.entries())
    if as_json:
        problems = [
            {"path": str(f.path), "problem": f.problem, "address": f.address, "message": f.message} for f in findings
        ]
        _print_json({"entries": count, "problems": problems})
    else:
        for finding in findings:
            print(f"{finding.problem}: {finding.message}")
        print(f"{count} entries, {len(findings)} problem{'' if len(findings) == 1 else 's'}")
        if not store.index.path.is_file() and not named:
            print("without an index nobody knows of files that are gone; `horizonval archive reindex` makes one")
    return 1 if findings else 0


@archive_app.command("reindex")
def archive_reindex(folder: Archive) -> None:
    """Make the index anew, from the headers alone. What is missing by then is not missed any more."""
    store = _store(folder)
    print(f"{store.index.path}: {store.index.rebuild(_told('reading headers'))} entries")


@archive_app.command("export")
def archive_export(
    source: Annotated[Path, typer.Argument(help="An archive, the folder of a run, or one EXR file of ours.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the files; made if need be.")],
    fits: Annotated[bool, typer.Option("--fits", help="FITS, with units, camera and celestial coordinates.")] = False,
    png: Annotated[bool, typer.Option("--png", help="PNG of 16 bits; unit, scale and truth in a JSON file.")] = False,
    address: Annotated[list[str] | None, typer.Option(help="Only this one, by its beginning; repeatable.")] = None,
    kind: Kind = None,
    scene: SceneGlob = None,
    camera: CameraGlob = None,
    head: HeadGlob = None,
    band: BandName = None,
    seed: SeedText = None,
    since: Since = None,
    until: Until = None,
) -> None:
    """Frames and images as files of other programs."""
    from horizonval.archive.export import export_file

    if not (fits or png):
        raise UserError("which format?", where="archive export", expected="--fits, --png or both")
    wanted = _filter(kind, scene, camera, head, band, seed, since, until)
    if not source.is_dir():
        _refuse_filters(address, wanted)
        paths = [source]
    else:
        store = _store(source)
        chosen = {store.find(start) for start in address or ()}
        entries = [e for e in store.index.select(wanted) if not chosen or e.address in chosen]
        paths = [store.path(e.address) for e in entries if e.kind != "missing"]
    if not paths:
        raise UserError("nothing to export", where=str(source), fix="see `horizonval archive ls`")
    out.mkdir(parents=True, exist_ok=True)
    tell, count = _told("exporting"), 0
    for number, path in enumerate(paths, 1):
        count += len(export_file(path, out, fits=fits, png=png))
        tell(number, len(paths))
    print(f"{out}: {count} files of {len(paths)} {'entry' if len(paths) == 1 else 'entries'}")


@archive_app.command("gc")
def archive_gc(
    folder: Annotated[Path, typer.Argument(help="The folder of a run, or its archive.")],
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Remove without asking.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be removed, and leave it.")] = False,
) -> int:
    """Remove what no result of the run names, such as frames that other code rendered; never during a run."""
    from horizonval.campaign.named import garbage, remove, run_folder_of

    store = _store(folder, follow=False)
    run_folder = run_folder_of(store.root)
    if run_folder is None:
        raise UserError(
            "no run.json beside it, so that nothing says what is in use",
            where=str(store.root),
            expected="the archive of a run",
        )
    with run_folder.locked():
        found = garbage(run_folder)
        what = f"{len(found.files)} file{'' if len(found.files) == 1 else 's'}, {found.size_bytes / 1e6:.2f} MB"
        if not found.files:
            print(f"nothing to remove, {found.kept} entries are in use")
            return 0
        for path in found.files:
            print(path.relative_to(store.root))
        if dry_run:
            print(f"{what} would be removed, {found.kept} entries are in use")
            return 0
        if not yes and not _agreed(f"remove {what}? {found.kept} entries are in use and stay [y/N] "):
            print("nothing was removed")
            return 0
        remove(found, run_folder)
        print(f"{what} removed, {found.kept} entries are in use")
    return 0


@archive_app.command("rescore")
def archive_rescore(
    folder: Archive,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the results; made if need be.")],
    estimator: Annotated[
        list[str] | None,
        typer.Option(help="Repeatable; by default those of the run (`horizonval list estimators`)."),
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Estimates at a time; by default the processors.")] = None,
    time_limit: Annotated[float, typer.Option(min=0.1, metavar="S", help="Of one estimate.")] = 60.0,
    scene: SceneGlob = None,
    camera: CameraGlob = None,
    head: HeadGlob = None,
    band: BandName = None,
    seed: SeedText = None,
    since: Since = None,
    until: Until = None,
    as_json: Json = False,
) -> int:
    """Estimate and score the archived images again, without rendering: results, summary and report in OUT.

    The same command again, after whatever interrupted it, finishes what is missing. Exit status 1 if an image is
    damaged.
    """
    from horizonval.campaign.pool import available_cpus
    from horizonval.campaign.progress import Terminal
    from horizonval.campaign.rescore import rescore
    from horizonval.campaign.sandbox import Limits

    wanted = _filter("image", scene, camera, head, band, seed, since, until)
    try:
        with Terminal("rescore", "cases") as progress:
            done = rescore(
                _store(folder),
                out,
                tuple(estimator or ()),
                wanted,
                workers or available_cpus(),
                Limits(time_s=time_limit),
                progress,
            )
    except KeyboardInterrupt:
        print("horizonval: interrupted; the same command goes on from here", file=sys.stderr)
        raise SystemExit(130) from None
    if as_json:
        _print_json(done.summary)
    else:
        _print_summary(done.summary)
        print(f"report: {done.report}")
    for name, why in done.failed.items():
        print(f"horizonval: {name}: {why}", file=sys.stderr)
    return 1 if done.failed else 0


BASELINES = Path("results/baseline")
BaselineFile = Annotated[
    Path | None, typer.Option("--baseline", metavar="FILE", help="By default results/baseline/SUITE.json.")
]


@app.command()
def regress(
    suite: Annotated[
        str, typer.Argument(help="A suite with a [regression] table: a file or a shipped name.")
    ] = "nightly",
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the nights; made if need be.")] = Path("regress"),
    baseline: BaselineFile = None,
    lane: Annotated[
        list[str] | None, typer.Option(help="replay, rerender or fresh; repeatable. All by default.")
    ] = None,
    night: Annotated[str | None, typer.Option(metavar="DATE", help="Label and seed; today (UTC) by default.")] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Another version's folder of this night: pairs for fresh scenes.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; by default as many as processors.")] = None,
    as_json: Json = False,
) -> int:
    """Nightly verdict: is anything worse than the accepted baseline or the last release?

    Writes verdict.json, junit.xml and index.html. `--lane replay` alone is quick enough for every change. Exit status
    0 pass (or improved), 1 regression, 2 incomplete (no baseline, failed frames, wrong use), 3 inconclusive.
    """
    from datetime import UTC, datetime

    from horizonval.campaign.progress import Terminal
    from horizonval.regression.night import LANES, Wanted, run_night

    lanes = tuple(one for one in LANES if lane is None or one in lane)
    for one in lane or ():
        if one not in LANES:
            raise UserError(f"found {one!r}", where="--lane", expected=" or ".join(LANES))
    label = night or datetime.now(UTC).date().isoformat()
    file = baseline or BASELINES / f"{Path(suite).stem}.json"
    try:
        with Terminal(f"night {label}", "units") as progress:
            verdict = run_night(Wanted(suite, out, file, label, lanes, workers, reference), progress)
    except KeyboardInterrupt:
        print("horizonval: interrupted; finished units are kept, the same command goes on from here", file=sys.stderr)
        raise SystemExit(130) from None
    if as_json:
        _print_json(verdict)
    else:
        _print_verdict(verdict)
        print(f"report: {out / 'index.html'}")
    return int(verdict["exit_status"])


@baseline_app.command("accept")
def baseline_accept(
    run: Annotated[Path, typer.Argument(help="Folder of a night, as `regress` writes it.")],
    reason: Annotated[str, typer.Option(help="Why the results are right, for whoever reviews the change.")],
    baseline: BaselineFile = None,
    release: Annotated[bool, typer.Option("--release", help="Also as the last release's.")] = False,
) -> None:
    """Make a night the accepted baseline, and write the table of what differs from the one before."""
    from horizonval.campaign.folder import read_json
    from horizonval.regression.accept import accept

    name = (read_json(run / "night.json") or {}).get("suite", "nightly")
    for path in accept(run, baseline or BASELINES / f"{name}.json", reason, release=release):
        print(f"{path}: {path.stat().st_size / 1e3:.1f} kB")


@app.command()
def gallery(
    scenes: Annotated[
        list[str] | None, typer.Argument(metavar="[SCENE]...", help="Shipped scenes; all by default.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder of the page; made if need be.")] = Path("gallery"),
) -> None:
    """Pictures of the shipped scenes on one page: in colour, or as brightness temperatures in the infrared."""
    from horizonval.campaign.gallery import make_gallery

    def tell(name: str, number: int, count: int) -> None:
        print(f"{number} of {count}: {name}", file=sys.stderr)

    print(f"gallery: {make_gallery(out, scenes or [], tell)}")


@app.command()
def doctor(as_json: Json = False) -> int:
    """Say what works on this machine, and how to mend what does not. Exit status 1 if rendering is impossible."""
    from horizonval.campaign.doctor import examine

    found = examine()
    if as_json:
        _print_json(found)
    else:
        for label, text in found["facts"]:
            print(f"{label:24} {text}")
        for problem, fix in found["problems"]:
            print(f"problem: {problem}\n    to mend it: {fix}")
        print("ready" if found["can_render"] else "rendering is impossible here")
    return 0 if found["can_render"] else 1


@app.command("list")
def list_names(
    what: Annotated[str, typer.Argument(help="cameras, suites, studies, scenes, estimators or atmospheres.")],
    as_json: Json = False,
) -> None:
    """List the names that other commands take."""
    from horizonval.campaign.listing import LISTS
    from horizonval.suggest import nearest

    if what not in LISTS:
        raise UserError(
            f"nothing is called {what!r}", where="list", expected=f"one of {', '.join(nearest(what, LISTS))}"
        )
    names = LISTS[what]()
    if as_json:
        _print_json(names)
    else:
        for name in names:
            print(name)


def _write_frame(out: Path, frame: Any, start: float) -> None:
    from horizonval.archive.exr import write_frame

    write_frame(out, frame)
    height, width = next(iter(frame.radiance.values())).shape
    counts = frame.render.get("spectral_nodes", {})
    bands = ", ".join(f"{band} ({counts[band]} spectral nodes)" if band in counts else band for band in frame.radiance)
    print(f"{out}: {width} x {height}, bands {bands}, {time.perf_counter() - start:.1f} s")


def _size(text: str, where: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal() and 0 < int(width) <= 16384 and 0 < int(height) <= 16384):
        raise UserError(f"found {text!r}", where=where, expected="WIDTHxHEIGHT in pixels, such as 64x64")
    return int(width), int(height)


def _check_folder(out: Path) -> None:
    """Refuse a folder that is not new or empty: what lies there is not ours to overwrite."""
    if not out.parent.is_dir():
        raise UserError("no such folder", where=str(out.parent), fix="create it first")
    if out.exists() and not out.is_dir():
        raise UserError("is a file", where=str(out), expected="a new or empty folder")
    if out.is_dir() and any(out.iterdir()):
        raise UserError("is not empty", where=str(out), expected="a new or empty folder")


def _check_target(out: Path, source: Path | None = None) -> None:
    """Refuse a file that cannot be written before the work is done, not after."""
    if not out.parent.is_dir():
        raise UserError("no such folder", where=str(out.parent), fix="create it first")
    if out.is_dir():
        raise UserError("is a folder", where=str(out), expected="the path of a file")
    if source is not None and out.exists() and out.samefile(source):
        raise UserError("input and output are the same file", where=str(out))


def _store(folder: Path, *, follow: bool = True) -> Any:
    """Return the archive of a folder; ``follow``: of results that were scored again that of their images."""
    from horizonval.archive.store import Store
    from horizonval.campaign.folder import RunFolder, read_json

    inside = folder / "archive"
    elsewhere = (read_json(RunFolder(folder).suite) or {}).get("archive") if follow else None
    if isinstance(elsewhere, str):
        inside = folder / elsewhere
    root = inside if inside.is_dir() else folder
    expected = "an archive, or the folder of a run"
    if not root.is_dir():
        raise UserError("is a file" if root.exists() else "no such folder", where=str(folder), expected=expected)
    store = Store(root)
    if root.resolve().name != "archive" and not store.is_one():
        raise UserError("holds no archive", where=str(folder), expected=expected)
    return store


def _file(folder: Path, address: str | None) -> Path:
    """Return the file that an archive and an address name, or a path alone."""
    if not folder.is_dir():
        if address is not None:
            raise UserError("is a file, which needs no address", where=str(folder))
        return folder
    if address is None:
        raise UserError("which entry?", where=str(folder), expected="an address, see `horizonval archive ls`")
    store = _store(folder)
    path: Path = store.path(store.find(address))
    return path


def _filter(kind: str | None, *others: str | None) -> Any:
    from horizonval.archive.index import Filter

    if kind not in (None, "frame", "image"):
        raise UserError(f"found {kind!r}", where="--kind", expected="frame or image")
    return Filter(kind, *others)


def _refuse_filters(address: list[str] | None, wanted: Any) -> None:
    """Refuse filters of an archive where one file is named."""
    given = {"address": address, **vars(wanted)}
    for name, value in given.items():
        if value:
            raise UserError("used with one file", where=f"--{name}", expected="an archive, or the folder of a run")


def _told(what: str) -> Any:
    """Return what shows on a terminal how far long work has come; a log is told nothing, for it ends by itself."""
    shown = [time.monotonic()]

    def tell(number: int, count: int) -> None:
        if sys.stderr.isatty() and (time.monotonic() - shown[0] > 0.5 or (number == count and len(shown) > 1)):
            shown[:] = [time.monotonic(), 1.0]
            print(f"\r{what}: {number} of {count}", end="\n" if number == count else "", file=sys.stderr, flush=True)

    return tell


def _agreed(question: str) -> bool:
    if not sys.stdin.isatty():
        raise UserError("nobody is there to ask", where="archive gc", fix="add --yes, or look with --dry-run first")
    try:
        return input(question).strip().lower() in ("y", "yes")
    except (EOFError, KeyboardInterrupt):
        print()
        return False


def _print_summary(summary: dict[str, Any]) -> None:
    head = ("estimator", "camera", "frames", "available", "nadir rms", "median", "p95", "false valid")
    drawn = any(g["nees_noise"]["n"] for g in summary["groups"])
    rows = [(*head, "noise NEES / 2") if drawn else head]
    for g in summary["groups"]:
        error, available, false = g["nadir_error_arcsec"], g["availability"], g["false_valid"]
        rows.append(
            (
                g["estimator"],
                g["camera"],
                str(g["n"]),
                f"{available['n']}/{available['of']}",
                *(_arcsec(error[key]) for key in ("rms", "median", "p95")),
                f"{false['n']}/{false['of']}",
                *([_noise_nees(g["nees_noise"])] if drawn else []),
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def _noise_nees(found: dict[str, Any]) -> str:
    """Return the mean per degree of freedom with its standard error, 1 if the claimed noise is honest."""
    if not found["n"]:
        return "-"
    error = found["standard_error"]
    spread = "" if error is None else f" +- {error / found['expected']:.2f}"
    return f"{found['mean'] / found['expected']:.2f}{spread} ({found['n']} frames)"


def _print_study(digest: dict[str, Any]) -> None:
    for band in digest["bands"]:
        half, errors = band["half_km"], [f"{s['name']} {s['max_pitch_deg']:.3f}" for s in band["sensors"]]
        print(
            f"infrared horizon, {band['name']}: half plateau {half['min']:.1f} to {half['max']:.1f} km; "
            f"largest pitch error [deg]: {', '.join(errors)}"
        )


def _print_verdict(verdict: dict[str, Any]) -> None:
    from horizonval.regression.words import anchor_sentence, gate_sentence

    for gate in verdict["gates"]:
        print(f"{gate['verdict']:12} {gate['name']} ({gate['against']}): {gate_sentence(gate)}")
    for anchor in verdict["anchors"]:
        print(f"{anchor['verdict']:12} anchor {anchor['name']}: {anchor_sentence(anchor)}")
    for problem in verdict["problems"]:
        print(f"problem: {problem}")
    for step in verdict["trend"]:
        print(
            f"step: {step['figure']} from {step['before']:.4g} to {step['after']:.4g} {step['unit']} on {step['night']}"
        )
    print(f"night {verdict['night']}: {verdict['verdict']}{'' if verdict['complete'] else ', incomplete'}")


def _arcsec(value: float | None) -> str:
    return "-" if value is None else f'{value:.1f}"'


def _text(value: object) -> str:
    if isinstance(value, list):
        return " ".join(_text(v) for v in value)
    return f"{value:.6f}" if isinstance(value, float) else str(value)
