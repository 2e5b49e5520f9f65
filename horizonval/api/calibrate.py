"""Calibration of cameras from limb images, and import of other programs' calibrations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.api.camera import Camera
from horizonval.api.estimate import observation_from
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.outcome import Refusal
from horizonval.core.progress import Progress
from horizonval.estimation.fit.bundle import TURN
from horizonval.estimation.fit.calibrate import BEND, FOCAL, POINT, CameraCalibration
from horizonval.estimation.fit.calibrate import calibrate as calibrate_camera
from horizonval.estimation.methods import limb_ellipsoid
from horizonval.estimation.observation import Calibration, Observation
from horizonval.formats.csv_table import CsvTable, read_csv
from horizonval.formats.lens import read_camera
from horizonval.geometry.camera import (
    CameraModel,
    camera_from_spec,
    camera_table,
    check_invertible,
    field_angles,
    unproject,
)
from horizonval.jobs.progress import shown
from horizonval.plugins.program import camera_file
from horizonval.report.rerun import toml
from horizonval.sensor.lens.optics import relative_illumination
from horizonval.spec.camera import CameraSpec
from horizonval.spec.files import find
from horizonval.spec.load import read_camera_tables, validate
from horizonval.spec.prior import PriorSpec
from horizonval.store.folder import RunFolder
from horizonval.store.store import Store

PLACES, SHARES = ("field_deg", "radius_px"), ("relative_illumination", "vignetting")
BRIGHTER = 1.02
"""Maximum transmission relative to the law of the pupil, with a margin for measurement errors."""


def calibrate(
    images: Sequence[Path],
    camera: Camera | None = None,
    known: PriorSpec | None = None,
    *,
    part: str | int | None = None,
    orientation: str | None = None,
    progress: bool | Progress = True,
) -> tuple[dict[str, Any], str | None]:
    """Return focal length, principal point and mounting from the limbs in the images of a pass.

    Parameters
    ----------
    images : sequence of Path
        Images of one camera, or folders of runs with an archive.
    camera : Camera, optional
        Initial camera; images of this package carry theirs.
    known : PriorSpec, optional
        Position and attitude with their sigmas; replaces those in the files.
    part, orientation : optional
        As for :func:`horizonval.estimate`, for all images.
    progress : bool or Progress

    Returns
    -------
    report : dict
        The calibration or its refusal as plain data.
    text : str or None
        The calibrated camera file; None after a refusal.
    """
    observations = observations_of(images, camera, known, part, orientation)
    with shown(progress, "calibrate", "images") as listener:
        found = calibrate_camera(observations, listener)
    report = report_of(found)
    if isinstance(found, Refusal):
        return report, None
    sigma = report["principal_point_sigma_px"]
    left = Calibration(float(found.sigma[FOCAL]), max(sigma), float(found.sigma[BEND]))
    text = camera_file(replace(observations[0], camera=found.camera, calibration=left))
    lines = [
        f"# Focal length to {report['focal_length_sigma_percent']:.2g} %, principal point to {sigma[0]:.2g} and "
        f"{sigma[1]:.2g} px, of {found.frames} frames.",
        f"# Mounting, q_cam_from_body, scalar last: {[round(float(q), 9) for q in found.q_cam_from_body]}",
    ]
    if found.not_determined:
        lines.append(f"# Not determined, as the priors say: {', '.join(found.not_determined)}")
    return report, "\n".join(lines) + "\n" + text


def images_of(paths: Sequence[Path]) -> list[Path]:
    """Return the given files, and for a run's folder all its detector images in the order of their times.

    Raises ``UserError``: a folder without an archive of images.
    """
    found: list[Path] = []
    for path in paths:
        if not path.is_dir():
            found.append(path)
            continue
        archive = RunFolder(path).archive
        entries = [] if not archive.exists() else Store(archive).index.select()
        images = [Store(archive).path(entry.address) for entry in entries if entry.kind == "image"]
        if not images:
            raise UserError("no images in this folder", where=str(path), expected="a run's folder with its archive")
        found += images
    return found


def observations_of(
    paths: Sequence[Path],
    camera: Camera | None = None,
    known: PriorSpec | None = None,
    part: str | int | None = None,
    orientation: str | None = None,
) -> list[Observation]:
    """Return the observations of a calibration; parameters as for :func:`calibrate`."""
    method = limb_ellipsoid.ESTIMATOR
    found = [observation_from(path, method, camera, known, part, orientation)[0] for path in images_of(paths)]
    if camera is not None and camera.spec.camera.uncertainty is None:
        # The defaults are of a calibrated camera, which this one is not yet.
        found = [replace(one, calibration=None) for one in found]
    return found


def report_of(found: CameraCalibration | Refusal) -> dict[str, Any]:
    """Return a calibration or a refusal as plain data."""
    if isinstance(found, Refusal):
        return {"status": str(found.status), "reason": found.reason}
    sigma, change = found.sigma, found.change
    u, v = sigma[POINT]
    camera = found.camera
    table = camera_table(camera)
    return {
        "status": "valid",
        "frames": found.frames,
        "left_out": list(found.left_out),
        **{key: table[key] for key in ("fx", "fy", "cx", "cy")},
        "distortion": list(camera.distortion) if camera.classic else table["distortion"],
        "q_cam_from_body": found.q_cam_from_body.tolist(),
        "focal_length_change_percent": 100.0 * math.expm1(change[FOCAL]),
        "focal_length_sigma_percent": 100.0 * float(sigma[FOCAL]),
        "principal_point_sigma_px": [float(u), float(v)],
        "mounting_change_deg": [math.degrees(x) for x in change[TURN]],
        "mounting_sigma_deg": [math.degrees(x) for x in sigma[TURN]],
        "limb_height_change_km": found.height_m / 1e3,
        "limb_height_sigma_km": found.height_sigma_m / 1e3,
        "not_determined": list(found.not_determined),
    }


def camera_text(
    path: Path,
    camera: str | None = None,
    base: str | None = None,
    vignetting: Path | None = None,
    model: str | None = None,
    image_circle_deg: float | None = None,
) -> str:
    """Return the text of a camera file; comments at its beginning say what was assumed or applied.

    Raises ``UserError``: a mistake, with file and key.

    Parameters
    ----------
    path : Path
        Camera file of ROS, Kalibr, OpenCV, Basalt, camodocal or MATLAB.
    camera : str, optional
        Name of one of several cameras in it.
    base : str, optional
        Camera of this package, by name or file, from which all tables but ``[camera]`` are taken.
    vignetting : Path, optional
        Table of ``field_deg`` or ``radius_px``, the distance from the principal point along its row, and either
        ``relative_illumination``, the total loss towards the edge, or ``vignetting``, the loss beyond the law of the
        pupil.
    model : str, optional
        ``pinhole`` or ``fisheye`` where the file has coefficients without a model.
    image_circle_deg : float, optional
        Full angle of the field that the lens fills, where it does not fill the image.
    """
    found, program = read_camera(path, camera, model)
    data: dict[str, Any] = {} if base is None else read_camera_tables(find("camera", base))
    data["camera"] = found.table(f"{program}: {path.name}")
    if image_circle_deg is not None:
        data["camera"]["image_circle_deg"] = image_circle_deg
    spec = validate(CameraSpec, data, str(path))
    check_invertible(camera_from_spec(spec.camera), f"{path}: distortion")
    if vignetting is not None:
        optics = dict(data.get("optics", {}))
        for key in ("vignetting_deg", "vignetting"):
            optics.pop(key, None)
        data["optics"] = optics
        spec = validate(CameraSpec, data, str(path))
        optics["vignetting_deg"], optics["vignetting"] = _vignetting(vignetting, spec)
        validate(CameraSpec, data, str(vignetting))
    # The camera comes first, as in every shipped file.
    return "".join(f"# {note}\n" for note in found.notes) + toml({"camera": data.pop("camera"), **data})


def _vignetting(path: Path, spec: CameraSpec) -> tuple[list[float], list[float]]:
    """Return field angles [deg] and the transmission of the lens there relative to the law of its pupil."""
    table = read_csv(path, *((place, share) for place in PLACES for share in SHARES))
    camera = camera_from_spec(spec.camera)
    place, key = (next(name for name in names if name in table.numbers) for names in (PLACES, SHARES))
    whole, share = key == SHARES[0], table.numbers[key]
    at = table.numbers[place]
    for row, (here, before) in enumerate(zip(at[1:], at[:-1], strict=True), 1):
        if here <= before:
            raise UserError(f"{here:g} after {before:g}", where=table.place(row, place), expected="rising numbers")
    angle = at if place == PLACES[0] else _angles_deg(table, camera)
    if whole:
        law_angle = np.degrees(field_angles(camera)).ravel()
        law = relative_illumination(camera, spec.optics).ravel()
        seen = np.isfinite(law_angle)
        order = np.argsort(law_angle[seen])
        corner = float(law_angle[seen].max())
        if angle[0] > corner:
            raise UserError(f"begins at {angle[0]:g} deg", where=str(path), expected=f"angles up to {corner:.4g} deg")
        kept = angle <= corner
        angle = angle[kept]
        share = share[kept] / share[0] / np.interp(angle, law_angle[seen][order], law[seen][order])
    high = int(np.argmax(share))
    if not (float(share.min()) >= 0.0 and float(share[high]) <= BRIGHTER):
        raise UserError(
            f"{share[high]:.4g} times the law of the pupil at {angle[high]:g} deg",
            where=f"{path}: {key}",
            expected="0 to 1",
            fix='optics.pupil = "constant" in the --base is the law of lenses whose pupil turns towards the light',
        )
    return [float(a) for a in angle], [round(min(float(s), 1.0), 6) for s in share]


def _angles_deg(table: CsvTable, camera: CameraModel) -> FloatArray:
    """Return the field angles of radii from the principal point, along its row."""
    radius = table.numbers["radius_px"]
    directions = unproject(camera, np.stack([camera.cx + radius, np.full(len(radius), camera.cy)], axis=1))
    across = np.hypot(directions[:, 0], directions[:, 1])
    angle = np.degrees(np.arctan2(across, directions[:, 2]))
    row = int(np.argmin((radius >= 0.0) & np.isfinite(angle)))
    if not (radius[row] >= 0.0 and np.isfinite(angle[row])):
        raise UserError(
            f"found {radius[row]:g}",
            where=table.place(row, "radius_px"),
            expected="0 and more, up to where the lens has a picture",
        )
    return np.asarray(angle)
