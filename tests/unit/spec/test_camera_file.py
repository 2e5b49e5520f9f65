"""What a camera file says of scale, field of view and lens, and what of it is kept with frames."""

from __future__ import annotations

import math
from typing import Any

import pytest
from synthetic import CMOS

from horizonval.geometry.camera import camera_from_spec, unproject
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import validate


def spec(detector: dict[str, Any] | None = CMOS, **camera: Any) -> CameraSpec:
    data: dict[str, Any] = {"camera": {"width": 512, "height": 512} | camera}
    if detector is not None:
        data["detector"] = detector
    return validate(CameraSpec, data, "c.toml")


@pytest.mark.parametrize("projection", ["pinhole", "fisheye", "equal_angle"])
def test_focal_length_and_pitch_are_a_scale(projection: str) -> None:
    """8 mm over 5.5 um; and what was worked out is written down where the file is kept, and read again."""
    made = spec(focal_length_mm=8.0, projection=projection)
    assert camera_from_spec(made.camera).fx == pytest.approx(8000.0 / 5.5, rel=1e-15)
    again = CameraSpec.model_validate(made.model_dump(mode="json"))
    assert camera_from_spec(again.camera) == camera_from_spec(made.camera)


def test_rounded_figures_of_a_data_sheet_agree() -> None:
    """20 deg is 7.985 mm; a data sheet says 8.0."""
    assert spec(fov_deg=20.0, focal_length_mm=8.0).camera.fx is None


@pytest.mark.parametrize(
    ("projection", "distortion", "fov_deg"),
    [("pinhole", [], 60.0), ("fisheye", [], 190.0), ("fisheye", [0.02, -0.004], 190.0), ("equal_angle", [], 200.0)],
)
def test_the_field_of_view_lies_between_the_outer_edges(
    projection: str, distortion: list[float], fov_deg: float
) -> None:
    """1e-12 rad, along the middle row."""
    geometry: dict[str, Any] = {"projection": projection, "distortion": distortion, "fov_deg": fov_deg, "height": 4}
    camera = camera_from_spec(spec(**geometry).camera)
    for column, side in ((-0.5, -1.0), (511.5, 1.0)):
        d = unproject(camera, [column, 1.5])
        assert math.atan2(d[0], d[2]) == pytest.approx(side * math.radians(fov_deg) / 2, abs=1e-12)


def test_keys_that_are_not_used_leave_no_trace() -> None:
    """A file written before there were such keys keeps its identity, hence its noise."""
    data = spec(fov_deg=60.0).model_dump(mode="json")
    assert "head" not in data
    assert set(data["camera"]) == {
        *("name", "source", "width", "height", "fov_deg", "fx", "fy", "cx", "cy", "distortion", "projection")
    }
    assert spec(fov_deg=60.0, image_circle_deg=50.0).model_dump()["camera"]["image_circle_deg"] == 50.0


@pytest.mark.parametrize(
    "window",
    [
        {"width": 1280, "height": 16, "fx": 1000.0, "cy": -472.0},
        {"width": 64, "height": 64, "fx": 2000.0, "cx": -1500.0, "cy": 900.0},
        {"width": 64, "height": 64, "fx": 100.0, "cx": -250.0, "projection": "fisheye"},
    ],
)
def test_the_axis_of_a_strip_or_a_window_may_lie_far_outside(window: dict[str, Any]) -> None:
    """Its directions are those of the same pixels of the whole image."""
    camera = camera_from_spec(spec(None, **window).camera)
    by = [600.0 - camera.cx, 500.0 - camera.cy]
    whole = spec(None, **window | {"width": 1200, "height": 1000, "cx": 600.0, "cy": 500.0})
    corner = [0.0, camera.height - 1.0]
    d = unproject(camera_from_spec(whole.camera), [corner[0] + by[0], corner[1] + by[1]])
    assert unproject(camera, corner) == pytest.approx(d, abs=1e-15)


SCATTER = {"b0": 0.1, "l_rad": 0.01, "s": -2.0}


def test_aperture_against_f_number_and_focal_length(camera_tables):
    """40 pixels of 5.5 um over 60 deg are a focal length of 0.1905 mm."""
    camera_tables["optics"]["aperture_mm"] = 0.1905 / 4
    CameraSpec.model_validate(camera_tables)


def test_keys_survive_the_archive(camera_tables):
    camera_tables["optics"] |= {
        "diffraction": True,
        "scatter": SCATTER,
        "stray": {"angle_deg": [30, 40], "pst": [1e-3, 1e-4]},
        "ghost": [{"ratio": 0.1}],
    }
    spec = CameraSpec.model_validate(camera_tables)
    assert CameraSpec.model_validate(spec.model_dump(mode="json")) == spec
    assert "defocus_um" not in spec.model_dump()["optics"]
