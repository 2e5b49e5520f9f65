"""The limb in several heads at once, on pictures made without the package, against the bound of their information."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from limb_image import RADIUS_M, Sphere, noisy, picture
from scipy.spatial.transform import Rotation

from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import SOLAR_RELIEF
from horizonval.estimation.fit.heights import SUN_SIGMA_RAD, ArcPlaces, UnevenLimb, band_heights
from horizonval.estimation.methods.limb_heads import run
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.ellipsoid import sphere
from horizonval.scoring.information import limb_information
from horizonval.sensor.expected_image import ExpectedImage

ALTITUDE_M = 500e3
SCALE_HEIGHT_M = Prior().limb_scale_height_m
ARCSEC = math.radians(1.0 / 3600.0)
LEVELS = {"a": (200.0, 20.0), "b": (150.0, 30.0), "c": (220.0, 25.0), "d": (180.0, 15.0)}
"""Every head has an Earth and a space of its own."""


def _mounts(count: int) -> list[Rotation]:
    """Heads that look 62 deg from the body's z axis, evenly round it, their rows across the limb."""
    return [
        Rotation.from_euler("y", 62.0, degrees=True) * Rotation.from_euler("z", -360.0 * k / count, degrees=True)
        for k in range(count)
    ]


def _heads(nadir_body: np.ndarray, width: int, height: int, fov_deg: float, count: int) -> dict[str, Sphere]:
    focal = width / 2 / math.tan(math.radians(fov_deg / 2))
    heads = {}
    for name, mount in zip(LEVELS, _mounts(count)[:count], strict=False):
        nadir = mount.apply(nadir_body)
        earth, space = LEVELS[name]
        heads[name] = Sphere(width, height, focal, tuple(nadir), ALTITUDE_M, earth=earth, space=space)
    return heads


def _camera(one: Sphere) -> CameraModel:
    return CameraModel(one.width, one.height, one.focal_px, one.focal_px, (one.width - 1) / 2, (one.height - 1) / 2)


def _observation(images: dict[str, np.ndarray], heads: dict[str, Sphere], prior: Prior, count: int) -> Observation:
    seen = {
        name: Observation(
            image=images[name],
            camera=_camera(one),
            q_cam_from_body=mount.as_quat(),
            full_scale=255.0,
            prior=prior,
            band_kind="solar",
        )
        for (name, one), mount in zip(heads.items(), _mounts(count), strict=False)
    }
    return replace(next(iter(seen.values())), heads=seen)


def _bounds_rad(heads: dict[str, Sphere], nadir_body: np.ndarray, count: int) -> tuple[float, float]:
    """Return the bound of the nadir by noise and by knowledge, altitude free, the limb for the sphere itself."""
    total = None
    for one, mount in zip(heads.values(), _mounts(count), strict=False):
        mean = picture(one)
        expected = ExpectedImage(
            mean, np.full(mean.shape, 2.55**2 + 1 / 12), np.ones(mean.shape, bool), 0.0, np.ones(mean.shape)
        )
        body_from_cam = mount.inv().as_matrix()
        found = limb_information(
            expected,
            _camera(one),
            mount.as_matrix(),
            -(RADIUS_M + ALTITUDE_M) * nadir_body,
            sphere(RADIUS_M),
            SOLAR_RELIEF,
            body_from_cam=body_from_cam,
        )
        assert found is not None
        total = found if total is None else total + found
    assert total is not None
    first = np.cross(nadir_body, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    unknowns = np.zeros((12, 3))
    unknowns[:3, 0], unknowns[:3, 1], unknowns[3:6, 2] = first, np.cross(nadir_body, first), -nadir_body * 7e6
    noise, known = (
        math.sqrt(np.trace(np.linalg.inv(unknowns.T @ matrix @ unknowns)[:2, :2]))
        for matrix in (total.by_noise, total.by_knowledge)
    )
    return noise, known


@pytest.mark.parametrize(
    ("width", "height", "fov_deg", "count", "draws"),
    # A pair of cameras a half turn apart sees both tilts; four rows see a crossing each.
    [(160, 120, 57.0, 2, 12), (160, 1, 24.0, 4, 40)],
    ids=["two cameras", "four linear arrays"],
)
def test_heads_together_reach_the_bound_of_all_their_pixels(width, height, fov_deg, count, draws):
    rng = np.random.default_rng(11)
    prior = Prior(shape="sphere", radius_m=RADIUS_M)
    errors, claims = [], []
    tilt = rng.uniform(-0.02, 0.02, 2)
    nadir_body = np.array([tilt[0], tilt[1], 1.0]) / math.hypot(1.0, *tilt)
    heads = _heads(nadir_body, width, height, fov_deg, count)
    clean = {name: picture(one) for name, one in heads.items()}
    for _ in range(draws):
        images = {name: noisy(one, rng) for name, one in clean.items()}
        fit = run(_observation(images, heads, prior, count))
        assert isinstance(fit, Fit), fit
        truth = next(iter(heads.values())).nadir
        errors.append(float(np.linalg.norm(np.cross(fit.nadir_cam, truth))))
        claims.append(math.sqrt(np.trace(fit.total_covariance_nadir_cam)))
        roll_pitch = np.hypot(fit.roll_rad, fit.pitch_rad)
        assert roll_pitch == pytest.approx(math.hypot(*tilt), abs=0.01)
    noise, known = _bounds_rad(heads, nadir_body, count)
    rms = float(np.sqrt(np.mean(np.square(errors))))
    # The true limb has no relief: errors lie between what the noise allows and what the relief would.
    assert 0.7 * noise < rms < 1.15 * max(known, 1.3 * noise)
    # The claim holds the relief, as the bound by knowledge does; that has a gain along the limb beside.
    assert float(np.median(claims)) == pytest.approx(known, rel=0.35)


def test_two_heads_know_more_than_one_of_them():
    """Of two arcs on opposite sides the altitude is no tilt any more: ten times better than one arc, altitude free."""
    nadir = np.array([0.0, 0.0, 1.0])
    both = _bounds_rad(_heads(nadir, 160, 120, 57.0, 2), nadir, 2)[0]
    # 56 arcsec: the figure of one arc of 160 x 120 px at 57 deg.
    assert both < 0.2 * 56.0 * ARCSEC


BAND_UM = (0.45, 0.75)


def _height_m(one: Sphere, mount: Rotation, nadir_body: np.ndarray, sun_body: np.ndarray) -> float:
    """Return the height that the shipped profiles give the middle of a head's limb."""
    ahead = mount.inv().apply([0.0, 0.0, 1.0])
    level = ahead - (ahead @ nadir_body) * nadir_body
    level /= np.linalg.norm(level)
    rho = math.asin(RADIUS_M / (RADIUS_M + ALTITUDE_M))
    los = math.cos(rho) * nadir_body + math.sin(rho) * level
    up = math.cos(rho) * level - math.sin(rho) * nadir_body
    heights = band_heights("solar", BAND_UM, SCALE_HEIGHT_M)
    assert heights is not None
    pixel_m = math.sqrt((RADIUS_M + ALTITUDE_M) ** 2 - RADIUS_M**2) / one.focal_px
    places = ArcPlaces(mount.apply([los]), mount.apply([up]), mount.as_matrix(), np.array([pixel_m]))
    known = UnevenLimb(heights, mount.apply(sun_body), SUN_SIGMA_RAD, month=None, thermal=False, typical_m=0.0)
    return float(known.along(places, np.zeros(1))[0][0])


def test_limbs_that_stand_unlike_under_one_sun_are_no_tilt():
    """The Sun is high over one limb and low over the other, which stands 3.6 km higher for that: a tilt of 146 arcsec.

    Drawn at the heights that the shipped profiles give, which is all that the fit may know. With the Sun in the axes of
    the first head for both, and heights from the middle of either arc, all of the tilt was erred.
    """
    nadir_body = np.array([0.0, 0.0, 1.0])
    heads, mounts = _heads(nadir_body, 160, 120, 57.0, 2), _mounts(2)
    first = mounts[0].inv().apply([0.0, 0.0, 1.0])
    first -= (first @ nadir_body) * nadir_body
    sun_body = math.cos(math.radians(62.0)) * -nadir_body + math.sin(math.radians(62.0)) * first / np.linalg.norm(first)
    raised = [_height_m(one, mount, nadir_body, sun_body) for one, mount in zip(heads.values(), mounts, strict=True)]
    tilt = 0.5 * abs(raised[0] - raised[1]) / math.sqrt((RADIUS_M + ALTITUDE_M) ** 2 - RADIUS_M**2)
    assert tilt > 60.0 * ARCSEC
    distance = RADIUS_M + ALTITUDE_M
    seen = {
        name: replace(one, altitude_m=distance * RADIUS_M / (RADIUS_M + height) - RADIUS_M)
        for (name, one), height in zip(heads.items(), raised, strict=True)
    }
    prior = Prior(shape="sphere", radius_m=RADIUS_M)
    rng = np.random.default_rng(5)
    together = _observation({name: noisy(picture(one), rng) for name, one in seen.items()}, seen, prior, 2)
    of_heads = {
        name: replace(one, band_um=BAND_UM, sun_cam=mount.apply(sun_body))
        for (name, one), mount in zip(together.heads.items(), mounts, strict=True)
    }
    fit = run(replace(together, band_um=BAND_UM, sun_cam=mounts[0].apply(sun_body), heads=of_heads))
    assert isinstance(fit, Fit), fit
    off = float(np.linalg.norm(np.cross(fit.nadir_cam, seen["a"].nadir)))
    assert off < 0.35 * tilt


def test_a_head_without_limb_is_named():
    nadir = np.array([0.0, 0.0, 1.0])
    heads = _heads(nadir, 160, 1, 24.0, 4)
    images = {name: picture(one) for name, one in heads.items()}
    images["c"] = np.full((1, 160), 20.0) + np.random.default_rng(1).normal(0.0, 1.0, (1, 160))
    refused = run(_observation(images, heads, Prior(), 4))
    assert isinstance(refused, Refusal)
    assert "head c" in refused.reason


def test_one_head_is_too_few():
    nadir = np.array([0.0, 0.0, 1.0])
    heads = dict(list(_heads(nadir, 160, 120, 57.0, 2).items())[:1])
    refused = run(_observation({"a": picture(heads["a"])}, heads, Prior(), 2))
    assert isinstance(refused, Refusal)
    assert refused.status is Outcome.BAD_INPUT


def test_a_row_that_is_not_its_cameras_is_refused() -> None:
    camera = CameraModel(width=256, height=1, fx=400.0, fy=400.0, cx=127.5, cy=0.0)
    row = np.full((1, 200), 10.0)
    row[0, 100:] = 200.0
    turns = [Rotation.from_euler("z", 90.0 * k, degrees=True).as_quat() for k in range(4)]
    heads = {str(k): Observation(image=row, camera=camera, q_cam_from_body=q) for k, q in enumerate(turns)}
    found = run(Observation(image=row, camera=camera, heads=heads))
    assert isinstance(found, Refusal)
    assert found.status is Outcome.BAD_INPUT
    assert "200 x 1" in found.reason
