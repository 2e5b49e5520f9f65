from typing import Any

import numpy as np
import pytest

from horizonval.earth.gases import afgl
from horizonval.earth.surface import surface_temperature
from horizonval.earth.surface.ground_emission import (
    KINDS,
    EmittingPlaces,
    GroundEmission,
    emitting_ground,
    ground_emissivity,
)
from horizonval.earth.surface.ground_emission import ground_k as at_places
from horizonval.earth.surface.ground_map import mean_height_m
from horizonval.spec.scene import SceneSpec


def scene(**tables: Any) -> SceneSpec:
    platform = {"altitude_km": 500, "epoch_utc": "2026-01-16T12:00:00Z"}
    return SceneSpec.model_validate({"camera": {"file": "c"}, "platform": platform, **tables})


SIN = np.linspace(-1, 1, 41)


def ground_k(ground: GroundEmission, kind: str, sine: Any, hour: Any, land: bool = True, sheet: float = 0.0) -> Any:
    """At sea level."""
    sine, hour = np.broadcast_arrays(np.asarray(sine, dtype=float), np.asarray(hour, dtype=float))
    zero = 0.0 * sine
    return at_places(ground, kind, EmittingPlaces(sine, hour, {}, (zero + land) > 0.0, zero, zero + sheet))


def test_a_uniform_ground_is_as_warm_as_the_lowest_air() -> None:
    ground = emitting_ground(scene(surface={"emissivity": 0.9}), 288.0)
    for kind in KINDS:
        np.testing.assert_array_equal(ground_k(ground, kind, SIN, 1.0), 288.0)
        np.testing.assert_array_equal(ground_emissivity(ground, kind, [8.0, 11.0]), 0.9)
    given = emitting_ground(scene(surface={"temperature_k": 300.0}), 288.0)
    assert float(ground_k(given, "land", 0.3, 0.0)) == 300.0


def test_a_uniform_ground_under_varying_air() -> None:
    ground = emitting_ground(scene(atmosphere={"profile": "by_latitude_month"}), 288.0)
    assert ground.kind == "uniform"
    for sine, climate in ((0.0, "tropical"), (0.71, "midlatitude_winter"), (-0.71, "midlatitude_summer")):
        expected = float(afgl.state(climate, np.zeros(1)).temperature_k[0])
        # The middle of January, half a day off: 1e-4 of 30 K.
        assert float(ground_k(ground, "land", sine, 0.0)) == pytest.approx(expected, abs=0.02)
    fixed = emitting_ground(scene(atmosphere={"profile": "by_latitude_month", "latitude_deg": 10.0}), 288.0)
    assert set(fixed.land_k) == {288.0}


def test_the_earth_has_its_climate() -> None:
    ground = emitting_ground(scene(surface={"kind": "earth"}), 288.0)
    latitude = np.degrees(np.arcsin(SIN))
    for kind, table in (("water", surface_temperature.sea_k), ("snow", surface_temperature.sea_ice_k)):
        for hour in (0.0, 2.0):
            # The table on steps of 0.02 of the sine; near the poles 8 deg of latitude lie in one.
            np.testing.assert_allclose(ground_k(ground, kind, SIN, hour, land=False), table(latitude, 1.02), atol=1.0)
    afternoon, before_dawn = (ground_k(ground, "land", SIN, np.radians(h)) for h in (22.5, -157.5))
    mean = surface_temperature.land_k(latitude, 1.02) + 4.5e-3 * mean_height_m(latitude)
    np.testing.assert_allclose((afternoon + before_dawn) / 2, mean, atol=1.5)
    at_20_north = int(np.argmin(np.abs(latitude - 20)))
    assert (afternoon - before_dawn)[at_20_north] == pytest.approx(26.0, abs=1.0)
    assert afternoon[at_20_north] == pytest.approx(
        ground_k(ground, "land", SIN, np.linspace(-3, 3, 301)[:, None])[:, at_20_north].max(), abs=1e-2
    )


def test_one_temperature_in_place_of_everything() -> None:
    ground = emitting_ground(scene(surface={"kind": "earth", "temperature_k": 280.0}), 288.0)
    assert ground.kind == "earth"
    for kind in KINDS:
        np.testing.assert_array_equal(ground_k(ground, kind, SIN, np.linspace(-3, 3, 41)), 280.0)
    # Its emissivities are still those of land, snow and sea.
    assert len({float(ground_emissivity(ground, kind, 8.6)) for kind in KINDS}) == 4
    assert float(ground_emissivity(ground, "water", 11.0, 0.1)) < 0.6


def test_clouds_are_black_unless_they_are_not() -> None:
    assert emitting_ground(scene(), 288.0).cloud_emissivity == 1.0
    assert emitting_ground(scene(clouds={"cover": 0.5}), 288.0).cloud_emissivity == 1.0
    assert emitting_ground(scene(clouds={"cover": 0.5, "emissivity": 0.6}), 288.0).cloud_emissivity == 0.6
