"""Frames and images as an MCAP file of ROS 2 messages, written without ROS.

Of every detector image, on topics that begin with the camera's name, its head's if it has several, and the band's:

==============================  =============================  =====================================================
topic                           type                           holds
==============================  =============================  =====================================================
``.../image_raw``               ``sensor_msgs/msg/Image``      digital numbers, ``mono16``; of a frame its radiance
                                                               [W m-2 sr-1], ``32FC1``, on ``.../radiance``
``.../camera_info``             ``sensor_msgs/msg/CameraInfo`` intrinsics and distortion
``CAMERA[/HEAD]/pose``          ``geometry_msgs/msg/           the camera along Earth-fixed axes, exact
                                PoseStamped``
``/tf``                         ``tf2_msgs/msg/TFMessage``     the same as a transform
``.../truth``                   ``std_msgs/msg/String``        the whole truth as JSON
==============================  =============================  =====================================================

Our camera axes (x right, y down, z forward) are those of an optical frame (REP 103), and Earth-fixed axes are the frame
``earth`` (REP 105). Pixels are counted from the centre of the first, as in ``image_geometry``. A pinhole is
``plumb_bob`` (with rational terms ``rational_polynomial``), a fisheye ``equidistant``, all with OpenCV's coefficients;
the fixed grid of geostationary imagers, unified lenses and thin prism terms have no model there, and such a camera is
said to be uncalibrated. Stamps are the epoch, as seconds since 1970 without leap
seconds. The same files give the same bytes.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from horizonval.core import atomic
from horizonval.core.errors import UserError
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.geometry.camera import CameraModel, camera_from_spec
from horizonval.geometry.frames import inverse
from horizonval.spec.base import in_utc
from horizonval.store import exr
from horizonval.store.attributes import camera_of

if TYPE_CHECKING:
    from horizonval.core.progress import Progress

EARTH_FRAME = "earth"
MODELS = {"pinhole": ("plumb_bob", 5), "fisheye": ("equidistant", 4)}
"""Of a projection, the name that ROS gives it, and how many coefficients it has there."""
_UNFIT = re.compile(r"[^A-Za-z0-9_]+")
_LINE = "=" * 80
_PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
}
_MESSAGES = {
    "sensor_msgs/msg/Image": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
        "uint8[] data"
    ),
    "sensor_msgs/msg/CameraInfo": (
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\nfloat64[9] k\n"
        "float64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi"
    ),
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "std_msgs/msg/String": "string data",
}
"""Definitions of ROS 2's common interfaces, which have been the same in all of its releases."""


def write_mcap(path: Path, sources: Iterable[Path], progress: Progress | None = None) -> int:
    """Write frames and images of ours as one MCAP file; return the number of messages.

    Parameters
    ----------
    path : Path
        Replaced when the new file is complete.
    sources : iterable of Path
        EXR files, in the order in which they are written; one pose per instant and camera.
    progress : Progress, optional

    Raises
    ------
    UserError
        The package is not installed, a file is not one of ours or damaged, or the MCAP file cannot be written.
    """
    writer_class = _writer_class()
    with atomic.replacing(path) as temporary, temporary.open("wb") as stream:
        writer = writer_class(stream)
        count = _write_all(writer, sources, progress)
        writer.finish()
    return count


def messages_of(source: RadianceFrame | DetectorImage) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Return topic, type and content of the messages of one frame or image.

    Plain data by field, byte arrays as bytes.
    """
    truth = source.truth
    spec = camera_of(truth, source.observation if isinstance(source, DetectorImage) else None)
    camera = "/".join(["", *(_name(part) for part in (spec.camera.name, truth.head or "") if part)])
    frame_id = f"{camera[1:].replace('/', '_')}_optical"
    header = {"stamp": _stamp(truth.epoch_utc), "frame_id": frame_id}
    if isinstance(source, DetectorImage):
        images = [(source.band, "image_raw", "mono16", source.dn.astype("<u2"))]
    else:
        images = [(band, "radiance", "32FC1", x.astype("<f4")) for band, x in source.radiance.items()]
    info = _camera_info(camera_from_spec(spec.camera), header)
    for band, kind, encoding, pixels in images:
        height, width = pixels.shape
        topic = f"{camera}/{_name(band)}"
        yield (
            f"{topic}/{kind}",
            "sensor_msgs/msg/Image",
            {
                "header": header,
                "height": height,
                "width": width,
                "encoding": encoding,
                "is_bigendian": 0,
                "step": width * pixels.itemsize,
                "data": pixels.tobytes(),
            },
        )
        yield f"{topic}/camera_info", "sensor_msgs/msg/CameraInfo", info
        text = json.dumps(truth.to_dict(), sort_keys=True, separators=(",", ":"), allow_nan=False)
        yield f"{topic}/truth", "std_msgs/msg/String", {"data": text}
    place = dict(zip("xyz", map(float, truth.r_itrs), strict=True))
    turn = dict(zip("xyzw", inverse(truth.q_cam_from_itrs).tolist(), strict=True))
    in_earth = {"stamp": header["stamp"], "frame_id": EARTH_FRAME}
    pose = {"header": in_earth, "pose": {"position": place, "orientation": turn}}
    yield f"{camera}/pose", "geometry_msgs/msg/PoseStamped", pose
    transform = {
        "header": in_earth,
        "child_frame_id": frame_id,
        "transform": {"translation": place, "rotation": turn},
    }
    yield "/tf", "tf2_msgs/msg/TFMessage", {"transforms": [transform]}


def _write_all(writer: Any, sources: Iterable[Path], progress: Progress | None) -> int:
    schemas: dict[str, Any] = {}
    posed: set[tuple[str, str, str]] = set()
    sequences: dict[str, int] = {}
    for path in sources:
        source = exr.read(path)
        nanoseconds = _nanoseconds(source.truth)
        here = (source.truth.epoch_utc, source.truth.camera_spec.camera.name, source.truth.head or "")
        for topic, name, content in messages_of(source):
            if name in ("geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage") and here in posed:
                continue
            if name not in schemas:
                schemas[name] = writer.register_msgdef(name, definition_of(name))
            sequences[topic] = sequence = sequences.get(topic, -1) + 1
            writer.write_message(topic, schemas[name], content, nanoseconds, nanoseconds, sequence)
        posed.add(here)
        if progress is not None:
            progress.done(path.name)
    return sum(last + 1 for last in sequences.values())


def definition_of(name: str) -> str:
    """Return the definition of a message with those of the types that it is made of, as MCAP holds them."""
    texts, found = [_MESSAGES[name]], []
    while texts:
        text = texts.pop(0)
        for part, inner in _PARTS.items():
            if re.search(rf"^{part}(\[\])? ", text, re.MULTILINE) and part not in found:
                found.append(part)
                texts.append(inner)
    return "\n".join([_MESSAGES[name], *(f"{_LINE}\nMSG: {part}\n{_PARTS[part]}" for part in found)]) + "\n"


def _model_of(camera: CameraModel) -> tuple[str, int]:
    """Return ROS's name of a distortion with its number of coefficients; no name for a lens that ROS cannot state."""
    if camera.projection == "pinhole" and len(camera.distortion) > 5:
        return ("", 0) if any(camera.distortion[8:]) else ("rational_polynomial", 8)
    return MODELS.get(camera.projection, ("", 0))


def _camera_info(camera: CameraModel, header: dict[str, Any]) -> dict[str, Any]:
    model, count = _model_of(camera)
    known = 1.0 if model else 0.0
    fx, fy, cx, cy = (known * x for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    return {
        "header": header,
        "height": camera.height,
        "width": camera.width,
        "distortion_model": model,
        "d": list(camera.distortion[:count]),
        "k": [fx, fx * camera.skew, cx, 0.0, fy, cy, 0.0, 0.0, known],
        "r": (known * np.eye(3)).ravel().tolist(),
        "p": [fx, fx * camera.skew, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, known, 0.0],
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def _name(text: str) -> str:
    """Return a name as a part of a topic, which begins with a letter and has neither hyphens nor dots."""
    fit = _UNFIT.sub("_", text).strip("_")
    return fit if fit[:1].isalpha() else f"x{fit}"


def _nanoseconds(truth: FrameTruth) -> int:
    stamp = _stamp(truth.epoch_utc)
    return stamp["sec"] * 10**9 + stamp["nanosec"]


def _stamp(epoch_utc: str) -> dict[str, int]:
    since = in_utc(datetime.fromisoformat(epoch_utc)) - datetime(1970, 1, 1, tzinfo=UTC)
    seconds = since.days * 86400 + since.seconds
    if not 0 <= seconds < 2**31:
        raise UserError(f"epoch {epoch_utc}", where="mcap", expected="1970 to 2038, which the stamps of ROS can hold")
    return {"sec": seconds, "nanosec": since.microseconds * 1000}


def _writer_class() -> Any:
    try:
        from mcap_ros2.writer import Writer
    except ImportError:
        raise UserError(
            "the package mcap-ros2-support is not installed",
            where="--mcap",
            fix="install the extra `ros`: pip install 'horizonval[ros]'",
        ) from None
    return Writer
