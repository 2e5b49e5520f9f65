"""The guard on constructed scenes: what it must refuse, what it must let through, and what its fits claim.

The pictures are formulas: a limb is an error function of the angle to the nadir, 0.8 px wide, so that sampling at the
pixels' centres is exact for any position.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.guard.guard import guarded
from horizonval.estimation.guard.limits import sunlit_heights
from horizonval.estimation.methods import altitude_free, altitude_free_published
from horizonval.estimation.observation import Calibration, Estimator, Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle, tangent_basis
from horizonval.scoring.summary import noise_nees

SIZE = 160
CAMERA = CameraModel(width=SIZE, height=SIZE, fx=140.0, fy=140.0, cx=(SIZE - 1) / 2, cy=(SIZE - 1) / 2)
PX = 1.0 / CAMERA.fx
RHO = math.radians(60.0)
GUARDED = guarded(altitude_free.ESTIMATOR)
BRIGHT, DARK, FULL = 600.0, 40.0, 1023.0


def nadir_at(off_deg: float = 62.0, turn_deg: float = 12.0) -> np.ndarray:
    off, turn = math.radians(off_deg), math.radians(turn_deg)
    return np.array([math.sin(off) * math.sin(turn), math.sin(off) * math.cos(turn), math.cos(off)])


def picture(nadir: np.ndarray, camera: CameraModel = CAMERA, seed: int | None = 0, noise: float = 6.0) -> np.ndarray:
    los = unproject(camera, pixel_grid(camera))
    image = DARK + (BRIGHT - DARK) * ndtr((RHO - off_axis_angle(los, nadir)) / (0.8 * PX))
    if seed is not None:
        image = image + np.random.default_rng(seed).normal(0.0, noise, image.shape)
    return image


def observe(image: np.ndarray, **changes) -> Observation:
    values = {"full_scale": FULL, "prior": Prior(shape="sphere"), "band_kind": "solar"}
    return Observation(image=np.clip(image, 0.0, FULL), camera=CAMERA, **(values | changes))


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return math.degrees(float(np.linalg.norm(np.cross(a, b))))


def test_a_good_limb_passes_and_says_what_the_model_leaves_out():
    nadir = nadir_at()
    fit = GUARDED.run(observe(picture(nadir)))
    assert isinstance(fit, Fit)
    assert GUARDED.name == "guarded-altitude-free"
    # Noise of 1 % of the step moves single points by 0.02 px and the nadir of 140 of them by hundredths of a degree.
    assert angle_deg(fit.nadir_cam, nadir) < 0.05
    assert fit.systematic_nadir_cam.shape == (3, 3)
    assert fit.systematic_nadir_cam @ fit.nadir_cam == pytest.approx(np.zeros(3), abs=1e-7)
    assert np.trace(fit.total_covariance_nadir_cam) > np.trace(fit.covariance_nadir_cam)
    # An ellipsoid is known less well than a sphere.
    oblate = GUARDED.run(observe(picture(nadir), prior=Prior()))
    assert np.trace(oblate.systematic_nadir_cam) > np.trace(fit.systematic_nadir_cam)


def test_what_the_lens_leaves_open_is_claimed_and_refused_beyond_what_a_claim_needs():
    """Two pixels of the principal point are 0.82 deg on the axis and half of it at the nadir; a claim needs 0.2 deg."""
    exact, good, bad = (
        GUARDED.run(observe(picture(nadir_at()), calibration=Calibration(principal_point_sigma_px=px)))
        for px in (0.0, 0.2, 2.0)
    )
    assert isinstance(exact, Fit)
    assert isinstance(good, Fit)
    added = np.linalg.eigvalsh(good.total_covariance_nadir_cam - exact.total_covariance_nadir_cam)
    assert 0.5 < math.sqrt(added[-1]) / (0.2 * PX) < 1.5
    assert isinstance(bad, Refusal)
    assert "determines the nadir to" in bad.reason


def test_noise_alone_has_an_honest_covariance():
    """Mean normalised error squared of 40 draws about their mean: 2 within the factor of two of the bar.

    80 degrees of freedom: by chance the mean of an honest one leaves 1 to 4 once in ten million times on the high side
    and in a thousand on the low one. Noise of 3 % of the step: it outweighs the scatter that whole pixels make without
    any noise.
    """
    nadir = nadir_at()
    fits = [GUARDED.run(observe(picture(nadir, seed=seed, noise=18.0))) for seed in range(40)]
    assert all(isinstance(fit, Fit) for fit in fits)
    assert 1.0 < noise_nees(fits).mean() < 4.0


def test_a_pattern_that_every_exposure_repeats_is_no_noise_but_is_claimed():
    """Waves of 0.1 px along the limb outweigh noise of 1 % of the step; draws about their mean do not see them.

    40 degrees of freedom: an honest mean leaves 1 to 4 once in ten thousand times.
    """
    nadir = nadir_at()
    los = unproject(CAMERA, pixel_grid(CAMERA))
    across = los @ tangent_basis(nadir)
    waves = 0.1 * PX * np.sin(100.0 * np.arctan2(across[..., 1], across[..., 0]))
    image = DARK + (BRIGHT - DARK) * ndtr((RHO + waves - off_axis_angle(los, nadir)) / (0.8 * PX))
    seen = [observe(image + np.random.default_rng(seed).normal(0.0, 6.0, image.shape)) for seed in range(20)]
    fits = [GUARDED.run(one) for one in seen]
    assert all(isinstance(fit, Fit) for fit in fits)
    assert 1.0 < noise_nees(fits).mean() < 4.0
    assert np.trace(fits[0].covariance_nadir_cam) < 0.3 * np.trace(fits[0].total_covariance_nadir_cam)


def test_a_saturated_ground_is_refused():
    """The picture of a limb whose bright side is clipped at full scale shows where the clipping is."""
    image = DARK + (picture(nadir_at(), seed=None) - DARK) * 3.0
    result = GUARDED.run(observe(image + np.random.default_rng(0).normal(0, 6, image.shape)))
    assert isinstance(result, Refusal)
    assert result.status is Outcome.SATURATED


def test_a_clipped_part_of_the_limb_is_left_out():
    """The left half of the ground is three times as bright and clipped: points of the right half alone are used."""
    image = picture(nadir_at(70.0, 0.0), seed=None)
    left = np.arange(SIZE) < 60
    image[:, left] = DARK + (image[:, left] - DARK) * 3.0
    points = GUARDED.run(observe(image + np.random.default_rng(0).normal(0, 6, image.shape))).points
    assert len(points) > 40
    assert points[:, 0].min() > 52


def test_a_limb_under_a_low_sun_is_refused_where_the_sun_is_known():
    nadir = nadir_at()
    up = -nadir
    overhead = GUARDED.run(observe(picture(nadir), sun_cam=up))
    assert isinstance(overhead, Fit)
    # From the satellite's zenith angle z the tangent points have z less up to 30 deg, the Earth's part of the view.
    across = np.cross(nadir, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    low = GUARDED.run(observe(picture(nadir), sun_cam=across * math.sin(2.0) + up * math.cos(2.0)))
    assert isinstance(low, Refusal)
    assert low.status is Outcome.DARK
    # Heat does not come from the Sun.
    thermal = observe(picture(nadir), sun_cam=across * math.sin(2.0) + up * math.cos(2.0), band_kind="thermal")
    assert "points" not in getattr(GUARDED.run(thermal), "reason", "")


def test_a_short_arc_is_refused():
    """Twenty degrees of a sphere's limb, exact to hundredths of a pixel: the air's relief alone forbids a claim."""
    nadir = nadir_at()
    image = picture(nadir)
    image[:, :100] = DARK + np.random.default_rng(3).normal(0, 6, (SIZE, 100))
    result = GUARDED.run(observe(image))
    assert isinstance(result, Refusal)


def test_a_disc_of_half_a_degree_is_not_the_earth():
    tele = replace(CAMERA, fx=8000.0, fy=8000.0)
    los = unproject(tele, pixel_grid(tele))
    moon = np.array([0.0, 0.0, 1.0])
    image = DARK + 500.0 * ndtr((math.radians(0.26) - off_axis_angle(los, moon)) * 8000.0 / 0.8)
    image = image + np.random.default_rng(0).normal(0, 6, image.shape)
    assert isinstance(altitude_free.ESTIMATOR.run(replace(observe(image), camera=tele)), Fit)
    result = GUARDED.run(replace(observe(image), camera=tele))
    assert isinstance(result, Refusal)
    assert "not the Earth" in result.reason


def test_a_known_altitude_that_does_not_fit_is_refused():
    altitude = 6371008.8 / math.sin(RHO) - 6371008.8
    known = Prior(shape="sphere", altitude_m=altitude, altitude_sigma_m=1e3)
    assert isinstance(GUARDED.run(observe(picture(nadir_at()), prior=known)), Fit)
    too_high = replace(known, altitude_m=altitude + 400e3)
    wrong = GUARDED.run(observe(picture(nadir_at()), prior=too_high))
    assert isinstance(wrong, Refusal)
    assert wrong.status is Outcome.AMBIGUOUS
    # Who knows his altitude to 100 km is not contradicted by 400 km: five sigma are asked for.
    doubtful = replace(too_high, altitude_sigma_m=100e3)
    assert isinstance(GUARDED.run(observe(picture(nadir_at()), prior=doubtful)), Fit)


def liar(off_deg: float) -> Estimator:
    def run(observation: Observation) -> Fit | Refusal:
        fit = altitude_free.ESTIMATOR.run(observation)
        assert isinstance(fit, Fit)
        turn = Rotation.from_rotvec([math.radians(off_deg), 0.0, 0.0])
        nadir = turn.apply(fit.nadir_cam)
        claimed = math.radians(0.05) ** 2 * (np.eye(3) - np.outer(nadir, nadir))
        return replace(fit, nadir_cam=nadir, covariance_nadir_cam=claimed, systematic_nadir_cam=None)

    return Estimator(name="liar", title="off", run=run)


def test_an_answer_far_from_the_limb_is_refused_and_a_near_one_is_not():
    """Of a method that takes no points; in a solar band without a Sun this limb would determine the nadir too badly."""
    seen = observe(picture(nadir_at()), band_kind=None)
    assert isinstance(guarded(liar(0.0)).run(seen), Fit)
    result = guarded(liar(3.0)).run(seen)
    assert isinstance(result, Refusal)
    assert result.status in (Outcome.AMBIGUOUS, Outcome.NO_LIMB)


def test_one_that_is_given_the_pose_is_not_touched():
    oracle = Estimator(name="oracle", title="", run=lambda _: Refusal(Outcome.NO_LIMB, ""), needs="pose")
    assert guarded(oracle).run is oracle.run


def raised_picture(nadir: np.ndarray, sun: np.ndarray, camera: CameraModel) -> np.ndarray:
    """A limb that stands where the table of sunlit limbs says."""
    los = unproject(camera, pixel_grid(camera)).reshape(-1, 3)
    height, _ = sunlit_heights(los, nadir, RHO, Observation(np.zeros((SIZE, SIZE)), camera, sun_cam=sun))
    edge = RHO + height * math.tan(RHO) / 6371008.8
    level = ndtr((edge - off_axis_angle(los, nadir)) / (0.8 * PX)).reshape(camera.height, camera.width)
    return DARK + (BRIGHT - DARK) * level + np.random.default_rng(1).normal(0.0, 6.0, level.shape)


def test_a_known_sun_takes_the_bow_of_the_limb_away():
    """The Sun is 75 deg from the zenith of the middle of the arc, at its right end 90: ten kilometres of bow."""
    nadir = nadir_at()
    los = np.array([0.0, math.sin(math.radians(2.0)), math.cos(math.radians(2.0))])
    up = los * (los @ nadir) - nadir
    up /= np.linalg.norm(up)
    side = np.cross(up, los)
    sun = math.cos(1.35) * up + math.sin(1.35) * (0.5 * los / np.linalg.norm(los) + 0.87 * side)
    sun /= np.linalg.norm(sun)
    image = raised_picture(nadir, sun, CAMERA)
    lowered = GUARDED.run(observe(image, sun_cam=sun))
    as_seen = GUARDED.run(observe(image))
    assert isinstance(lowered, Fit)
    # A tenth of a degree is what half a kilometre of bow makes of this arc; the coarse grid of the table leaves that.
    assert angle_deg(lowered.nadir_cam, nadir) < 0.12
    cone = fit_cone(unproject(CAMERA, as_seen.points)).axis_cam
    assert angle_deg(cone, nadir) > 2.0 * angle_deg(lowered.nadir_cam, nadir)


def test_spots_between_clipped_ground_are_not_used():
    nadir = nadir_at(70.0, 0.0)
    image = picture(nadir, seed=None)
    spots = np.arange(SIZE) % 40 < 28
    image[:, spots] = DARK + (image[:, spots] - DARK) * 3.0
    result = GUARDED.run(observe(image + np.random.default_rng(0).normal(0, 6, image.shape)))
    assert isinstance(result, Refusal)


def test_the_published_method_answers_on_the_points_that_are_trusted():
    nadir = nadir_at()
    fit = guarded(altitude_free_published.ESTIMATOR).run(observe(picture(nadir)))
    assert isinstance(fit, Fit)
    assert angle_deg(fit.nadir_cam, nadir) < 0.05
