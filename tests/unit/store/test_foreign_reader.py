"""OpenImageIO, which knows nothing of us, opens our files and finds the camera in them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenImageIO
import pytest
from scipy.spatial.transform import Rotation
from synthetic import CMOS, SOLAR_CAMERA, toy_image, truth_at

from horizonval.frame import MAP_UNITS, DetectorImage
from horizonval.geometry.camera import project
from horizonval.spec.camera import CameraSpec
from horizonval.store import exr
from horizonval.store.store import Store

TOLERANCE_PX = 0.25
PITCH_UM = CMOS["pixel_pitch_um"]


def attributes(path: Path) -> tuple[Any, dict[str, Any]]:
    opened = OpenImageIO.ImageInput.open(str(path))
    assert opened is not None, OpenImageIO.geterror()
    spec = opened.spec()
    opened.close()
    return spec, {a.name: a.value for a in spec.extra_attribs}


def pixels(path: Path) -> dict[str, np.ndarray]:
    buffer = OpenImageIO.ImageBuf(str(path))
    values = buffer.get_pixels(OpenImageIO.FLOAT)
    return {name: values[..., i] for i, name in enumerate(buffer.spec().channelnames)}


def by_window(spec: Any, found: dict[str, Any], point: np.ndarray) -> np.ndarray:
    """Column and row by worldToCamera and the screen window, in the words of the format."""
    x, y, z, _ = point @ np.array(found["worldToCamera"]).reshape(4, 4)
    width = found["screenWindowWidth"]
    height = width * spec.height / spec.width / found["PixelAspectRatio"]
    centre = found["screenWindowCenter"]
    across, down = (x / z - centre[0]) / width + 0.5, 0.5 - (y / z - centre[1]) / height
    return np.array([across * spec.width, down * spec.height]) - 0.5


def by_ndc(spec: Any, found: dict[str, Any], point: np.ndarray) -> np.ndarray:
    x, y, _, w = point @ np.array(found["worldToNDC"]).reshape(4, 4)
    return np.array([x / w * spec.width, y / w * spec.height]) - 0.5


def by_ours(spec: Any, found: dict[str, Any], point: np.ndarray) -> np.ndarray:
    """By the typed keys and OpenCV, whose lens models ours are."""
    cam = (point @ np.array(found["horizonval:itrs_to_camera"]).reshape(4, 4))[:3]
    (fx, fy), (cx, cy) = found["horizonval:focal_length_px"], found["horizonval:principal_point_px"]
    k = np.array(found["horizonval:distortion"])
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    cam = cam / np.linalg.norm(cam)
    match found["horizonval:projection"]:
        case "pinhole":
            return cv2.projectPoints(cam[None], np.zeros(3), np.zeros(3), matrix, k)[0].reshape(2)
        case "fisheye":
            return cv2.fisheye.projectPoints(cam[None, None], np.zeros(3), np.zeros(3), matrix, k[:4])[0].reshape(2)
    return np.array([fx * math.atan2(cam[0], cam[2]) + cx, fy * math.asin(cam[1]) + cy])


def camera(**geometry: Any) -> dict[str, Any]:
    return SOLAR_CAMERA | {
        "camera": {"name": "some", "width": 80, "height": 60, **geometry},
        "optics": {"f_number": 2.8, "transmission": 0.5},
        "detector": CMOS | {"black_level_dn": 32},
    }


CAMERAS = {
    "plain": camera(fov_deg=60.0),
    "off-centre": camera(fx=70.0, fy=90.0, cx=30.25, cy=41.5),
    "distorted": camera(fov_deg=60.0, distortion=[-0.2, 0.05, 1e-3, -2e-3, 0.01]),
    "fisheye": camera(fov_deg=150.0, projection="fisheye", distortion=[0.01, -0.002, 0.0, 0.0], image_circle_deg=170.0),
    "equal angle": camera(fx=400.0, projection="equal_angle"),
}
WAYS = {"plain": [by_window, by_ndc, by_ours], "off-centre": [by_window, by_ndc, by_ours]}


@pytest.mark.parametrize("name", CAMERAS)
def test_a_known_direction_is_projected_from_the_attributes_alone(tmp_path, name):
    truth = truth_at(CAMERAS[name], roll_deg=66.0, yaw_deg=25.0)
    exr.write_image(tmp_path / "a.exr", DetectorImage(np.zeros((60, 80), np.uint16), "red", truth, 1023))
    spec, found = attributes(tmp_path / "a.exr")
    model = truth.camera_model
    back = Rotation.from_quat(truth.q_cam_from_itrs).inv()
    rng = np.random.default_rng(4)
    for _ in range(20):
        d = rng.normal([0.0, 0.0, 1.0], 0.12)
        (expected,), (seen,) = project(model, d[None])
        assert seen
        far = np.array([*back.apply(d), 0.0])
        near = np.array([*(np.array(truth.r_itrs) + 2e6 * back.apply(d)), 1.0])
        for way in WAYS.get(name, [by_ours]):
            for point in (far, near):
                np.testing.assert_allclose(way(spec, found, point), expected, atol=TOLERANCE_PX / 10, err_msg=str(way))


def test_the_sun_is_where_the_attributes_say(tmp_path):
    """In the pixels, as OpenImageIO reads them."""
    wide = camera(fov_deg=60.0)
    wide["camera"] |= {"width": 480, "height": 360}
    truth = truth_at(wide, roll_deg=66.0, sun_zenith_deg=100.0, sun_azimuth_deg=270.0)
    exr.write_image(tmp_path / "a.exr", toy_image(truth))
    spec, found = attributes(tmp_path / "a.exr")
    read = pixels(tmp_path / "a.exr")
    assert set(read) == {"Y", "dn.red", "mask.saturated"}
    np.testing.assert_array_equal(read["mask.saturated"] > 0, read["Y"] == 1023)
    np.testing.assert_array_equal(read["dn.red"], read["Y"])
    rows, columns = np.nonzero(read["mask.saturated"])
    sun = np.array([*found["horizonval:sun_direction_itrs"], 0.0])
    centre = [columns.mean(), rows.mean()]
    assert len(rows) > 9
    for way in (by_window, by_ndc, by_ours):
        np.testing.assert_allclose(way(spec, found, sun), centre, atol=TOLERANCE_PX)


@pytest.mark.parametrize(("full_scale", "dtype"), [(1023, "half"), (2048, "half"), (2049, "float"), (65535, "float")])
def test_digital_numbers_are_what_a_foreign_reader_shows(tmp_path, full_scale, dtype):
    """Every number from 0 to the full scale, in a file that needs no code of ours."""
    dn = np.arange(256 * 256).reshape(256, 256).astype(np.int64) % (full_scale + 1)
    square = SOLAR_CAMERA | {"camera": {"name": "square", "width": 256, "height": 256, "fov_deg": 60.0}}
    exr.write_image(tmp_path / "a.exr", DetectorImage(dn.astype(np.uint16), "red", truth_at(square), full_scale))
    spec, found = attributes(tmp_path / "a.exr")
    assert {str(spec.channelformat(i)) for i in range(2)} == {dtype}
    read = pixels(tmp_path / "a.exr")
    np.testing.assert_array_equal(read["dn.red"], dn)
    np.testing.assert_array_equal(read["Y"], dn)
    assert found["compression"] == "zip"
    np.testing.assert_array_equal(exr.read_image(tmp_path / "a.exr").dn, dn)


def test_channels_have_units(tmp_path, make_frame):
    exr.write_frame(tmp_path / "a.exr", make_frame())
    exr.write_image(tmp_path / "b.exr", toy_image(truth_at(roll_deg=66.0)))
    units = {}
    for name in "ab":
        spec, found = attributes(tmp_path / f"{name}.exr")
        units |= {f"{name}:{c}": found[f"horizonval:unit.{c}"] for c in spec.channelnames if "mask." not in c}
    assert units == {
        **dict.fromkeys(("a:Y", "a:radiance.vis"), "W m-2 sr-1 of as many photons of 0.6000 um"),
        **{f"a:truth.{name}": unit for name, unit in MAP_UNITS.items()},
        **dict.fromkeys(("b:Y", "b:dn.red"), "DN"),
    }


@pytest.mark.parametrize("codec", ["htj2k256", "zip"])
def test_every_bit_of_a_frame_comes_through_the_codec(tmp_path, make_frame, codec):
    """Smooth radiance, which HTJ2K does transform, and maps with all that float32 has but numbers."""
    camera = SOLAR_CAMERA | {"camera": {"name": "wide", "width": 300, "height": 280, "fov_deg": 60.0}}
    row, column = np.mgrid[0:280, 0:300]
    frame = make_frame({"red": np.sin(column / 50) * row * 1e-3}, camera)
    odd = frame.maps["distance"].view(np.uint32)
    # Quiet and signalling NaN with a payload, infinities, zeros of both signs, subnormals, the largest and smallest.
    special = "7FC12345 FFC12345 7F812345 7F800000 FF800000 0 80000000 1 80000001 7F7FFFFF FF7FFFFF"
    odd[7, :11] = [int(word, 16) for word in special.split()]
    exr.write_frame(tmp_path / "a.exr", frame, codec=codec)
    exr.write_frame(tmp_path / "b.exr", frame, codec=codec)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    _, found = attributes(tmp_path / "a.exr")
    assert found["compression"] == codec
    read, again = pixels(tmp_path / "a.exr"), exr.read_frame(tmp_path / "a.exr")
    for name, values in {"radiance.red": frame.radiance["red"], "truth.distance": frame.maps["distance"]}.items():
        assert np.ascontiguousarray(read[name]).tobytes() == values.tobytes(), name
    assert again.maps["distance"].tobytes() == frame.maps["distance"].tobytes()
    smaller = (tmp_path / "a.exr").stat().st_size
    exr.write_frame(tmp_path / "zip.exr", frame, codec="zip")
    assert codec == "zip" or smaller < 0.8 * (tmp_path / "zip.exr").stat().st_size


def test_attributes_have_the_units_of_the_format(tmp_path):
    truth = truth_at(CAMERAS["off-centre"], roll_deg=66.0)
    exr.write_image(tmp_path / "a.exr", toy_image(truth))
    spec, found = attributes(tmp_path / "a.exr")
    pitch_mm = PITCH_UM * 1e-3
    assert (spec.width, spec.height) == (80, 60)
    expected = {
        "pinholeFocalLength": 70.0 * pitch_mm,
        "effectiveFocalLength": 70.0 * pitch_mm,
        "sensorPhotositePitch": PITCH_UM,
        "sensorOverallDimensions": (80 * pitch_mm, 60 * pitch_mm),
        "sensorCenterOffset": ((39.5 - 30.25) * PITCH_UM, (29.5 - 41.5) * PITCH_UM),
        "sensorAcquisitionRectangle": (0, 0, 79, 59),
        "ExposureTime": 2e-4,
        "FNumber": 2.8,
        "tStop": 2.8 * math.sqrt(2),
        "altitude": 500e3,
        "latitude": 40.0,
        "longitude": 20.0,
        "utcOffset": 0.0,
        "PixelAspectRatio": 90.0 / 70.0,
        "horizonval:exposure_s": 2e-4,
        "horizonval:band_lo_um": 0.6,
        "horizonval:epoch_tai_mjd": 61119.5 + 37 / 86400,
        "horizonval:camera_position_m": truth.r_itrs,
    }
    for key, value in expected.items():
        np.testing.assert_allclose(found[key], value, rtol=1e-6, err_msg=key)
    assert found["DateTime"] == "2026:03:20 12:00:00"
    assert (found["cameraLabel"], found["horizonval:world_frame"], found["horizonval:scene"]) == (
        "some",
        "ITRS",
        "made",
    )
    assert found["oiio:ColorSpace"] == "data"


def test_exposure_and_pitch_are_those_of_the_camera_that_took_the_image(tmp_path):
    """A frame can be observed with another camera file of the same geometry."""
    truth = truth_at(CAMERAS["plain"], roll_deg=66.0)
    other = CameraSpec.model_validate(CAMERAS["plain"] | {"optics": {"f_number": 8.0}}).model_dump(mode="json")
    other["detector"]["pixel_pitch_um"] = 11.0
    image = replace(toy_image(truth), observation={"camera": other, "exposure_s": 0.03125, "seed": 2**40})
    exr.write_image(tmp_path / "a.exr", image)
    _, found = attributes(tmp_path / "a.exr")
    assert (found["FNumber"], found["ExposureTime"], found["sensorPhotositePitch"]) == (8.0, 0.03125, 11.0)
    assert found["horizonval:seed"] == str(2**40)


def test_files_of_every_schema_open(tmp_path, make_frame):
    archives = [Store(Path(__file__).parents[2] / "data" / name) for name in ("archive-v1", "archive-v4")]
    paths = [archive.path(entry.address) for archive in archives for entry in archive.entries()]
    assert len(paths) == 4
    exr.write_frame(tmp_path / "a.exr", make_frame())
    for path in [*paths, tmp_path / "a.exr"]:
        spec, found = attributes(path)
        assert {"Y", "worldToCamera"} <= {*spec.channelnames, *found}
        assert all(np.isfinite(values).any() for values in pixels(path).values())
    read = pixels(tmp_path / "a.exr")
    np.testing.assert_array_equal(read["Y"], read["radiance.vis"])
    np.testing.assert_array_equal(read["mask.earth"], np.isfinite(read["truth.distance"]))
