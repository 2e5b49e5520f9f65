"""A camera file of ours from that of a calibration program, a camera that has the rest, and a lens's illumination."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.formats.csv_table import CsvTable, read_csv
from horizonval.formats.lens.cameras import read_camera
from horizonval.geometry.camera import CameraModel, camera_from_spec, check_invertible, field_angles, unproject
from horizonval.report.rerun import toml
from horizonval.sensor.lens.optics import relative_illumination
from horizonval.spec.camera import CameraSpec
from horizonval.spec.files import find
from horizonval.spec.load import read_toml, validate

PLACES, SHARES = ("field_deg", "radius_px"), ("relative_illumination", "vignetting")
BRIGHTER = 1.02
"""Over the law of the pupil: what the measurement of a lens may be off by."""


def camera_text(path: Path, camera: str | None = None, base: str | None = None, vignetting: Path | None = None) -> str:
    """Return the text of a camera file.

    Parameters
    ----------
    path : Path
        Of ROS, Kalibr, OpenCV or MATLAB.
    camera : str, optional
        Of several in it.
    base : str, optional
        Camera of ours, by name or file, of which everything but ``[camera]`` is taken.
    vignetting : Path, optional
        Table of ``field_deg`` or ``radius_px``, the distance from the principal point along its row, and either
        ``relative_illumination``, all that the image loses towards its edge, or ``vignetting``, what it loses beyond
        the law of the pupil.

    Raises
    ------
    UserError
        With file and key.
    """
    found, program = read_camera(path, camera)
    data: dict[str, Any] = {} if base is None else read_toml(find("camera", base))
    data["camera"] = found.table(f"{program}: {path.name}")
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
    return toml({"camera": data.pop("camera"), **data})


def _vignetting(path: Path, spec: CameraSpec) -> tuple[list[float], list[float]]:
    """Return field angles and what the lens loses there beyond the law of its pupil."""
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
