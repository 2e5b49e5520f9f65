"""Camera files that contradict themselves are refused with the key and both values; those that agree are not."""

from __future__ import annotations

import math
from typing import Any

import pytest

from horizonval.core.errors import UserError
from horizonval.geometry.camera import camera_from_spec, unproject
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import validate

CMOS = {
    "pixel_pitch_um": 5.5,
    "exposure_s": 1e-3,
    "quantum_efficiency": 0.6,
    "full_well_e": 13500.0,
    "read_noise_e": 13.0,
    "bits": 10,
    "kind": "cmos",
}


def spec(detector: dict[str, Any] | None = CMOS, **camera: Any) -> CameraSpec:
    data: dict[str, Any] = {"camera": {"width": 512, "height": 512} | camera}
    if detector is not None:
        data["detector"] = detector
    return validate(CameraSpec, data, "c.toml")


@pytest.mark.parametrize(
    ("camera", "parts"),
    [
        # 512 x 5.5 um behind 8 mm: 2 atan(1.408 / 8) = 19.97 deg
        ({"fov_deg": 60.0, "focal_length_mm": 8.0}, ["fov_deg = 60", "2.439 mm", "focal_length_mm = 8", "= 5.5"]),
        ({"fx": 1480.0, "focal_length_mm": 8.0}, ["fx = 1480", "8.14 mm", "focal_length_mm = 8", "pixel_pitch_um"]),
        ({"fov_deg": 60.0, "cx": 5000.0}, ["cx = 5000", "width = 512"]),
        ({"fov_deg": 60.0, "cy": -600.0}, ["cy = -600", "height = 512"]),
        ({"fov_deg": 190.0}, ["fov_deg = 190", "less than 180", "fisheye"]),
        ({"fov_deg": 60.0, "image_circle_deg": 185.0}, ["image_circle_deg = 185", "less than 180"]),
        ({"fov_deg": 360.0, "projection": "fisheye"}, ["camera.fov_deg", "found 360", "below 360"]),
        (
            {"fov_deg": 220.0, "projection": "fisheye", "distortion": [-0.1]},
            ["fov_deg = 220", "distortion = [-0.1]", "209.2"],
        ),
        (
            {"fx": 100.0, "projection": "fisheye", "distortion": [-0.1], "image_circle_deg": 210.0},
            ["image_circle_deg = 210", "209.2"],
        ),
        (
            {"fov_deg": 190.0, "projection": "fisheye", "distortion": [0.1] * 5},
            ["distortion has 5 numbers", "k1 k2 k3 k4"],
        ),
        ({}, ["exactly one of fov_deg and fx"]),
    ],
)
def test_a_contradiction_is_refused(camera: dict[str, Any], parts: list[str]) -> None:
    with pytest.raises(UserError) as refusal:
        spec(**camera)
    for part in parts:
        assert part in refusal.value.line(), refusal.value.line()


def test_a_focal_length_without_a_pixel_pitch_is_no_scale() -> None:
    with pytest.raises(UserError, match="pixel_pitch_um"):
        spec(detector=None, focal_length_mm=8.0)


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
