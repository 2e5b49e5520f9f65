"""Positions from directions: geometry, smoothing, filter, and the function and command on top of them."""

from __future__ import annotations

import csv
import json
from datetime import datetime, timedelta

import numpy as np
import pytest

import horizonval as hv
from horizonval.api.locate import COLUMNS, read_angles
from horizonval.cli import run_command_line
from horizonval.geometry.orbit import GM_M3_PER_S2
from horizonval.geometry.sightings import Station, adaptive_filter, celestial, intersection, smoothed

STATIONS = [Station(48.0, 35.0, 1000.0), Station(54.0, 36.0, 200.0), Station(51.0, 31.0, 0.0)]
START = datetime(2019, 11, 26, 14, 38, 38)
R_M = 7.14e6


def positions(seconds) -> np.ndarray:
    """Circle over the stations, in axes that are taken as celestial or as Earth-fixed."""
    angle = np.asarray(seconds) * np.sqrt(GM_M3_PER_S2 / R_M**3) + np.radians(34.0)
    there = np.radians(51.0)
    flat = np.cos(angle)
    return R_M * np.stack([flat * np.cos(there), flat * np.sin(there), np.sin(angle)], axis=-1)


def angles_deg(r_itrs) -> np.ndarray:
    return np.degrees(np.stack([one.azimuth_elevation(r_itrs) for one in STATIONS], axis=1))


def test_station_axes() -> None:
    """Above the station the elevation is 90 deg; due east of a station on the equator the azimuth is."""
    station = Station(10.0, 0.0, 0.0)
    assert station.azimuth_elevation(1.1 * station.r_itrs)[1] == pytest.approx(np.pi / 2)
    east = Station(10.1, 0.0, 0.0).r_itrs
    assert station.azimuth_elevation(east)[0] == pytest.approx(np.pi / 2)
    there = positions([0.0, 30.0])
    line = there - station.r_itrs
    found = station.directions(station.azimuth_elevation(there))
    assert found == pytest.approx(line / np.linalg.norm(line, axis=-1, keepdims=True), abs=1e-12)


def test_two_lines_meet_in_the_middle_of_their_shortest_distance() -> None:
    """The published solution ``(L1 + L2 + r1 d1 + r2 d2) / 2`` with ``[r1 -r2] d = L2 - L1`` by least squares."""
    rng = np.random.default_rng(1)
    origins, lines = rng.normal(size=(2, 3)), rng.normal(size=(2, 3))
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    d = np.linalg.lstsq(np.stack([lines[0], -lines[1]], axis=1), origins[1] - origins[0], rcond=None)[0]
    ends = origins + d[:, None] * lines
    point, miss = intersection(origins, lines)
    assert point == pytest.approx(ends.mean(axis=0))
    assert miss == pytest.approx(0.5 * np.linalg.norm(ends[0] - ends[1]))


def test_exact_angles_give_the_exact_position_and_a_missing_one_does_not_matter() -> None:
    there = positions([0.0, 30.0, 60.0, 90.0])
    angles = angles_deg(there)
    angles[1, 2] = np.nan
    angles[3, :2] = np.nan
    found = hv.locate(angles, STATIONS)
    assert found.r_itrs_m[:3] == pytest.approx(there[:3], abs=1e-3)
    assert np.isnan(found.miss_m).tolist() == [False, False, False, True]
    assert len(list(found.rows())) == 3
    # Parallel lines of sight meet nowhere.
    lines = STATIONS[0].directions([[1.0, 1.0]] * 2)[None]
    assert np.isnan(intersection([one.r_itrs for one in STATIONS[:2]], lines)[1]).all()


def test_smoothing_keeps_a_straight_series_to_its_ends_and_takes_noise_away() -> None:
    t = np.arange(200.0)
    straight = np.stack([np.ones_like(t), 1e-4 * (t - 100.0), np.zeros_like(t)], axis=-1)
    unit = straight / np.linalg.norm(straight, axis=-1, keepdims=True)
    assert smoothed(unit, 3.0) == pytest.approx(unit, abs=1e-6)
    noise = np.random.default_rng(2).normal(scale=1e-3, size=unit.shape)
    # White noise becomes 1 / sqrt(2 sqrt(pi) 3) of itself.
    rest = (smoothed(unit + noise, 3.0) - unit)[20:-20, 1:]
    assert rest.std() == pytest.approx(1e-3 / np.sqrt(6.0 * np.sqrt(np.pi)), rel=0.2)


def test_without_adaptation_the_filter_follows_the_motion_and_with_it_the_measurements() -> None:
    t = np.arange(0.0, 120.0, 0.5)
    truth = positions(t)
    noisy = truth + np.random.default_rng(3).normal(scale=100.0, size=truth.shape)
    cov = 1e4 * np.eye(3)
    # The first speed is that of half a step later, 2 m/s off.
    assert adaptive_filter(t, truth, cov, 1.0) == pytest.approx(truth, abs=3.0)
    off = {alpha: np.std(adaptive_filter(t, noisy, cov, alpha)[40:] - truth[40:]) for alpha in (0.3, 1.0)}
    assert off[1.0] < 40.0 < off[0.3] < 130.0


def test_celestial_coordinates() -> None:
    found = celestial([[0.0, -2.0, 2.0], [3.0, 0.0, 0.0]])
    assert found == pytest.approx(np.array([[1.5 * np.pi, np.pi / 4, np.sqrt(8.0)], [0.0, 0.0, 3.0]]))


@pytest.fixture
def file(tmp_path):
    angles = angles_deg(positions([0.0, 0.5, 1.0]))[:, :2]
    with (tmp_path / "angles.csv").open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(COLUMNS)
        for k, at in enumerate(angles):
            for name, station, (azimuth, elevation) in zip("AB", STATIONS, at, strict=False):
                time = (START + timedelta(seconds=0.5 * k)).isoformat()
                place = station.longitude_deg, station.latitude_deg, station.height_m
                writer.writerow([time, name, *place, azimuth, elevation])
    return tmp_path / "angles.csv"


def test_the_command_writes_what_the_function_gives(file, capsys) -> None:
    assert run_command_line(["locate", str(file), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    degrees, stations, times = read_angles(file)
    found = hv.locate(degrees, stations, times)
    assert rows == list(found.rows())
    assert [row["x_itrs_km"] for row in rows] == pytest.approx(positions([0.0, 0.5, 1.0])[:, 0] / 1e3, abs=1e-6)
    # The Earth turns, but not the distance from its centre.
    assert found.distance_km == pytest.approx(R_M / 1e3, abs=1e-6)
    out = file.with_name("out.csv")
    assert run_command_line(["locate", str(file), "-o", str(out), "--smooth", "0.5", "--forgetting", "0.3"]) == 0
    with out.open() as lines:
        assert [row["time_utc"] for row in csv.DictReader(lines)] == list(times)


@pytest.mark.parametrize(
    ("old", "new", "options", "expected"),
    [
        (",B,", ",A,", [], "line 3, column longitude_deg"),
        ("azimuth_deg", "azimut_deg", [], "azimuth_deg"),
        ("00.0,", "x,", [], "line 2, column height_m"),
        (",A,48.0", ",A,480.0", [], "longitude"),
        ("T14:38:38.5", "T14:38:38.6", ["--smooth", "1"], "equal steps"),
        ("", "", ["--forgetting", "2"], "at most 1"),
    ],
)
def test_mistakes_are_one_line(file, capsys, old, new, options, expected) -> None:
    file.write_text(file.read_text().replace(old, new))
    assert run_command_line(["locate", str(file), *options]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert len(lines) == 1
    assert expected in lines[0]


@pytest.mark.parametrize(
    ("stations", "angles", "expected"),
    [
        (STATIONS[:1], np.zeros((1, 1, 2)), "at least two"),
        ([STATIONS[0]] * 2, np.zeros((1, 2, 2)), "different places"),
        (STATIONS[:2], np.zeros((1, 3, 2)), "(n, 2, 2)"),
        (STATIONS[:2], np.full((1, 2, 2), 91.0), "in degrees"),
    ],
)
def test_what_does_not_fit_is_refused(stations, angles, expected) -> None:
    with pytest.raises(hv.UserError) as caught:
        hv.locate(angles, stations)
    assert expected in str(caught.value)
