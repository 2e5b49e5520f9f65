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
archive_app = typer.Typer(help="Look into the archive of a run.", rich_markup_mode=None)
app.add_typer(archive_app, name="archive")

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
    folder, at the same time or not; the command without --shard then makes what is missing and the report. Exit status
    1 if a frame failed.
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
    folder: Annotated[Path, typer.Argument(help="An archive, or the folder of a run.")], as_json: Json = False
) -> None:
    """List the frames and images of an archive."""
    from dataclasses import asdict

    entries = list(_store(folder).entries())
    if as_json:
        _print_json([asdict(entry) for entry in entries])
        return
    for e in entries:
        print(
            f"{e.address[:16]}  {e.kind:8} {e.size_bytes / 1e6:7.2f} MB  {e.camera:24} {','.join(e.bands):12} {e.scene}"
        )


@archive_app.command("verify")
def archive_verify(
    folder: Annotated[Path, typer.Argument(help="An archive, or the folder of a run.")], as_json: Json = False
) -> int:
    """Read everything and compare with its checksums; exit status 1 if anything is wrong."""
    store = _store(folder)
    findings = store.verify()
    count = sum(1 for _ in store.entries())
    if as_json:
        problems = [{"path": str(f.path), "problem": f.problem, "message": f.message} for f in findings]
        _print_json({"entries": count, "problems": problems})
    else:
        for finding in findings:
            print(f"{finding.problem}: {finding.message}")
        print(f"{count} entries, {len(findings)} problem{'' if len(findings) == 1 else 's'}")
    return 1 if findings else 0


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


def _store(folder: Path) -> Any:
    from horizonval.archive.store import Store

    inside = folder / "archive"
    root = inside if inside.is_dir() else folder
    if not root.is_dir():
        raise UserError("no such folder", where=str(folder), expected="an archive, or the folder of a run")
    return Store(root)


def _print_summary(summary: dict[str, Any]) -> None:
    head = ("estimator", "camera", "frames", "available", "nadir rms", "median", "p95", "false valid")
    rows = [head]
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
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def _print_study(digest: dict[str, Any]) -> None:
    for band in digest["bands"]:
        half, errors = band["half_km"], [f"{s['name']} {s['max_pitch_deg']:.3f}" for s in band["sensors"]]
        print(
            f"infrared horizon, {band['name']}: half plateau {half['min']:.1f} to {half['max']:.1f} km; "
            f"largest pitch error [deg]: {', '.join(errors)}"
        )


def _arcsec(value: float | None) -> str:
    return "-" if value is None else f'{value:.1f}"'


def _text(value: object) -> str:
    if isinstance(value, list):
        return " ".join(_text(v) for v in value)
    return f"{value:.6f}" if isinstance(value, float) else str(value)
