"""Which program wrote a camera's file, told by what it holds, and the camera in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from horizonval.core import files
from horizonval.core.errors import UserError
from horizonval.formats.lens import camera_info, kalibr, matlab, opencv_file
from horizonval.formats.lens.intrinsics import Intrinsics
from horizonval.formats.lens.yaml_file import MAX_FILE_BYTES, read_yaml

EXPECTED = "a camera of ROS (camera_info), Kalibr (camchain), OpenCV (FileStorage) or MATLAB (a struct as JSON)"


def read_camera(path: Path, camera: str | None = None) -> tuple[Intrinsics, str]:
    """Return a camera and the name of the program that wrote it.

    Parameters
    ----------
    path : Path
    camera : str, optional
        Of several in one file, as Kalibr writes them.

    Raises
    ------
    UserError
        With file and key: a file of no such program, or a lens that ours cannot be.
    """
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=EXPECTED)
    found: Intrinsics
    if opencv_file.is_opencv(text):
        found, program = opencv_file.of_opencv(path), "OpenCV"
    else:
        json_ = path.suffix.lower() == ".json"
        data = files.parse_json(text, path) if json_ else read_yaml(path, EXPECTED)
        if not isinstance(data, Mapping):
            raise UserError("holds no keys", where=str(path), expected=EXPECTED)
        found, program = _of_keys(data, path, camera)
    if camera is not None and program != "Kalibr":
        raise UserError(f"{program} writes one camera into a file", where=str(path), fix="leave out --camera")
    if not (found.fx > 0.0 and found.fy > 0.0 and found.width > 0 and found.height > 0):
        raise UserError(
            f"a focal length of {found.fx:g} and {found.fy:g} px, {found.width} x {found.height} px",
            where=str(path),
            expected="numbers above 0",
        )
    return found, program


def _of_keys(data: Mapping[str, Any], path: Path, camera: str | None) -> tuple[Intrinsics, str]:
    readers: list[tuple[Callable[[Mapping[str, Any]], bool], Callable[[], Intrinsics], str]] = [
        (camera_info.is_camera_info, lambda: camera_info.of_camera_info(data, path), "ROS"),
        (kalibr.is_kalibr, lambda: kalibr.of_kalibr(data, path, camera), "Kalibr"),
        (matlab.is_matlab, lambda: matlab.of_matlab(data, path), "MATLAB"),
    ]
    for is_one, read, program in readers:
        if is_one(data):
            return read(), program
    raise UserError("a camera of no program that is known", where=str(path), expected=EXPECTED)
