"""The circle fit against circles and a textbook's worked data."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.estimation.limb.arc import fit_circle


@pytest.mark.parametrize("arc_deg", [5.0, 40.0, 360.0])
@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_points_of_a_circle_give_it_back(arc_deg: float, offset: float) -> None:
    angle = np.radians(np.linspace(20.0, 20.0 + arc_deg, 200))
    uv = offset + np.array([300.0, -800.0]) + 1500.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    circle = fit_circle(uv)
    assert circle is not None
    # the coordinates' own rounding, amplified by (radius / sagitta): 1e-11 px times 1e3 and 10 for the offset's digits
    assert circle.centre == pytest.approx(offset + np.array([300.0, -800.0]), abs=1e-5)
    assert circle.radius_px == pytest.approx(1500.0, abs=1e-5)
    assert np.abs(circle.distance_px(uv)).max() < 1e-6
    assert circle.nearest(uv) == pytest.approx(uv, abs=1e-6)


def test_the_fit_of_a_noisy_short_arc_is_not_biased_towards_small_circles() -> None:
    """Kasa's fit shrinks short arcs; Taubin's must not, to first order (Chernov 2010, section 5.9)."""
    rng = np.random.default_rng(3)
    angle = np.radians(np.linspace(-15.0, 15.0, 300))
    exact = 1000.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    radii, shrunk = [], []
    for _ in range(200):
        uv = exact + rng.normal(0.0, 2.0, exact.shape)
        circle = fit_circle(uv)
        assert circle is not None
        radii.append(circle.radius_px)
        kasa = np.linalg.lstsq(np.column_stack([uv, np.ones(300)]), (uv**2).sum(axis=1), rcond=None)[0]
        shrunk.append(np.sqrt(kasa[2] + (kasa[:2] ** 2).sum() / 4))
    error = np.std(radii) / np.sqrt(200)
    assert np.mean(radii) == pytest.approx(1000.0, abs=4 * error)
    assert np.mean(shrunk) < 1000.0 - 4 * error


def test_lines_and_single_places_have_no_circle() -> None:
    line = np.column_stack([np.arange(50.0), 7.0 + 0.5 * np.arange(50.0)])
    assert fit_circle(line) is None
    assert fit_circle(np.full((5, 2), 3.0)) is None
    with pytest.raises(ValueError, match="three"):
        fit_circle(line[:2])
