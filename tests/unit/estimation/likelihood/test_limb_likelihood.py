"""The fit of the limb against pictures made without the package, and against the bound that they set.

The bound knows the pictures' two levels and their blur no better than the fit does, but no sectors and no shading, and
takes every pixel; the fit's own covariance is 1.03 to 1.06 of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from limb_image import RADIUS_M, Sphere, bound_rad, noisy, picture
from scipy.ndimage import gaussian_filter

from horizonval.earth.limb_heights import Relief
from horizonval.estimation.fit.known import LimbKnowledge, sphere_knowledge
from horizonval.estimation.fit.limb import LimbFit, fit_limb
from horizonval.geometry.camera import CameraModel

ARCSEC = np.radians(1.0 / 3600.0)
NOISE = float(np.hypot(2.55, 12.0**-0.5))


def _focal(pixels: int, field_deg: float) -> float:
    return float(pixels / 2 / np.tan(np.radians(field_deg) / 2))


def _off(angle_deg: float) -> tuple[float, float, float]:
    off, turn = np.radians(angle_deg), np.radians(100.0)
    return float(np.sin(off) * np.cos(turn)), float(np.sin(off) * np.sin(turn)), float(np.cos(off))


DISC = Sphere(1024, 1024, _focal(1024, 20.0), _off(0.4), RADIUS_M / np.sin(np.radians(8.7)) - RADIUS_M)
LOW_ORBIT = Sphere(1024, 1024, _focal(1024, 60.0), _off(66.0), 500e3)
SOFT = replace(LOW_ORBIT, scale_height_m=8e3)
SMALL = Sphere(160, 120, _focal(160, 57.0), _off(64.0), 500e3)


@dataclass(frozen=True)
class Trials:
    """Errors of the nadir along two directions [rad], and the squares of these over what the fits claim."""

    errors: np.ndarray
    nees: np.ndarray
    fits: list[LimbFit]

    @property
    def rms(self) -> float:
        return float(np.sqrt((self.errors**2).sum(axis=1).mean()))


def _camera(sphere: Sphere) -> CameraModel:
    middle = ((sphere.width - 1) / 2, (sphere.height - 1) / 2)
    return CameraModel(sphere.width, sphere.height, sphere.focal_px, sphere.focal_px, *middle)


def _knowledge(sphere: Sphere, nadir: np.ndarray, altitude_m: float, known: bool) -> LimbKnowledge:
    planet, mean, information = sphere_knowledge(nadir, RADIUS_M, altitude_m, 0.0 if known else np.inf)
    return LimbKnowledge(
        planet,
        mean,
        information,
        scale_height_m=sphere.scale_height_m,
        # The bound knows the scale height: the fit is told it to 10 m.
        scale_sigma_m=10.0 if sphere.scale_height_m > 0.0 else 0.0,
        blur_log_sigma=0.3,
    )


def _trials(sphere: Sphere, count: int, *, known: bool, seed: int, poses: int) -> Trials:
    """Fit pictures of some poses, each with noise of its own, from starts that are off by half a pixel or so."""
    rng = np.random.default_rng(seed)
    errors, nees, fits = [], [], []
    for pose in range(poses):
        pixel = 1.0 / sphere.focal_px
        there = replace(sphere, tilt=tuple(rng.uniform(-3.0, 3.0, 2) * pixel))
        clean = picture(there)
        first, second = there.across
        across = np.array([first, second])
        for _ in range(pose * count // poses, (pose + 1) * count // poses):
            tilt = tuple(np.array(there.tilt) + rng.normal(0.0, 0.3, 2) * pixel)
            altitude = sphere.altitude_m + (0.0 if known else rng.normal(0.0, 1e3))
            knowledge = _knowledge(sphere, replace(there, tilt=tilt).nadir, altitude, known)
            fit = fit_limb(noisy(clean, rng), _camera(sphere), knowledge.mean, knowledge)
            error = across @ (fit.pose.nadir_cam - there.nadir)
            claimed = across @ fit.by_nadir @ fit.covariance @ fit.by_nadir.T @ across.T
            errors.append(error)
            nees.append(error @ np.linalg.solve(claimed, error) / 2.0)
            fits.append(fit)
    return Trials(np.array(errors), np.array(nees), fits)


@pytest.mark.parametrize("known", [False, True])
def test_small_pictures_are_fitted_as_well_as_their_noise_allows(known: bool) -> None:
    """Ten draws: their rms has a standard error of 22 % where one direction makes it; three of them above the claim."""
    trials = _trials(SMALL, 10, known=known, seed=1, poses=5)
    bound = float(np.sqrt(np.trace(bound_rad(SMALL, altitude_known=known))))
    assert bound / ARCSEC == pytest.approx(7.8 if known else 53.7, rel=0.02)
    assert trials.rms < 1.7 * bound
    claimed = np.median([np.sqrt(np.trace(f.by_nadir @ f.covariance @ f.by_nadir.T)) for f in trials.fits])
    assert 0.97 < claimed / bound < 1.08
    # the mean of ten squares of two unknowns each has a standard error of 0.32
    assert 0.3 < trials.nees.mean() < 2.0
    assert np.mean([f.noise_sigma[0] for f in trials.fits]) == pytest.approx(NOISE, rel=0.03)
    assert max(len(f.steps) for f in trials.fits) <= 16
    assert np.mean([f.blur_px for f in trials.fits]) == pytest.approx(0.7, abs=0.02)


def test_without_noise_the_answer_is_the_truth() -> None:
    """A hundredth of a pixel of tilt would be 14 arcsec. What is left: the square pixel taken for a Gaussian, the bend
    to first order, 8 bits that this picture does not have."""
    rng = np.random.default_rng(6)
    for known, most in ((True, 1.0), (False, 4.0)):
        there = replace(SMALL, tilt=tuple(rng.uniform(-3.0, 3.0, 2) / SMALL.focal_px))
        knowledge = _knowledge(SMALL, there.nadir, SMALL.altitude_m, known)
        image = picture(there) + rng.normal(0.0, 0.02, (SMALL.height, SMALL.width))
        fit = fit_limb(image, _camera(SMALL), knowledge.mean, knowledge)
        assert np.linalg.norm(fit.pose.nadir_cam - there.nadir) < most * ARCSEC


def test_the_limb_may_be_darker_than_space() -> None:
    there = replace(SMALL, earth=20.0, space=200.0)
    knowledge = _knowledge(there, there.nadir, there.altitude_m, True)
    image = noisy(picture(there), np.random.default_rng(3))
    fit = fit_limb(image, _camera(there), knowledge.mean, knowledge)
    assert np.linalg.norm(fit.pose.nadir_cam - there.nadir) < 30.0 * ARCSEC


def test_uneven_light_and_stars_move_the_answer_little() -> None:
    """Brightness that doubles along the limb and falls by a tenth over 8 px inside, and thirty stars beside it."""
    there = replace(SMALL, space=0.0, earth=1.0)
    rng = np.random.default_rng(9)
    column, row = np.meshgrid(np.arange(160.0), np.arange(120.0))
    clean = 10.0 + picture(there) * (80.0 + 80.0 * column / 160.0 - 0.3 * (row - 60.0))
    image = clean + rng.normal(0.0, 2.55, clean.shape)
    image[rng.integers(0, 120, 30), rng.integers(0, 160, 30)] += 150.0
    knowledge = _knowledge(there, there.nadir, there.altitude_m, True)
    fit = fit_limb(image, _camera(there), knowledge.mean, knowledge)
    error = fit.pose.nadir_cam - there.nadir
    claimed = float(np.sqrt(np.trace(fit.by_nadir @ fit.covariance @ fit.by_nadir.T)))
    assert np.linalg.norm(error) < 3.0 * claimed
    assert claimed < 30.0 * ARCSEC


def test_a_prior_of_the_altitude_is_worth_what_it_claims() -> None:
    """Between free and known; and a wrong one pulls the answer by what its sigma allows."""
    image = noisy(picture(SMALL), np.random.default_rng(12))
    sigmas = []
    for altitude_sigma_m in (np.inf, 300.0, 0.0):
        planet, mean, information = sphere_knowledge(SMALL.nadir, RADIUS_M, SMALL.altitude_m, altitude_sigma_m)
        fit = fit_limb(image, _camera(SMALL), mean, LimbKnowledge(planet, mean, information))
        sigmas.append(float(np.sqrt(np.trace(fit.by_nadir @ fit.covariance @ fit.by_nadir.T))))
    assert sigmas[0] > 1.5 * sigmas[1] > 3.0 * sigmas[2]


def test_relief_of_the_limb_is_in_the_claim() -> None:
    """A limb lifted by a random relief of 1 km, drawn twelve times: the error is what the fit with modes claims."""
    relief = Relief(1000.0, 0.3)
    rng = np.random.default_rng(21)
    squares, plain = [], []
    sphere = replace(SMALL, blur_px=0.7)
    column, row = np.meshgrid(np.arange(160.0), np.arange(120.0))
    d = np.stack([(column - 79.5) / sphere.focal_px, (row - 59.5) / sphere.focal_px, np.ones_like(row)])
    d /= np.linalg.norm(d, axis=0)
    cosine = np.tensordot(sphere.nadir, d, axes=1)
    first, second = sphere.across
    azimuth = np.arctan2(np.tensordot(second, d, axes=1), np.tensordot(first, d, axes=1))
    azimuth = np.mod(azimuth - azimuth[cosine.argmin() // 160, cosine.argmin() % 160], 2 * np.pi)
    grid = np.linspace(0.0, 2 * np.pi, 200)
    apart = np.abs(grid[:, None] - grid[None, :])
    apart = np.minimum(apart, 2 * np.pi - apart)
    values, vectors = np.linalg.eigh(relief.sigma_m**2 * np.exp(-0.5 * (apart / relief.correlation_rad) ** 2))
    rho = np.arcsin(RADIUS_M / (RADIUS_M + sphere.altitude_m))
    for _ in range(12):
        heights = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=200))
        inside = rho + np.interp(azimuth, grid, heights) * np.tan(rho) / RADIUS_M - np.arccos(cosine)
        image = 20.0 + 180.0 / (1.0 + np.exp(-inside * sphere.focal_px / 0.45)) + rng.normal(0.0, 2.55, inside.shape)
        planet, mean, information = sphere_knowledge(sphere.nadir, RADIUS_M, sphere.altitude_m, 100.0)
        across = np.array([first, second])
        for reliefs, out in (((relief,), squares), ((), plain)):
            fit = fit_limb(image, _camera(sphere), mean, LimbKnowledge(planet, mean, information, reliefs=reliefs))
            claimed = across @ fit.by_nadir @ fit.covariance @ fit.by_nadir.T @ across.T
            error = across @ (fit.pose.nadir_cam - sphere.nadir)
            out.append(error @ np.linalg.solve(claimed, error) / 2.0)
    # twelve squares of two: a standard error of 0.29
    assert 0.2 < np.mean(squares) < 1.9
    assert np.mean(plain) > 5.0


def test_too_little_limb_and_no_limb_raise() -> None:
    knowledge = _knowledge(SMALL, np.array([0.0, 0.0, 1.0]), SMALL.altitude_m, True)
    with pytest.raises(np.linalg.LinAlgError, match="pixels of limb"):
        fit_limb(np.zeros((120, 160)), _camera(SMALL), knowledge.mean, knowledge)


BARS = [
    ("full disc, 1024 px in 20 deg", DISC, False, 0.075),
    ("low orbit, altitude free", LOW_ORBIT, False, 3.4),
    ("low orbit, altitude known", LOW_ORBIT, True, 0.52),
    ("soft limb of 8 km, altitude free", SOFT, False, 8.0),
    ("soft limb of 8 km, altitude known", SOFT, True, 1.0),
    ("160 x 120, altitude free", SMALL, False, 58.0),
    ("160 x 120, altitude known", SMALL, True, 8.2),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "sphere", "known", "bar_arcsec"), BARS, ids=[bar[0] for bar in BARS])
def test_two_hundred_draws_reach_the_bound(name: str, sphere: Sphere, known: bool, bar_arcsec: float) -> None:
    """At most 1.15 times the bound, of which 5 % is the standard error of two hundred draws along one direction.

    (A hundred draws have 7 %: those of seed 2026 in low orbit, altitude free, were at 1.155.)

    The bar in arcsec was set for limbs like these whose geometry was not written down; these bounds lie within 7 % of
    the ones it was set for, so that it is judged to 7 %.
    """
    trials = _trials(sphere, 200, known=known, seed=2026, poses=20)
    bound = float(np.sqrt(np.trace(bound_rad(sphere, altitude_known=known))))
    print(  # noqa: T201
        f"\n{name}: rms {trials.rms / ARCSEC:.3f} arcsec, {trials.rms / bound:.3f} of the bound {bound / ARCSEC:.3f},"
        f" NEES {trials.nees.mean():.2f}, {np.mean([len(f.steps) for f in trials.fits]):.1f} steps"
    )
    assert trials.rms < 1.15 * bound
    assert trials.rms < 1.07 * bar_arcsec * ARCSEC
    assert 0.8 < trials.nees.mean() < 1.25


def test_a_disc_most_of_which_is_black_night_is_where_its_clouds_say() -> None:
    """Eight bits without any noise: three fifths of the limb and the sky are exactly black, the rest is uneven."""
    sphere = Sphere(256, 256, _focal(256, 20.0), _off(0.3), RADIUS_M / np.sin(np.radians(8.2)) - RADIUS_M, space=0.0)
    camera, clean = _camera(sphere), picture(sphere)
    rows, columns = np.indices(clean.shape)
    lit = np.cos(np.arctan2(rows - 127.5, columns - 127.5)) > np.cos(0.4 * np.pi)
    errors = []
    for seed in range(4):
        ground = gaussian_filter(np.random.default_rng(seed).normal(size=clean.shape), 1.5)
        seen = np.rint(np.clip(lit * clean * (0.6 + 0.12 * ground / ground.std()), 0.0, 255.0))
        planet, mean, information = sphere_knowledge(sphere.nadir, RADIUS_M, sphere.altitude_m, 5e3)
        found = fit_limb(seen, camera, mean, LimbKnowledge(planet, mean, information))
        off = np.array(sphere.across) @ (found.pose.nadir_cam - sphere.nadir)
        by = np.array(sphere.across) @ found.by_nadir
        errors.append(float(off @ np.linalg.solve(by @ found.covariance @ by.T, off)))
    # Of eight degrees of freedom: of errors as they are claimed, one sum of a thousand is above.
    assert np.sum(errors) < 26.0, errors
