"""Images and cameras: detector images, sheets, estimates, calibration."""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from horizonval.cli.options import CameraName, Json, Orientation, Part, PriorFile, estimators, shipped
from horizonval.cli.output import check_target, print_json, print_result, watched, written
from horizonval.core import atomic
from horizonval.core.errors import UserError, printable

if TYPE_CHECKING:
    from horizonval.spec.camera import CameraSpec

MOST_IMAGES = 10_000


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
    from horizonval.scoring.information import informed
    from horizonval.store.exr import write_image

    stored = hv.open_frame(frame)
    seen_by = stored.camera if camera is None else hv.Camera.from_file(camera)
    todo = plans(out, seed or [], exposure or [], band or [], seen_by.spec)
    if todo[0].path.parent == Path(out):
        Path(out).mkdir(exist_ok=True)
    for plan in todo:
        check_target(plan.path)
    for plan in todo:
        image = stored.observe(plan.seed, band=plan.band, camera=hv.Camera(plan.camera(seen_by.spec)))
        with written(plan.path) as path:
            write_image(path, informed(image, stored))
        size = f"{image.dn.shape[1]} x {image.dn.shape[0]}"
        print(f"{plan.path}: band {image.band}, seed {plan.seed}, {size}, full scale {image.full_scale}")


def sheet(
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGE...", help="Detector images (EXR), or folders of finished runs.")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="The sheet, a PNG file.")],
    columns: Annotated[int, typer.Option(min=1, max=40, help="Images in a row.")] = 5,
) -> None:
    """Contact sheet: detector images side by side in one picture."""
    from horizonval.report.pictures import contact_sheet, tiles_of

    check_target(out, *images)
    tiles = tiles_of(images)
    with written(out) as path:
        atomic.write_bytes(path, contact_sheet(tiles, columns))
    print(f"{out}: {len(tiles)} images")


def oracle(
    image: Annotated[
        list[Path], typer.Argument(help="Frames or detector images of ours (EXR); of several a line each.")
    ],
    as_json: Json = False,
) -> None:
    """Readings of an ideal horizon sensor at the pose of an image; pixels are not used.

    Roll and pitch errors against the nearest point of the horizon, and the elevations of the sensor's axes over the
    tangent plane there: both readings of the published module's documentation. With --json a list, one object per
    image.
    """
    from horizonval.api.estimate import horizon_report

    readings = [{"file": str(path), **horizon_report(path)} for path in image]
    print_result(readings, as_json, map(_reading, readings))


def _reading(reading: dict[str, Any]) -> str:
    if reading["roll_error_deg"] is None:
        return f"{reading['file']}: no nearest horizon point: {reading['status']}"
    errors = f"roll error {reading['roll_error_deg']:.6f}, pitch error {reading['pitch_error_deg']:.6f} deg"
    other = f"elevations {reading['roll_elevation_deg']:.6f}, {reading['pitch_elevation_deg']:.6f} deg"
    return f"{reading['file']}: {errors} (other reading: {other})"


def estimate(
    image: Annotated[
        list[Path],
        typer.Argument(
            help="EXR, PNG, TIFF, JPEG, FITS, NumPy, CSV; of several a line each, or for a method of several heads "
            "one for each."
        ),
    ],
    estimator: Annotated[
        str,
        typer.Option(help="Its name; see `horizonval list estimators`. Or an ONNX file.", autocompletion=estimators),
    ],
    camera: CameraName = None,
    suite: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="Suite or study whose [[estimator]] table the estimator is: a program."),
    ] = None,
    prior: PriorFile = None,
    part: Part = None,
    orientation: Orientation = None,
    as_json: Json = False,
) -> int:
    """One estimator on any image, also a real photograph; with the error of the answer for our own files.

    The truth in our files is compared with the answer, and not given to the estimator; `assumed` lists what was given.
    A refusal (any status other than `valid`) is a normal result: exit status 0. Unreadable images among several are
    reported and skipped, with exit status 1.
    """
    import horizonval as hv
    from horizonval.api.estimate import estimate_report, estimator_of, prior_from

    method = estimator_of(estimator, suite)
    taken_by = hv.Camera.from_file(camera) if camera is not None else None
    known = prior_from(prior) if prior is not None else None

    def report_of(images: Path | list[Path]) -> dict[str, Any]:
        return estimate_report(images, method, camera=taken_by, prior=known, part=part, orientation=orientation)

    if len(image) > 1 and method.needs != "heads":
        return _each(image, report_of, as_json)
    report = report_of(image[0] if len(image) == 1 else image)
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
    """Return the answer, its claimed uncertainty and its error as a line."""
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


def calibrate(
    images: Annotated[
        list[Path],
        typer.Argument(help="Images of one camera, or folders of runs with an archive."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Camera file to write; the --camera of estimates."),
    ] = None,
    camera: CameraName = None,
    prior: PriorFile = None,
    part: Part = None,
    orientation: Orientation = None,
    as_json: Json = False,
) -> int:
    """Focal length, principal point and mounting from the limbs in the images of a pass.

    Needs position and attitude for every image, as the platform states them. If the images do not determine the focal
    length, the result is a refusal with its reason: no file is written, and the exit status is 1.
    """
    import horizonval as hv
    from horizonval.api.calibrate import calibrate as calibrated
    from horizonval.api.estimate import prior_from

    if out is not None:
        check_target(out, *images, camera, prior)
    believed = hv.Camera.from_file(camera) if camera is not None else None
    known = prior_from(prior) if prior is not None else None
    with watched("calibrate", "images") as progress:
        report, text = calibrated(images, believed, known, part=part, orientation=orientation, progress=progress)
    if out is not None and text is not None:
        with written(out) as path:
            atomic.write_text(path, text)
    print_result(report, as_json, (f"{key:28} {value}" for key, value in report.items()))
    return 0 if text is not None else 1


def camera(
    file: Annotated[Path, typer.Argument(help="File of ROS, OpenCV, Kalibr, Basalt, camodocal or MATLAB (JSON).")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Camera file to write; without, it is printed.")
    ] = None,
    base: Annotated[
        str | None,
        typer.Option(
            help="Camera of ours whose bands, optics and detector it takes.", autocompletion=shipped("camera")
        ),
    ] = None,
    vignetting: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Table of field_deg or radius_px, and relative_illumination or vignetting."),
    ] = None,
    name: Annotated[
        str | None, typer.Option("--camera", help="Of several cameras in one file, as cam0 (Kalibr) or 1 (M1).")
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="pinhole or fisheye, where the file has coefficients without a model.")
    ] = None,
    image_circle_deg: Annotated[
        float | None, typer.Option(metavar="DEG", help="Full angle that the lens fills, if not the whole image.")
    ] = None,
) -> None:
    """Convert the camera file of a calibration program: the exact lens, or why it cannot be represented.

    Without --base the file has the lens alone, which is enough for `horizonval estimate --camera`.
    """
    from horizonval.api.calibrate import camera_text

    if out is not None:
        check_target(out, file, base, vignetting)
    text = camera_text(file, name, base, vignetting, model, image_circle_deg)
    for line in text.splitlines():
        if line.startswith("# "):
            print(printable(f"horizonval: note: {file}: {line[2:]}"), file=sys.stderr)
    if out is None:
        print(text, end="")
    else:
        with written(out) as path:
            atomic.write_text(path, text)


@dataclass(frozen=True)
class ImagePlan:
    """One image to make; ``exposure_s`` and ``band`` None mean the camera file's."""

    path: Path
    seed: int
    exposure_s: float | None
    band: str | None

    def camera(self, camera: CameraSpec) -> CameraSpec:
        """Return the camera with this exposure, automatic exposure off."""
        if self.exposure_s is None or camera.detector is None:
            return camera
        changes = {"exposure_s": self.exposure_s, "auto_exposure": None}
        return camera.model_copy(update={"detector": camera.detector.model_copy(update=changes)})


def plans(
    out: str, seeds: Sequence[str], exposures: Sequence[str], bands: Sequence[str], camera: CameraSpec
) -> list[ImagePlan]:
    """Return the requested images, one for every combination of options; ``out`` is a path, pattern or folder.

    Empty lists mean seed 0, the camera's exposure, its first band. Raises ``UserError``: text that is not a number, an
    exposure for a detector without one, or two images of one name.
    """
    chosen_seeds = _seeds(seeds) or [0]
    chosen_exposures: Sequence[float | None] = _exposures(exposures, camera) or [None]
    chosen_bands: Sequence[str | None] = list(dict.fromkeys(_split(bands))) or [None]
    count = len(chosen_seeds) * len(chosen_exposures) * len(chosen_bands)
    if count > MOST_IMAGES:
        raise UserError(f"{count} images", where="--seed", expected=f"at most {MOST_IMAGES} in one command")
    lists = {"band": chosen_bands, "exposure": chosen_exposures, "seed": chosen_seeds}
    differ = [f"{{{name}}}" for name, values in lists.items() if len(values) > 1]
    if differ and "{" not in out and (Path(out).is_dir() or not Path(out).suffix):
        # A folder: file names contain the options that differ.
        out = str(Path(out) / ("-".join(differ) + ".exr"))
    images = [
        ImagePlan(Path(_filled(out, camera, band, exposure, seed)), seed, exposure, band)
        for band, exposure, seed in itertools.product(chosen_bands, chosen_exposures, chosen_seeds)
    ]
    if len({plan.path for plan in images}) < count:
        raise UserError(
            f"{count} images would overwrite each other in {out!r}",
            where="--out",
            fix=f"put {' and '.join(differ)} into the name, or name a folder",
        )
    return images


def _split(texts: Sequence[str]) -> list[str]:
    return [part.strip() for text in texts for part in text.split(",")]


def _seeds(texts: Sequence[str]) -> list[int]:
    seeds: dict[int, None] = {}
    for part in _split(texts):
        match = re.fullmatch(r"(\d{1,9})(?:-(\d{1,9}))?", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if last < first:
            raise UserError(f"found {part!r}", where="--seed", expected="numbers from 0 up, or ranges such as 0-9")
        if last - first >= MOST_IMAGES:
            raise UserError(f"{part} are too many", where="--seed", expected=f"at most {MOST_IMAGES} in one command")
        seeds |= dict.fromkeys(range(first, last + 1))
    return list(seeds)


def _exposures(texts: Sequence[str], camera: CameraSpec) -> list[float]:
    from horizonval.spec.detector import LONGEST_EXPOSURE_S

    exposures: dict[float, None] = {}
    for part in _split(texts):
        try:
            seconds = float(part)
        except ValueError:
            seconds = -1.0
        if not 0 < seconds <= LONGEST_EXPOSURE_S:
            raise UserError(
                f"found {part!r}",
                where="--exposure",
                expected=f"seconds above 0 and of at most {LONGEST_EXPOSURE_S:g}, such as 1e-3",
            )
        exposures[seconds] = None
    if exposures and getattr(camera.detector, "exposure_s", None) is None:
        kind = "no detector" if camera.detector is None else f"a detector of kind {camera.detector.kind!r}"
        raise UserError(f"the camera has {kind}, which has no exposure", where="--exposure", fix="leave it out")
    return list(exposures)


def _filled(pattern: str, camera: CameraSpec, band: str | None, exposure_s: float | None, seed: int) -> str:
    seconds = exposure_s or getattr(camera.detector, "exposure_s", 0.0)
    name = band or (camera.band[0].name if camera.band else "")
    try:
        return pattern.format(band=name, exposure=f"{seconds:.9g}", seed=seed)
    except (ValueError, LookupError, AttributeError) as e:
        raise UserError(f"found {pattern!r}", where="--out", expected="{seed}, {exposure}, {band} or none") from e
