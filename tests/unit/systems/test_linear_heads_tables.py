"""The published tables as typed in, the orbit, and the closed form of the working range."""

from __future__ import annotations

import math
from datetime import datetime

import numpy as np
import pytest

from horizonval.geometry.sun_and_moon import sun_itrs
from horizonval.systems.d.figures import widest_in_field
from horizonval.systems.d.frames import EPOCH, orbit_place
from horizonval.systems.d.steps import (
    COLUMNS,
    MOMENTS,
    PRINTED,
    PRINTED_STEPS,
    QUANTUM_DEG,
    TABLES,
    TRUE_DEG,
    HeadVariant,
    best_phases,
    chance,
    count,
    cross_axis,
    crossing,
    lost_elsewhere,
    odd_columns,
    steps_of,
)


@pytest.mark.parametrize(("table", "axis"), MOMENTS)
def test_printed_moments_are_those_of_the_printed_readings(table: int, axis: str) -> None:
    """Mean and sample standard deviation of reading minus truth, as printed to four digits of rounded readings."""
    errors = np.array([s.read[axis] - s.true_deg(axis) for s in TABLES[table]])
    mean, deviation = MOMENTS[table, axis]
    assert errors.mean() == pytest.approx(mean, abs=1.5e-4)
    assert errors.std(ddof=1) == pytest.approx(deviation, abs=1.5e-4)


def test_descending_node_is_at_noon_and_the_orbit_is_inclined() -> None:
    """At the descending node the Sun's meridian; at 90 deg from the node the latitude is 180 - 97 deg."""
    node = orbit_place(180.0, EPOCH)
    sun, _ = sun_itrs(datetime.fromisoformat(EPOCH))
    assert node["latitude_deg"] == pytest.approx(0.0, abs=1e-9)
    assert node["longitude_deg"] == pytest.approx(math.degrees(math.atan2(sun[1], sun[0])), abs=1e-9)
    # Southwards and, retrograde, to the west: azimuth 180 + 7 deg.
    assert node["heading_deg"] % 360.0 == pytest.approx(187.0, abs=1e-9)
    assert orbit_place(90.0, EPOCH)["latitude_deg"] == pytest.approx(83.0, abs=1e-9)


def test_working_range_in_closed_form() -> None:
    """At the nominal altitude sqrt(2) t fills the half field of 8 deg, to second order; beyond the ends is none."""
    assert widest_in_field(400.0, 70.22) == pytest.approx(8.0 / math.sqrt(2.0), abs=0.03)
    assert math.isnan(widest_in_field(120.0, 70.22))
    assert math.isnan(widest_in_field(900.0, 70.22))


def test_the_printed_figures_are_all_on_their_own_step_and_the_truth_is_on_41() -> None:
    assert count(PRINTED_STEPS) == PRINTED
    assert count(TRUE_DEG / QUANTUM_DEG) == 41
    assert cross_axis().sum() == 5


def test_no_whole_pixels_break_the_rule_of_even_sums_but_two_columns_do() -> None:
    steps = steps_of(np.random.default_rng(0).integers(-80, 80, (100, 4)))
    assert not (steps.sum(axis=-1) % 2).any()
    assert odd_columns() == ["roll 0, pitch -2, yaw 0, 400 km", "roll 0, pitch -3, yaw 0, 400 km"]
    assert list(lost_elsewhere()) == ["roll 0, pitch -2, yaw 0, 400 km"]


def test_closed_crossings_are_those_of_the_cone() -> None:
    """Small tilts move a crossing by ``-theta cos a + phi sin a``; level, all four are alike."""
    level = next(s for s in COLUMNS if s.key == "roll 0, pitch 0, yaw 0, 400 km")
    tilted = next(s for s in COLUMNS if s.key == "roll 1, pitch 0, yaw 0, 400 km")
    at_rest, moved = (crossing(s, HeadVariant(perspective=False)) for s in (level, tilted))
    assert np.ptp(at_rest) < 1e-9
    azimuth = np.radians([135.0, 225.0, 315.0, 45.0])
    assert moved - at_rest == pytest.approx(10.0 * np.sin(azimuth), abs=0.1)
    # Beyond the array there is no crossing.
    assert not np.isnan(moved).any()


def test_phases_by_chance_never_do_better_than_chosen_ones_can() -> None:
    crossings = np.array([crossing(s, HeadVariant(perspective=False)) for s in COLUMNS])
    counts = chance(crossings, np.random.default_rng(1))
    best = best_phases(crossings)
    assert counts.mean() < 30 < best.count <= PRINTED - len(odd_columns())
    assert best.across <= 5
