"""The published method and the closed form, against exact cones and against draws of noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.cone import noise_bias
from horizonval.estimation.methods import altitude_free_closed_form as closed_form
from horizonval.estimation.methods import altitude_free_published as published
from horizonval.estimation.methods.altitude_free import newton, solve, step_by_qr
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle

RADIUS_M = MEAN_RADIUS_M
NADIR = nadir_of_roll_pitch(np.radians(20.0), np.radians(30.0))
RHO = float(np.arcsin(RADIUS_M / (RADIUS_M + 3000e3)))


def _arc(nadir: np.ndarray, rho: float, width_rad: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points on an arc of the cone, the middle one nearest to +z, and the outward directions across it."""
    towards = np.array([0.0, 0.0, 1.0]) - nadir[2] * nadir if nadir[2] < 1.0 - 1e-12 else np.array([1.0, 0.0, 0.0])
    e1 = towards / np.linalg.norm(towards)
    e2 = np.cross(nadir, e1)
    angle = np.linspace(-width_rad / 2, width_rad / 2, n)[:, None]
    t = np.cos(angle) * e1 + np.sin(angle) * e2
    return np.cos(rho) * nadir + np.sin(rho) * t, np.cos(rho) * t - np.sin(rho) * nadir


def _noisy(rng: np.random.Generator, width_rad: float, n: int, sigma: float, rho: float = RHO) -> np.ndarray:
    los, outwards = _arc(NADIR, rho, width_rad, n)
    e = rng.normal(0.0, sigma, n)[:, None]
    return np.cos(e) * los + np.sin(e) * outwards


def _observation() -> Observation:
    camera = CameraModel(400, 400, 346.4, 346.4, 199.5, 199.5)
    return Observation(image=np.zeros((400, 400)), camera=camera)


def _fit(module, los: np.ndarray, observation: Observation | None = None) -> Fit | Refusal:  # type: ignore[no-untyped-def]
    observation = observation or _observation()
    uv = project(observation.camera, los)[0]
    return (module.fit_pixels if module is published else module.fit_points)(los, uv, observation)


@pytest.mark.parametrize("module", [published, closed_form])
def test_exact_points_give_the_exact_attitude_and_altitude(module) -> None:  # type: ignore[no-untyped-def]
    fit = _fit(module, _arc(NADIR, RHO, 1.5, 300)[0])
    assert isinstance(fit, Fit)
    # float64 through a condition number of a few hundred squared
    assert fit.roll_rad == pytest.approx(np.radians(20.0), abs=1e-10)
    assert fit.pitch_rad == pytest.approx(np.radians(30.0), abs=1e-10)
    assert fit.altitude_m == pytest.approx(3000e3, abs=0.01)


@pytest.mark.parametrize("module", [published, closed_form])
def test_the_mounting_turns_the_nadir_into_body_axes(module) -> None:  # type: ignore[no-untyped-def]
    mounting = Rotation.from_euler("zyx", [0.3, -0.5, 0.2])
    los = mounting.apply(_arc(NADIR, RHO, 2.0, 300)[0])
    observation = Observation(
        image=np.zeros((400, 400)), camera=_observation().camera, q_cam_from_body=mounting.as_quat()
    )
    fit = _fit(module, los, observation)
    assert isinstance(fit, Fit)
    assert (fit.roll_rad, fit.pitch_rad) == pytest.approx((np.radians(20.0), np.radians(30.0)), abs=1e-10)


def test_the_printed_pseudo_inverse_takes_the_steps_of_the_qr() -> None:
    los = _noisy(np.random.default_rng(3), 1.0, 200, 1e-3)
    one = newton(los, published.START, published.step_by_pseudo_inverse)
    other = newton(los, published.START, step_by_qr)
    assert one == pytest.approx(other, abs=1e-9)


@pytest.mark.parametrize("start_rho_deg", [15.0, 45.0, 80.0])
@pytest.mark.parametrize("azimuth_deg", [0.0, 72.0, 144.0, 216.0, 288.0])
@pytest.mark.parametrize("rho_deg", [31.0, 42.8, 62.7, 70.2])
def test_every_attitude_to_fifty_degrees_is_in_the_basin_of_the_start(
    start_rho_deg: float, azimuth_deg: float, rho_deg: float
) -> None:
    for off_deg in (0.0, 25.0, 50.0):
        nadir = Rotation.from_euler("zx", [azimuth_deg, off_deg], degrees=True).apply([0.0, 0.0, 1.0])
        los = (
            _arc(nadir, np.radians(rho_deg), 1.2, 120)[0] if off_deg else _arc(nadir, np.radians(rho_deg), 6.2, 120)[0]
        )
        steps = newton(los, np.array([0.0, 0.0, np.radians(start_rho_deg)]), published.step_by_pseudo_inverse)
        assert nadir_of_roll_pitch(*steps[-1, :2]) == pytest.approx(nadir, abs=1e-8)


def test_the_first_step_finds_the_tangents_of_the_attitude_whatever_the_radius() -> None:
    los = _arc(NADIR, RHO, 1.5, 300)[0]
    for rho in (0.3, 0.8, 1.4):
        phi, theta, _ = newton(los, np.array([0.0, 0.0, rho]), published.step_by_pseudo_inverse)[1]
        assert (phi, -theta) == pytest.approx((NADIR[1] / NADIR[2], NADIR[0] / NADIR[2]), abs=1e-10)


def test_newton_ends_at_the_orthogonal_regression() -> None:
    """Both minimise the sum of (u.n - cos rho)^2 over unit n: an independent route, by singular vectors."""
    for seed in range(5):
        los = _noisy(np.random.default_rng(seed), 0.8, 150, 2e-3)
        nadir, rho, _ = solve(los)
        cone = fit_cone(los)
        assert nadir == pytest.approx(cone.axis_cam, abs=1e-9)
        assert rho == pytest.approx(cone.rho_rad, abs=1e-9)


def test_the_mirrored_solution_is_turned_to_the_smaller_cap() -> None:
    """75 deg off the optical axis the first step overshoots and the iteration ends at (-n, pi - rho)."""
    nadir = nadir_of_roll_pitch(np.radians(75.0), 0.0)
    los = _arc(nadir, np.radians(63.0), 0.8, 200)[0]
    fit = _fit(published, los)
    assert isinstance(fit, Fit)
    assert np.cos(fit.steps[-1, 2]) < 0.0
    assert fit.nadir_cam == pytest.approx(nadir, abs=1e-8)
    assert fit.angular_radius_rad == pytest.approx(np.radians(63.0), abs=1e-8)


@pytest.mark.parametrize("altitude_km", [400.0, 3000.0, 6000.0])
def test_noise_shortens_the_radius_as_foretold_and_the_orthogonal_fit_suffers_less(altitude_km: float) -> None:
    """Means of 1500 draws against the second-order formulas; on a short arc their ratio is 1 / cos^2 rho."""
    rng = np.random.default_rng(np.random.SeedSequence([21, int(altitude_km)]))
    rho = float(np.arcsin(RADIUS_M / (RADIUS_M + altitude_km * 1e3)))
    width, n, sigma = 0.6, 200, 4e-4
    exact = _arc(NADIR, rho, width, n)[0]
    # m = n / cos rho, so along n it changes by tan rho / cos rho drho
    linear = float(closed_form.attenuation(exact, NADIR, rho, sigma) @ NADIR) * np.cos(rho) / np.tan(rho)
    orthogonal = float(noise_bias(exact, NADIR, rho, sigma)[2])
    assert orthogonal / linear == pytest.approx(np.cos(rho) ** 2, rel=0.02)
    draws = [_noisy(rng, width, n, sigma, rho) for _ in range(1500)]
    by_closed_form = np.array([closed_form.solve(los)[1] for los in draws]) - rho
    by_cone = np.array([fit_cone(los).rho_rad for los in draws]) - rho
    mean_error = by_cone.std() / np.sqrt(len(draws))
    # many standard errors of the mean, so that this could fail
    assert linear < -6 * mean_error
    # the next order is the fourth: a tenth of the bias on so short an arc
    assert by_closed_form.mean() == pytest.approx(linear, abs=0.1 * abs(linear) + 3 * mean_error)
    assert by_cone.mean() == pytest.approx(orthogonal, abs=0.1 * abs(orthogonal) + 3 * mean_error)


@pytest.mark.parametrize(("width", "sigma"), [(2.0, 5e-4), (0.5, 5e-4)])
@pytest.mark.parametrize("module", [published, closed_form])
def test_claimed_covariance_is_the_scatter_of_draws(module, width: float, sigma: float) -> None:  # type: ignore[no-untyped-def]
    """Mean of e^T C^-1 e over 400 draws, in the two directions of the nadir; 2 if the covariance is right.

    Its standard error is 0.1 for Gaussian errors. The correlation length is measured on every draw and never below 1,
    which makes the claim up to a half too large for independent noise.
    """
    rng = np.random.default_rng(np.random.SeedSequence(33))
    squares = []
    for _ in range(400):
        fit = _fit(module, _noisy(rng, width, 200, sigma))
        assert isinstance(fit, Fit)
        error = fit.nadir_cam - NADIR
        squares.append(error @ np.linalg.pinv(fit.covariance_nadir_cam, rcond=1e-9) @ error)
    assert 1.0 < np.mean(squares) < 2.5


def test_radius_near_ninety_degrees_is_lost_to_the_linear_form_alone() -> None:
    """89.5 deg: m is 115 long and the noise that the plane shrugs off shortens it to less than half."""
    rho = np.radians(89.5)
    los = _noisy(np.random.default_rng(4), 1.0, 300, 1e-3, rho)
    assert abs(fit_cone(los).rho_rad - rho) < np.radians(0.3)
    assert abs(closed_form.solve(los)[1] - rho) > np.radians(0.5)


@pytest.mark.parametrize("module", [published, closed_form])
def test_points_that_determine_no_cone_are_refused(module) -> None:  # type: ignore[no-untyped-def]
    los = _arc(NADIR, RHO, 1.0, 3)[0]
    few = _fit(module, los)
    assert isinstance(few, Refusal)
    assert few.status is Outcome.SHORT_ARC
    same = _fit(module, np.repeat(los[:1], 30, axis=0))
    assert isinstance(same, Refusal)
    assert same.status is Outcome.NOT_CONVERGED


@pytest.mark.parametrize("module", [published, closed_form])
@pytest.mark.parametrize("level", [0.0, np.nan, 255.0])
def test_images_without_an_edge_are_refused(module, level: float) -> None:  # type: ignore[no-untyped-def]
    camera = _observation().camera
    result = module.ESTIMATOR.run(Observation(image=np.full((400, 400), level), camera=camera, full_scale=255.0))
    assert isinstance(result, Refusal)
    assert result.status is not Outcome.VALID


def test_published_points_are_whole_pixels_and_the_disc_is_found() -> None:
    """A hard disc of 100 px: 600 Canny pixels or so, each within a pixel of the circle's line."""
    camera = _observation().camera
    row, column = np.indices((400, 400)) - 199.5
    image = np.clip(100.0 - np.hypot(row, column) + 0.5, 0.0, 1.0) * 200.0
    fit = published.ESTIMATOR.run(Observation(image=image, camera=camera, full_scale=255.0))
    assert isinstance(fit, Fit)
    assert np.array_equal(fit.points, np.rint(fit.points))
    assert np.abs(np.hypot(*(fit.points - 199.5).T) - 100.0).max() < 1.0
    # a tenth of a pixel of 595 arcsec: the disc is symmetric
    assert off_axis_angle(np.array([0.0, 0.0, 1.0]), fit.nadir_cam) < 0.1 / 346.4
    assert fit.angular_radius_rad == pytest.approx(np.arctan(100.0 / 346.4), abs=0.5 / 346.4)
