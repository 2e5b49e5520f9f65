"""A camera calibrated from the limbs in the images of a pass."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from horizonval.commands.estimate import observation_from
from horizonval.commands.picture import read_picture
from horizonval.core.errors import UserError
from horizonval.core.outcome import Refusal
from horizonval.core.progress import Progress
from horizonval.estimation.likelihood.calibration.shared import FOCAL, POINT, TURN
from horizonval.estimation.likelihood.calibration.solve import CameraCalibration, calibrate
from horizonval.estimation.methods import limb_ellipsoid
from horizonval.estimation.observation import Observation
from horizonval.estimation.process.external import camera_file
from horizonval.spec.camera import CameraSpec
from horizonval.spec.prior import PriorSpec
from horizonval.store.folder import RunFolder
from horizonval.store.store import Store


def images_of(paths: Sequence[Path]) -> list[Path]:
    """Return files: those that are named, and of a run's folder all detector images, in the order of their times.

    Raises
    ------
    UserError
        A folder without an archive of images.
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
    paths: Sequence[Path], camera: CameraSpec | None = None, camera_name: str = "", known: PriorSpec | None = None
) -> list[Observation]:
    """Return what a calibration is given of images; parameters as for :func:`.estimate.estimate_file`."""
    made = []
    for path in images_of(paths):
        picture = read_picture(path, camera, camera_name)
        made.append(observation_from(picture, limb_ellipsoid.ESTIMATOR, str(path), camera, camera_name, known))
    return made


def report_of(found: CameraCalibration | Refusal) -> dict[str, Any]:
    """Return a calibration or a refusal as plain data."""
    if isinstance(found, Refusal):
        return {"status": str(found.status), "reason": found.reason}
    sigma, change = found.sigma, found.change
    u, v = sigma[POINT]
    return {
        "status": "valid",
        "frames": found.frames,
        "left_out": list(found.left_out),
        "fx": found.camera.fx,
        "fy": found.camera.fy,
        "cx": found.camera.cx,
        "cy": found.camera.cy,
        "distortion": list(found.camera.distortion),
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


def calibrated(
    observations: Sequence[Observation], progress: Progress | None = None
) -> tuple[dict[str, Any], str | None]:
    """Return the report of a calibration, and the camera file that it makes; None after a refusal."""
    found = calibrate(observations, progress)
    report = report_of(found)
    if isinstance(found, Refusal):
        return report, None
    text = camera_file(replace(observations[0], camera=found.camera))
    sigma = report["principal_point_sigma_px"]
    lines = [
        f"# Focal length to {report['focal_length_sigma_percent']:.2g} %, principal point to {sigma[0]:.2g} and "
        f"{sigma[1]:.2g} px, of {found.frames} frames.",
        f"# Mounting, q_cam_from_body, scalar last: {[round(float(q), 9) for q in found.q_cam_from_body]}",
    ]
    if found.not_determined:
        lines.append(f"# Not determined, as the priors say: {', '.join(found.not_determined)}")
    return report, "\n".join(lines) + "\n" + text
