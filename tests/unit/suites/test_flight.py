"""Flights of suites: orbits, attitudes and files, against independent codes."""

from __future__ import annotations

import math
import os
import struct
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from scipy.spatial.transform import Rotation

from horizonval.core.errors import UserError
from horizonval.formats.aem import aem_text
from horizonval.formats.trajectory import span_of
from horizonval.geometry.ellipsoid import WGS84, itrs_from_geodetic
from horizonval.geometry.orbit import ElementSet, gcrs_states, lvlh_matrices
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
    return fly(TypeAdapter(OrbitSpec).validate_python(values), WGS84, 1, "o", Path())[0]


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
    samples, _ = fly(spec, WGS84, 1, "o", Path())
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
    assert fly(from_file, WGS84, 1, "o", tmp_path)[0] == samples
    for wrong, message in ((lines[:1], "found 1 lines"), ([*lines, *lines], "2 element sets of 25544")):
        (tmp_path / "iss.txt").write_text("\n".join(wrong))
        with pytest.raises(UserError, match=message):
            fly(from_file, WGS84, 1, "o", tmp_path)


TWO_LINES = [
    "1 25544U 98067A   26079.50000000  .00012000  00000-0  22000-3 0  9999",
    "2 25544  51.6400 208.9163 0006703 130.5360 325.0288 15.49560000 00010",
]
NOON = datetime(2026, 3, 20, 12, tzinfo=UTC)
SPAN_S, N = 900.0, 6
ANGLES_DEG = (20.0, -5.0, 3.0)
"""Yaw, pitch, roll of the body, as the elements' flight has them and as the files do."""


def flown(beside: Path = Path(), **keys: object) -> list[dict]:
    spec = OrbitSpec.model_validate({"duration_s": SPAN_S, "n": N, **keys})
    return fly(spec, WGS84, 1, "orbit", beside)[0]


def states(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return gcrs_states(ElementSet(*TWO_LINES), NOON, t)


def quaternions(t: np.ndarray) -> np.ndarray:
    """Return ``q_body_from_gcrs`` of a body at the angles against the local vertical, by its axes' own turns."""
    yaw, pitch, roll = np.radians(ANGLES_DEG)
    body_from_lvlh = Rotation.from_euler("ZYX", [yaw, pitch, roll]).inv().as_matrix()
    return Rotation.from_matrix(body_from_lvlh @ lvlh_matrices(*states(t))).as_quat()


def text_of(t: float) -> str:
    return (NOON + timedelta(seconds=float(t))).replace(tzinfo=None).isoformat(timespec="microseconds")


def same(found: list[dict], expected: list[dict]) -> None:
    """Check places to a metre, and angles to an arc second.

    SGP4's velocities are not the derivatives of its positions, by 15 mm/s: half an arc second of heading.
    """
    near = {"latitude_deg": 1e-5, "longitude_deg": 1e-5, "altitude_km": 1e-3, "heading_deg": 3e-4}
    for one, other in zip(found, expected, strict=True):
        assert one["platform"]["epoch_utc"] == other["platform"]["epoch_utc"]
        for key, tolerance in near.items():
            assert one["platform"][key] == pytest.approx(other["platform"][key], abs=tolerance), key
        for key in ("yaw_deg", "pitch_deg", "roll_deg"):
            assert one["attitude"][key] == pytest.approx(other["attitude"][key], abs=3e-4), key


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("files")
    coarse, fine = np.arange(0.0, SPAN_S + 1.0, 60.0), np.arange(0.0, SPAN_S + 1.0, 10.0)
    both = np.hstack(states(coarse)) / 1e3
    rows = [f"{text_of(t)}Z,{','.join(f'{x:.9f}' for x in state)}" for t, state in zip(coarse, both, strict=True)]
    names = "time_utc,x_gcrs_km,y_gcrs_km,z_gcrs_km,vx_gcrs_km_s,vy_gcrs_km_s,vz_gcrs_km_s"
    (folder / "orbit.csv").write_text("\n".join([names, *rows]) + "\n")
    head = ["CCSDS_OEM_VERS = 2.0", "CREATION_DATE = 2026-03-19T00:00:00", "ORIGINATOR = TEST", "META_START"]
    head += ["OBJECT_NAME = SAT", "OBJECT_ID = 2026-001A", "CENTER_NAME = EARTH", "REF_FRAME = ICRF"]
    head += ["TIME_SYSTEM = UTC", f"START_TIME = {text_of(0)}", f"STOP_TIME = {text_of(SPAN_S)}", "META_STOP"]
    (folder / "sat.oem").write_text(
        "\n".join([*head, *(row.replace("Z,", " ").replace(",", " ") for row in rows)]) + "\n"
    )
    times = [NOON + timedelta(seconds=float(t)) for t in fine]
    (folder / "sat.aem").write_text(aem_text(times, quaternions(fine), name="SAT", created_utc=NOON))
    columns = "time_utc," + ",".join(f"q_body_from_gcrs_{c}" for c in "xyzw")
    rows = [f"{text_of(t)},{','.join(f'{x:.12f}' for x in q)}" for t, q in zip(fine, quaternions(fine), strict=True)]
    (folder / "attitude.csv").write_text("\n".join([columns, *rows]) + "\n")
    return folder


@pytest.mark.parametrize(("orbit", "attitude"), [("sat.oem", "sat.aem"), ("orbit.csv", "attitude.csv")])
def test_files_fly_as_the_elements_that_they_were_made_of(files: Path, orbit: str, attitude: str) -> None:
    expected = flown(tle=TWO_LINES, epoch_utc=NOON, attitude={"offset_deg": ANGLES_DEG})
    found = flown(files, ephemeris=orbit, attitude={"file": attitude})
    same(found, expected)
    for one in found:
        assert np.abs(one["attitude"].get("rate_deg_s", [0.0] * 3)).max() < 2e-4


def test_a_later_start_and_the_files_own_end(files: Path) -> None:
    whole = flown(files, ephemeris="orbit.csv", duration_s=None)
    assert whole[-1]["platform"]["epoch_utc"] == NOON + timedelta(seconds=750)
    later = flown(files, ephemeris="orbit.csv", duration_s=None, epoch_utc=NOON + timedelta(seconds=300))
    assert later[0]["platform"] == whole[2]["platform"]


def test_a_rate_is_whole_at_the_ends_of_the_files(files: Path) -> None:
    """A body that keeps still among the stars turns against the local vertical alike at the first sample and later."""
    held = files / "held.csv"
    columns = "time_utc," + ",".join(f"q_body_from_gcrs_{c}" for c in "xyzw")
    held.write_text("\n".join([columns, *(f"{text_of(t)},0,0,0,1" for t in (0.0, SPAN_S))]) + "\n")
    rates = [
        np.linalg.norm(one["attitude"]["rate_deg_s"])
        for one in flown(files, ephemeris="orbit.csv", attitude={"file": "held.csv"})
    ]
    assert rates == pytest.approx([360.0 * 15.4956 / 86400.0] * N, rel=0.01)
    tumbling = flown(files, ephemeris="orbit.csv", attitude={"tumble_deg_s": (0.1, 0.0, 0.0)})
    assert tumbling[0]["attitude"]["rate_deg_s"] == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)


def test_what_does_not_go_together_is_refused(files: Path) -> None:
    with pytest.raises(UserError, match="no state for 2026-03-20T11:59"):
        flown(files, ephemeris="orbit.csv", epoch_utc=NOON - timedelta(seconds=60))
    with pytest.raises(UserError, match="no state for 2026-03-20T12:20"):
        flown(files, ephemeris="orbit.csv", duration_s=2 * SPAN_S)
    with pytest.raises(UserError, match="a file of states has no revolutions"):
        flown(files, ephemeris="orbit.csv", duration_s=None, revolutions=1.0)
    with pytest.raises(UserError, match="no attitude for"):
        flown(files, tle=TWO_LINES, epoch_utc=NOON + timedelta(days=1), attitude={"file": "sat.aem"})
    for keys, line in (
        ({"ephemeris": "orbit.csv", "altitude_km": 500.0}, "ephemeris says the whole orbit"),
        ({"ephemeris": "orbit.csv", "tle": TWO_LINES}, "tle says the whole orbit"),
        ({"tle": TWO_LINES, "attitude": {"file": "a.csv", "pointing": "sun"}}, "file says the whole attitude"),
        ({"kernels": ["a.bsp"]}, "kernels and spacecraft go together"),
        ({"tle": TWO_LINES, "attitude": {"body_axes": "SAT"}}, "body_axes goes with kernels"),
    ):
        with pytest.raises(ValueError, match=line):
            OrbitSpec.model_validate({"n": 2, **keys})


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with kernels of the same flight, written by SPICE itself."""
    spice = pytest.importorskip("spiceypy")
    folder = tmp_path_factory.mktemp("kernels")
    leap = "KPL/LSK\n\\begindata\nDELTET/DELTA_T_A = 32.184\nDELTET/K = 1.657D-3\nDELTET/EB = 1.671D-2\n"
    leap += "DELTET/M = ( 6.239996D0 1.99096871D-7 )\nDELTET/DELTA_AT = ( 37, @2017-JAN-1 )\n\\begintext\n"
    (folder / "leap.tls").write_text(leap)
    clock = "KPL/SCLK\n\\begindata\nSCLK_KERNEL_ID = ( @2026-01-01 )\nSCLK_DATA_TYPE_999 = ( 1 )\n"
    clock += "SCLK01_TIME_SYSTEM_999 = ( 2 )\nSCLK01_N_FIELDS_999 = ( 2 )\nSCLK01_MODULI_999 = ( 4294967296 65536 )\n"
    clock += "SCLK01_OFFSETS_999 = ( 0 0 )\nSCLK01_OUTPUT_DELIM_999 = ( 2 )\nSCLK_PARTITION_START_999 = ( 0.0 )\n"
    clock += "SCLK_PARTITION_END_999 = ( 2.8E14 )\nSCLK01_COEFFICIENTS_999 = ( 0.0 0.0 1.0 )\n\\begintext\n"
    (folder / "clock.tsc").write_text(clock)
    frame = "KPL/FK\n\\begindata\nFRAME_SAT_BODY = -999000\nFRAME_-999000_NAME = 'SAT_BODY'\nFRAME_-999000_CLASS = 3\n"
    frame += (
        "FRAME_-999000_CLASS_ID = -999000\nFRAME_-999000_CENTER = -999\nCK_-999000_SCLK = -999\nCK_-999000_SPK = -999\n"
    )
    (folder / "frame.tf").write_text(frame + "\\begintext\n")
    t = np.arange(0.0, SPAN_S + 1.0, 10.0)
    loaded = [str(folder / name) for name in ("leap.tls", "clock.tsc", "frame.tf")]
    for name in loaded:
        spice.furnsh(name)
    try:
        et = np.array([spice.str2et(text_of(x)) for x in t])
        r, v = states(t)
        handle = spice.spkopn(str(folder / "orbit.bsp"), "orbit", 0)
        spice.spkw13(handle, -999, 399, "J2000", et[0], et[-1], "orbit", 7, len(t), np.hstack([r, v]) / 1e3, et)
        spice.spkcls(handle)
        matrices = Rotation.from_quat(quaternions(t)).as_matrix()
        ticks = np.array([spice.sce2c(-999, x) for x in et])
        handle = spice.ckopn(str(folder / "body.bc"), "attitude", 0)
        q = np.array([spice.m2q(m) for m in matrices])
        still, begin, end = np.zeros((len(t), 3)), ticks[0], ticks[-1]
        spice.ckw03(handle, begin, end, -999000, "J2000", False, "body", len(t), ticks, q, still, 1, [begin])
        spice.ckcls(handle)
    finally:
        for name in loaded:
            spice.unload(name)
    return folder


KERNELS = ["leap.tls", "clock.tsc", "frame.tf", "orbit.bsp", "body.bc"]


def test_kernels_fly_as_the_elements_that_they_were_made_of(kernels: Path) -> None:
    expected = flown(tle=TWO_LINES, epoch_utc=NOON, attitude={"offset_deg": ANGLES_DEG})
    body = {"body_axes": "SAT_BODY"}
    found = flown(kernels, kernels=KERNELS, spacecraft="-999", epoch_utc=NOON, attitude=body)
    same(found[1:], expected[1:])


def test_kernels_with_old_leap_seconds_or_wrong_velocities_are_refused(kernels: Path) -> None:
    spice = pytest.importorskip("spiceypy")
    leap = (kernels / "leap.tls").read_text().replace("37, @2017-JAN-1", "36, @2015-JUL-1")
    (kernels / "old.tls").write_text(leap)
    with pytest.raises(UserError, match=r"old.tls, .* is -1 s off: leap seconds.*expected an up-to-date kernel"):
        flown(kernels, kernels=["old.tls", "orbit.bsp"], spacecraft="-999", duration_s=100.0)
    t = np.arange(0.0, SPAN_S + 1.0, 10.0)
    r, _ = states(t)
    spice.furnsh(str(kernels / "leap.tls"))
    try:
        et = np.array([spice.str2et(text_of(x)) for x in t])
        handle = spice.spkopn(str(kernels / "zero.bsp"), "orbit", 0)
        spice.spkw09(handle, -999, 399, "J2000", et[0], et[-1], "orbit", 7, len(t), np.hstack([r, 0.0 * r]) / 1e3, et)
        spice.spkcls(handle)
    finally:
        spice.unload(str(kernels / "leap.tls"))
    with pytest.raises(UserError, match=r"zero.bsp: -999 at 2026.*the velocity is 7.* it is zero"):
        flown(kernels, kernels=["leap.tls", "zero.bsp"], spacecraft="-999", duration_s=100.0)


def test_what_kernels_do_not_hold_is_one_line(kernels: Path) -> None:
    for keys, line in (
        ({"kernels": ["leap.tls", "orbit.bsp"], "spacecraft": "-998"}, "no states of '-998'"),
        ({"kernels": ["leap.tls", "orbit.bsp"], "spacecraft": "NOBODY"}, "SPICE"),
        ({"kernels": ["orbit.bsp"], "spacecraft": "-999"}, "SPICE"),
        ({"kernels": ["leap.tls", "none.bsp"], "spacecraft": "-999"}, "none.bsp"),
        ({"kernels": KERNELS, "spacecraft": "-999", "attitude": {"body_axes": "OTHER"}}, "SPICE"),
    ):
        with pytest.raises(UserError) as found:
            flown(kernels, duration_s=100.0, **keys)
        assert line in str(found.value)


@pytest.mark.skipif(os.name != "posix", reason="no FIFO")
@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("'fifo'", "fifo: is a FIFO; expected a SPICE kernel"),
        ("'$A/fi+', 'fo'", "fifo: is a FIFO"),
        ("'../fifo'", "names '../fifo', and SPICE starts such a path from the working folder; expected a kernel in"),
        ("'meta.tm'", "meta.tm: names itself; expected a kernel in the meta-kernel's folder"),
        ("'other.tm'", "names 'other.tm', which is a meta-kernel itself"),
        ("'/etc/passwd'", "names '/etc/passwd'"),
    ],
)
def test_a_meta_kernel_names_regular_files_of_its_own_folder(tmp_path, monkeypatch, names, said):
    pytest.importorskip("spiceypy")
    monkeypatch.chdir(tmp_path)
    os.mkfifo("fifo")
    head = "KPL/MK\n\\begindata\nPATH_VALUES = ( '.' )\nPATH_SYMBOLS = ( 'A' )\n"
    for name in ("meta.tm", "other.tm"):
        (tmp_path / name).write_text(f"{head}KERNELS_TO_LOAD = ( {names} )\n\\begintext\n")
    with pytest.raises(UserError) as refused:
        span_of([Path("meta.tm")], "-1")
    assert said in refused.value.line()


@pytest.mark.parametrize(
    ("at", "kind", "value", "said"),
    [
        (1024, "d", 2.0, "summary record 2: is followed by record 2 again: the summaries go round in a ring"),
        (1024, "d", 3.5, "summary record 3.5: is not in the file"),
        (1024, "d", math.nan, "summary record nan: is not in the file"),
        (1032, "d", 2.0, "summary record 2: names 2 as the one before, not 0"),
        (1040, "d", 26.0, "summary record 2: has 26 summaries; expected at most 25"),
        (1040, "d", 0.5, "has 0.5 summaries"),
        (1084, "i", 2**31 - 1, "segment 1 has numbers .* to 2147483647 of"),
        (12, "i", -1, "summaries of a wrong size"),
        (76, "i", 2**30, "summary record 1.07374e.09: is not in the file"),
        (80, "i", 7, "names 7 as the last summary record, not 2"),
        (0, "4s", b"DAS/", "is a shape or a table of events"),
    ],
)
def test_the_summaries_of_a_binary_kernel_are_a_chain_within_the_file(kernels, tmp_path, at, kind, value, said):
    data = bytearray((kernels / "orbit.bsp").read_bytes())
    struct.pack_into(f"={kind}", data, at, value)
    (tmp_path / "wrong.bsp").write_bytes(data)
    with pytest.raises(UserError, match=said):
        span_of([tmp_path / "wrong.bsp"], "-999")
