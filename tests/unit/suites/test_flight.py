"""Samples of an orbit, against Kepler's and the Earth's own numbers."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from horizonval.core.errors import UserError
from horizonval.geometry.ellipsoid import WGS84, itrs_from_geodetic
from horizonval.geometry.sun_and_moon import sun_itrs
from horizonval.spec.orbit import OrbitSpec
from horizonval.suites.flight import fly

EPOCH = datetime(2026, 3, 20, 6, 0, tzinfo=UTC)
MU, RADIUS_M = 3.986004418e14, 6378137.0
DAY_S = 86164.0905


def orbit(**keys: Any) -> list[dict[str, Any]]:
    values = {"epoch_utc": EPOCH, "n": 24} | keys
    if not {"altitude_km", "semi_major_axis_km", "perigee_km"} & set(values):
        values["altitude_km"] = 700.0
    if "sun_synchronous" not in values and "inclination_deg" not in values:
        values["inclination_deg"] = 60.0
    return fly(TypeAdapter(OrbitSpec).validate_python(values), WGS84, 1, "o", Path())


def places(samples: list[dict[str, Any]]) -> np.ndarray:
    """Places in the Earth's axes."""
    return np.array(
        [
            itrs_from_geodetic(
                math.radians(s["platform"]["latitude_deg"]),
                math.radians(s["platform"]["longitude_deg"]),
                s["platform"]["altitude_km"] * 1e3,
                WGS84,
            )
            for s in samples
        ]
    )


def seconds(samples: list[dict[str, Any]]) -> np.ndarray:
    return np.array([(s["platform"]["epoch_utc"] - EPOCH).total_seconds() for s in samples])


@pytest.mark.parametrize("altitude_km", [500.0, 2000.0, 20000.0])
def test_a_circular_orbit_has_one_radius_its_inclination_and_keplers_period(altitude_km: float) -> None:
    samples = orbit(altitude_km=altitude_km, inclination_deg=70.0, n=48, revolutions=1.0)
    r = places(samples)
    assert np.linalg.norm(r, axis=1) == pytest.approx(np.full(48, RADIUS_M + altitude_km * 1e3), abs=3.0)
    assert np.degrees(np.arcsin(r[:, 2] / np.linalg.norm(r, axis=1))).max() == pytest.approx(70.0, abs=0.3)
    t = seconds(samples)
    period = 2 * math.pi * math.sqrt((RADIUS_M + altitude_km * 1e3) ** 3 / MU)
    # Samples are even, the last a step before the first comes again; the node's period is Kepler's to a part in 500.
    assert np.diff(t) == pytest.approx(np.full(47, t[1] - t[0]), abs=1e-5)
    assert 48 * (t[1] - t[0]) == pytest.approx(period, rel=3e-3)


def test_headings_are_those_of_the_way_over_the_ground_among_the_stars() -> None:
    """Between neighbours a second apart, the Earth's own turning added to their ways."""
    samples = orbit(n=3, duration_s=3.0)
    r, t = places(samples), seconds(samples)
    assert t == pytest.approx([0.0, 1.0, 2.0])
    spin = np.array([0.0, 0.0, 2 * math.pi / DAY_S])
    way = (r[2] - r[0]) / 2.0 + np.cross(spin, r[1])
    up = r[1] / np.linalg.norm(r[1])
    north = np.array([0.0, 0.0, 1.0]) - up[2] * up
    east = np.cross([0.0, 0.0, 1.0], up)
    heading = math.degrees(math.atan2(way @ east / np.linalg.norm(east), way @ north / np.linalg.norm(north)))
    assert samples[1]["platform"]["heading_deg"] % 360.0 == pytest.approx(heading % 360.0, abs=0.3)


def test_axes_may_be_given_in_three_ways() -> None:
    a = (RADIUS_M + 700e3) / 1e3
    assert orbit(semi_major_axis_km=a) == orbit(altitude_km=700.0)
    low, high = 600.0, 1400.0
    mean, eccentricity = RADIUS_M / 1e3 + (low + high) / 2, (high - low) / (high + low + 2 * RADIUS_M / 1e3)
    assert orbit(perigee_km=low, apogee_km=high) == orbit(semi_major_axis_km=mean, eccentricity=eccentricity)
    r = np.linalg.norm(places(orbit(perigee_km=low, apogee_km=high, n=200)), axis=1)
    assert (r.min() - RADIUS_M, r.max() - RADIUS_M) == pytest.approx((low * 1e3, high * 1e3), abs=2e3)
    assert np.argmin(r) in (0, 1, 199), "it starts at the perigee"
    half = np.linalg.norm(places(orbit(perigee_km=low, apogee_km=high, n=4, true_anomaly_deg=180.0)), axis=1)
    assert half[0] - RADIUS_M == pytest.approx(high * 1e3, abs=2e3)
    turned = places(orbit(perigee_km=low, apogee_km=high, argument_of_perigee_deg=90.0, n=4))
    assert turned[0, 2] == pytest.approx(np.linalg.norm(turned[0]) * math.sin(math.radians(60.0)), rel=2e-3)


def solar_time_h(sample: dict[str, Any]) -> float:
    """Apparent local solar time."""
    sun, _ = sun_itrs(sample["platform"]["epoch_utc"])
    noon = math.degrees(math.atan2(sun[1], sun[0]))
    return (12.0 + (sample["platform"]["longitude_deg"] - noon) / 15.0) % 24.0


@pytest.mark.parametrize(("key", "start_deg"), [("ltan_h", 0.0), ("ltdn_h", 180.0)])
@pytest.mark.parametrize("hour", [10.5, 18.0])
def test_nodes_lie_at_their_local_time(key: str, start_deg: float, hour: float) -> None:
    """Mean and apparent time differ by a quarter of an hour at most."""
    samples = orbit(sun_synchronous=True, true_anomaly_deg=start_deg, **{key: hour}, n=2, duration_s=2.0)
    first = samples[0]["platform"]
    assert first["latitude_deg"] == pytest.approx(0.0, abs=0.1)
    assert solar_time_h(samples[0]) == pytest.approx(hour, abs=0.3)
    # A Sun-synchronous orbit is retrograde: northwards to the west at the ascending node.
    heading = first["heading_deg"] % 360.0
    assert 345.0 < heading < 360.0 if start_deg == 0.0 else 180.0 < heading < 195.0


def test_the_node_may_be_given_on_the_ground_or_among_the_stars() -> None:
    first = orbit(node_longitude_deg=35.0)[0]["platform"]
    assert (first["longitude_deg"], first["latitude_deg"]) == pytest.approx((35.0, 0.0), abs=0.01)
    a, b = (orbit(raan_deg=node)[0]["platform"]["longitude_deg"] for node in (10.0, 50.0))
    assert (b - a) % 360.0 == pytest.approx(40.0, abs=1e-6)


def test_several_revolutions_or_a_time_are_flown() -> None:
    one, three = seconds(orbit(revolutions=1.0)), seconds(orbit(revolutions=3.0))
    assert three == pytest.approx(3 * one, rel=1e-6)
    assert seconds(orbit()) == pytest.approx(one)
    assert seconds(orbit(duration_s=240.0, n=24)) == pytest.approx(np.arange(24) * 10.0)


def test_what_flies_below_the_ground_is_refused() -> None:
    for keys in ({"perigee_km": -100.0, "apogee_km": 900.0}, {"semi_major_axis_km": 6500.0, "eccentricity": 0.5}):
        with pytest.raises((UserError, ValueError)):
            orbit(**keys)


def test_the_attitude_is_that_of_the_file() -> None:
    samples = orbit(attitude={"offset_deg": [10.0, -5.0, 3.0]})
    turned = samples[0]["attitude"]
    assert (turned["yaw_deg"], turned["pitch_deg"], turned["roll_deg"]) == pytest.approx((10.0, -5.0, 3.0), abs=1e-6)
    assert "rate_deg_s" not in turned
    slew = orbit(
        attitude={"slew": {"to_deg": [40.0, 0.0, 0.0], "start_s": 20.0, "duration_s": 20.0}}, duration_s=100.0, n=10
    )
    yaw = np.array([s["attitude"]["yaw_deg"] for s in slew])
    assert yaw[:3] == pytest.approx(np.zeros(3), abs=1e-6)
    assert yaw[4:] == pytest.approx(np.full(6, 40.0), abs=1e-6)
    assert 5.0 < yaw[3] < 35.0
    assert "rate_deg_s" in slew[3]["attitude"]
    error = {"rms_deg": [0.5, 0.2, 0.1], "correlation_s": 30.0}
    wobble = orbit(attitude={"error": error}, n=400, duration_s=40_000.0)
    angles = np.array([[s["attitude"][f"{name}_deg"] for name in ("yaw", "pitch", "roll")] for s in wobble])
    assert np.sqrt((angles**2).mean(axis=0)) == pytest.approx([0.5, 0.2, 0.1], rel=0.35)
    again = orbit(attitude={"error": error}, n=400, duration_s=40_000.0)
    assert again == wobble


LINES = [
    "1 25544U 98067A   26079.50000000  .00010000  00000-0  18000-3 0  9990",
    "2 25544  51.6400 100.0000 0005000  60.0000 300.0000 15.50000000  1000",
]


def checked(line: str) -> str:
    digits = sum(int(c) if c.isdigit() else c == "-" for c in line[:68])
    return line[:68] + str(digits % 10)


def test_two_lines_fly_as_sgp4_says(tmp_path: Path) -> None:
    from sgp4.api import Satrec

    lines = [checked(line) for line in LINES]
    spec = TypeAdapter(OrbitSpec).validate_python({"tle": lines, "n": 12})
    samples = fly(spec, WGS84, 1, "o", Path())
    satellite = Satrec.twoline2rv(*lines)
    start = samples[0]["platform"]["epoch_utc"]
    assert abs(start - datetime(2026, 3, 20, 12, tzinfo=UTC)) < timedelta(milliseconds=1)
    code, position, _ = satellite.sgp4(satellite.jdsatepoch, satellite.jdsatepochF)
    assert code == 0
    assert np.linalg.norm(places(samples)[0]) == pytest.approx(np.linalg.norm(position) * 1e3, abs=50.0)
    assert places(samples)[0][2] == pytest.approx(position[2] * 1e3, abs=50.0)
    t = np.array([(s["platform"]["epoch_utc"] - start).total_seconds() for s in samples])
    # 15.5 revolutions a day by the lines, from perigee to perigee; from node to node a little more.
    assert 12 * t[1] == pytest.approx(86400 / 15.5, rel=2e-3)
    (tmp_path / "iss.txt").write_text("ISS\n" + "\n".join(lines) + "\n\n")
    from_file = TypeAdapter(OrbitSpec).validate_python({"tle": "iss.txt", "n": 12})
    assert fly(from_file, WGS84, 1, "o", tmp_path) == samples
    for wrong in (lines[:1], [*lines, *lines]):
        (tmp_path / "iss.txt").write_text("\n".join(wrong))
        with pytest.raises(UserError, match="lines"):
            fly(from_file, WGS84, 1, "o", tmp_path)
