"""Cameras of calibration programs, in the terms of our camera files; the program is recognised by the file's keys.

Every key of a file is used, is known to say nothing about the lens, or is refused by name. Lens models, with the names
of the programs::

    Brown-Conrady      k1 k2 p1 p2 k3     plumb_bob, radtan (k3 = 0), MATLAB's [k1 k2 k3] and [p1 p2]
    rational           ... k4 k5 k6       rational_polynomial, OpenCV's 8 coefficients
    thin prism         ... s1 s2 s3 s4    OpenCV's 12 coefficients; 14 if tauX and tauY, a tilted sensor, are 0
    Kannala-Brandt     k1 k2 k3 k4        equidistant, equi, kb4, OpenCV's fisheye; with its skew alpha
    omnidirectional    xi, k1 k2 p1 p2    OpenCV's omnidir, Kalibr's omni, camodocal's MEI
    double sphere      xi, alpha          ds
    extended unified   alpha, beta        eucm

Other models are refused by name. Pixel 0 is the centre of the first, but for MATLAB. A file of YAML may have several
documents if they state the same camera.

* OpenCV: YAML, XML or JSON of ``cv::FileStorage``. ``fisheye_model = 1`` means the fisheye, ``xi`` the omnidirectional
  camera. Four coefficients without either may be of a pinhole or a fisheye, so that the model must be stated.
* ROS: the YAML of ``camera_calibration``, or a ``sensor_msgs/CameraInfo`` message as text. ``K`` is the lens; ``P`` and
  ``R``, those of a rectified image, are not read. ``roi`` and ``binning`` are applied to K.
* Kalibr: ``camchain.yaml``, one table for every camera, ``cam0`` and so on; also the ``sensor.yaml`` of EuRoC. The
  cameras' poses in their rig are not read. Basalt: the same models as JSON. camodocal: YAML with ``model_type``.
* MATLAB: ``jsonencode(toStruct(cameraParams))``, of ``cameraParameters`` or ``cameraIntrinsics``. It counts pixels from
  1; ``IntrinsicMatrix`` is the transpose of ``K``; ``ImageSize`` is rows and columns.
"""

from __future__ import annotations

import contextlib
import math
import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from horizonval.core import files
from horizonval.core.errors import UserError, excerpt, nearest
from horizonval.spec.camera import LARGEST_SIDE_PX

PINHOLE, FISHEYE, UNIFIED = "pinhole", "fisheye", "unified"
MODELS = (PINHOLE, FISHEYE)
"""Models that a file with four coefficients may mean."""
SMALLEST_SKEW = 1e-9
"""Skew over the focal length; less is what a computation leaves of axes that are square to each other."""


@dataclass(frozen=True)
class Intrinsics:
    """Image size and lens; pixel 0 is the centre of the first, as in our camera files.

    ``distortion``, ``skew``, ``xi``, ``alpha`` and ``beta`` are as in a camera file. ``notes``: what was assumed or
    applied, in words.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    projection: str = PINHOLE
    name: str = ""
    skew: float = 0.0
    xi: float = 0.0
    alpha: float = 0.0
    beta: float = 1.0
    notes: tuple[str, ...] = ()

    def table(self, source: str) -> dict[str, Any]:
        """Return the table ``[camera]``; ``source`` says in words where the figures come from."""
        table = {
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
        if self.skew:
            table["skew"] = self.skew
        if self.projection == UNIFIED:
            table |= {"xi": self.xi, "alpha": self.alpha, "beta": self.beta}
        return table


_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_MATRIX_KEYS = ("rows", "cols", "dt", "data", "type_id", "sizes")


class FileReader:
    """The keys of a parsed file, each read by name; a mistake names file and key."""

    def __init__(self, data: Mapping[str, Any], where: str) -> None:
        self.data, self.where = data, where

    def fail(self, key: str, what: str, expected: str, fix: str = "") -> UserError:
        """Return the mistake of a key."""
        return UserError(what, where=f"{self.where}: {key}" if key else self.where, expected=expected, fix=fix)

    def knows(self, used: Collection[str], harmless: Collection[str], program: str) -> None:
        """Refuse keys that are neither used nor known to say nothing about the lens."""
        for key in self.data:
            if key not in used and key not in harmless:
                raise self.fail(
                    str(key),
                    f"a key that is not known of files of {program}, and may change what the others mean",
                    f"keys such as {', '.join(nearest(str(key), used)[:4])}",
                    "remove it if it says nothing about the lens",
                )

    def first(self, *keys: str) -> str | None:
        """Return which of some names of one thing the file has; two of them are refused."""
        found = [key for key in keys if key in self.data]
        if len(found) > 1:
            raise self.fail(found[1], f"the same as {found[0]}", "one of them")
        return found[0] if found else None

    def inside(self, key: str) -> FileReader:
        """Return the reader of a table within the file; an empty one where it is missing."""
        value = self.data.get(key)
        if value in (None, ""):
            value = {}
        if not isinstance(value, Mapping):
            raise self.fail(key, "found no table of keys", "keys with values")
        return FileReader(value, f"{self.where}: {key}")

    def numbers(self, key: str, count: int | tuple[int, ...]) -> list[float]:
        """Return a list of numbers of that length, or of one of those."""
        value = self.data.get(key)
        counts = (count,) if isinstance(count, int) else count
        *others, last = (str(c) for c in counts)
        wanted = f"{', '.join(others)}{' or ' if others else ''}{last} finite number{'' if counts == (1,) else 's'}"
        shape = None
        if isinstance(value, Mapping):
            # ROS and OpenCV write the size of a matrix next to its data.
            inner = FileReader(value, f"{self.where}: {key}")
            inner.knows(_MATRIX_KEYS, (), "matrices")
            if "rows" in value and "cols" in value:
                shape = int(inner.numbers("rows", 1)[0]), int(inner.numbers("cols", 1)[0])
            value = value.get("data")
        flat: list[float] = []
        for item in _leaves(value):
            if isinstance(item, str) and len(parts := item.split()) > 1 and all(map(_NUMBER.fullmatch, parts)):
                raise self.fail(key, f"{len(parts)} numbers without commas between them: {excerpt(item, 100)}", wanted)
            number = _number(item)
            if number is None:
                kinds = isinstance(item, str | float), isinstance(item, Mapping)
                found = f"'{item}'" if kinds[0] else "a table of keys" if kinds[1] else "no number"
                raise self.fail(key, f"found {excerpt(found)}", wanted)
            flat.append(number)
        if len(flat) not in counts:
            found = "nothing" if value in (None, "") else "1 number" if len(flat) == 1 else f"{len(flat)} numbers"
            raise self.fail(key, f"found {found}", wanted)
        if shape is not None and flat and shape[0] * shape[1] != len(flat):
            raise self.fail(key, f"found {len(flat)} numbers", f"{shape[0]} x {shape[1]}, as rows and cols say")
        return flat

    def number(self, key: str, default: float) -> float:
        """Return a number, or its default where the key is missing."""
        return self.numbers(key, 1)[0] if key in self.data else default

    def whole(self, key: str, least: int = 1, default: float | None = None) -> int:
        """Return a whole number, of pixels or places."""
        value = self.numbers(key, 1)[0] if default is None or key in self.data else default
        if value != int(value) or value < least:
            raise self.fail(key, f"found {value:g}", f"a whole number from {least} up")
        return int(value)

    def size(self, key: str) -> tuple[int, int]:
        """Return width and height, stated as one list."""
        width, height = self.numbers(key, 2)
        if width != int(width) or height != int(height) or min(width, height) < 1:
            raise self.fail(key, f"found {width:g} and {height:g}", "whole numbers of pixels")
        return int(width), int(height)

    def matrix(self, key: str, *, transposed: bool = False) -> dict[str, Any]:
        """Return ``fx fy cx cy skew`` of a matrix of nine numbers by rows, with 0 where such a matrix has it."""
        m = self.numbers(key, 9)
        if transposed:
            m = [m[3 * column + row] for row in range(3) for column in range(3)]
        fx, skew, cx, below, fy, cy, *last = m
        if not any(m):
            raise self.fail(key, "nine zeros, as of a camera that is not calibrated", "fx 0 cx, 0 fy cy, 0 0 1")
        if not (fx > 0.0 and fy > 0.0) or last != [0.0, 0.0, 1.0] or below != 0.0:
            raise self.fail(key, f"found {m}", "fx 0 cx, 0 fy cy, 0 0 1")
        return {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "skew": _skew(skew / fx)}

    def brown(self, key: str, k: Sequence[float]) -> tuple[float, ...]:
        """Return coefficients in our order of OpenCV's 0, 4, 5, 8, 12 or 14, which is the same without the tilt."""
        if any(k[12:]):
            raise self.fail(
                key,
                "the 13th and 14th coefficient, tauX and tauY of a tilted sensor, are not 0",
                "at most 12 coefficients",
                "calibrate again without CALIB_TILTED_MODEL",
            )
        k = [*k, *[0.0] * (5 - len(k))][:12]
        return tuple(k if any(k[5:]) else k[:5])


def _with(one: Intrinsics, names: Sequence[str], numbers: Sequence[float]) -> Intrinsics:
    """Return a camera with further values, the first of the numbers, by name."""
    values: dict[str, Any] = dict(zip(names, numbers, strict=False))
    return replace(one, **values)


def _skew(skew: float) -> float:
    return skew if abs(skew) > SMALLEST_SKEW else 0.0


def _leaves(value: Any) -> list[Any]:
    """Return what is in nested lists, in order; of a single value itself, of nothing nothing."""
    if value is None or value == "":
        return []
    if not isinstance(value, list | tuple):
        return [value]
    return [leaf for item in value for leaf in ([None] if item is None else _leaves(item))]


def _number(value: Any) -> float | None:
    """Return a finite number, also one that is stated as text; None of anything else."""
    if isinstance(value, bool):
        return None
    if isinstance(value, str) and _NUMBER.fullmatch(value.strip()):
        value = float(value)
    if not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _text(value: Any) -> str:
    return value.strip() if isinstance(value, str) else ""


# Kalibr, EuRoC and Basalt

KALIBR_KEYS = ("camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "resolution")
EUROC_KEYS = ("camera_model", "intrinsics", "distortion_model", "distortion_coefficients", "resolution")
KALIBR_HARMLESS = (
    *("rostopic", "T_cam_imu", "T_imu_cam", "T_cn_cnm1", "T_BS", "timeshift_cam_imu", "cam_overlaps", "line_delay"),
    *("sensor_type", "comment", "rate_hz", "frame_id", "label"),
)
SHAPES: dict[str, tuple[str, ...]] = {
    "pinhole": (),
    "omni": ("xi",),
    "ds": ("xi", "alpha"),
    "eucm": ("alpha", "beta"),
}
"""Numbers that Kalibr's projections have before ``fu fv pu pv``."""


def is_kalibr(data: Mapping[str, Any]) -> bool:
    """Whether the keys are those of a camchain, or of one camera of it."""
    return ("camera_model" in data and "intrinsics" in data) or bool(cameras_of_kalibr(data))


def cameras_of_kalibr(data: Mapping[str, Any]) -> list[str]:
    """Return the names of the cameras in a camchain."""
    return [str(name) for name, one in data.items() if isinstance(one, Mapping) and "camera_model" in one]


def _chosen(names: Sequence[str], name: str | None, path: Path) -> str:
    """Return the name of one of several cameras; the only one without a name."""
    if name is None and len(names) != 1:
        raise UserError(
            f"{len(names)} cameras: {', '.join(names)}",
            where=str(path),
            expected="a choice between them",
            fix=f"--camera {names[0]}" if names else "",
        )
    if name is not None and name not in names:
        raise UserError(f"no camera {name!r}", where=str(path), expected=", ".join(names))
    return names[0] if name is None else name


def of_kalibr(data: Mapping[str, Any], path: Path, name: str | None = None) -> Intrinsics:
    """Return one camera of a camchain; the only one without a name. A mistake is a :class:`UserError`."""
    if "camera_model" in data:
        return _of_kalibr(FileReader(data, str(path)), "")
    names = cameras_of_kalibr(data)
    FileReader(data, str(path)).knows(names, (), "Kalibr")
    chosen = _chosen(names, name, path)
    return _of_kalibr(FileReader(data[chosen], f"{path}: {chosen}"), chosen)


def _of_kalibr(read: FileReader, name: str) -> Intrinsics:
    keys = EUROC_KEYS if "distortion_coefficients" in read.data else KALIBR_KEYS
    read.knows(keys, KALIBR_HARMLESS, "Kalibr")
    kind, coefficients = _text(read.data.get("camera_model")), keys[3]
    if kind not in SHAPES:
        raise read.fail("camera_model", f"found {excerpt(kind)!r}", ", ".join(SHAPES))
    first = SHAPES[kind]
    numbers = read.numbers("intrinsics", len(first) + 4)
    fx, fy, cx, cy = numbers[len(first) :]
    if not (fx > 0.0 and fy > 0.0):
        raise read.fail("intrinsics", f"found {numbers}", f"{' '.join((*first, 'fu fv pu pv'))}, fu and fv above 0")
    width, height = read.size("resolution")
    one = Intrinsics(width, height, fx, fy, cx, cy, name=name, projection=UNIFIED if first else PINHOLE)
    one = _with(one, first, numbers)
    if "line_delay" in read.data:
        one = replace(one, notes=("The line_delay of a rolling shutter is not carried over.",))
    model = read.data.get("distortion_model")
    if model in ("equi", "equidistant") and kind == "pinhole":
        return replace(one, distortion=tuple(read.numbers(coefficients, 4)), projection=FISHEYE)
    if model in ("radtan", "radial-tangential") and kind in ("pinhole", "omni"):
        return replace(one, distortion=read.brown(coefficients, read.numbers(coefficients, (4, 5))))
    if model == "none":
        if any(_leaves(read.data.get(coefficients))) and any(read.numbers(coefficients, tuple(range(1, 15)))):
            raise read.fail(coefficients, "coefficients that are not 0", "none, as distortion_model says")
        return one
    expected = {"pinhole": "radtan, equi or none", "omni": "radtan or none"}.get(kind, "none")
    raise read.fail("distortion_model", "missing" if model is None else f"found {excerpt(repr(model))}", expected)


BASALT_SHAPES = {
    "pinhole": (), "ds": ("xi", "alpha"), "eucm": ("alpha", "beta"), "ucm": ("alpha",), "kb4": ("k1", "k2", "k3", "k4")
}  # fmt: skip
BASALT_HARMLESS = (
    *("T_imu_cam", "vignette", "calib_accel_bias", "calib_gyro_bias", "imu_update_rate", "accel_noise_std"),
    *("gyro_noise_std", "accel_bias_std", "gyro_bias_std", "T_mocap_world", "T_imu_marker", "mocap_time_offset_ns"),
    *("mocap_to_imu_offset_ns", "cam_time_offset_ns"),
)


def is_basalt(data: Mapping[str, Any]) -> bool:
    """Whether the keys are those of a calibration of Basalt."""
    return isinstance(one := data.get("value0"), Mapping) and "intrinsics" in one


def of_basalt(data: Mapping[str, Any], path: Path, name: str | None = None) -> Intrinsics:
    """Return one camera of a calibration of Basalt, by its number from 0."""
    FileReader(data, str(path)).knows(("value0",), (), "Basalt")
    outer = FileReader(data["value0"], str(path))
    outer.knows(("intrinsics", "resolution"), BASALT_HARMLESS, "Basalt")
    cameras, sizes = outer.data["intrinsics"], outer.data.get("resolution")
    if not isinstance(cameras, list) or not isinstance(sizes, list) or len(cameras) != len(sizes):
        raise outer.fail("resolution", "found not as many as intrinsics", "two numbers for each camera")
    number = int(_chosen([str(i) for i in range(len(cameras))], name, path))
    where = f"{path}: intrinsics {number}"
    if not isinstance(cameras[number], Mapping):
        raise UserError("found no keys", where=where, expected="camera_type and intrinsics")
    one = FileReader(cameras[number], where)
    one.knows(("camera_type", "intrinsics"), (), "Basalt")
    kind = _text(one.data.get("camera_type"))
    if kind not in BASALT_SHAPES:
        raise one.fail("camera_type", f"found {excerpt(repr(kind))}", ", ".join(BASALT_SHAPES))
    read, names = one.inside("intrinsics"), BASALT_SHAPES[kind]
    read.knows(("fx", "fy", "cx", "cy", *names), (), "Basalt")
    fx, fy, cx, cy, *numbers = (read.numbers(key, 1)[0] for key in ("fx", "fy", "cx", "cy", *names))
    width, height = FileReader({"resolution": sizes[number]}, where).size("resolution")
    found = Intrinsics(width, height, fx, fy, cx, cy)
    if kind == "kb4":
        return replace(found, distortion=tuple(numbers), projection=FISHEYE)
    return _with(replace(found, projection=UNIFIED if names else PINHOLE), names, numbers)


CAMODOCAL = {
    "PINHOLE": (("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2"), PINHOLE),
    "MEI": (("gamma1", "gamma2", "u0", "v0"), ("k1", "k2", "p1", "p2"), UNIFIED),
    "KANNALA_BRANDT": (("mu", "mv", "u0", "v0"), ("k2", "k3", "k4", "k5"), FISHEYE),
}
"""Names of the intrinsics and of the coefficients, and our projection, of camodocal's models."""


def of_camodocal(data: Mapping[str, Any], path: Path) -> Intrinsics:
    """Return the camera of a file of camodocal."""
    read, kind = FileReader(data, str(path)), _text(data["model_type"]).upper()
    if kind not in CAMODOCAL:
        raise read.fail("model_type", f"found {excerpt(repr(kind))}", ", ".join(CAMODOCAL))
    names, coefficients, projection = CAMODOCAL[kind]
    tables: dict[str, tuple[str, ...]] = {"projection_parameters": names, "distortion_parameters": coefficients}
    if kind == "KANNALA_BRANDT":
        tables = {"projection_parameters": (*coefficients, *names)}
    elif kind == "MEI":
        tables["mirror_parameters"] = ("xi",)
    read.knows(("model_type", "camera_name", "image_width", "image_height", *tables), (), "camodocal")
    numbers: dict[str, float] = {}
    for table, keys in tables.items():
        inner = read.inside(table)
        inner.knows(keys, (), "camodocal")
        numbers |= {key: inner.numbers(key, 1)[0] for key in keys}
    fx, fy, cx, cy = (numbers[key] for key in names)
    return Intrinsics(
        read.whole("image_width"),
        read.whole("image_height"),
        fx,
        fy,
        cx,
        cy,
        distortion=tuple(numbers[key] for key in coefficients),
        projection=projection,
        name=_text(data.get("camera_name")),
        xi=numbers.get("xi", 0.0),
    )


# MATLAB

FIRST_PIXEL = 1.0
MATLAB_KEYS = (
    *("ImageSize", "FocalLength", "PrincipalPoint", "Skew", "K", "IntrinsicMatrix"),
    *("RadialDistortion", "TangentialDistortion"),
)
MATLAB_HARMLESS = (
    *("WorldPoints", "WorldUnits", "EstimateSkew", "NumRadialDistortionCoefficients", "EstimateTangentialDistortion"),
    *("RotationVectors", "TranslationVectors", "ReprojectionErrors", "ReprojectedPoints", "MeanReprojectionError"),
    *("NumPatterns", "PatternExtrinsics", "DetectedKeypoints", "RotationMatrices", "Version"),
)


def is_matlab(data: Mapping[str, Any]) -> bool:
    """Whether the keys are those of a struct of MATLAB's."""
    return "ImageSize" in data or "IntrinsicMatrix" in data or "PrincipalPoint" in data


def of_matlab(data: Mapping[str, Any], path: Path) -> Intrinsics:
    """Return the camera of a struct; what is wrong is a :class:`UserError` with file and key."""
    read = FileReader(data, str(path))
    for key in ("MappingCoefficients", "StretchMatrix", "DistortionCenter"):
        if key in data:
            raise read.fail(
                key,
                "a fisheye of MATLAB's own (Scaramuzza's polynomial)",
                "cameraParameters or cameraIntrinsics",
                "calibrate with OpenCV's fisheye",
            )
    read.knows(MATLAB_KEYS, MATLAB_HARMLESS, "MATLAB")
    columns, rows = reversed(read.size("ImageSize"))
    stated = [read.matrix(key, transposed=key != "K") for key in ("K", "IntrinsicMatrix") if key in data]
    if "FocalLength" in data or not stated:
        fx, fy = read.numbers("FocalLength", 2)
        cx, cy = read.numbers("PrincipalPoint", 2)
        skew = read.number("Skew", stated[0]["skew"] * fx if stated else 0.0)
        stated.append({"fx": fx, "fy": fy, "cx": cx, "cy": cy, "skew": _skew(skew / fx) if fx else 0.0})
    for one in stated[1:]:
        for key, value in one.items():
            if not math.isclose(value, stated[0][key], rel_tol=1e-6, abs_tol=1e-6):
                what = f"{key} is {value:g} and {stated[0][key]:g}"
                raise read.fail("K, IntrinsicMatrix and FocalLength", what, "one value by all keys")
    radial = read.numbers("RadialDistortion", (2, 3)) if "RadialDistortion" in data else [0.0, 0.0]
    tangential = read.numbers("TangentialDistortion", 2) if "TangentialDistortion" in data else [0.0, 0.0]
    k1, k2, k3 = [*radial, 0.0][:3]
    lens = stated[0] | {"cx": stated[0]["cx"] - FIRST_PIXEL, "cy": stated[0]["cy"] - FIRST_PIXEL}
    return replace(Intrinsics(columns, rows, 1.0, 1.0, 0.0, 0.0, (k1, k2, *tangential, k3)), **lens)


# ROS and OpenCV: a camera matrix and coefficients

MATRICES = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "M", "mtx")
COEFFICIENTS = (
    *(
        "distortion_coefficients",
        "Distortion_Coefficients",
        "distCoeffs",
        "dist_coeffs",
        "dist_coeff",
        "dist",
        "D",
        "d",
    ),
)
WIDTHS, HEIGHTS = ("image_width", "image_Width", "width"), ("image_height", "image_Height", "height")
SIZES = ("cameraResolution", "resolution")
MATRIX_USED = (
    *(*MATRICES, *COEFFICIENTS, *WIDTHS, *HEIGHTS, *SIZES, "xi"),
    *("distortion_model", "fisheye_model", "camera_name", "binning_x", "binning_y", "roi"),
)
MATRIX_HARMLESS = (
    # ROS
    *("header", "rectification_matrix", "projection_matrix", "R", "r", "P", "p"),
    # OpenCV: calibration, camera_calibration (its names have changed), interactive-calibration, stereo, omnidir
    *("calibration_time", "calibration_Time", "calibrationDate", "nframes", "nFrames", "nr_of_frames", "nrOfFrames"),
    *("framesCount", "board_width", "board_Width", "board_height", "board_Height", "square_size", "square_Size"),
    *("marker_size", "patternSize", "pattern_size", "aspectRatio", "aspect_ratio", "fix_aspect_ratio"),
    *("FixAspectRatio", "flags", "flagValue", "flag", "avg_reprojection_error", "Avg_Reprojection_Error", "rms"),
    *("per_view_reprojection_errors", "Per_View_Reprojection_Errors", "extrinsic_parameters", "Extrinsic_Parameters"),
    *("image_points", "Image_points", "grid_points", "camera_matrix_std_dev", "cameraMatrix_std_dev"),
    *("distortion_coefficients_std_dev", "dist_coeffs_std_dev", "used_imgs", "rvecs", "tvecs", "rvec", "tvec"),
    *("T", "E", "F", "Q", "om", "om_extrinsic", "R1", "R2", "P1", "P2"),
)
ROS_KEYS = ("distortion_model", "header", "binning_x", "roi", "projection_matrix")
MODEL_NAMES = {
    "plumb_bob": PINHOLE,
    "rational_polynomial": PINHOLE,
    "equidistant": FISHEYE,
    "fisheye": FISHEYE,
}
_NUMBERED = [name for name in (*MATRICES, *COEFFICIENTS, "xi") if name not in ("k", "d")]
_ONE_OF_SEVERAL = re.compile(rf"({'|'.join(_NUMBERED)})(_?\d+|_left|_right)")


def is_matrix(data: Mapping[str, Any]) -> bool:
    """Whether the keys are those of ROS or OpenCV."""
    return any(key in data for key in MATRICES) or bool(_numbered(data))


def _numbered(data: Mapping[str, Any]) -> list[str]:
    """Return the endings by which a file tells the matrices of several cameras apart: 1 and 2 of M1 and M2."""
    found = [m for key in data if (m := _ONE_OF_SEVERAL.fullmatch(str(key)))]
    return list(dict.fromkeys(m[2] for m in found if m[1] in MATRICES))


def of_matrix(data: Mapping[str, Any], path: Path, name: str | None, model: str | None) -> Intrinsics:
    """Return the camera of a file of ROS or OpenCV; a mistake is a :class:`UserError` with file and key."""
    endings = _numbered(data)
    if endings:
        chosen = _chosen([ending.lstrip("_") for ending in endings], name, path)
        ending = next(one for one in endings if one.lstrip("_") == chosen)
        several = {key: _ONE_OF_SEVERAL.fullmatch(str(key)) for key in data}
        ours = {m[1]: data[key] for key, m in several.items() if m is not None and m[2] == ending}
        data = {key: value for key, value in data.items() if several[key] is None} | ours
    elif name is not None:
        raise UserError("one camera", where=str(path), fix="leave out --camera")
    read = FileReader(data, str(path))
    read.knows(MATRIX_USED, MATRIX_HARMLESS, "ROS and OpenCV")
    lens = read.matrix(read.first(*MATRICES) or MATRICES[0])
    notes = []
    key = read.first(*COEFFICIENTS)
    k = [] if key is None else read.numbers(key, (0, 4, 5, 8, 12, 14))
    key = key or COEFFICIENTS[0]
    kind = _model(read, key, k, model)
    if key not in data:
        notes.append(f"The file has no {key}: the lens is taken to have no distortion.")
    if data.get("distortion_model", "-") in (None, ""):
        notes.append("The file has no distortion_model: taken for plumb_bob or, with 8 numbers, rational_polynomial.")
    if kind in (FISHEYE, UNIFIED) and len(k) != 4:
        name_of = {FISHEYE: "a fisheye", UNIFIED: "an omnidirectional camera (xi)"}[kind]
        raise read.fail(key, f"found {len(k)} numbers", f"4 of {name_of}")
    if data.get("distortion_model") == "plumb_bob" and any(k[5:]):
        raise read.fail(key, f"{len(k)} coefficients that are not 0", "k1 k2 p1 p2 k3, as plumb_bob says")
    if lens["skew"] and kind == PINHOLE:
        notes.append("The skew in the camera matrix is applied; OpenCV's functions for pinholes ignore it.")
    size_key = read.first(*SIZES)
    width = read.first(*WIDTHS)
    if size_key is not None and width is None:
        size = read.size(size_key)
    else:
        size = read.whole(width or WIDTHS[0]), read.whole(read.first(*HEIGHTS) or HEIGHTS[0])
    distortion = tuple(k) if kind == FISHEYE else read.brown(key, k)
    found = Intrinsics(size[0], size[1], 1.0, 1.0, 0.0, 0.0, distortion, kind, _text(data.get("camera_name")))
    return _window(read, replace(found, **lens, xi=read.number("xi", 0.0), notes=tuple(notes)))


def _model(read: FileReader, key: str, k: Sequence[float], wanted: str | None) -> str:
    """Return the lens model that the file states, or the wanted one where it states none."""
    stated: dict[str, str] = {}
    named = _text(read.data.get("distortion_model")).lower()
    if named or not isinstance(read.data.get("distortion_model", ""), str):
        if named not in MODEL_NAMES:
            raise read.fail("distortion_model", f"found {excerpt(repr(named))}", ", ".join(MODEL_NAMES))
        stated["distortion_model"] = MODEL_NAMES[named]
    if "fisheye_model" in read.data:
        fisheye = str(read.data["fisheye_model"]).lower() in ("true", "yes") or (
            str(read.data["fisheye_model"]).lower() not in ("false", "no") and read.whole("fisheye_model", 0) != 0
        )
        stated["fisheye_model"] = FISHEYE if fisheye else PINHOLE
    if "xi" in read.data:
        stated["xi"] = UNIFIED
    if wanted is not None:
        stated["--model"] = wanted
    kinds = set(stated.values())
    if len(kinds) > 1:
        stated_models = " and ".join(f"{where} means {kind}" for where, kind in stated.items())
        raise read.fail(next(iter(stated)), stated_models, "one model of the lens")
    if kinds:
        return kinds.pop()
    if len(k) == 4:
        raise read.fail(
            key,
            "4 coefficients without a model, which may be k1 k2 p1 p2 of a pinhole or k1 k2 k3 k4 of a fisheye",
            "distortion_model or fisheye_model in the file",
            "use --model pinhole or --model fisheye",
        )
    return PINHOLE


def _window(read: FileReader, found: Intrinsics) -> Intrinsics:
    """Return the camera of the part of a detector that a CameraInfo message states, and of its binned pixels.

    ``K`` is of the whole detector, and so are width and height, unless they are the region's.
    """
    bx, by = (max(1, read.whole(f"binning_{axis}", 0, 0.0)) for axis in "xy")
    roi = read.inside("roi")
    roi.knows(("x_offset", "y_offset", "width", "height"), ("do_rectify",), "ROS")
    x, y, w, h = (roi.whole(key, 0, 0.0) for key in ("x_offset", "y_offset", "width", "height"))
    if (x, y, w, h, bx, by) == (0, 0, 0, 0, 1, 1):
        return found
    if (w == 0) != (h == 0) or (w == 0 and (x or y)):
        raise roi.fail("", f"{w} x {h} px from column {x}, row {y}", "width and height, or a region of zeros for all")
    w, h = w or found.width, h or found.height
    if (x, y, w, h, bx, by) == (0, 0, found.width, found.height, 1, 1):
        return found
    inside = x + w <= found.width and y + h <= found.height
    if not inside and (found.width, found.height) not in ((w, h), (w // bx, h // by)):
        raise roi.fail(
            "",
            f"{w} x {h} px from column {x}, row {y}",
            f"a region of the image of {found.width} x {found.height} px, or one of that size",
        )
    if w < bx or h < by:
        raise roi.fail("", f"{w} x {h} px after binning {bx} x {by}", "a pixel at least")
    note = f"Region of {w} x {h} px from column {x}, row {y} and binning {bx} x {by} applied to the camera matrix."
    return replace(
        found,
        width=w // bx,
        height=h // by,
        fx=found.fx / bx,
        fy=found.fy / by,
        cx=(found.cx - x + 0.5) / bx - 0.5,
        cy=(found.cy - y + 0.5) / by - 0.5,
        notes=(*found.notes, note),
    )


# Files

MAX_FILE_BYTES = 1024 * 1024
"""A camera has some dozen numbers; the images of its calibration have some thousand points."""
MOST_VALUES, DEEPEST = 50_000, 40
"""Values and nested lists of a file after its aliases are expanded."""
EXPECTED = "a camera of ROS (camera_info), OpenCV (FileStorage), Kalibr, Basalt, camodocal or MATLAB (a struct as JSON)"


_COMMENT = re.compile(r"^[ \t]*//.*$", re.MULTILINE)
"""Comments that OpenCV writes into JSON."""


def read_camera(path: Path, camera: str | None = None, model: str | None = None) -> tuple[Intrinsics, str]:
    """Return a camera and the name of the program that wrote it.

    ``camera`` names one of several in a file; ``model`` is ``pinhole`` or ``fisheye`` where the file does not say it.
    UserError, with file and key: a file of no such program, or a lens that our camera files cannot hold.
    """
    if model is not None and model not in MODELS:
        raise UserError(f"found {model!r}", where="--model", expected=" or ".join(MODELS))
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=EXPECTED).removeprefix("\ufeff")
    start = text.lstrip()
    if start.startswith("<"):
        documents = [_xml(text, path)]
    elif path.suffix.lower() == ".json" or _is_json(start):
        documents = [_json(text, path)]
    else:
        documents = _yaml(text, path)
    found = []
    for number, data in enumerate(documents, 1):
        if not isinstance(data, Mapping):
            raise UserError("holds no keys", where=str(path), expected=EXPECTED)
        _check_size(data, path)
        try:
            found.append(_of_keys(data, path, camera, model))
        except UserError as error:
            if len(documents) == 1:
                raise
            inner = error.where.removeprefix(str(path)).removeprefix(": ")
            raise error.at(f"{path}: document {number}{': ' if inner else ''}{inner}") from None
        if found[-1] != found[0]:
            raise UserError(
                f"{len(documents)} documents, of which 1 and {number} state different cameras",
                where=str(path),
                expected="one camera",
                fix="keep one of the documents, which `---` separates",
            )
    one, program = found[0]
    if not (one.fx > 0.0 and one.fy > 0.0):
        raise UserError(f"a focal length of {one.fx:g} and {one.fy:g} px", where=str(path), expected="numbers above 0")
    if max(one.width, one.height) > LARGEST_SIDE_PX:
        what = f"an image of {one.width} x {one.height} px"
        raise UserError(what, where=str(path), expected=f"{LARGEST_SIDE_PX} px a side at most")
    return one, program


def _of_keys(data: Mapping[str, Any], path: Path, camera: str | None, model: str | None) -> tuple[Intrinsics, str]:
    if is_matrix(data) and not is_matlab(data):
        return of_matrix(data, path, camera, model), "ROS" if any(key in data for key in ROS_KEYS) else "OpenCV"
    if model is not None:
        raise UserError("the file states the model of its lens", where=str(path), fix="leave out --model")
    if is_kalibr(data):
        return of_kalibr(data, path, camera), "Kalibr"
    if is_basalt(data):
        return of_basalt(data, path, camera), "Basalt"
    if camera is not None:
        raise UserError("one camera", where=str(path), fix="leave out --camera")
    if "model_type" in data:
        return of_camodocal(data, path), "camodocal"
    if is_matlab(data) or "MappingCoefficients" in data:
        return of_matlab(data, path), "MATLAB"
    keys = ", ".join(excerpt(str(key)) for key in list(data)[:6])
    raise UserError(f"a camera of no program that is known, with the keys {keys}", where=str(path), expected=EXPECTED)


def _check_size(data: Any, path: Path) -> None:
    """Refuse what aliases make endless or very large, before anything walks through it."""
    left, waiting = MOST_VALUES, [(data, 0)]
    while waiting:
        value, depth = waiting.pop()
        inner = list(value.values()) if isinstance(value, Mapping) else value if isinstance(value, list) else []
        left -= len(inner) + 1
        if left < 0 or depth > DEEPEST:
            what = "nested too deeply" if depth > DEEPEST else f"more than {MOST_VALUES} values"
            raise UserError(f"{what}, aliases included", where=str(path), expected=EXPECTED)
        waiting += [(one, depth + 1) for one in inner]


def _yaml(text: str, path: Path) -> list[Any]:
    """Return the documents of a YAML file, all scalars as text; empty documents are left out."""
    import yaml

    class Loader(yaml.BaseLoader):
        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
            _once((key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)), path)
            return dict(super().construct_mapping(node, deep))

    # Lists of a hostile file take PyYAML half a minute.
    if text.count(",") + text.count("\n") > MOST_VALUES:
        raise UserError(f"more than {MOST_VALUES} values", where=str(path), expected=EXPECTED)
    # OpenCV before version 5 writes %YAML:1.0, which is no directive of YAML.
    if text.startswith("%YAML"):
        text = "#" + text
    try:
        documents = [one for one in yaml.load_all(text, Loader) if one not in (None, "")]
    except (yaml.YAMLError, RecursionError, ValueError, TypeError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f" (line {mark.line + 1})" if mark is not None else ""
        raise UserError(f"not valid YAML{place}", where=str(path), expected=EXPECTED) from error
    if not documents:
        raise UserError("holds no keys", where=str(path), expected=EXPECTED)
    return documents


def _is_json(text: str) -> bool:
    """Whether a text is JSON, and not YAML that also begins with a brace."""
    if not text.startswith("{"):
        return False
    with contextlib.suppress(UserError):
        files.parse_json(_COMMENT.sub("", text), "")
        return True
    return False


def _once(names: Iterable[str], path: Path) -> None:
    """Refuse names of one table of which one comes twice."""
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise UserError("found twice", where=f"{path}: {excerpt(twice[0])}", expected="every key once")


def _json(text: str, path: Path) -> Any:
    def table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        _once((name for name, _ in pairs), path)
        return dict(pairs)

    return files.parse_json(_COMMENT.sub("", text), path, pairs=table)


def _xml(text: str, path: Path) -> Any:
    """Return the keys of OpenCV's XML."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise UserError("an XML file with entities of its own", where=str(path), expected=EXPECTED)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UserError(f"not valid XML (line {error.position[0]})", where=str(path), expected=EXPECTED) from error
    if root.tag != "opencv_storage":
        raise UserError(f"XML of <{excerpt(root.tag)}>", where=str(path), expected="<opencv_storage> of OpenCV")
    return _of_element(root, path, 0)


def _of_element(element: ElementTree.Element, path: Path, depth: int) -> Any:
    if depth > DEEPEST:
        raise UserError("nested too deeply", where=str(path), expected=EXPECTED)
    children = [(child.tag, _of_element(child, path, depth + 1)) for child in element]
    if not children:
        words = (element.text or "").split()
        return words if len(words) > 1 and all(map(_NUMBER.fullmatch, words)) else " ".join(words).strip('"')
    if all(tag == "_" for tag, _ in children):
        return [value for _, value in children]
    _once((tag for tag, _ in children), path)
    return dict(children)
