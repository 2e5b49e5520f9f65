"""Crossings of the limb in one row, against edges whose place is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.crossing import Crossing, published_crossing, sub_pixel_crossing

PIXELS = np.arange(160.0)
PLACES = 79.5 + np.linspace(-0.5, 0.5, 21)


def _hard(place: float) -> np.ndarray:
    """Return a step seen by pixels of full width: 1 to the left of ``place``."""
    return np.clip(place - (PIXELS - 0.5), 0.0, 1.0)


def _ramp(place: float, width: float) -> np.ndarray:
    """Return the pixel means of a straight slope of some width about ``place``."""

    def primitive(x: np.ndarray) -> np.ndarray:
        inside = np.clip(x - place + 0.5 * width, 0.0, width)
        return np.minimum(x, place + 0.5 * width) - 0.5 * inside**2 / width

    return primitive(PIXELS + 0.5) - primitive(PIXELS - 0.5)


def _blurred(place: float, sigma: float) -> np.ndarray:
    """Return the pixel means of a step seen through a Gaussian, by its primitive."""

    def primitive(x: np.ndarray) -> np.ndarray:
        z = (x - place) / (np.sqrt(2.0) * sigma)
        falls = (x - place) * 0.5 * (1.0 + erf(z)) + sigma / np.sqrt(2.0 * np.pi) * np.exp(-(z**2))
        return x - falls

    return primitive(PIXELS + 0.5) - primitive(PIXELS - 0.5)


def _column(row: np.ndarray, kind: str) -> float:
    found = sub_pixel_crossing(row)
    assert isinstance(found, Crossing), found
    assert found.kind == kind
    return found.column


@pytest.mark.parametrize(
    "edge",
    [_hard, lambda place: _ramp(place, 1.5), lambda place: _blurred(place, 0.3)],
    ids=["hard", "ramp of 1.5 px", "Gaussian of 0.3 px"],
)
def test_area_is_exact_for_every_unresolved_edge(edge) -> None:
    """To 1e-6 px: no light lies beyond the window (Gaussian: ten sigma)."""
    errors = [_column(700.0 * edge(place) + 20.0, "area") - place for place in PLACES]
    assert np.abs(errors).max() < 1e-6


@pytest.mark.parametrize("sigma", [2.0, 2.5])
def test_half_level_of_a_resolved_edge(sigma: float) -> None:
    """A Gaussian step is odd about its middle. Its plateau from 5 px on lacks 0.6 % of the step (2 px) or 2.3 % (2.5),
    whose half moves the crossing by up to 0.004 px and 0.025 px; the spline adds less than 1e-3."""
    errors = [_column(700.0 * _blurred(place, sigma) + 20.0, "half-level") - place for place in PLACES]
    assert np.abs(errors).max() < {2.0: 0.006, 2.5: 0.03}[sigma]
    assert np.ptp(errors) < 2e-3


@pytest.mark.parametrize("row", [_hard(70.3), _blurred(70.3, 2.0)], ids=["hard", "soft"])
def test_earth_may_be_at_either_end(row: np.ndarray) -> None:
    there, mirrored = sub_pixel_crossing(500.0 * row), sub_pixel_crossing(500.0 * row[::-1])
    assert isinstance(there, Crossing)
    assert isinstance(mirrored, Crossing)
    assert mirrored.column == pytest.approx(159.0 - there.column, abs=1e-9)


def test_published_crossing_knows_whole_pixels_only() -> None:
    """The fine crossing steps by 1 and is half a pixel off at most, as if there were no samples every 0.1 px."""
    places = 79.5 + np.linspace(-2.0, 2.0, 401)
    fine = np.array([published_crossing(1000.0 * _hard(place)).fine for place in places])
    fraction = fine - np.floor(fine)
    assert np.ptp(fraction) < 1e-9
    assert len(np.unique(np.round(fine, 6))) == 5
    error = fine - places
    assert np.ptp(error) == pytest.approx(1.0, abs=0.02)
    assert error.std() == pytest.approx(1 / np.sqrt(12.0), abs=0.02)


def test_published_median_filter_removes_a_dead_pixel() -> None:
    row = 1000.0 * _hard(79.5)
    row[30] = 0.0
    assert published_crossing(row).coarse == 79


@pytest.mark.parametrize(
    ("row", "word"),
    [
        (np.random.default_rng(1).normal(20.0, 3.0, 160).round(), "noise"),
        (np.linspace(900.0, 700.0, 160), ""),
        (1000.0 * _hard(2.0), "end"),
        (1000.0 * _blurred(154.0, 2.5), "end"),
        (np.full(160, 500.0), ""),
    ],
    ids=["space", "slope of the disc", "hard limb at the end", "soft limb at the end", "constant"],
)
def test_rows_without_a_limb_are_refused(row: np.ndarray, word: str) -> None:
    found = sub_pixel_crossing(row)
    assert isinstance(found, Refusal)
    assert found.status is Outcome.NO_LIMB
    assert word in found.reason


@pytest.mark.parametrize("row", [np.full(160, np.nan), np.ones(5)])
def test_rows_that_cannot_hold_a_limb(row: np.ndarray) -> None:
    found = sub_pixel_crossing(row)
    assert isinstance(found, Refusal)
    assert found.status is Outcome.BAD_INPUT


def test_soft_limb_near_the_end_is_found_with_less_trust() -> None:
    """Dark level from the last three pixels, 3 sigma outside: a Gaussian is dark there to 0.1 %."""
    found = sub_pixel_crossing(1000.0 * _blurred(151.3, 2.0))
    assert isinstance(found, Crossing)
    assert found.column == pytest.approx(151.3, abs=0.02)
    assert found.sigma_px == pytest.approx(0.1, rel=0.01)


@pytest.mark.parametrize("sigma_px", [0.3, 2.0])
def test_claimed_uncertainty_is_that_of_noise(sigma_px: float) -> None:
    """400 draws: the sample's variance is good to 7 %, the row's own noise estimate to 10 % more."""
    rng = np.random.default_rng(7)
    clean = 1500.0 * _blurred(79.8, sigma_px) + 100.0
    quiet = sub_pixel_crossing(clean)
    assert isinstance(quiet, Crossing)
    pulls = []
    for _ in range(400):
        found = sub_pixel_crossing(np.round(clean + rng.normal(0.0, 15.0, 160)))
        assert isinstance(found, Crossing)
        pulls.append((found.column - quiet.column) / found.sigma_px)
    assert 0.5 < float(np.mean(np.square(pulls))) < 1.5
