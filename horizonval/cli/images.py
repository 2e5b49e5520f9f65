"""Detector images: made of a frame, looked at, estimated from."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from horizonval.cli.checks import check_target
from horizonval.cli.options import Json
from horizonval.cli.options.completion import estimators, files, shipped
from horizonval.cli.printing import print_json
from horizonval.core import atomic
from horizonval.core.errors import UserError


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
        str | None,
        typer.Option(
            help="Another camera file or name of the same image geometry and bands.", autocompletion=shipped("camera")
        ),
    ] = None,
) -> None:
    """Detector images of a stored frame, without rendering again: one for every seed, exposure and band."""
    import horizonval as hv
    from horizonval.commands.observing import plans
    from horizonval.scoring.information import informed
    from horizonval.store.exr import write_image

    stored = hv.open_frame(frame)
    seen_by = stored.camera if camera is None else hv.Camera.from_file(camera)
    todo = plans(out, seed or [], exposure or [], band or [], seen_by.spec)
    if todo[0].path.parent == Path(out):
        Path(out).mkdir(exist_ok=True)
    for plan in todo:
        check_target(plan.path, frame)
    for plan in todo:
        image = stored.observe(plan.seed, band=plan.band, camera=hv.Camera(plan.camera(seen_by.spec)))
        write_image(plan.path, informed(image, stored))
        size = f"{image.dn.shape[1]} x {image.dn.shape[0]}"
        print(f"{plan.path}: band {image.band}, seed {plan.seed}, {size}, full scale {image.full_scale}")


def sheet(
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGE...", help="Detector images (EXR), or folders of finished runs.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The sheet, a PNG file.")],
    columns: Annotated[int, typer.Option(min=1, max=40, help="Images in a row.")] = 5,
) -> None:
    """Contact sheet: detector images side by side in one picture, to look at."""
    from horizonval.report.pages.contact_sheet import contact_sheet, tiles_of

    tiles = tiles_of(images)
    check_target(out)
    for image in images:
        if image.is_file():
            check_target(out, image)
    atomic.write_bytes(out, contact_sheet(tiles, columns))
    print(f"{out}: {len(tiles)} images")


def oracle(
    image: Annotated[
        list[Path], typer.Argument(help="Frames or detector images of ours (EXR); of several a line each.")
    ],
    as_json: Json = False,
) -> None:
    """What an ideal horizon sensor reads where an image was taken, from the pose in its header; pixels are not looked
    at.

    Roll and pitch errors against the nearest point of the horizon, and the elevations of the sensor's axes over the
    tangent plane there: both readings of the published module's documentation. With --json a list, one object an image.
    """
    from horizonval.commands.oracle import oracle_of_file

    readings = [oracle_of_file(path) for path in image]
    if as_json:
        print_json(readings)
        return
    for reading in readings:
        if reading["roll_error_deg"] is None:
            print(f"{reading['file']}: no nearest horizon point: {reading['status']}")
            continue
        errors = f"roll error {reading['roll_error_deg']:.6f}, pitch error {reading['pitch_error_deg']:.6f} deg"
        other = f"elevations {reading['roll_elevation_deg']:.6f}, {reading['pitch_elevation_deg']:.6f} deg"
        print(f"{reading['file']}: {errors} (other reading: {other})")


def estimate(
    image: Annotated[
        list[Path],
        typer.Argument(
            help="EXR, PNG, TIFF, JPEG, FITS; of several a line each, or for a method of several heads one for each."
        ),
    ],
    estimator: Annotated[
        str,
        typer.Option(help="Its name; see `horizonval list estimators`. Or an ONNX file.", autocompletion=estimators),
    ],
    camera: Annotated[
        str | None,
        typer.Option(help="Camera file or shipped name; our own files carry theirs.", autocompletion=shipped("camera")),
    ] = None,
    suite: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Suite or study whose [[estimator]] table the estimator is: a program."),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="File of a table [prior]: what is known beside the image; see `horizonval schema prior`.",
            autocompletion=files(".toml"),
        ),
    ] = None,
    as_json: Json = False,
) -> int:
    """One estimator on any image, also a real photograph; of our own files also how far off the answer is.

    The truth in a file of ours is compared with the answer, and never given to the estimator; `assumed` says what was.
    A refusal (any status
    other than `valid`) is a result like any other: exit status 0. Of several images one that cannot be read is said,
    the others are done, and the exit status is 1.
    """
    from horizonval.commands.estimate import estimate_file, estimate_heads, estimator_of, prior_from
    from horizonval.spec.load import load_camera

    method = estimator_of(estimator, suite)
    spec = load_camera(camera) if camera is not None else None
    known = prior_from(prior) if prior is not None else None
    if len(image) > 1 and method.needs != "heads":
        return _each(image, lambda path: estimate_file(path, method, spec, camera or "", known), as_json)
    if len(image) == 1:
        report = estimate_file(image[0], method, spec, camera or "", known)
    elif spec is not None:
        raise UserError("used with several images", where="--camera", expected="our own EXR, which carry theirs")
    else:
        report = estimate_heads(image, method, known)
    if as_json:
        print_json(report)
        return 0
    for key, value in report.items():
        if key == "output":
            print("\n" + str(value))
        elif value is not None:
            print(f"{key:20} {_text(value)}")
    return 0


def _each(images: list[Path], estimated: Callable[[Path], dict[str, Any]], as_json: bool) -> int:
    """Print a line for every image, or with ``as_json`` a list of all; return the exit status."""
    reports = []
    for path in images:
        try:
            report = {"image": str(path)} | estimated(path)
        except UserError as e:
            print(f"horizonval: {e.line()}", file=sys.stderr)
            continue
        reports.append(report)
        if not as_json:
            print(f"{path}: {_line(report)}", flush=True)
    if as_json:
        print_json(reports)
    return 0 if len(reports) == len(images) else 1


def _line(report: dict[str, Any]) -> str:
    """Return the answer, what it claims of itself, and how far off it is, on a line."""
    parts = [report["status"]]
    if report["reason"]:
        parts.append(report["reason"])
    for key, unit in (("roll_deg", "deg"), ("pitch_deg", "deg"), ("altitude_km", "km")):
        if report[key] is not None:
            parts.append(f"{key.rpartition('_')[0]} {report[key]:.6f} {unit}")
    if report["sigma_nadir_arcsec"] is not None:
        parts.append(f"claimed {report['sigma_nadir_arcsec']:.1f} arcsec")
    if report["nadir_error_arcsec"] is not None:
        parts.append(f"off by {report['nadir_error_arcsec']:.1f} arcsec")
    if report["false_valid"]:
        parts.append("a false claim")
    return ", ".join(parts)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return " ".join(_text(v) for v in value)
    return f"{value:.6f}" if isinstance(value, float) else str(value)
