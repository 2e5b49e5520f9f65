"""Two lines of sight: exact directions give the exact point, derivatives are those of the formula as published."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.geometry.ellipsoid import itrs_from_geodetic, surface_normal
from horizonval.systems.e.localisation.batch import triangulate, triangulate_with_partials
from horizonval.systems.e.localisation.stations import Station

STATIONS = (
    Station("A", np.radians(48.3358), np.radians(35.7061), 1000.0),
    Station("B", np.radians(54.7458), np.radians(35.7161), 200.0),
)
SATELLITES = itrs_from_geodetic(np.radians([32.0, 36.0, 39.0]), np.radians([53.0, 52.0, 51.0]), 771e3)


def _angles() -> np.ndarray:
    return np.concatenate([np.stack(s.azimuth_elevation(SATELLITES), axis=1) for s in STATIONS], axis=1)


def test_station_axes_are_east_north_and_the_ellipsoids_normal() -> None:
    station = STATIONS[0]
    east, north, up = station.itrs_from_enu.T
    assert up == pytest.approx(surface_normal(station.r_itrs), abs=1e-14)
    eastwards = itrs_from_geodetic(station.latitude_rad, station.longitude_rad + 1e-6, 1000.0) - station.r_itrs
    assert eastwards / np.linalg.norm(eastwards) == pytest.approx(east, abs=1e-6)
    northwards = itrs_from_geodetic(station.latitude_rad + 1e-6, station.longitude_rad, 1000.0) - station.r_itrs
    assert northwards / np.linalg.norm(northwards) == pytest.approx(north, abs=1e-6)


def test_azimuth_runs_from_north_through_east() -> None:
    station = STATIONS[0]
    around = station.r_itrs + 1e5 * np.array([[0, 1, 0], [1, 0, 0], [0, -1, 0], [-1, 0, 1]]) @ station.itrs_from_enu.T
    azimuth, elevation = station.azimuth_elevation(around)
    assert np.degrees(azimuth) == pytest.approx([0.0, 90.0, 180.0, 270.0], abs=1e-6)
    assert np.degrees(elevation) == pytest.approx([0.0, 0.0, 0.0, 45.0], abs=1e-6)


def test_exact_directions_give_the_exact_point() -> None:
    """1 um: rounding of Earth-sized coordinates is 1 nm, and the lines cross at more than 30 degrees."""
    angles = _angles()
    u1, u2 = (s.directions_itrs(angles[:, 2 * i], angles[:, 2 * i + 1]) for i, s in enumerate(STATIONS))
    r, distances, miss = triangulate(STATIONS[0].r_itrs, STATIONS[1].r_itrs, u1, u2)
    assert np.abs(r - SATELLITES).max() < 1e-6
    assert miss.max() < 1e-6
    assert distances[:, 1] == pytest.approx(np.linalg.norm(SATELLITES - STATIONS[1].r_itrs, axis=1))


def test_skew_lines_give_the_published_normal_equations_answer() -> None:
    """Against numpy's least squares and the middle of the shortest line."""
    rng = np.random.default_rng(np.random.SeedSequence(11))
    l1, l2, u1, u2 = rng.normal(size=(4, 3))
    u1, u2 = u1 / np.linalg.norm(u1), u2 / np.linalg.norm(u2)
    x, rest, *_ = np.linalg.lstsq(np.stack([u1, -u2], axis=1), l2 - l1, rcond=None)
    r, distances, miss = triangulate(l1, l2, u1, u2)
    assert distances == pytest.approx(x)
    assert miss == pytest.approx(np.sqrt(rest[0]))
    assert r == pytest.approx((l1 + x[0] * u1 + l2 + x[1] * u2) / 2.0)


@pytest.mark.parametrize("index", range(4))
def test_partials_are_differences(index: int) -> None:
    """Central differences of 1e-5 rad: their own error is 1e-10 of the derivative, times some units."""
    step = 1e-5
    # the lines are made to miss each other, where the published formula has its second term
    angles = _angles() + np.array([1e-3, -2e-3, 0.5e-3, 1e-3])
    moved = [angles.copy(), angles.copy()]
    moved[0][:, index] -= step
    moved[1][:, index] += step
    ends = [triangulate_with_partials(STATIONS, a)[0] for a in moved]
    _, partials = triangulate_with_partials(STATIONS, angles)
    expected = (ends[1] - ends[0]) / (2.0 * step)
    assert partials[..., index] == pytest.approx(expected, rel=1e-6, abs=1e-7 * np.abs(expected).max())
