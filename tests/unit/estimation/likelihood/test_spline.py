"""Splines through places of an axis, as weights."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from horizonval.estimation.likelihood.templates import slopes, spline_weights

AXIS = np.array([0.0, 0.4, 0.7, 1.3, 1.5, 2.2])
VALUES = np.array([1.0, 3.0, 2.0, 2.5, 0.5, 0.0])


@pytest.mark.parametrize("level", [(True, True), (True, False), (False, True), (False, False)])
def test_as_the_spline_of_the_same_ends(level):
    def parabola(x, y):
        return np.polyder(np.poly1d(np.polyfit(x, y, 2)))(x[0])

    ends = (
        (1, 0.0 if level[0] else parabola(AXIS[:3], VALUES[:3])),
        (1, 0.0 if level[1] else parabola(AXIS[:-4:-1], VALUES[:-4:-1])),
    )
    x = np.linspace(0.0, 2.2, 50)
    found = spline_weights(AXIS, slopes(AXIS, level), x) @ VALUES
    np.testing.assert_allclose(found, CubicSpline(AXIS, VALUES, bc_type=ends)(x), atol=1e-12)


def test_ends_hold_and_weights_sum_up_to_one():
    weights = spline_weights(AXIS, slopes(AXIS, (False, True)), np.array([-1.0, 0.9, 3.0]))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(weights @ VALUES, [1.0, weights[1] @ VALUES, 0.0], atol=1e-12)
