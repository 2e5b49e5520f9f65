"""Cameras of calibration programs, in the terms of our camera files; the program is recognised by the file's keys.

All of them use the pinhole or the fisheye of OpenCV, with other names and other orders::

    Brown-Conrady   k1 k2 p1 p2 k3     plumb_bob, radtan (k3 = 0), MATLAB's [k1 k2 k3] and [p1 p2]
    Kannala-Brandt  k1 k2 k3 k4        equidistant, equi, OpenCV's fisheye

Other models are refused: a rational or a thin prism term, a tilted sensor, a skew, a mirror (``omni``). Terms that are
0 are ignored. Pixel 0 is the centre of the first, but for MATLAB.

* OpenCV: YAML, XML or JSON of ``cv::FileStorage``, read by OpenCV. ``fisheye_model = 1`` means the fisheye.
* Kalibr: ``camchain.yaml``, one table for every camera, ``cam0`` and so on. ``intrinsics`` is ``fu fv pu pv`` of a
  ``pinhole``, ``distortion_coeffs`` is ``k1 k2 p1 p2`` (``radtan``) or ``k1 k2 k3 k4`` (``equi``). The cameras' poses
  in their rig (``T_cn_cnm1``) are not read.
* MATLAB: ``jsonencode(toStruct(cameraParams))``, of ``cameraParameters`` or ``cameraIntrinsics``. It counts pixels from
  1; ``IntrinsicMatrix`` is the transpose of ``K``; ``ImageSize`` is rows and columns.
* ROS: the YAML of ``camera_calibration``, or a ``sensor_msgs/CameraInfo`` message as text. ``K`` is the lens; ``P`` and
  ``R``, those of a rectified image, are not read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from horizonval.core import files
from horizonval.core.errors import UserError

BROWN, FISHEYE = "pinhole", "fisheye"
LARGEST_SKEW = 1e-9
"""Of a focal length: what a computation leaves of axes that are square to each other."""


@dataclass(frozen=True)
class Intrinsics:
    """Image size and lens; pixel 0 is the centre of the first, as in our camera files.

    ``distortion``: ``k1 k2 p1 p2 k3`` of a pinhole, ``k1 k2 k3 k4`` of a fisheye.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    projection: str = BROWN
    name: str = ""

    def table(self, source: str) -> dict[str, Any]:
        """Return the table ``[camera]``; ``source`` says in words where the figures come from."""
        return {
            "name": self.name,
            "source": source,
            "width": self.width,
            "height": self.height,
            "projection": self.projection,
            "fx": self.fx,
            "fy": self.fy,
            "cx": self.cx,
            "cy": self.cy,
            "distortion": list(self.distortion),
        }


class FileReader:
    """The keys of a parsed file, each read by name; a mistake names file and key."""

    def __init__(self, data: Mapping[str, Any], where: str) -> None:
        self.data, self.where = data, where

    def fail(self, key: str, what: str, expected: str, fix: str = "") -> UserError:
        """Return the mistake of a key."""
        return UserError(what, where=f"{self.where}: {key}" if key else self.where, expected=expected, fix=fix)

    def first(self, *keys: str) -> str | None:
        """Return the first of some names of one thing that the file has."""
        return next((key for key in keys if key in self.data), None)

    def numbers(self, key: str, count: int | tuple[int, ...]) -> list[float]:
        """Return a list of numbers of that length, or of one of those."""
        value = self.data.get(key)
        if isinstance(value, Mapping):
            # ROS and OpenCV write matrices with their size beside the data.
            value = value.get("data")
        if isinstance(value, int | float) and not isinstance(value, bool):
            value = [value]
        flat = _flat(value)
        counts = (count,) if isinstance(count, int) else count
        wanted = " or ".join(str(c) for c in counts)
        if flat is None or (counts and len(flat) not in counts):
            found = "nothing" if value is None else "no list of numbers" if flat is None else f"{len(flat)} numbers"
            raise self.fail(key, f"found {found}", f"{wanted} finite numbers")
        return flat

    def size(self, key: str) -> int:
        """Return a whole number of pixels."""
        (value,) = self.numbers(key, 1)
        if value != int(value) or value < 1:
            raise self.fail(key, f"found {value:g}", "a whole number of pixels")
        return int(value)

    def matrix(self, key: str, *, transposed: bool = False) -> tuple[float, float, float, float]:
        """Return ``fx fy cx cy`` of a matrix of nine numbers by rows, with 0 where such a matrix has it."""
        m = self.numbers(key, 9)
        if transposed:
            m = [m[3 * column + row] for row in range(3) for column in range(3)]
        fx, skew, cx, below, fy, cy, *last = m
        if not (fx > 0.0 and fy > 0.0) or last != [0.0, 0.0, 1.0] or below != 0.0:
            raise self.fail(key, f"found {m}", "fx 0 cx, 0 fy cy, 0 0 1")
        self.square(key, skew, fx)
        return fx, fy, cx, cy

    def square(self, key: str, skew: float, fx: float) -> None:
        """Refuse axes that are not square to each other."""
        if abs(skew) > LARGEST_SKEW * fx:
            raise self.fail(key, f"a skew of {skew:g}", "0", "calibrate again without skew")

    def brown(self, key: str, k: Sequence[float]) -> tuple[float, ...]:
        """Return ``k1 k2 p1 p2 k3`` of OpenCV's 0, 4, 5, 8, 12 or 14 coefficients, if the others are 0."""
        values = [*k, 0.0, 0.0, 0.0, 0.0, 0.0]
        if any(k[5:]):
            raise self.fail(
                key,
                f"{len(k)} coefficients, of which those after the fifth are not 0",
                "k1 k2 p1 p2 k3",
                "calibrate again without rational, thin prism and tilt terms",
            )
        return tuple(values[:5])


def _flat(value: Any) -> list[float] | None:
    if not isinstance(value, list | tuple):
        return None
    found: list[float] = []
    for item in value:
        if isinstance(item, list | tuple):
            inner = _flat(item)
            if inner is None:
                return None
            found += inner
        elif isinstance(item, bool) or not isinstance(item, int | float) or not math.isfinite(item):
            return None
        else:
            found.append(float(item))
    return found


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


FIRST_PIXEL = 1.0


def is_matlab(data: Mapping[str, Any]) -> bool:
    """Whether the keys are those of a struct of MATLAB's."""
    return "ImageSize" in data or "IntrinsicMatrix" in data or "PrincipalPoint" in data


def of_matlab(data: Mapping[str, Any], path: Path) -> Intrinsics:
    """Return the camera of a struct; what is wrong is a :class:`UserError` with file and key."""
    read = FileReader(data, str(path))
    if "MappingCoefficients" in data:
        raise UserError(
            "a fisheye of MATLAB's own",
            where=f"{path}: MappingCoefficients",
            expected="cameraParameters or cameraIntrinsics",
            fix="calibrate with OpenCV's fisheye",
        )
    rows, columns = read.numbers("ImageSize", 2)
    if "FocalLength" in data:
        fx, fy = read.numbers("FocalLength", 2)
        cx, cy = read.numbers("PrincipalPoint", 2)
        if "Skew" in data:
            read.square("Skew", read.numbers("Skew", 1)[0], fx)
    elif "K" in data:
        fx, fy, cx, cy = read.matrix("K")
    else:
        fx, fy, cx, cy = read.matrix("IntrinsicMatrix", transposed=True)
    radial = read.numbers("RadialDistortion", (2, 3)) if "RadialDistortion" in data else [0.0, 0.0]
    tangential = read.numbers("TangentialDistortion", 2) if "TangentialDistortion" in data else [0.0, 0.0]
    k1, k2, k3 = [*radial, 0.0][:3]
    distortion = (k1, k2, *tangential, k3)
    return Intrinsics(int(columns), int(rows), fx, fy, cx - FIRST_PIXEL, cy - FIRST_PIXEL, distortion)


BROWN_MODELS = ("plumb_bob", "rational_polynomial", "")
FISHEYE_MODELS = ("equidistant", "fisheye")


def is_camera_info(data: Mapping[str, Any]) -> bool:
    """Whether the keys are those of a camera_info."""
    return "distortion_model" in data and ("camera_matrix" in data or "K" in data or "k" in data)


def of_camera_info(data: Mapping[str, Any], path: Path) -> Intrinsics:
    """Return the camera of a camera_info; what is wrong is a :class:`UserError` with file and key."""
    read = FileReader(data, str(path))
    model = str(data.get("distortion_model") or "").lower()
    if model not in BROWN_MODELS + FISHEYE_MODELS:
        raise UserError(
            f"found {model!r}",
            where=f"{path}: distortion_model",
            expected="plumb_bob, rational_polynomial, equidistant or fisheye",
        )
    width, height = (read.size(read.first(f"image_{side}", side) or f"image_{side}") for side in ("width", "height"))
    fx, fy, cx, cy = read.matrix(read.first("camera_matrix", "K", "k") or "camera_matrix")
    key = read.first("distortion_coefficients", "D", "d")
    name = str(data.get("camera_name") or "")
    if model in FISHEYE_MODELS:
        k = read.numbers(key or "distortion_coefficients", 4)
        return Intrinsics(width, height, fx, fy, cx, cy, tuple(k), FISHEYE, name)
    k = [] if key is None else read.numbers(key, (0, 4, 5, 8, 12, 14))
    return Intrinsics(width, height, fx, fy, cx, cy, read.brown(key or "D", k), name=name)


MAX_FILE_BYTES = 1024 * 1024
"""A camera has some dozen numbers."""


def read_yaml(path: Path, expected: str) -> Mapping[str, Any]:
    """Return the mapping in a YAML file, read by PyYAML without objects.

    UserError: no such file, no YAML, no mapping (``expected`` names the kind of file), or PyYAML is not installed.
    """
    try:
        import yaml
    except ImportError:
        raise UserError(
            "PyYAML is not installed", where=str(path), fix='run `pip install "horizonval[formats]"`'
        ) from None
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=expected)
    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f" (line {mark.line + 1})" if mark is not None else ""
        raise UserError(f"not valid YAML{place}", where=str(path), expected=expected) from error
    if not isinstance(data, Mapping):
        raise UserError("holds no keys", where=str(path), expected=expected)
    return data


OPENCV_EXPECTED = "a file of OpenCV's FileStorage: image_width, image_height, camera_matrix, distortion_coefficients"
MATRICES = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "M1")
COEFFICIENTS = ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D", "D1")
WIDTHS, HEIGHTS = ("image_width", "image_Width"), ("image_height", "image_Height")


def is_opencv(text: str) -> bool:
    """Whether a text is one of FileStorage: no other program writes its type of a matrix."""
    return "opencv-matrix" in text or "<opencv_storage>" in text


def of_opencv(path: Path) -> Intrinsics:
    """Return the camera in a file; what is wrong is a :class:`UserError` with file and key."""
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=OPENCV_EXPECTED)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except cv2.error as error:
        raise UserError("OpenCV cannot read it", where=str(path), expected=OPENCV_EXPECTED) from error
    try:
        data = {key: _value(storage.getNode(key)) for key in storage.root().keys()}  # noqa: SIM118  (no mapping)
    finally:
        storage.release()
    read = FileReader(data, str(path))
    width, height = read.size(read.first(*WIDTHS) or WIDTHS[0]), read.size(read.first(*HEIGHTS) or HEIGHTS[0])
    fx, fy, cx, cy = read.matrix(read.first(*MATRICES) or MATRICES[0])
    key = read.first(*COEFFICIENTS) or COEFFICIENTS[0]
    if data.get("fisheye_model"):
        return Intrinsics(width, height, fx, fy, cx, cy, tuple(read.numbers(key, 4)), FISHEYE)
    k = read.numbers(key, (0, 4, 5, 8, 12, 14)) if key in data else []
    return Intrinsics(width, height, fx, fy, cx, cy, read.brown(key, k))


def _value(node: Any) -> Any:
    """Return what a node holds: a matrix as its numbers by rows, a number, a text; None of anything else."""
    if node.isMap():
        try:
            return node.mat().ravel().tolist()
        except (cv2.error, AttributeError):
            return None
    if node.isInt() or node.isReal():
        return node.real()
    if node.isSeq():
        return [node.at(i).real() for i in range(node.size())]
    return node.string() if node.isString() else None


EXPECTED = "a camera of ROS (camera_info), Kalibr (camchain), OpenCV (FileStorage) or MATLAB (a struct as JSON)"


def read_camera(path: Path, camera: str | None = None) -> tuple[Intrinsics, str]:
    """Return a camera and the name of the program that wrote it; ``camera`` names one of several in a file of Kalibr.

    UserError, with file and key: a file of no such program, or a lens that our camera files cannot hold.
    """
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=EXPECTED)
    found: Intrinsics
    if is_opencv(text):
        found, program = of_opencv(path), "OpenCV"
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
        (is_camera_info, lambda: of_camera_info(data, path), "ROS"),
        (is_kalibr, lambda: of_kalibr(data, path, camera), "Kalibr"),
        (is_matlab, lambda: of_matlab(data, path), "MATLAB"),
    ]
    for is_one, read, program in readers:
        if is_one(data):
            return read(), program
    raise UserError("a camera of no program that is known", where=str(path), expected=EXPECTED)
