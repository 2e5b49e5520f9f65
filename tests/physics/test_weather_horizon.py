"""What weather does to the infrared horizon, against figures that others found."""

from __future__ import annotations

import numpy as np
import pytest
from make_weather_horizon import drawn_heights, real_heights, round_the_orbit, sensitivities

PUBLISHED = {
    "tropics, to 25 deg": (21, 41.56, 0.63),
    "25 to 50 deg": (25, 40.29, 1.81),
    "poleward of 50, winter": (32, 38.61, 2.88),
    "poleward of 50, summer": (10, 40.99, 2.32),
    "poleward of 50, April, October": (8, 39.90, 3.35),
}
"""Of the 96 states: count, mean and standard deviation [km], by another look-up, integrator and climate of other gases
(a note on the tables of RRTMG-LW, rows by the same classes)."""


def test_real_states_have_the_horizons_that_others_found() -> None:
    """Means within 0.1 km, standard deviations (of a sample, n - 1) within 0.1 km."""
    found = real_heights()
    for name, (count, mean, spread) in PUBLISHED.items():
        height = found[name][0]
        assert len(height) == count
        assert height.mean() == pytest.approx(mean, abs=0.1)
        assert height.std(ddof=1) == pytest.approx(spread, abs=0.1)


@pytest.mark.slow
def test_winter_varies_more_than_the_tropics() -> None:
    """Drawn weather, 40 days each: 0.3 to 0.9 km in the tropics, 1.5 to 3 km in the polar winter."""
    tropics = drawn_heights("tropics, to 25 deg", 40)[0]
    winter = drawn_heights("poleward of 50, winter", 40)[0]
    assert 0.3 < tropics.std() < 0.9
    assert 1.5 < winter.std() < 3.0
    assert tropics.mean() > winter.mean() + 1.0


@pytest.mark.slow
def test_published_figures() -> None:
    """Climate and days about equal (Hashmall 1998); a table of season and shape improves about eightfold (Alex and
    Shrivastava 1989); what 10 K and longitude do, within a factor of 1.5, of a warming 2: cases differ.
    """
    orbit = round_the_orbit()
    assert 0.6 < orbit["days"] / orbit["climate"] < 1.5
    assert 5.0 < orbit["uncorrected"] / orbit["table"] < 12.0
    assert orbit["oblateness"] > orbit["table"]
    found = sensitivities()
    ten = found["+10 K above 12 km"]
    assert np.allclose(ten, (0.025, 0.066), rtol=0.5)
    warming = found["warming of 40 K, 75 N in February"]
    assert 0.5 < warming[0] / 0.05 < 2.0
    assert 0.5 < warming[1] / 0.14 < 2.0
