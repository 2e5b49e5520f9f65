"""A camera as Kalibr tells it: ``camchain.yaml``, one table for every camera, ``cam0`` and so on.

``intrinsics`` is ``fu fv pu pv`` of a ``pinhole``, ``distortion_coeffs`` is ``k1 k2 p1 p2`` (``radtan``) or ``k1 k2 k3
k4`` (``equi``). Pixel 0 is the centre of the first. Where the cameras stand in their rig (``T_cn_cnm1``) is not read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError
from horizonval.formats.lens.intrinsics import FISHEYE, FileReader, Intrinsics

EXPECTED = "a camchain file of Kalibr: cam0 with camera_model, intrinsics, distortion_model, resolution"


def is_kalibr(data: Mapping[str, Any]) -> bool:
    """Whether the keys are those of a camchain."""
    return any(isinstance(one, Mapping) and "intrinsics" in one and "camera_model" in one for one in data.values())


def cameras_of_kalibr(data: Mapping[str, Any]) -> list[str]:
    """Return the names of the cameras in a camchain."""
    return [str(name) for name, one in data.items() if isinstance(one, Mapping) and "camera_model" in one]


def of_kalibr(data: Mapping[str, Any], path: Path, name: str | None = None) -> Intrinsics:
    """Return one camera of a camchain; the only one without a name. A mistake is a :class:`UserError`."""
    names = cameras_of_kalibr(data)
    if name is None and len(names) != 1:
        raise UserError(
            f"{len(names)} cameras", where=str(path), expected="a choice between them", fix=f"--camera {names[0]}"
        )
    chosen = names[0] if name is None else name
    if chosen not in names:
        raise UserError(f"no camera {chosen!r}", where=str(path), expected=", ".join(names))
    table = data[chosen]
    where = f"{path}: {chosen}"
    read = FileReader(table, where)
    if table.get("camera_model") != "pinhole":
        raise read.fail("camera_model", f"found {table.get('camera_model')!r}", "pinhole", "calibrate as pinhole-equi")
    fx, fy, cx, cy = read.numbers("intrinsics", 4)
    if not (fx > 0.0 and fy > 0.0):
        raise read.fail("intrinsics", f"found {[fx, fy, cx, cy]}", "fu fv pu pv, the first two above 0")
    width, height = read.numbers("resolution", 2)
    model = table.get("distortion_model")
    size = int(width), int(height)
    if model in ("equi", "equidistant"):
        return Intrinsics(*size, fx, fy, cx, cy, tuple(read.numbers("distortion_coeffs", 4)), FISHEYE, chosen)
    if model == "radtan":
        k = read.numbers("distortion_coeffs", (4, 5))
        return Intrinsics(*size, fx, fy, cx, cy, read.brown("distortion_coeffs", k), name=chosen)
    if model in (None, "none"):
        return Intrinsics(*size, fx, fy, cx, cy, name=chosen)
    raise read.fail("distortion_model", f"found {model!r}", "radtan, equi or none")
