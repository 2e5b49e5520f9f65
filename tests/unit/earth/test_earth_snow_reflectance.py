"""Snow's reflectance against energy and its known shape."""

from __future__ import annotations

import numpy as np
import pytest
from earth_forms import snow_factor

from horizonval.earth.surface.surface import SNOW_NODES, mean_snow_reflection


def _cosine(mu_sun: float, mu_view: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Between the directions to Sun and observer; azimuth 0 is on the Sun's side."""
    return mu_sun * mu_view + np.sqrt((1.0 - mu_sun**2) * (1.0 - mu_view**2)) * np.cos(azimuth)


@pytest.mark.parametrize("zenith_deg", [0.0, 30.0, 55.0, 70.0, 80.0, 88.0])
def test_snow_keeps_its_albedo(zenith_deg: float) -> None:
    """The hemispherical integral of ``factor cos / pi`` is 1 to 1 %: by a midpoint rule of our own."""
    theta = np.radians((np.arange(900) + 0.5) * 0.1)
    azimuth = np.radians(np.arange(0.5, 360.0, 1.0))
    mu = np.cos(theta)[:, None]
    factor = snow_factor(np.cos(np.radians(zenith_deg)), mu, _cosine(np.cos(np.radians(zenith_deg)), mu, azimuth))
    weight = mu * np.sin(theta)[:, None] * np.radians(0.1) * np.radians(1.0) / np.pi
    assert float((factor * weight).sum()) == pytest.approx(1.0, abs=0.01)


def test_snow_shines_forward_the_more_the_lower_the_sun() -> None:
    """Away from the Sun brighter than towards it, and nadir darker than a Lambert surface."""
    view = np.array(np.cos(np.radians(70.0)))
    forward = []
    for zenith_deg in (50.0, 60.0, 70.0, 80.0):
        sun = float(np.cos(np.radians(zenith_deg)))
        away, towards = (float(snow_factor(sun, view, _cosine(sun, view, np.array(a)))) for a in (np.pi, 0.0))
        assert away > towards
        forward.append(away)
    assert np.all(np.diff(forward) > 0.0)
    assert forward[-1] > 1.5
    low = np.cos(np.radians(67.0))
    assert 0.85 < float(snow_factor(low, 1.0, low)) < 0.97


def test_the_factor_is_nearly_reciprocal() -> None:
    """As far as N is the same at all heights of the Sun: 2 % above 9 deg."""
    mean = mean_snow_reflection()[np.linspace(0.0, 1.0, SNOW_NODES) > np.sin(np.radians(9.0))]
    assert 0.98 < mean.min() <= mean.max() < 1.02
