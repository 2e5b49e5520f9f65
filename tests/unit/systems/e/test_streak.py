"""Streaks: all light is kept, the middle is where it was put, and the claimed covariance is the scatter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad

from horizonval.systems.e.ground.detection import (
    Detection,
    NoDetection,
    Noise,
    WhyNone,
    find_streak,
    fit_streak,
    points_image,
    streak_image,
)

SIGMA = 0.9
SHAPE = (49, 61)


@pytest.mark.parametrize(
    "path",
    [
        [[20.0, 25.0], [40.0, 22.0]],
        [[30.3, 20.1], [30.3, 20.1]],
        [[15.2, 30.7], [29.0, 25.0], [44.0, 21.0]],
    ],
)
def test_all_light_is_in_the_image(path):
    # The nearest border is 15 sigma away: what falls beyond is below rounding.
    assert streak_image(path, 1e5, SIGMA, SHAPE).sum() == pytest.approx(1e5, rel=1e-12)


def test_first_moment_is_the_middle():
    image = streak_image([[20.37, 26.0], [39.12, 22.71]], 1.0, SIGMA, SHAPE)
    u, v = np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
    # Pixel sums keep the first moment of a Gaussian to 1e-5 px at sigma 0.9 (the aliased term, exp(-2 pi^2 s^2)).
    assert (image * u).sum() == pytest.approx((20.37 + 39.12) / 2, abs=1e-5)
    assert (image * v).sum() == pytest.approx((26.0 + 22.71) / 2, abs=1e-5)


def test_a_pixel_against_quadrature():
    a, b = np.array([20.37, 26.0]), np.array([39.12, 22.71])

    def along(v: float, u: float) -> float:
        t = np.linspace(0.0, 1.0, 801)
        p = a + t[:, None] * (b - a)
        light = np.exp(-((u - p[:, 0]) ** 2 + (v - p[:, 1]) ** 2) / (2 * SIGMA**2)) / (2 * np.pi * SIGMA**2)
        return float(np.trapezoid(light, t))

    # The end of the streak, where the rule along the path has most to do; scipy's quadrature is good to 1e-8.
    expected, _ = dblquad(along, 38.5, 39.5, 22.5, 23.5, epsabs=1e-8)
    assert streak_image([a, b], 1.0, SIGMA, SHAPE)[23, 39] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("u", "v"), [(30.0, 24.0), (30.41, 23.77)])
def test_without_noise_the_fit_is_exact(u, v):
    half = np.array([8.1, -2.3])
    middle = np.array([u, v])
    image = 3.0 + streak_image([middle - half, middle + half], 5e4, SIGMA, SHAPE)
    fit = fit_streak(image, (0, 0), SIGMA, Noise(6.0), (29.0, 25.0), (14.0, -3.0))
    assert fit is not None
    # The bar is 0.01 px; the model is the truth here, so only the last step is left.
    np.testing.assert_allclose(fit.middle_uv, middle, atol=1e-4)
    np.testing.assert_allclose(fit.run_uv, 2 * half, atol=1e-3)
    assert fit.light_e == pytest.approx(5e4, rel=1e-4)


def test_a_curved_path_keeps_its_middle():
    # An orbit's path bends and speeds up by less than 0.01 px in 0.1 s; ten times that moves the fit by less than 0.1.
    path = [[20.0, 25.0], [30.0, 24.1], [40.0, 23.0]]
    image = streak_image(path, 5e4, SIGMA, SHAPE)
    fit = fit_streak(image, (0, 0), SIGMA, Noise(6.0), (30.0, 24.0), (20.0, -2.0))
    assert fit is not None
    np.testing.assert_allclose(fit.middle_uv, path[1], atol=0.1)


@pytest.mark.slow
def test_the_claimed_covariance_is_the_scatter():
    rng = np.random.default_rng(5)
    middle, half = np.array([30.2, 24.4]), np.array([8.0, -2.0])
    clean = 4.0 + streak_image([middle - half, middle + half], 2e4, SIGMA, SHAPE)
    normalised = []
    for _ in range(150):
        image = rng.poisson(clean) + 6.0 * rng.standard_normal(SHAPE)
        fit = fit_streak(image, (0, 0), SIGMA, Noise(6.0), (30.0, 24.0), (15.0, -3.0))
        assert fit is not None
        error = np.array(fit.middle_uv) - middle
        normalised.append(error @ np.linalg.solve(fit.covariance[:2, :2], error) / 2)
    # Mean of 150 chi-square with two degrees of freedom, halved: 1 within 0.08 (one sigma); four of them allowed.
    assert np.mean(normalised) == pytest.approx(1.0, abs=0.33)


def test_nothing_there_is_no_streak_that_is_sure_of_itself():
    rng = np.random.default_rng(6)
    image = 6.0 * rng.standard_normal(SHAPE)
    fit = fit_streak(image, (0, 0), SIGMA, Noise(6.0), (30.0, 24.0), (15.0, -3.0))
    assert fit is None or abs(fit.light_e) < 6.0 * np.sqrt(fit.covariance[4, 4])


SKY = (256, 256)
READ_E = 6.0
RUN = (17.0, -4.0)


def _image(light: float, middle=(130.3, 120.8), stars=(), seed=1, run=RUN):
    half = np.array(run) / 2
    expected = 5.0 + streak_image([middle - half, middle + half], light, SIGMA, SKY)
    if len(stars):
        stars = np.asarray(stars, float)
        expected = expected + points_image(stars[:, :2], stars[:, 2], SIGMA, SKY)
    rng = np.random.default_rng(seed)
    return rng.poisson(expected) + READ_E * rng.standard_normal(SKY)


def _find(image):
    return find_streak(image, RUN, SIGMA, Noise(READ_E))


@pytest.mark.parametrize("light", [1500.0, 1e5])
def test_a_streak_is_found(light):
    found = _find(_image(light))
    assert isinstance(found, Detection)
    error = np.abs(np.array(found.fit.middle_uv) - (130.3, 120.8))
    # Four standard deviations of its own claim, which the fit's test holds to the scatter.
    assert np.all(error < 4.0 * np.sqrt(np.diag(found.fit.covariance)[:2]))


def test_an_empty_sky_gives_nothing():
    # 6 sigma in 6e4 pixels: 1e-5 false peaks an image.
    for seed in range(10):
        found = _find(_image(0.0, seed=seed))
        assert isinstance(found, NoDetection)
        assert found.why is WhyNone.FAINT


def test_stars_are_no_satellite():
    rng = np.random.default_rng(3)
    stars = np.column_stack([rng.uniform(30, 226, (20, 2)), rng.uniform(500, 2e4, 20)])
    assert isinstance(_find(_image(0.0, stars=stars)), NoDetection)


def test_among_brighter_stars_the_streak_is_found():
    stars = [[60.0, 60.0, 5e4], [200.0, 70.0, 2e4], [70.0, 190.0, 1e4]]
    found = _find(_image(6e3, stars=stars))
    assert isinstance(found, Detection)
    assert np.hypot(*(np.array(found.fit.middle_uv) - (130.3, 120.8))) < 0.3


def test_at_the_edge():
    found = _find(_image(1e5, middle=(9.0, 120.0)))
    assert isinstance(found, NoDetection)
    assert found.why is WhyNone.AT_EDGE
