"""A camera file of ours from that of a calibration program, a camera that has the rest, and a lens's illumination."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.errors import UserError
from horizonval.formats.csv_table import read_csv
from horizonval.formats.lens.cameras import read_camera
from horizonval.geometry.camera import camera_from_spec, check_invertible, field_angles
from horizonval.report.rerun import toml
from horizonval.sensor.lens.optics import relative_illumination
from horizonval.spec.files import find
from horizonval.spec.load import read_toml, validate
from horizonval.spec.sensor.camera import CameraSpec

BEYOND, WHOLE = ("field_deg", "vignetting"), ("field_deg", "relative_illumination")
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
        Table of ``field_deg`` and either ``relative_illumination``, all that the image loses towards its edge, or
        ``vignetting``, what it loses beyond the law of the pupil.

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
    table = read_csv(path, WHOLE, BEYOND)
    angle = table.numbers["field_deg"]
    whole = "relative_illumination" in table.numbers
    share = table.numbers["relative_illumination" if whole else "vignetting"]
    for row, (here, before) in enumerate(zip(angle[1:], angle[:-1], strict=True), 1):
        if here <= before:
            raise UserError(f"{here:g} after {before:g}", where=table.place(row, "field_deg"), expected="rising angles")
    if whole:
        camera = camera_from_spec(spec.camera)
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
            where=f"{path}: {'relative_illumination' if whole else 'vignetting'}",
            expected="0 to 1",
            fix='optics.pupil = "constant" in the --base is the law of lenses whose pupil turns towards the light',
        )
    return [float(a) for a in angle], [round(min(float(s), 1.0), 6) for s in share]
