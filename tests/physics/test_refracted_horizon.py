"""The refracted horizon and the truth of infrared horizons under refraction, against the ray equation."""

from __future__ import annotations

import numpy as np
import pytest
from bent_rays import Air, shoot

from horizonval.earth.column import OpticalModel
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import truth_of
from horizonval.truth.infrared_radiance import straight_heights

AIR = Air()
Z = np.linspace(0.0, 1e5, 1001)


def _model(refractivity: np.ndarray | None) -> OpticalModel:
    return OpticalModel(Z, 1e5, (), 0.0, refractivity=refractivity)


def _entering(height_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where a line at a height past the planet enters the air, and its direction."""
    impact, top = AIR.radius_m + height_m, AIR.radius_m + AIR.top_m
    return np.array([[-np.sqrt(top**2 - impact**2) - 1.0, 0.0, impact]]), np.array([[1.0, 0.0, 0.0]])


@pytest.mark.parametrize("height_m", [1.9e3, 5e3, 12e3, 30e3])
def test_depth_of_a_bent_ray(height_m: float) -> None:
    """2e-4 of the optical depth, the trapezoid's over 100 m; without the change of height it is 0.4 to 30 % off."""
    p, d = _entering(height_m)
    shot, _ = shoot(AIR, p, d, 2.6e6, 5200)
    share = np.exp(-Z / AIR.scale_m)
    heights = straight_heights(_model(AIR.refractivity * share), AIR.radius_m)
    lowest = height_m - heights.rise_m
    radius = AIR.radius_m + heights.rise_m
    u = np.linspace(0.0, np.sqrt(heights.top_m - lowest), 20_001)
    y = lowest + u**2
    slant = 2.0 * (radius + y) / np.sqrt(2.0 * radius + y + lowest)
    k = AIR.extinction_per_m * np.interp(y, heights.height_m, share * heights.stretch)
    depth = 2.0 * np.trapezoid(k * slant, u)
    assert depth == pytest.approx(float(shot.tau[0]), rel=2e-4)


def test_straight_air_keeps_its_heights() -> None:
    heights = straight_heights(_model(None), AIR.radius_m)
    assert heights.rise_m == 0.0
    assert np.array_equal(heights.of(Z), Z)
    assert np.all(heights.stretch == 1.0)


def _scene(**atmosphere: object) -> SceneSpec:
    return SceneSpec.model_validate(
        {
            "camera": {"file": "test"},
            "platform": {"altitude_km": 500.0},
            "earth": {"shape": "sphere"},
            "atmosphere": atmosphere,
        }
    )


CAMERA = CameraSpec.model_validate(
    {
        "camera": {"width": 32, "height": 32, "fov_deg": 60.0},
        "band": [{"name": "b", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6}],
    }
)


def test_the_truth_has_both_horizons() -> None:
    """The rise is (n - 1) R of Peck and Reeder's air at 288.15 K and 1013.25 hPa: 2.7785e-4 at 0.55 um."""
    truth = truth_of(_scene(profile="us76"), CAMERA)
    assert truth.horizon_rise_m == pytest.approx(2.7785e-4 * 6_371_008.8, rel=2e-3)
    assert np.sin(truth.angular_radius_rad) == pytest.approx(6_371_008.8 / 6_871_008.8, rel=1e-12)
    rise = truth.horizon_rise_m
    assert np.sin(truth.refracted_angular_radius_rad) == pytest.approx((6_371_008.8 + rise) / 6_871_008.8, rel=1e-12)
    assert truth.apparent_ellipsoid == Ellipsoid(6_371_008.8 + rise, 6_371_008.8 + rise)


@pytest.mark.parametrize("atmosphere", [{"refraction": False}, {"profile": "none"}])
def test_straight_light_has_one_horizon(atmosphere: dict[str, object]) -> None:
    truth = truth_of(_scene(**atmosphere), CAMERA)
    assert truth.horizon_rise_m == 0.0
    assert truth.refracted_angular_radius_rad == truth.angular_radius_rad


def test_a_camera_inside_the_air_sees_less_of_a_rise() -> None:
    high = _scene()
    low = high.model_copy(update={"platform": high.platform.model_copy(update={"altitude_km": 10.0})})
    outside, inside = truth_of(high, CAMERA), truth_of(low, CAMERA)
    assert 0.5 * outside.horizon_rise_m < inside.horizon_rise_m < 0.8 * outside.horizon_rise_m
