"""Orbit fit, motion and triangulation against scipy, SGP4, Monte Carlo, differences and exact directions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

from horizonval.geometry.ellipsoid import itrs_from_geodetic, surface_normal
from horizonval.geometry.orbit import gcrs_states
from horizonval.geometry.rotation import itrs_from_gcrs
from horizonval.systems.e.case import ENVISAT, EPOCH_UTC, METHODS, STATIONS, exact_pass
from horizonval.systems.e.figures import half_width, mean
from horizonval.systems.e.localisation.batch import (
    J2,
    MU_M3_S2,
    OrbitFit,
    acceleration,
    fit_orbit,
    propagate,
    transition,
    triangulate,
    triangulate_with_partials,
)
from horizonval.systems.e.localisation.pipeline import locate
from horizonval.systems.e.localisation.stations import ARCSEC, celestial, celestial_errors, normalised_squares, rms

SIGMA = 100.0 * ARCSEC
TIMES = exact_pass().times_s[::8]
ANGLES = exact_pass().angles_rad[::8]
TURNS = itrs_from_gcrs(EPOCH_UTC, TIMES)


def _state(second: float) -> np.ndarray:
    r, v = gcrs_states(ENVISAT, EPOCH_UTC, second)
    return np.concatenate([r, v])


def _fit(angles: np.ndarray, lasting: np.ndarray | None = None) -> OrbitFit:
    start = _state(60.0) + np.array([3e4, -2e4, 1e4, 50.0, -50.0, 20.0])
    return fit_orbit(STATIONS, TIMES, angles, SIGMA**2 * np.eye(4), TURNS, start, lasting)


def test_acceleration_is_the_gradient_of_the_potential() -> None:
    """Central differences over 10 m of mu / r - J2's term: 1e-9 m/s^2 of 8."""

    def potential(r: np.ndarray) -> float:
        distance = np.linalg.norm(r)
        oblate = J2 * (6378137.0 / distance) ** 2 * (1.5 * (r[2] / distance) ** 2 - 0.5)
        return MU_M3_S2 / distance * (1.0 - oblate)

    r = np.array([4.1e6, 3.0e6, 4.9e6])
    by_difference = [(potential(r + 10.0 * e) - potential(r - 10.0 * e)) / 20.0 for e in np.eye(3)]
    assert acceleration(r) == pytest.approx(by_difference, abs=3e-8)


def test_motion_equals_an_independent_integrator() -> None:
    """Scipy's DOP853 at 1e-12: 1 mm after 60 s."""
    start = _state(0.0)
    there = solve_ivp(
        lambda _, x: np.concatenate([x[3:], acceleration(x[:3])]), (0, 60.0), start, "DOP853", rtol=1e-12, atol=1e-6
    ).y[:, -1]
    assert np.abs(propagate(start, 60.0) - there)[:3].max() < 1e-3
    assert propagate(propagate(start, 60.0), -60.0) == pytest.approx(start, abs=1e-3)


def test_transition_is_the_propagations_derivative() -> None:
    """1 % of what gravity does to it: the gradient of J2's pull, some 3e-3 of the point mass's, is left out."""
    start, dt = _state(60.0), 55.0
    columns = []
    for k, step in enumerate([100.0] * 3 + [0.1] * 3):
        e = np.eye(6)[k] * step
        columns.append((propagate(start + e, dt) - propagate(start - e, dt)) / (2.0 * step))
    expected, ours = np.stack(columns, axis=1), transition(start, dt)
    free = np.eye(6) + dt * np.eye(6, k=3)
    for rows in (slice(0, 3), slice(3, 6)):
        for cols in (slice(0, 3), slice(3, 6)):
            gravity = np.abs((expected - free)[rows, cols]).max()
            assert np.abs((ours - expected)[rows, cols]).max() < 0.01 * gravity


def test_exact_angles_give_the_orbit_to_the_models_accuracy() -> None:
    fit = _fit(ANGLES)
    assert fit.converged
    r, _ = gcrs_states(ENVISAT, EPOCH_UTC, TIMES)
    assert np.linalg.norm(fit.states_gcrs[:, :3] - r, axis=1).max() < 1.0


def test_covariance_is_that_of_the_derivatives() -> None:
    """sigma^2 (J^T J)^-1 with J by differences of the angles; 2 %: the transition leaves out J2's gradient."""
    fit = _fit(ANGLES)

    def angles(state: np.ndarray) -> np.ndarray:
        r_gcrs = propagate(state, TIMES - fit.epoch_s)[:, :3]
        r = np.einsum("nij,nj->ni", TURNS, r_gcrs)
        return np.concatenate([np.stack(s.azimuth_elevation(r), axis=1) for s in STATIONS], axis=1).ravel()

    steps = [1.0] * 3 + [1e-3] * 3
    columns = [
        (angles(fit.state_gcrs + h * e) - angles(fit.state_gcrs - h * e)) / (2 * h)
        for h, e in zip(steps, np.eye(6), strict=True)
    ]
    j = np.stack(columns, axis=1) / SIGMA
    expected = np.linalg.inv(j.T @ j)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((fit.covariance - expected) / scale).max() < 0.02


@pytest.mark.slow
def test_covariance_is_that_of_many_fits() -> None:
    """150 fits: a standard deviation is known to 6 %; the mean of 6 chi-square to 0.28, of 31 x 4 residuals to 0.01."""
    rng = np.random.default_rng(np.random.SeedSequence(21))
    fits = [_fit(ANGLES + rng.normal(0.0, SIGMA, ANGLES.shape)) for _ in range(150)]
    errors = np.array([fit.state_gcrs for fit in fits]) - _fit(ANGLES).state_gcrs
    claimed = np.sqrt(np.diag(fits[0].covariance))
    assert errors.std(axis=0) / claimed == pytest.approx(np.ones(6), abs=0.25)
    squares = [e @ np.linalg.solve(fit.covariance, e) for e, fit in zip(errors, fits, strict=True)]
    assert np.mean(squares) == pytest.approx(6.0, abs=1.0)
    assert np.mean([fit.chi2_per_dof for fit in fits]) == pytest.approx(1.0, abs=0.05)
    r, _ = gcrs_states(ENVISAT, EPOCH_UTC, TIMES)
    ends = [normalised_squares(fit.states_gcrs[-1, :3], fit.covariances[-1, :3, :3], r[-1]) for fit in fits]
    assert np.mean(ends) == pytest.approx(3.0, abs=0.7)


def test_lasting_errors_are_considered() -> None:
    """An offset of one sigma in each of the four angles: the covariance grows by just what it does to the orbit."""
    lasting = np.broadcast_to(np.eye(4) * SIGMA, (len(TIMES), 4, 4))
    plain, with_lasting = _fit(ANGLES), _fit(ANGLES, lasting)
    moved = np.stack([_fit(ANGLES + SIGMA * np.eye(4)[k]).state_gcrs - plain.state_gcrs for k in range(4)], axis=1)
    grown = with_lasting.covariance - plain.covariance
    assert np.diag(grown) == pytest.approx(np.diag(moved @ moved.T), rel=0.02)


def test_what_one_station_missed_does_not_count() -> None:
    """Wild angles with the variance of no measurement leave the orbit where it is."""
    rng = np.random.default_rng(np.random.SeedSequence(22))
    angles = ANGLES + rng.normal(0.0, SIGMA, ANGLES.shape)
    spread = np.broadcast_to(SIGMA**2 * np.eye(4), (len(TIMES), 4, 4)).copy()
    spread[10:15, 0, 0] = spread[10:15, 1, 1] = 1e6
    wild = angles.copy()
    wild[10:15, :2] += 0.5
    fits = [fit_orbit(STATIONS, TIMES, a, spread, TURNS, _state(60.0)) for a in (angles, wild)]
    assert fits[0].state_gcrs == pytest.approx(fits[1].state_gcrs, abs=1e-2)
    assert fits[1].chi2_per_dof == pytest.approx(1.0, abs=0.4)


def test_the_pipeline_orders_its_methods() -> None:
    """Independent noise: every step makes the errors smaller, and the plain ones are what the partials predict."""
    truth = exact_pass()
    rng = np.random.default_rng(np.random.SeedSequence(23))
    located = locate(truth.measured(truth.angles_rad + rng.normal(0.0, SIGMA, truth.angles_rad.shape)))
    errors = {
        m: np.linalg.norm(getattr(located, m) - truth.r_gcrs, axis=1)
        for m in ("plain", "smoothed", "proposed", "batch")
    }
    size = {m: np.sqrt(np.mean(e**2)) for m, e in errors.items()}
    assert size["batch"] < size["proposed"] < size["smoothed"] < 0.3 * size["plain"]
    assert located.orbit.chi2_per_dof == pytest.approx(1.0, abs=0.15)


def test_celestial_errors_are_angles_about_the_axis() -> None:
    r = np.array([[7e6 * np.cos(np.pi - 1e-6), 7e6 * np.sin(np.pi - 1e-6), 7e6]])
    turned = np.array([[7e6 * np.cos(np.pi + 1e-6), 7e6 * np.sin(np.pi + 1e-6), 7e6]])
    assert celestial_errors(turned, r)[0] == pytest.approx([2e-6 / ARCSEC, 0.0, 0.0], abs=1e-8)
    assert celestial(r)[0, 1] == pytest.approx(np.pi / 4)
    assert rms(np.array([[3.0, 0.0, 1.0], [4.0, 0.0, 1.0]])) == pytest.approx([np.sqrt(12.5), 0.0, 1.0])


SATELLITES = itrs_from_geodetic(np.radians([32.0, 36.0, 39.0]), np.radians([53.0, 52.0, 51.0]), 771e3)


def _exact_angles() -> np.ndarray:
    return np.concatenate([np.stack(s.azimuth_elevation(SATELLITES), axis=1) for s in STATIONS], axis=1)


def test_station_axes_are_east_north_and_the_ellipsoids_normal() -> None:
    station = STATIONS[0]
    east, north, up = station.itrs_from_enu.T
    assert up == pytest.approx(surface_normal(station.r_itrs), abs=1e-14)
    eastwards = itrs_from_geodetic(station.latitude_rad, station.longitude_rad + 1e-6, 1000.0) - station.r_itrs
    assert eastwards / np.linalg.norm(eastwards) == pytest.approx(east, abs=1e-6)
    northwards = itrs_from_geodetic(station.latitude_rad + 1e-6, station.longitude_rad, 1000.0) - station.r_itrs
    assert northwards / np.linalg.norm(northwards) == pytest.approx(north, abs=1e-6)


def test_exact_directions_give_the_exact_point() -> None:
    """1 um: rounding of Earth-sized coordinates is 1 nm, and the lines cross at more than 30 degrees."""
    angles = _exact_angles()
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
    angles = _exact_angles() + np.array([1e-3, -2e-3, 0.5e-3, 1e-3])
    moved = [angles.copy(), angles.copy()]
    moved[0][:, index] -= step
    moved[1][:, index] += step
    ends = [triangulate_with_partials(STATIONS, a)[0] for a in moved]
    _, partials = triangulate_with_partials(STATIONS, angles)
    expected = (ends[1] - ends[0]) / (2.0 * step)
    assert partials[..., index] == pytest.approx(expected, rel=1e-6, abs=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("n", [2, 5, 40])
def test_the_interval_of_a_mean_is_students(n: int) -> None:
    draws = np.random.default_rng(n).gamma(2.0, 3.0, (n, len(METHODS), 3))
    rows = {"noisy": {"rms": draws}}
    for k, method in enumerate(METHODS):
        interval = stats.ttest_1samp(draws[:, k], 0.0).confidence_interval(0.95)
        assert mean(rows, "noisy", method) == pytest.approx((interval.high + interval.low) / 2)
        assert half_width(rows, "noisy", method) == pytest.approx((interval.high - interval.low) / 2)
