"""MCAP files, read back by rosbags, which shares no code with what writes them."""

from __future__ import annotations

import builtins
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from erfa import DJM0, dtf2d
from scipy.spatial.transform import Rotation
from synthetic import SOLAR_CAMERA, toy_image, truth_at
from typer.testing import CliRunner

from horizonval.cli.app import app
from horizonval.core.errors import UserError
from horizonval.frame import DetectorImage
from horizonval.geometry.camera import unproject
from horizonval.store import exr

pytest.importorskip("mcap_ros2", reason="needs the extra `ros`")
highlevel = pytest.importorskip("rosbags.highlevel", reason="needs the package rosbags")
typesys = pytest.importorskip("rosbags.typesys", reason="needs the package rosbags")

from horizonval.bridges.mcap import write_mcap  # noqa: E402 - after the packages that it needs

CAMERAS: dict[str, dict[str, Any]] = {
    "plumb_bob": {"fx": 70.0, "fy": 90.0, "cx": 30.25, "cy": 41.5, "distortion": [-0.2, 0.05, 1e-3, -2e-3, 0.01]},
    "equidistant": {"fov_deg": 120.0, "projection": "fisheye", "distortion": [0.01, -0.002, 0.001, 0.0]},
    "rational_polynomial": {"fx": 70.0, "distortion": [0.9, 0.1, 1e-4, 2e-4, 3e-3, 1.3, 0.35, 0.02]},
    "": {"fov_deg": 18.0, "projection": "equal_angle"},
}


def image_of(geometry: dict[str, Any]) -> DetectorImage:
    truth = truth_at(
        SOLAR_CAMERA | {"camera": {"name": "my-cam", "width": 80, "height": 60, **geometry}}, roll_deg=66.0
    )
    dn = np.random.default_rng(2).integers(0, 1024, (60, 80)).astype(np.uint16)
    return DetectorImage(dn, "red", truth, 1023, {"seed": 5, "exposure_s": 0.002})


def written(folder: Path, image: DetectorImage, name: str = "image") -> Path:
    exr.write_image(folder / f"{name}.exr", image)
    write_mcap(folder / f"{name}.mcap", [folder / f"{name}.exr"])
    return folder / f"{name}.mcap"


def read(path: Path) -> dict[str, tuple[str, int, Any]]:
    """Return type, time [ns] and message of the one message of every topic, decoded by definitions of rosbags' own."""
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    found = {}
    with highlevel.AnyReader([path], default_typestore=store) as reader:
        for connection, stamp, data in reader.messages():
            assert connection.topic not in found
            message = store.deserialize_cdr(data, connection.msgtype)
            found[connection.topic] = (connection.msgtype, stamp, message)
    return found


@pytest.mark.parametrize("model", CAMERAS)
def test_another_library_reads_what_was_written(tmp_path, model):
    image = image_of(CAMERAS[model])
    found = read(written(tmp_path, image))
    topic = "/my_cam/red"
    assert {name: kind for name, (kind, _, _) in found.items()} == {
        f"{topic}/image_raw": "sensor_msgs/msg/Image",
        f"{topic}/camera_info": "sensor_msgs/msg/CameraInfo",
        f"{topic}/truth": "std_msgs/msg/String",
        "/my_cam/pose": "geometry_msgs/msg/PoseStamped",
        "/tf": "tf2_msgs/msg/TFMessage",
    }
    picture, info = found[f"{topic}/image_raw"][2], found[f"{topic}/camera_info"][2]
    assert (picture.encoding, picture.step, picture.is_bigendian) == ("mono16", 160, 0)
    np.testing.assert_array_equal(picture.data.view("<u2").reshape(picture.height, picture.width), image.dn)
    assert picture.header.frame_id == info.header.frame_id == "my_cam_optical"
    assert info.distortion_model == model
    assert (info.height, info.width) == (60, 80)
    # "If the camera is uncalibrated, the matrices D, K, R, P should be left zeroed."
    assert bool(info.k.any()) == bool(info.p.any()) == bool(model)
    assert json.loads(found[f"{topic}/truth"][2].data)["scene_id"] == image.truth.scene_id


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant", "rational_polynomial"])
def test_the_pose_and_camera_of_the_messages_put_points_where_our_camera_sees_them(tmp_path, model):
    """Points on the ground through the message's pose, matrix and coefficients, by OpenCV's projections."""
    image = image_of(CAMERAS[model])
    found = read(written(tmp_path, image))
    info, pose = found["/my_cam/red/camera_info"][2], found["/my_cam/pose"][2]
    assert pose.header.frame_id == "earth"
    place, turn = pose.pose.position, pose.pose.orientation
    earth_from_cam = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
    pixels = np.array([[10.0, 12.0], [40.0, 30.0], [70.0, 50.0]])
    directions_itrs = (
        Rotation.from_quat(image.truth.q_cam_from_itrs).inv().apply(unproject(image.truth.camera_model, pixels))
    )
    points_earth = np.array(image.truth.r_itrs) + 1e6 * directions_itrs
    seen = earth_from_cam.inv().apply(points_earth - [place.x, place.y, place.z])
    lens = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    uv = lens(seen.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), info.k.reshape(3, 3), info.d)[0]
    np.testing.assert_allclose(uv.reshape(-1, 2), pixels, atol=1e-6)
    transform = found["/tf"][2].transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("earth", "my_cam_optical")
    assert transform.transform.rotation == turn


def test_stamps_are_the_epoch(tmp_path):
    image = image_of(CAMERAS["plumb_bob"])
    found = read(written(tmp_path, image))
    date, time = image.truth.epoch_utc.split("T")
    hours, minutes, seconds = time.rstrip("Z").split("+")[0].split(":")
    day = sum(dtf2d("UTC", *map(int, date.split("-")), int(hours), int(minutes), float(seconds)))
    expected_s = (day - DJM0 - 40587.0) * 86400.0
    kind, stamp, picture = found["/my_cam/red/image_raw"]
    assert kind == "sensor_msgs/msg/Image"
    assert stamp == picture.header.stamp.sec * 10**9 + picture.header.stamp.nanosec
    assert stamp / 1e9 == pytest.approx(expected_s, abs=1e-4)


def test_the_same_files_give_the_same_bytes(tmp_path):
    image = toy_image(truth_at(roll_deg=66.0))
    first = written(tmp_path, image, "one").read_bytes()
    assert written(tmp_path, image, "other").read_bytes() == first


def test_the_command(tmp_path):
    exr.write_image(tmp_path / "image.exr", toy_image(truth_at(roll_deg=66.0)))
    done = CliRunner().invoke(
        app, ["archive", "export", str(tmp_path / "image.exr"), "--mcap", "-o", str(tmp_path / "out")]
    )
    assert done.exit_code == 0, done.output
    assert len(read(tmp_path / "out" / "image.mcap")) == 5


def test_the_missing_package_is_named(tmp_path, monkeypatch):
    actual = builtins.__import__

    def without(name: str, *rest: Any, **keywords: Any) -> Any:
        if name.startswith("mcap_ros2"):
            raise ImportError(name)
        return actual(name, *rest, **keywords)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UserError, match=r"pip install 'horizonval\[ros\]'"):
        write_mcap(tmp_path / "x.mcap", [])
    assert not list(tmp_path.iterdir())
