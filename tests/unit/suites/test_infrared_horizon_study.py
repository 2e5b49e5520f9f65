"""The infrared horizon round an orbit: geometry, locators and sensors against closed forms; the report's section."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from horizonval.geometry.ellipsoid import WGS84, geodetic_from_itrs, tangent_height, tangent_point
from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.geometry.horizon import rays_along_parallels
from horizonval.spec.suite import StabilityBand, StabilitySpec
from horizonval.suites import stability
from horizonval.truth.infrared_radiance import directions

SPEC = StabilitySpec(
    altitude_km=900.0,
    inclination_deg=99.03,
    positions=8,
    months=[1, 7],
    band=[StabilityBand(name="co2", lo_um=14.0, hi_um=16.3)],
)
HEIGHT_M = stability.heights_m(SPEC)
DISTANCE_KM = math.sqrt(7278.1**2 - (6371.0 + 41.0) ** 2)
"""Of a horizon 41 km high; oblateness changes it by 0.7 % either way."""


def limb(centre_km: float = 40.0, plateau: float = 6.0, width_km: float = 6.0) -> np.ndarray:
    """A limb that falls from a plateau, steepest and half at its centre."""
    return 0.5 * plateau * (1.0 - np.tanh((HEIGHT_M - 1e3 * centre_km) / (1e3 * width_km)))


def month(ahead: np.ndarray, other: np.ndarray | None = None) -> dict:
    """The forward head sees one limb, all others and the parallels another, or the same."""
    other = ahead if other is None else other
    orbit = np.broadcast_to(np.stack([ahead, other, other, other]), (8, 4, len(other)))
    return {"co2": (orbit, np.tile(other, (len(stability.LATITUDE_DEG), 1)))}


def sensors(*months: dict) -> dict[str, dict]:
    return {sensor["name"]: sensor for sensor in stability.conclude(SPEC, months)["bands"][0]["sensors"]}


def test_the_heads_look_along_the_orbit_and_across():
    polar = SPEC.model_copy(update={"inclination_deg": 90.0 - 1e-9})
    position, azimuth = stability.heads_round_orbit(polar)
    # Over the ascending node: forward is north, right is east.
    np.testing.assert_allclose(np.degrees(azimuth[0]) % 360.0, [0.0, 90.0, 180.0, 270.0], atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(position, axis=-1), WGS84.a_m + 900e3, rtol=1e-14)
    angle = stability.nadir_angles(SPEC)
    for r, a, eta in zip(*stability.heads_round_orbit(SPEC), angle, strict=True):
        found = tangent_height(r, directions(r, a[:, None], eta), WGS84)
        np.testing.assert_allclose(found, np.broadcast_to(HEIGHT_M, found.shape), rtol=0, atol=1e-3)


def test_rays_along_parallels_are_lowest_where_they_should_be():
    latitude, height = np.radians([-80.0, 0.0, 45.0]), np.array([-1e4, 5.0, 4e4])
    origin, direction = rays_along_parallels(latitude, height)
    s, lowest = tangent_point(origin, direction, WGS84)
    np.testing.assert_allclose(lowest, np.broadcast_to(height, (3, 3)), rtol=0, atol=1e-3)
    places = geodetic_from_itrs(origin + s[..., None] * direction)[0]
    # 1 m of the place along the ray is 1e-7 rad at most.
    np.testing.assert_allclose(places, np.broadcast_to(latitude[:, None], (3, 3)), rtol=0, atol=1e-7)


def test_the_air_or_the_ground_is_the_horizon():
    kind, plateau, half, gradient = stability.locate(HEIGHT_M, np.stack([limb(38.0), limb(43.0)])[None])
    assert kind == "opaque"
    # Cubics over 1 km of a fall of 6 km: 3 m at the half height; the steepest place is flat, 30 m.
    np.testing.assert_allclose(half, [[38e3, 43e3]], rtol=0, atol=3.0)
    np.testing.assert_allclose(gradient, [[38e3, 43e3]], rtol=0, atol=30.0)
    np.testing.assert_allclose(plateau, [[6.0, 6.0]], rtol=2e-3)
    window = np.where(HEIGHT_M < 0, 12.0, limb(4.0, 12.0, 2.5))
    kind, plateau, half, _ = stability.locate(HEIGHT_M, window[None])
    assert (kind, float(plateau[0])) == ("window", 12.0)
    assert float(half[0]) == pytest.approx(4e3, abs=10.0)
    assert stability.locate(HEIGHT_M, np.stack([limb(), window])[:, None])[0] == "mixed"


def test_the_highest_of_several_crossings_of_a_radiance():
    height = 1e3 * np.array([-10.0, -0.05, 0.05, *np.arange(1.0, 101.0)])
    line = np.clip((50e3 - height) / 1e4, 0.0, None)
    # Away from its ends a straight profile is its own monotone cubic.
    found = stability.highest_crossing(height, np.stack([line, 2 * line]), 1.55)
    np.testing.assert_allclose(found, [34.5e3, 42.25e3], rtol=0, atol=0.1)
    wave = np.cos(height / 5e3) * (height < 50e3)
    # It falls through one half at 5.2, 36.7 and, were it not cut off, at 68.1 km.
    found = stability.highest_crossing(height, wave, 0.5)
    assert float(found) == pytest.approx(5e3 * (2 * np.pi + np.pi / 3), abs=30.0)
    for level, end in ((1.0, -10e3), (-1.0, 100e3)):
        assert float(stability.highest_crossing(height, np.zeros_like(height), level)) == pytest.approx(end)


@pytest.mark.parametrize(("roll", "pitch"), [(1e-4, 0.0), (0.0, 1e-4), (2e-4, -3e-4)])
def test_a_tilted_body_is_an_error_of_attitude_with_the_opposite_sign(roll, pitch):
    # A cone of 61 deg about the tilted nadir, cut by the vertical planes of the heads in body axes.
    radius, nadir = math.radians(61.0), nadir_of_roll_pitch(roll, pitch)

    def horizon(alpha):
        def miss(eta):
            ray = [math.sin(eta) * math.cos(alpha), math.sin(eta) * math.sin(alpha), math.cos(eta)]
            return float(nadir @ ray) - math.cos(radius)

        return brentq(miss, 0.5, 1.6, xtol=1e-14)

    excess = np.array([horizon(alpha) for alpha in np.radians([0.0, 90.0, 180.0, 270.0])]) - radius
    # Second order in the tilt: 3e-4 squared.
    assert stability.attitude_error(excess) == pytest.approx((pitch, roll), abs=2e-7)
    assert stability.attitude_error(np.full(4, 1e-3)) == (0.0, 0.0)


WIDTH = math.radians(2.0)
STEP = np.array([-0.05, -0.03, -0.01, -1e-9, 1e-9, 0.01, 0.03])
DISC = np.where(STEP < 0, 6.0, 0.0)


def test_a_field_on_a_linear_profile_and_on_a_step():
    offset = np.linspace(-0.1, 0.1, 41)
    mean, slope = stability.field_output(np.array(0.013), WIDTH, offset, 5.0 - 20.0 * offset)
    assert (float(mean), float(slope)) == pytest.approx((5.0 - 20.0 * 0.013, -20.0), rel=1e-12)
    for centre in (-0.01, 0.0, 0.008):
        mean, slope = stability.field_output(np.array(centre), WIDTH, STEP, DISC)
        assert float(mean) == pytest.approx(6.0 * (WIDTH / 2 - centre) / WIDTH, rel=1e-6)
        assert float(slope) == pytest.approx(-6.0 / WIDTH, rel=1e-6)
    mean, slope = stability.field_output(np.array(0.1), WIDTH, STEP, DISC)
    assert (float(mean), float(slope)) == (0.0, 0.0)
    with pytest.raises(ValueError, match="below the profile"):
        stability.field_output(np.array(-0.04), WIDTH, STEP, DISC)


def test_a_steady_horizon_costs_an_edge_nothing():
    found = sensors(month(limb()), month(limb()))
    for name in ("edge-half", "edge-threshold"):
        # Heights are equal in all heads; what is left is rounding.
        assert found[name]["max_pitch_deg"] < 2e-6
        assert found[name]["max_roll_deg"] < 2e-6
        assert found[name]["height_km"] == pytest.approx(40.0, abs=0.01)
    # The distance of the horizon differs by half a per cent between poleward and equatorward heads: of 42 km, 0.7 deg.
    assert found["field"]["max_pitch_deg"] < 0.004


def test_a_higher_horizon_ahead_costs_half_of_its_angle_in_pitch():
    found = sensors(*2 * [month(limb(42.0), limb(40.0))])["edge-half"]
    assert found["max_pitch_deg"] == pytest.approx(0.5 * math.degrees(2.0 / DISTANCE_KM), rel=0.015)
    assert np.max(np.array(found["pitch_round_orbit_deg"])) < 0
    assert found["max_roll_deg"] < 2e-4


def test_brighter_air_ahead_costs_a_field_but_not_a_normalised_edge():
    found = sensors(*2 * [month(1.2 * limb(), limb())])
    assert found["edge-half"]["max_pitch_deg"] < 2e-6
    # A symmetric fall half way up a field of 2 deg: half the disc's radiance; gain and zero of the mean of four heads.
    assert found["field"]["max_pitch_deg"] == pytest.approx(0.5 * 0.2 / 1.05, rel=0.05)
    # A threshold of half the mean plateau, 3.15, in limbs of 6 and 7.2.
    step_km = 6.0 * (math.atanh(1 - 2 * 3.15 / 7.2) - math.atanh(1 - 2 * 3.15 / 6.0))
    expected = 0.5 * math.degrees(step_km / DISTANCE_KM)
    assert found["edge-threshold"]["max_pitch_deg"] == pytest.approx(expected, rel=0.015)
