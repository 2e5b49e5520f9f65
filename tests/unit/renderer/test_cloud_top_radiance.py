"""Rays that end on opaque clouds: black bodies as warm as the air, whatever lies behind them."""

from __future__ import annotations

import numpy as np
import pytest
from emission_models import RADIUS_M, black, isothermal

from horizonval.renderer.rays import cloud_top_radiance


@pytest.mark.parametrize("opacity_per_m", [1e-8, 1e-5, 1e-3])
def test_a_cloud_in_isothermal_air_is_a_black_body(opacity_per_m: float) -> None:
    observer = np.tile([-RADIUS_M - 500e3, 0.0, 0.0], (3, 1))
    direction = np.array([[1.0, 0.0, 0.0], [1.0, 0.2, 0.0], [1.0, 0.3, 0.1]])
    distance = np.array([490e3, 520e3, 600e3])
    seen = cloud_top_radiance(isothermal(opacity_per_m, 250.0, 0.3), RADIUS_M, observer, direction, distance)["b"]
    assert seen == pytest.approx(black(250.0), rel=1e-5)
