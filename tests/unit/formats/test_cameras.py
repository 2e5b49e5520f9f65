"""Cameras of other programs: OpenCV projects points through what they say, ours must put them into the same pixels."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from horizonval.api.calibrate import camera_text
from horizonval.core.errors import UserError
from horizonval.formats.lens import read_camera
from horizonval.geometry.camera import camera_from_spec, project, unproject
from horizonval.sensor.lens.optics import relative_illumination
from horizonval.spec.camera import CameraGeometry
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


NUMBERS = [812.5, 808.75, 322.25, 236.5]
SIZE = "image_width: 640\nimage_height: 480\n"


def kalibr(model: str, k: list[float], camera_model: str = "pinhole", first: tuple[float, ...] = ()) -> str:
    """Return a camchain of Kalibr, as its wiki shows it."""
    return f"""cam0:
  camera_model: {camera_model}
  intrinsics: {flow([*first, *NUMBERS])}
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


def pixels_of(path: Path, tmp_path: Path, **options: Any) -> np.ndarray:
    """Return where our camera, by its own file, puts the directions."""
    ours = written(tmp_path, "ours.toml", camera_text(path, **options))
    uv, seen = project(camera_from_spec(load_camera(ours).camera), DIRECTIONS)
    assert seen.all()
    return uv


BROWN_PIXELS = cv2.projectPoints(DIRECTIONS, np.zeros(3), np.zeros(3), MATRIX, np.array(RADTAN))[0][:, 0]
FISHEYE_PIXELS = cv2.fisheye.projectPoints(DIRECTIONS[:, None], np.zeros(3), np.zeros(3), MATRIX, np.array(EQUI))[0][
    :, 0
]


@pytest.mark.parametrize("name", ["camera.yaml", "camera.xml", "camera.json"])
def test_opencv_puts_points_where_its_own_file_says(tmp_path: Path, name: str) -> None:
    opencv(tmp_path / name, RADTAN)
    assert np.abs(pixels_of(tmp_path / name, tmp_path) - BROWN_PIXELS).max() < 1e-9
    opencv(tmp_path / name, EQUI, fisheye_model=1)
    assert np.abs(pixels_of(tmp_path / name, tmp_path) - FISHEYE_PIXELS).max() < 1e-9


def keys(names: str, numbers: list[float]) -> str:
    return "{" + ", ".join(f'"{n}": {v!r}' for n, v in zip(names.split(), numbers, strict=True)) + "}"


XI, OMNI = 1.2, [-0.1, 0.05, 1e-3, -2e-3]
RATIONAL = [*RADTAN, 0.1, 0.02, -0.004]
PRISM = [*RATIONAL, 3e-3, -1e-3, 2e-3, 5e-4]
MEI, SPHERE = (
    {"projection": "unified", "xi": XI, "distortion": OMNI},
    {"projection": "unified", "xi": -0.2, "alpha": 0.6},
)
FISHEYE = {"projection": "fisheye", "distortion": EQUI}
EUROC = (
    "sensor_type: camera\nT_BS:\n  cols: 4\nrate_hz: 20\nresolution: [640, 480]\ncamera_model: pinhole\n"
    f"intrinsics: {NUMBERS}\ndistortion_model: radial-tangential\ndistortion_coefficients: {RADTAN[:4]}\n"
)


def camodocal(kind: str, **tables: str) -> str:
    lines = "".join(f"{table}_parameters: {keys}\n" for table, keys in tables.items())
    return f"%YAML:1.0\n---\nmodel_type: {kind}\ncamera_name: a\n{SIZE}{lines}"


def basalt(kind: str, names: str, numbers: list[float]) -> str:
    one = f'{{"camera_type": "{kind}", "intrinsics": {keys(f"fx fy cx cy {names}", [*NUMBERS, *numbers])}}}'
    return f'{{"value0": {{"T_imu_cam": [], "intrinsics": [{one}], "resolution": [[640, 480]]}}}}'


@pytest.mark.parametrize(
    ("text", "lens"),
    [
        (EUROC, {"distortion": RADTAN[:4]}),
        (f"{SIZE}mtx: {MATRIX.tolist()}\ndist: [{RADTAN}]\n", {"distortion": RADTAN}),
        (ros("plumb_bob", RADTAN), {"distortion": RADTAN}),
        (ros("rational_polynomial", [*RADTAN, 0.0, 0.0, 0.0]), {"distortion": RADTAN}),
        (ros("rational_polynomial", RATIONAL), {"distortion": RATIONAL}),
        (ros("rational_polynomial", [*PRISM, 0.0, 0.0]), {"distortion": PRISM}),
        (ros("equidistant", EQUI), FISHEYE),
        (ros("equidistant", EQUI).replace("[812.5, 0.0,", "[812.5, 16.25,"), {**FISHEYE, "skew": 0.02}),
        (kalibr("radtan", RADTAN[:4]), {"distortion": RADTAN[:4]}),
        (kalibr("equi", EQUI), FISHEYE),
        (kalibr("radtan", OMNI, "omni", (XI,)), MEI),
        (kalibr("none", [], "ds", (-0.2, 0.6)), SPHERE),
        (kalibr("none", [], "eucm", (0.6, 1.1)), {"projection": "unified", "alpha": 0.6, "beta": 1.1}),
        (basalt("kb4", "k1 k2 k3 k4", EQUI), FISHEYE),
        (basalt("ds", "xi alpha", [-0.2, 0.6]), SPHERE),
        (camodocal("PINHOLE", distortion=keys("k1 k2 p1 p2", RADTAN[:4]), projection=keys("fx fy cx cy", NUMBERS)),
         {"distortion": RADTAN[:4]}),
        (camodocal("KANNALA_BRANDT", projection=keys("k2 k3 k4 k5 mu mv u0 v0", EQUI + NUMBERS)), FISHEYE),
        (camodocal("MEI", mirror=keys("xi", [XI]), distortion=keys("k1 k2 p1 p2", OMNI),
                   projection=keys("gamma1 gamma2 u0 v0", NUMBERS)), MEI),
        (ros("", OMNI).replace("distortion_model: \n", f"xi: {XI}\nflags: 0\n"), MEI),
    ],
)  # fmt: skip
def test_programs_mean_the_same_lenses(tmp_path: Path, text: str, lens: dict[str, Any]) -> None:
    """To 1e-9 px. ``test_wide_lenses`` compares our lenses with OpenCV and the papers."""
    scale = dict(zip(("fx", "fy", "cx", "cy"), NUMBERS, strict=True))
    geometry = CameraGeometry.model_validate({"width": 640, "height": 480, **scale, **lens})
    expected = project(camera_from_spec(geometry), DIRECTIONS)[0]
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
    skew = [[fx, 0, 0], [9, fy, 0], [1, 1, 1]]
    skewed = matlab(RadialDistortion=None, TangentialDistortion=None, IntrinsicMatrix=skew)
    x, y, z = DIRECTIONS.T
    expected = np.stack([fx * x / z + 9.0 * y / z, fy * y / z], axis=1)
    assert np.abs(pixels_of(written(tmp_path, "theirs.json", skewed), tmp_path) - expected).max() < 1e-9


MESSAGE = """height: {height}
width: {width}
distortion_model: plumb_bob
D: [0.015, -0.043, -0.0012, -0.0015, 0.0089]
K: [800.0, 0.0, 631.0, 0.0, 804.0, 375.5, 0.0, 0.0, 1.0]
R: [1, 0, 0, 0, 1, 0, 0, 0, 1]
P: [403.9, 0, 311.0, 0, 0, 403.9, 175.7, 0, 0, 0, 1, 0]
binning_x: {bx}
binning_y: {by}
roi: {{x_offset: {x}, y_offset: {y}, height: {h}, width: {w}, do_rectify: false}}
"""


@pytest.mark.parametrize(
    ("width", "height", "x", "y", "w", "h", "bx", "by", "size"),
    [
        (1280, 800, 0, 0, 0, 0, 0, 0, (1280, 800)),
        (1280, 800, 320, 200, 640, 400, 1, 1, (640, 400)),
        (640, 400, 320, 200, 640, 400, 1, 1, (640, 400)),
        (1280, 800, 0, 0, 0, 0, 2, 4, (640, 200)),
        (1280, 800, 101, 50, 601, 300, 2, 2, (300, 150)),
        (1280, 800, 0, 790, 1280, 2, 1, 1, (1280, 2)),
    ],
)
def test_region_and_binning_are_what_cutting_and_adding_pixels_makes(
    tmp_path: Path, width: int, height: int, x: int, y: int, w: int, h: int, bx: int, by: int, size: tuple[int, int]
) -> None:
    """A binned pixel's centre is the mean of its pixels' centres; the strip of two rows is 400 rows from the axis."""
    text = MESSAGE.format(width=width, height=height, x=x, y=y, w=w, h=h, bx=bx, by=by)
    ours = camera_from_spec(
        load_camera(written(tmp_path, "o.toml", camera_text(written(tmp_path, "m.yaml", text)))).camera
    )
    assert (ours.width, ours.height) == size
    whole = MESSAGE.format(width=1280, height=800, x=0, y=0, w=0, h=0, bx=0, by=0)
    full = camera_from_spec(
        load_camera(written(tmp_path, "f.toml", camera_text(written(tmp_path, "m.yaml", whole)))).camera
    )
    bx, by = max(bx, 1), max(by, 1)
    for column, row in ((0, 0), (size[0] - 1, size[1] - 1)):
        part = np.array([x + bx * column + (bx - 1) / 2, y + by * row + (by - 1) / 2])
        d = unproject(full, part)
        assert project(ours, d)[0] == pytest.approx([column, row], abs=1e-9)


ECHO = ros("plumb_bob", RADTAN) + "---\n"


def test_documents_of_one_camera_are_one(tmp_path: Path) -> None:
    """`ros2 topic echo` ends with ---, and repeats the message; numbers are read with any program's digits."""
    again = ros("plumb_bob", RADTAN).replace("812.5", "8.125e2").replace("[1, 0, 0,", "[1., .0, +0,")
    for text in (ECHO, "---\n" + ECHO, ECHO + ECHO, ECHO + again, "\ufeff" + ECHO):
        assert np.abs(pixels_of(written(tmp_path, "a.yaml", text), tmp_path) - BROWN_PIXELS).max() < 1e-9


FOUR = ros("plumb_bob", EQUI).replace("distortion_model: plumb_bob\n", "")


def test_four_coefficients_without_a_model_ask_for_it(tmp_path: Path) -> None:
    path = written(tmp_path, "a.yaml", FOUR)
    assert np.abs(pixels_of(path, tmp_path, model="fisheye") - FISHEYE_PIXELS).max() < 1e-9
    expected = cv2.projectPoints(DIRECTIONS, np.zeros(3), np.zeros(3), MATRIX, np.array(EQUI))[0][:, 0]
    assert np.abs(pixels_of(path, tmp_path, model="pinhole") - expected).max() < 1e-9


STEREO = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n" + "".join(
    f"M{n}: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [{n}., 0., 1., 0., {n}., 1., 0., 0., 1.]\n"
    f"D{n}: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [0., 0., 0., 0., 0.]\n"
    for n in (1, 2)
)


def test_a_stereo_file_has_two_cameras(tmp_path: Path) -> None:
    path = written(tmp_path, "intrinsics.yml", STEREO)
    assert [read_camera(path, name)[0].fx for name in ("1", "2")] == [1.0, 2.0]


def bomb() -> str:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 20)]
    return "\n".join(lines) + "\nK: *a19\n"


KALIBR, ROI = kalibr("radtan", RADTAN[:4]), MESSAGE.format(width=1280, height=800, x=700, y=0, w=640, h=400, bx=1, by=1)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (FOUR, "4 coefficients without a model"),
        (FOUR.replace(flow(EQUI), "[0, 0, 0, 0]"), "4 coefficients without a model"),
        (ros("plumb_bob", [*RADTAN, 0.1, 0.0, 0.0]), "8 coefficients that are not 0; expected k1 k2 p1 p2 k3"),
        (ros("rational_polynomial", [*RADTAN, *[0.0] * 8, 0.1]), "tauX and tauY of a tilted sensor"),
        (ros("thin_prism", RADTAN), "distortion_model: found 'thin_prism'"),
        (ros("plumb_bob", RADTAN) + "fisheye_model: 1\n", "distortion_model means pinhole and fisheye_model means"),
        (ros("plumb_bob", RADTAN) + "xi: 1.2\n", "distortion_model means pinhole and xi means unified"),
        (
            ros("plumb_bob", RADTAN).replace("640", "99999"),
            "an image of 99999 x 480 px; expected 16384 px",
        ),
        (ros("plumb_bob", RADTAN) + "gain: 2\n", "gain: a key that is not known of files of ROS and OpenCV"),
        (ros("plumb_bob", RADTAN) + "image_width: 320\n", "image_width: found twice"),
        (ros("plumb_bob", RADTAN) + f"K: {flow(MATRIX)}\n", "K: the same as camera_matrix"),
        (ros("plumb_bob", RADTAN).replace("cols: 5", "cols: 4"), "found 5 numbers; expected 1 x 4"),
        (ros("plumb_bob", RADTAN).replace("image_width: 640\n", ""), "image_width: found nothing"),
        (ros("plumb_bob", RADTAN).replace(flow(RADTAN), "[-0.1 0.2 0 0 0]"), "5 numbers without commas between them"),
        (ros("plumb_bob", RADTAN).replace(flow(RADTAN), "-0.1 0.2 0 0 0"), "5 numbers without commas between them"),
        (ros("plumb_bob", [float("nan")] * 5), "found 'nan'; expected"),
        (ros("plumb_bob", [0.0] * 5).replace(flow(MATRIX), flow([0] * 9)), "a camera that is not calibrated"),
        (ECHO + ECHO.replace("812.5", "900"), "2 documents, of which 1 and 2 state different cameras"),
        (ROI, "640 x 400 px from column 700, row 0; expected a region of the image of 1280 x 800 px"),
        (ROI.replace("do_rectify", "rotation"), "roi: rotation: a key that is not known"),
        (KALIBR.replace("radtan", "fov"), "cam0: distortion_model: found 'fov'"),
        (KALIBR.replace("pinhole", "mirror"), "cam0: camera_model: found 'mirror'"),
        (
            KALIBR.replace("pinhole", "ds").replace("intrinsics: [", "intrinsics: [0, 0, "),
            "cam0: distortion_model: found 'radtan'; expected none",
        ),
        (KALIBR.replace("pinhole", "ds"), "cam0: intrinsics: found 4 numbers; expected 6 finite numbers"),
        (KALIBR.replace("radtan", "none"), "coefficients that are not 0; expected none"),
        (KALIBR.replace("  distortion_model: radtan\n", ""), "distortion_model: missing"),
        (KALIBR + "  shutter: rolling\n", "cam0: shutter: a key that is not known of files of Kalibr"),
        (KALIBR + KALIBR.replace("cam0", "cam1"), "2 cameras: cam0, cam1"),
        (STEREO, "2 cameras: 1, 2"),
        (matlab(MappingCoefficients=[1, 2, 3, 4]), "a fisheye of MATLAB's own"),
        (matlab(StretchMatrix=[[1, 0], [0, 1]]), "StretchMatrix: a fisheye of MATLAB's own"),
        (matlab(ImageSize=None), "ImageSize: found nothing"),
        (matlab(Zoom=2), "Zoom: a key that is not known of files of MATLAB"),
        (matlab(K=[[800, 0, 1], [0, 800, 1], [0, 0, 1]]), "one value by all keys"),
        (matlab().replace("{", '{"ImageSize": [1, 1], ', 1), "ImageSize: found twice"),
        ("width: 640\n", "a camera of no program that is known, with the keys width"),
        ("a: [1\n", "not valid YAML (line"),
        ("K: &x [*x]\n", "not valid YAML (line 1)"),
        (bomb(), "more than 50000 values, aliases included"),
        ("K: " + "[" * 3000 + "]" * 3000, "not valid YAML"),
        ("K: " + "[" * 60 + "]" * 60, "nested too deeply"),
        ("", "holds no keys"),
        ("- 1\n", "holds no keys"),
        ("<?xml version='1.0'?>\n<opencv_storage>\n<K>", "not valid XML (line 3)"),
        ("<opencv_storage><K>1</K><K>2</K></opencv_storage>", "K: found twice"),
        ("<opencv_storage>" + "<a>" * 60 + "</a>" * 60 + "</opencv_storage>", "nested too deeply"),
        ("<!DOCTYPE a [<!ENTITY b 'c'>]><opencv_storage/>", "entities"),
        ("%YAML:1.0\n---\nM: !!opencv-matrix\n", "expected"),
    ],
)
def test_what_changes_the_meaning_or_cannot_be_read_is_one_line(tmp_path: Path, text: str, line: str) -> None:
    path = written(tmp_path, "a.yaml", text)
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
    opencv(tmp_path / "lens.yaml", [*RADTAN[:2], 0.0, 0.0, 0.0])
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
