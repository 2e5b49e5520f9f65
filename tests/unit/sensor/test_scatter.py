"""Scatter wings against integrals taken by another's quadrature."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import dblquad, quad

from horizonval.sensor.lens import scatter
from horizonval.spec.optics import Scatter

SHAPES = [(0.3, -1.5), (0.01, -1.5), (0.01, -2.0), (0.004, -3.0), (1e-4, -2.0)]


@pytest.mark.parametrize(("l_rad", "s"), SHAPES)
def test_total_integrated_scatter(l_rad, s):
    given = Scatter(b0=0.1, l_rad=l_rad, s=s)
    parts = [0, l_rad / 10, l_rad, min(10 * l_rad, 0.99), 1]
    exact = sum(
        quad(lambda x: 2 * math.pi * x * 0.1 * (1 + (x / l_rad) ** 2) ** (s / 2), a, b, epsabs=0, epsrel=1e-11)[0]
        for a, b in pairwise(parts)
    )
    assert given.total == pytest.approx(exact, rel=1e-9)
    assert Scatter(tis=exact, l_rad=l_rad, s=s).level == pytest.approx(0.1, rel=1e-9)


@pytest.mark.parametrize(("l_rad", "s"), SHAPES)
def test_image_plane_holds_the_total(l_rad, s):
    """Over the whole plane it is all; over a rectangle what a double integral finds."""
    given = Scatter(tis=0.01, l_rad=l_rad, s=s)
    assert scatter.share_in_rectangle(given, 1e5, 1e5) == pytest.approx(0.01, rel=1e-4)
    if l_rad >= 0.01:
        exact = 4 * dblquad(lambda y, x: float(scatter.image_share(given, x * x + y * y)), 0, 0.5, 0, 0.3)[0]
        assert scatter.share_in_rectangle(given, 0.5, 0.3) == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize(("l_rad", "s"), SHAPES)
def test_kernel_on_pixels(l_rad, s):
    given = Scatter(tis=0.01, l_rad=l_rad, s=s)
    kernel = scatter.quadrant(given, 300, 400, 350.0, 360.0)
    assert kernel.min() > 0
    inside = scatter.share_in_rectangle(given, 399.5 / 350, 299.5 / 360)
    assert scatter.quadrant_sum(kernel) == pytest.approx(inside, rel=1e-12)
    # The scale to that sum is the error of taking pixels by their centre: small.
    law = scatter.bsdf(given, np.sin(np.arctan(200 / 350))) * math.cos(math.atan(200 / 350)) ** 4 / (350 * 360)
    assert kernel[0, 200] == pytest.approx(law, rel=1e-3)
