"""Cameras of other programs: OpenCV projects points through what they say, ours must put them into the same pixels."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from horizonval.api.calibrate import camera_text
from horizonval.core.errors import UserError
from horizonval.formats.lens import read_camera
from horizonval.geometry.camera import camera_from_spec, project
from horizonval.sensor.lens.optics import relative_illumination
from horizonval.spec.load import load_camera

MATRIX = np.array([[812.5, 0.0, 322.25], [0.0, 808.75, 236.5], [0.0, 0.0, 1.0]])
RADTAN = [-0.28, 0.09, 0.0012, -0.0007, -0.013]
EQUI = [0.021, -0.008, 0.004, -0.001]
DIRECTIONS = np.random.default_rng(4).uniform([-0.35, -0.27, 1.0], [0.35, 0.27, 1.0], (50, 3))


def flow(values: np.ndarray | list[float]) -> str:
    return "[" + ", ".join(repr(float(v)) for v in np.ravel(values)) + "]"


def ros(model: str, k: list[float]) -> str:
    """Return what camera_calibration_parsers writes, as its documentation shows it."""
    return f"""image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: {flow(MATRIX)}
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {len(k)}
  data: {flow(k)}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
projection_matrix:
  rows: 3
  cols: 4
  data: [700, 0, 320, 0, 0, 700, 240, 0, 0, 0, 1, 0]
"""


def kalibr(model: str, k: list[float], camera_model: str = "pinhole") -> str:
    """Return a camchain of Kalibr, as its wiki shows it."""
    fx, fy, cx, cy = MATRIX[0, 0], MATRIX[1, 1], MATRIX[0, 2], MATRIX[1, 2]
    return f"""cam0:
  camera_model: {camera_model}
  intrinsics: {flow([fx, fy, cx, cy])}
  distortion_model: {model}
  distortion_coeffs: {flow(k)}
  T_cam_imu:
  - [1.0, 0.0, 0.0, 0.0]
  rostopic: /cam0/image_raw
  resolution: [640, 480]
"""


def opencv(path: Path, k: list[float], **more: float) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in {"image_width": 640, "image_height": 480, **more}.items():
        storage.write(key, value)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", np.array(k)[:, None])
    storage.release()


def matlab(**changes: object) -> str:
    """Return what jsonencode(toStruct(cameraParams)) writes: pixels from 1, the matrix transposed."""
    from_one = np.add(MATRIX, [[0, 0, 1], [0, 0, 1], [0, 0, 0]])
    struct = {
        "RadialDistortion": [RADTAN[0], RADTAN[1], RADTAN[4]],
        "TangentialDistortion": [RADTAN[2], RADTAN[3]],
        "ImageSize": [480, 640],
        "IntrinsicMatrix": from_one.T.tolist(),
        "WorldUnits": "mm",
        "Version": {"Name": "MATLAB"},
    }
    return json.dumps({k: v for k, v in {**struct, **changes}.items() if v is not None})


def written(tmp_path: Path, name: str, text: str) -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def pixels_of(path: Path, tmp_path: Path, **options: str) -> np.ndarray:
    """Return where our camera, by its own file, puts the directions."""
    ours = written(tmp_path, "ours.toml", camera_text(path, **options))
    uv, seen = project(camera_from_spec(load_camera(ours).camera), DIRECTIONS)
    assert seen.all()
    return uv


BROWN_PIXELS = cv2.projectPoints(DIRECTIONS, np.zeros(3), np.zeros(3), MATRIX, np.array(RADTAN))[0][:, 0]
RADTAN_PIXELS = cv2.projectPoints(DIRECTIONS, np.zeros(3), np.zeros(3), MATRIX, np.array(RADTAN[:4]))[0][:, 0]
FISHEYE_PIXELS = cv2.fisheye.projectPoints(DIRECTIONS[:, None], np.zeros(3), np.zeros(3), MATRIX, np.array(EQUI))[0][
    :, 0
]


@pytest.mark.parametrize("name", ["camera.yaml", "camera.xml", "camera.json"])
def test_opencv_puts_points_where_its_own_file_says(tmp_path: Path, name: str) -> None:
    opencv(tmp_path / name, RADTAN)
    assert np.abs(pixels_of(tmp_path / name, tmp_path) - BROWN_PIXELS).max() < 1e-9
    opencv(tmp_path / name, EQUI, fisheye_model=1)
    assert np.abs(pixels_of(tmp_path / name, tmp_path) - FISHEYE_PIXELS).max() < 1e-9


def test_ros_and_kalibr_mean_the_same_lenses(tmp_path: Path) -> None:
    for text, expected in (
        (ros("plumb_bob", RADTAN), BROWN_PIXELS),
        (ros("rational_polynomial", [*RADTAN, 0.0, 0.0, 0.0]), BROWN_PIXELS),
        (ros("equidistant", EQUI), FISHEYE_PIXELS),
        (kalibr("radtan", RADTAN[:4]), RADTAN_PIXELS),
        (kalibr("equi", EQUI), FISHEYE_PIXELS),
    ):
        assert np.abs(pixels_of(written(tmp_path, "theirs.yaml", text), tmp_path) - expected).max() < 1e-9


def test_matlab_counts_from_one_and_transposes(tmp_path: Path) -> None:
    fx, fy, cx, cy = 812.5, 808.75, 322.25, 236.5
    for text in (
        matlab(),
        matlab(IntrinsicMatrix=None, FocalLength=[fx, fy], PrincipalPoint=[cx + 1, cy + 1], Skew=0),
        matlab(IntrinsicMatrix=None, K=[[fx, 0, cx + 1], [0, fy, cy + 1], [0, 0, 1]]),
    ):
        path = written(tmp_path, "theirs.json", text)
        assert np.abs(pixels_of(path, tmp_path) - BROWN_PIXELS).max() < 1e-9
        assert (read_camera(path)[0].width, read_camera(path)[0].height) == (640, 480)


@pytest.mark.parametrize(
    ("text", "name", "line"),
    [
        (ros("rational_polynomial", [*RADTAN, 0.1, 0.0, 0.0]), "a.yaml", "distortion_coefficients: 8 coefficients"),
        (ros("thin_prism", RADTAN), "a.yaml", "distortion_model: found 'thin_prism'"),
        (ros("plumb_bob", RADTAN).replace("image_width: 640\n", ""), "a.yaml", "image_width: found nothing"),
        (ros("plumb_bob", [float("nan")] * 5).replace("nan", ".nan"), "a.yaml", "found no list of numbers"),
        (kalibr("radtan", RADTAN[:4], "omni"), "a.yaml", "cam0: camera_model: found 'omni'"),
        (kalibr("radtan", RADTAN[:4]) + kalibr("equi", EQUI).replace("cam0", "cam1"), "a.yaml", "2 cameras"),
        (matlab(IntrinsicMatrix=[[800, 0, 0], [3.0, 800, 0], [320, 240, 1]]), "a.json", "a skew of 3"),
        (matlab(MappingCoefficients=[1, 2, 3, 4]), "a.json", "a fisheye of MATLAB's own"),
        (matlab(ImageSize=None), "a.json", "ImageSize: found nothing"),
        ("width: 640\n", "a.yaml", "a camera of no program that is known"),
        ("a: [1\n", "a.yaml", "not valid YAML (line"),
        ("%YAML:1.0\n---\nM: !!opencv-matrix\n", "a.yaml", "expected"),
    ],
)
def test_what_ours_cannot_be_is_one_line(tmp_path: Path, text: str, name: str, line: str) -> None:
    path = written(tmp_path, name, text)
    with pytest.raises(UserError) as found:
        camera_text(path)
    assert line in str(found.value)
    assert str(path) in str(found.value)


def test_one_of_several_cameras_by_name(tmp_path: Path) -> None:
    path = written(tmp_path, "chain.yaml", kalibr("radtan", RADTAN[:4]) + kalibr("equi", EQUI).replace("cam0", "cam1"))
    assert np.abs(pixels_of(path, tmp_path, camera="cam1") - FISHEYE_PIXELS).max() < 1e-9
    with pytest.raises(UserError, match="no camera 'cam2'"):
        camera_text(path, "cam2")


def test_the_rest_is_of_another_camera_and_the_measured_lens_falls_off_as_measured(tmp_path: Path) -> None:
    """The law of cos^4 times a barrel that takes half at 20 deg, told as the whole: the barrel alone is left."""
    opencv(tmp_path / "lens.yaml", [0.0] * 5)
    angle = np.array([0.0, 5.0, 10.0, 15.0, 20.0, 40.0])
    barrel = 1.0 - 0.5 * angle / 20.0
    rows = [f"{a},{v}" for a, v in zip(angle, np.cos(np.radians(angle)) ** 4 * np.abs(barrel), strict=True)]
    table = written(tmp_path, "lens.csv", "# measured\nfield_deg,relative_illumination\n" + "\n".join(rows) + "\n")
    text = camera_text(tmp_path / "lens.yaml", base="vis-cmos-512-60deg", vignetting=table)
    spec = load_camera(written(tmp_path, "ours.toml", text))
    assert spec.detector == load_camera("vis-cmos-512-60deg").detector
    assert spec.optics.vignetting_deg == [0.0, 5.0, 10.0, 15.0, 20.0]
    assert spec.optics.vignetting == pytest.approx(barrel[:5], abs=2e-4)
    camera = camera_from_spec(spec.camera)
    uv, _ = project(camera, [np.tan(np.radians(15.0)), 0.0, 1.0])
    column, row = np.rint(uv).astype(int)
    seen = relative_illumination(camera, spec.optics)[row, column]
    assert seen == pytest.approx(np.cos(np.radians(15.0)) ** 4 * 0.625, rel=5e-3)


def test_a_fall_off_against_the_radius_is_that_against_the_angle(tmp_path: Path) -> None:
    """OpenCV says at which radius a distorting lens shows an angle."""
    opencv(tmp_path / "lens.yaml", [*RADTAN[:2], 0.0, 0.0])
    angle = np.array([0.0, 6.0, 12.0, 18.0])
    rays = np.stack([np.tan(np.radians(angle)), 0.0 * angle, 1.0 + 0.0 * angle], axis=1)
    radius = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), MATRIX, np.array([*RADTAN[:2], 0, 0]))[0][:, 0, 0]
    rows = [f"{r:.9f},{v}" for r, v in zip(radius - MATRIX[0, 2], (1.0, 0.97, 0.9, 0.7), strict=True)]
    table = written(tmp_path, "lens.csv", "radius_px,vignetting\n" + "\n".join(rows) + "\n")
    text = camera_text(tmp_path / "lens.yaml", base="vis-cmos-512-60deg", vignetting=table)
    spec = load_camera(written(tmp_path, "ours.toml", text))
    assert spec.optics.vignetting_deg == pytest.approx(angle, abs=1e-6)
    assert spec.optics.vignetting == [1.0, 0.97, 0.9, 0.7]
    with pytest.raises(UserError, match="line 2, column radius_px: found -1"):
        camera_text(tmp_path / "lens.yaml", vignetting=written(tmp_path, "b.csv", "radius_px,vignetting\n-1,1\n5,1\n"))


def test_an_illumination_that_no_pupil_has_is_refused(tmp_path: Path) -> None:
    opencv(tmp_path / "lens.yaml", [0.0] * 5)
    for rows, line in (
        ("field_deg,relative_illumination\n0,1\n20,1\n", "times the law of the pupil"),
        ("field_deg,vignetting\n0,1\n20,1\n10,1\n", "line 4, column field_deg: 10 after 20"),
        ("field_deg,loss\n0,1\n", "columns field_deg, loss"),
        ("field_deg,vignetting\n0,one\n", 'line 2, column vignetting: found "one"'),
    ):
        with pytest.raises(UserError) as found:
            camera_text(tmp_path / "lens.yaml", vignetting=written(tmp_path, "lens.csv", rows))
        assert line in str(found.value)
