"""The limb's height along its arc, correlations along it, and what the fit claims of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from limb_image import RADIUS_M, Sphere, noisy, picture
from scipy.ndimage import gaussian_filter

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Refusal
from horizonval.estimation.fit.heights import (
    ArcPlaces,
    BandHeights,
    LimbHeights,
    UnevenLimb,
    band_heights,
    correlations,
    edge_height,
    lengths_along,
)
from horizonval.estimation.fit.known import LimbKnowledge, sphere_knowledge
from horizonval.estimation.fit.light import edge_profile, light_basis, light_noise
from horizonval.estimation.fit.limb import LimbFit, fit_limb
from horizonval.estimation.guard.guard import guarded
from horizonval.estimation.limb.picture import rounding_variance
from horizonval.estimation.methods import limb_sphere
from horizonval.estimation.observation import Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel

SCALE_HEIGHT_M = Prior().limb_scale_height_m
CO2_UM, VISIBLE_UM = (14.0, 16.3), (0.45, 0.75)
RHO = float(np.arcsin(RADIUS_M / (RADIUS_M + 500e3)))
OFF = np.radians(64.0)
SOFT = Sphere(160, 120, 147.0, (0.0, float(np.sin(OFF)), float(np.cos(OFF))), 500e3, scale_height_m=SCALE_HEIGHT_M)


def _heights(kind: str, um: tuple[float, float]) -> BandHeights:
    found = band_heights(kind, um, SCALE_HEIGHT_M)  # type: ignore[arg-type]  # one of two words
    assert found is not None
    return found


@pytest.mark.parametrize("pixel_m", [4e3, 15e3, 50e3])
@pytest.mark.parametrize("stands_m", [3e3, 14.4e3, 37e3])
def test_an_exponential_edge_is_found_where_it_stands(pixel_m: float, stands_m: float) -> None:
    """A polygon of 100 m steps is as good as the curve; a parabola leaves a hundredth of a step of 1 to 2.5 km."""
    height = np.arange(-400e3, 95e3, 100.0)
    profile = 1.0 + 0.03 * np.exp(-np.maximum(height - stands_m, 0.0) / SCALE_HEIGHT_M)
    profile = 5.0 * (profile - 1.0) / 0.03
    found, left = edge_height(height, profile[None], pixel_m, 0.7, SCALE_HEIGHT_M)
    assert found[0] == pytest.approx(stands_m, abs=40.0)
    assert left[0] < 1e-3


def test_heights_of_the_bands_are_those_of_their_light() -> None:
    """Carbon dioxide shines from 40 km; of 14 to 16.3 um the half height is at 41 to 43 km, an edge starts below it."""
    places = np.full(3, 20e3), np.radians([-60.0, 0.0, 60.0]), np.full(3, 7.0)
    co2 = _heights("thermal", CO2_UM).at(*places)
    assert ((co2.mean_m > 32e3) & (co2.mean_m < 40e3)).all()
    assert (np.hypot.reduce(co2.patterns_m) < 3e3).all()
    day, dusk = (_heights("solar", VISIBLE_UM).at(*(np.array([x]) for x in (9e3, z, 1.6))) for z in (0.5, 1.62))
    assert 10e3 < day.mean_m[0] < 17e3
    # Three degrees beyond the horizon the Earth's shadow reaches 9 km.
    assert dusk.mean_m[0] > day.mean_m[0] + 5e3


def _arc(span_rad: float = 1.6, count: int = 33) -> tuple[ArcPlaces, FloatArray]:
    """Places along an arc whose middle lies towards +x, nadir towards +z."""
    azimuth = np.linspace(-0.5 * span_rad, 0.5 * span_rad, count)
    out = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)])
    nadir = np.array([0.0, 0.0, 1.0])
    los = np.cos(RHO) * nadir + np.sin(RHO) * out
    up = np.cos(RHO) * out - np.sin(RHO) * nadir
    return ArcPlaces(los, up, np.eye(3), np.full(count, 10e3)), azimuth


def _known(sun: FloatArray | None) -> UnevenLimb:
    return UnevenLimb(_heights("solar", VISIBLE_UM), sun, np.radians(0.5), month=None, thermal=False)


def test_a_limb_rises_towards_the_terminator_and_is_least_known_there() -> None:
    places, azimuth = _arc()
    # The Sun towards +y: at the arc's one end it stands high, at the other beyond the horizon.
    height, covariance = _known(np.array([0.0, 1.0, 0.0])).along(places, azimuth)
    assert height.mean() == pytest.approx(0.0, abs=1e-6)
    assert height[0] > height[-1] + 3e3
    assert np.linalg.eigvalsh(covariance).min() > -1e-6 * np.trace(covariance)
    assert covariance[0, 0] > covariance[-1, -1]


def test_a_thermal_place_that_is_not_known_leaves_more_open() -> None:
    places, azimuth = _arc()
    # Pole towards +y: the arc lies across the equator, where the air is the same all year.
    places = replace(places, cam_from_itrs=np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]))
    thermal = UnevenLimb(_heights("thermal", CO2_UM), None, 0.0, month=7.0, thermal=True, typical_m=36e3)
    known, unknown = (replace(thermal, month=month).along(places, azimuth) for month in (7.0, None))
    assert np.trace(unknown[1]) > 1.2 * np.trace(known[1])
    assert known[0] == pytest.approx(unknown[0], abs=6e3)


class _Bow(LimbHeights):
    """A limb that is known to stand higher to both sides, to 50 m of the bow."""

    def __init__(self, bow_m: float, sigma_m: float) -> None:
        self.bow_m, self.sigma_m = bow_m, sigma_m

    def along(self, places: ArcPlaces, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
        side = np.cross([0.0, 0.0, 1.0], SOFT.nadir)
        bow = (places.los_cam @ side / np.linalg.norm(side) / np.sin(RHO)) ** 2
        return self.bow_m * bow, self.sigma_m**2 * np.outer(bow, bow)


def _camera() -> CameraModel:
    return CameraModel(SOFT.width, SOFT.height, SOFT.focal_px, SOFT.focal_px, 79.5, 59.5)


def _fitted(image: FloatArray, uneven: LimbHeights | None) -> LimbFit:
    planet, mean, information = sphere_knowledge(SOFT.nadir, RADIUS_M, SOFT.altitude_m, 0.0)
    knowledge = LimbKnowledge(planet, mean, information, scale_height_m=SCALE_HEIGHT_M, scale_sigma_m=10.0)
    return fit_limb(image, _camera(), mean, replace(knowledge, uneven=uneven))


def _error_and_claim(fit: LimbFit) -> tuple[float, float]:
    claimed = fit.by_nadir @ fit.covariance @ fit.by_nadir.T
    return float(np.linalg.norm(fit.pose.nadir_cam - SOFT.nadir)), float(np.sqrt(np.trace(claimed)))


def test_a_height_that_is_known_along_the_limb_takes_the_error_of_it_away() -> None:
    image = noisy(picture(replace(SOFT, bow_m=20e3)), np.random.default_rng(4))
    ignorant, _ = _error_and_claim(_fitted(image, None))
    error, claim = _error_and_claim(_fitted(image, _Bow(20e3, 50.0)))
    assert error < 4.0 * claim
    assert error < 0.3 * ignorant
    # Known to no more than itself it is solved for.
    doubtful, claimed = _error_and_claim(_fitted(image, _Bow(0.0, 20e3)))
    assert doubtful < 4.0 * claimed
    assert doubtful < 0.3 * ignorant
    assert claimed > claim


def test_sectors_that_scatter_beyond_noise_make_the_claim_larger() -> None:
    """Every other stretch of limb stands a fifth of a pixel higher: no tilt does that, and no noise."""
    clean = picture(SOFT)
    even = _error_and_claim(_fitted(noisy(clean, np.random.default_rng(1)), None))[1]
    ragged = clean.copy()
    for first in range(0, SOFT.width, 40):
        moved = 0.8 * clean[:-1, first : first + 20] + 0.2 * clean[1:, first : first + 20]
        ragged[:-1, first : first + 20] = moved
    fit = _fitted(noisy(ragged, np.random.default_rng(1)), None)
    assert _error_and_claim(fit)[1] > 2.0 * even
    # It is no noise of the detector.
    by_nadir = fit.by_nadir
    systematic = np.trace(by_nadir @ fit.relief_covariance @ by_nadir.T)
    assert systematic > 0.5 * np.trace(by_nadir @ fit.covariance @ by_nadir.T)


def test_uneven_ground_is_not_averaged_as_noise_is() -> None:
    """Clouds of three pixels and a third of the ground's light: pixels that are bright together weigh as one.

    Eight draws of two unknowns: the mean square over the claim has a standard error of a third. It is 0.4, and 2.8
    where every pixel weighs for itself.
    """
    rng = np.random.default_rng(8)
    clean = picture(replace(SOFT, space=0.0))
    even = _error_and_claim(_fitted(noisy(clean, rng), None))[1]
    ratios = []
    for _ in range(8):
        clouds = gaussian_filter(rng.normal(size=clean.shape), 3.0)
        bright = 1.0 + 0.3 * np.clip(clouds / clouds.std(), -2.0, 2.0)
        error, claim = _error_and_claim(_fitted(noisy(clean * bright, rng), None))
        assert claim > 3.0 * even
        ratios.append((error / claim) ** 2)
    assert np.mean(ratios) < 1.5


def test_a_space_of_one_level_is_not_known_for_sure() -> None:
    """Whole levels of a dark sky have no noise, and would outweigh the limb by as much as one likes."""
    rng = np.random.default_rng(3)
    x = np.tile(np.linspace(-12.0, 8.0, 81), 24)
    edge = edge_profile(x, 0.8).level
    values = np.rint(10.0 + 100.0 * edge + rng.normal(0.0, 2.0, len(x)) * (edge > 0.01))
    basis, places = light_basis(edge, x, np.zeros_like(x)), np.array([np.repeat(np.arange(24.0), 81), x + 12.0])
    noise, _ = light_noise(basis, places, values, np.ones(len(x)), 1, rounding_variance(values))
    assert noise.parts[1] == pytest.approx(4.0, rel=0.2)
    assert (1.0 / noise.variance).max() < 1.3e3 / noise.parts[1]


def test_a_limb_that_is_all_saturated_is_refused() -> None:
    image = np.minimum(picture(replace(SOFT, earth=900.0)), 255.0)
    observation = Observation(
        image, _camera(), np.array([0.0, 0.0, 0.0, 1.0]), full_scale=255.0, band_kind="solar", band_um=VISIBLE_UM
    )
    result = guarded(limb_sphere.ESTIMATOR).run(observation)
    assert isinstance(result, Refusal)
    assert "saturated" in result.reason


POLE = np.array([0.0, 0.0, 1.0])


def places(count: int, seed: int) -> np.ndarray:
    up = np.random.default_rng(seed).standard_normal((count, 3))
    return np.asarray(up / np.linalg.norm(up, axis=1, keepdims=True))


def test_the_closed_form_is_that_of_whole_matrices() -> None:
    """Equation 1 of Paciorek and Schervish (2006) with determinants and inverses by numpy, north by the meridian."""
    up = places(12, 2)
    lengths = np.random.default_rng(3).uniform(0.1, 1.2, (12, 1, 2))
    latitude, longitude = np.arcsin(up[:, 2]), np.arctan2(up[:, 1], up[:, 0])
    north = np.column_stack(
        [-np.sin(latitude) * np.cos(longitude), -np.sin(latitude) * np.sin(longitude), np.cos(latitude)]
    )
    found = correlations(lengths, up, POLE)[0]
    kernel = [
        east**2 * np.eye(3) + (along**2 - east**2) * np.outer(n, n)
        for n, (along, east) in zip(north, lengths[:, 0], strict=True)
    ]
    for i in range(12):
        for j in range(12):
            middle, d = 0.5 * (kernel[i] + kernel[j]), up[i] - up[j]
            size = (np.linalg.det(kernel[i]) * np.linalg.det(kernel[j])) ** 0.25 / np.linalg.det(middle) ** 0.5
            assert found[i, j] == pytest.approx(size * np.exp(-0.5 * d @ np.linalg.solve(middle, d)), rel=1e-10)


def test_it_is_a_covariance_over_a_pole_and_wherever_lengths_change() -> None:
    latitude = np.radians(np.linspace(40.0, 140.0, 51))
    up = np.column_stack([np.cos(latitude), np.zeros(51), np.sin(latitude)])
    lengths = np.random.default_rng(4).uniform(0.05, 1.5, (51, 3, 2))
    found = correlations(lengths, up, POLE)
    assert np.linalg.eigvalsh(found).min() > -1e-12
    np.testing.assert_allclose(np.einsum("kii->ki", found), 1.0, rtol=1e-12)


def test_lengths_along_a_line_are_those_of_its_direction() -> None:
    up = np.array([[1.0, 0.0, 0.0]] * 3)
    level = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.0, np.sqrt(0.5), np.sqrt(0.5)]])
    lengths = np.broadcast_to([0.2, 0.5], (3, 1, 2))
    slanted = (0.5 * (0.2**-2 + 0.5**-2)) ** -0.5
    np.testing.assert_allclose(lengths_along(lengths, up, level, POLE)[:, 0], [0.2, 0.5, slanted], rtol=1e-12)
