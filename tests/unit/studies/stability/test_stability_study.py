"""From profiles to errors: profiles made by hand, whose answers are known."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from horizonval.spec.stability import EdgeSensor, FieldSensor, StabilityBand, StabilitySpec
from horizonval.studies.stability import study
from horizonval.studies.stability.case import cases_of, from_plain, to_plain
from horizonval.studies.stability.part import stability_identity
from horizonval.studies.stability.profiles import LATITUDE_DEG, Profiles, heights_m

SPEC = StabilitySpec(
    altitude_km=900.0,
    inclination_deg=99.03,
    positions=8,
    months=[1, 7],
    band=[StabilityBand(name="co2", lo_um=14.0, hi_um=16.3)],
    sensor=[
        EdgeSensor(name="half", kind="edge", locator="half"),
        EdgeSensor(name="threshold", kind="edge", locator="threshold"),
        FieldSensor(name="field", kind="field", field_deg=2.0),
    ],
)
HEIGHT_M = heights_m(SPEC)
DISTANCE_KM = math.sqrt(7278.1**2 - (6371.0 + 41.0) ** 2)
"""Of a horizon 41 km high; oblateness changes it by 0.7 % either way."""


def limb(centre_km: float = 40.0, plateau: float = 6.0) -> np.ndarray:
    """A limb that falls over 20 km."""
    return 0.5 * plateau * (1.0 - np.tanh((HEIGHT_M - 1e3 * centre_km) / 6e3))


def uniform(centre_km: float = 40.0, plateau: float = 6.0) -> Profiles:
    """The same limb everywhere."""
    profile = limb(centre_km, plateau)
    return Profiles(HEIGHT_M, np.broadcast_to(profile, (8, 4, len(profile))), np.tile(profile, (len(LATITUDE_DEG), 1)))


def sensors(profiles: dict[tuple[str, int], Profiles]) -> dict[str, dict]:
    result = study.conclude(SPEC, profiles)
    return {sensor["name"]: sensor for sensor in result["bands"][0]["sensors"]}


def test_a_steady_horizon_costs_an_edge_nothing():
    found = sensors({("co2", 1): uniform(), ("co2", 7): uniform()})
    for name in ("half", "threshold"):
        # Heights are equal in all heads; what is left is rounding.
        assert found[name]["max_pitch_deg"] < 2e-6
        assert found[name]["max_roll_deg"] < 2e-6
        assert found[name]["calibration"]["height_km"] == pytest.approx(40.0, abs=0.01)
    # The distance of the horizon differs by half a per cent between poleward and equatorward heads: of 42 km, 0.7 deg.
    assert found["field"]["max_pitch_deg"] < 0.004


def test_a_season_that_is_the_same_everywhere_is_no_error_of_attitude():
    found = sensors({("co2", 1): uniform(38.0), ("co2", 7): uniform(42.0)})
    # 2 km in all heads; the half per cent between their distances is left: 1e-4 deg.
    assert found["half"]["max_pitch_deg"] < 4e-4
    assert found["half"]["calibration"]["std_km"] == pytest.approx(2.0, abs=0.01)


def test_a_higher_horizon_ahead_costs_half_of_its_angle_in_pitch():
    orbit = np.array(uniform().orbit)
    orbit[:, 0] = limb(42.0)
    found = sensors({("co2", month): replace(uniform(), orbit=orbit) for month in (1, 7)})
    half = 0.5 * math.degrees(2.0 / DISTANCE_KM)
    assert found["half"]["max_pitch_deg"] == pytest.approx(half, rel=0.015)
    assert np.max(np.array(found["half"]["pitch_deg"])) < 0
    assert found["half"]["max_roll_deg"] < 2e-4


def test_brighter_air_ahead_costs_a_field_but_not_a_normalised_edge():
    orbit = np.array(uniform().orbit)
    orbit[:, 0] *= 1.2
    found = sensors({("co2", month): replace(uniform(), orbit=orbit) for month in (1, 7)})
    assert found["half"]["max_pitch_deg"] < 2e-6
    # A symmetric fall half way up a field of 2 deg: half the disc's radiance; gain and zero of the mean of four heads.
    assert found["field"]["max_pitch_deg"] == pytest.approx(0.5 * 0.2 / 1.05, rel=0.05)
    # A threshold of half the mean plateau, 3.15, in limbs of 6 and 7.2.
    step_km = 6.0 * (math.atanh(1 - 2 * 3.15 / 7.2) - math.atanh(1 - 2 * 3.15 / 6.0))
    assert found["threshold"]["max_pitch_deg"] == pytest.approx(0.5 * math.degrees(step_km / DISTANCE_KM), rel=0.015)


def test_the_result_is_plain_and_the_table_complete():
    result = study.conclude(SPEC, {("co2", 1): uniform(), ("co2", 7): uniform(41.0, 5.0)})
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    header, lines = study.rows(result)
    assert len(lines) == 16
    assert all(len(line) == len(header) == 10 for line in lines)
    band = result["bands"][0]
    assert band["kind"] == "opaque"
    assert np.shape(band["half_km"]) == (2, len(LATITUDE_DEG))
    assert band["half_statistics"]["min"] == pytest.approx(40.0, abs=0.01)
    assert band["half_statistics"]["max"] == pytest.approx(41.0, abs=0.01)
    assert band["variation"] == pytest.approx(1.0 / 5.5, rel=0.01)
    assert [e["month"] for e in band["examples"]] == [1, 1, 7]
    digest = study.digest(result)
    assert "pitch_deg" not in digest["bands"][0]["sensors"][0]
    assert digest["bands"][0]["sensors"][2]["field_deg"] == 2.0


def test_figures_published_for_another_orbit_are_left_out():
    low = SPEC.model_copy(update={"altitude_km": 500.0})
    profiles = {("co2", month): uniform() for month in (1, 7)}
    quantities = [item["quantity"] for item in study.conclude(low, profiles)["published"]]
    assert "edge_pitch_deg" not in quantities
    assert "variation" in quantities


def test_profiles_survive_their_file():
    cases = cases_of(SPEC)
    assert [case.name for case in cases] == ["co2-01", "co2-07"]
    before = uniform(39.0, 5.1)
    after = from_plain(json.loads(json.dumps(to_plain(before))))
    # Eight digits.
    np.testing.assert_allclose(after.orbit, before.orbit, rtol=1e-7, atol=0)
    np.testing.assert_allclose(after.height_m, before.height_m, rtol=1e-7)
    with pytest.raises(ValueError, match="shapes"):
        from_plain(to_plain(before) | {"parallels": [[1.0, 2.0]]})


def test_heights_reach_below_the_field():
    # The centre stands above the ground, so that half the field and a little more is enough.
    assert -0.5 * math.radians(2.0) * 3.55e6 > HEIGHT_M[0]
    assert np.all(np.diff(HEIGHT_M) > 0)
    assert -10e3 in HEIGHT_M


def test_a_case_is_known_by_its_study_its_month_and_its_band():
    other = SPEC.model_copy(update={"altitude_km": 901.0})
    names = {stability_identity(case) for spec in (SPEC, other) for case in cases_of(spec)}
    assert len(names) == 4
    assert stability_identity(cases_of(SPEC)[0]) == stability_identity(cases_of(SPEC.model_copy())[0])
