"""Heights of the horizon in profiles whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.studies.stability.locate import highest_crossing, locate

HEIGHT_M = 1e3 * np.array([-10.0, -0.05, 0.05, *np.arange(1.0, 101.0)])


def opaque(centre_m, plateau=6.0):
    """A plateau that falls over 20 km on both sides of ``centre_m``; steepest and half there."""
    return 0.5 * plateau * (1.0 - np.tanh((HEIGHT_M - centre_m) / 6e3))


def test_air_is_the_horizon():
    found = locate(HEIGHT_M, np.stack([opaque(38e3), opaque(43e3)])[None])
    assert found.kind == "opaque"
    # Cubics over 1 km of a fall of 6 km: 1 m at the half height; the steepest place is flat, 30 m.
    np.testing.assert_allclose(found.half_m, [[38e3, 43e3]], rtol=0, atol=3.0)
    np.testing.assert_allclose(found.gradient_m, [[38e3, 43e3]], rtol=0, atol=30.0)
    np.testing.assert_allclose(found.plateau, [[6.0, 6.0]], rtol=2e-3)


def test_the_ground_is_the_horizon():
    window = np.where(HEIGHT_M < 0, 12.0, 0.5 * 12.0 * (1.0 - np.tanh((HEIGHT_M - 4e3) / 2.5e3)))
    found = locate(HEIGHT_M, window[None, None])
    assert found.kind == "window"
    assert float(found.plateau[0, 0]) == 12.0
    assert float(found.half_m[0, 0]) == pytest.approx(4e3, abs=10.0)


def test_both_kinds_at_once():
    window = np.where(HEIGHT_M < 0, 12.0, 0.01)
    assert locate(HEIGHT_M, np.stack([opaque(40e3), window])[:, None]).kind == "mixed"


def test_a_fixed_radiance():
    line = np.clip((50e3 - HEIGHT_M) / 1e4, 0.0, None)
    # Away from its ends a straight profile is its own monotone cubic.
    np.testing.assert_allclose(
        highest_crossing(HEIGHT_M, np.stack([line, 2 * line]), 1.55), [34.5e3, 42.25e3], rtol=0, atol=0.1
    )


def test_the_highest_of_several_crossings():
    wave = np.cos(HEIGHT_M / 5e3) * (HEIGHT_M < 50e3)
    found = float(highest_crossing(HEIGHT_M, wave, 0.5))
    # It falls through one half at 5.2, 36.7 and, were it not cut off, at 68.1 km.
    assert found == pytest.approx(5e3 * (2 * np.pi + np.pi / 3), abs=30.0)


def test_profiles_that_never_cross():
    assert float(highest_crossing(HEIGHT_M, np.zeros_like(HEIGHT_M), 1.0)) == pytest.approx(-10e3)
    assert float(highest_crossing(HEIGHT_M, np.ones_like(HEIGHT_M), 0.5)) == pytest.approx(100e3)
