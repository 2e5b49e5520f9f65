"""Finding the streak: there, absent, hidden among stars, at the edge."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.systems.e.ground.detection import (
    Detection,
    NoDetection,
    Noise,
    WhyNone,
    background_plane,
    find_streak,
    points_image,
    streak_image,
)

SHAPE = (256, 256)
SIGMA, READ_E = 0.9, 6.0
RUN = (17.0, -4.0)


def _image(light: float, middle=(130.3, 120.8), stars=(), seed=1, run=RUN):
    half = np.array(run) / 2
    expected = 5.0 + streak_image([middle - half, middle + half], light, SIGMA, SHAPE)
    if len(stars):
        stars = np.asarray(stars, float)
        expected = expected + points_image(stars[:, :2], stars[:, 2], SIGMA, SHAPE)
    rng = np.random.default_rng(seed)
    return rng.poisson(expected) + READ_E * rng.standard_normal(SHAPE)


def _find(image):
    return find_streak(image, RUN, SIGMA, Noise(READ_E))


@pytest.mark.parametrize("light", [1500.0, 1e5])
def test_a_streak_is_found(light):
    found = _find(_image(light))
    assert isinstance(found, Detection)
    error = np.abs(np.array(found.fit.middle_uv) - (130.3, 120.8))
    # Four standard deviations of its own claim, which the fit's test holds to the scatter.
    assert np.all(error < 4.0 * np.sqrt(np.diag(found.fit.covariance)[:2]))


def test_its_direction_has_no_sign():
    found = find_streak(_image(1e5), (-RUN[0], -RUN[1]), SIGMA, Noise(READ_E))
    assert isinstance(found, Detection)


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


def test_another_satellite_is_not_taken():
    # At right angles to the prediction and as long: its image answers the filter, its run does not fit.
    found = _find(_image(1e5, run=(4.0, 17.0)))
    assert isinstance(found, NoDetection)


def test_at_the_edge():
    found = _find(_image(1e5, middle=(9.0, 120.0)))
    assert isinstance(found, NoDetection)
    assert found.why is WhyNone.AT_EDGE


def test_a_tilted_background_is_a_plane():
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    tilted = 20.0 + 0.01 * u - 0.02 * v
    np.testing.assert_allclose(background_plane(tilted), tilted, atol=1e-9)
