"""Inputs that a flight produces and no model has: none is claimed falsely, and clean ones keep their answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime

import cv2
import numpy as np
import pytest
from drawn_limbs import CAMERA, RADIUS_M, picture, table, view
from limb_image import Sphere, noisy
from limb_image import picture as sphere_picture
from scipy.ndimage import gaussian_filter, shift, uniform_filter
from scipy.spatial.transform import Rotation

from horizonval.core.outcome import Refusal
from horizonval.estimation.fit import known_profile
from horizonval.estimation.fit.guard import pulled, without_lost_lines
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.limb.foreign import without_foreign_light
from horizonval.estimation.methods import limb_profile, limb_sphere
from horizonval.estimation.observation import Fit, Lens, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.rotation import tangent_basis

Change = Callable[[np.ndarray, np.ndarray], np.ndarray]
EPOCH = datetime(2026, 1, 16, 12, tzinfo=UTC)
FALSE_SIGMAS, FALSE_RAD = 3.5, np.radians(0.05)


def is_false(found: Fit | Refusal, nadir: np.ndarray, least_rad: float = FALSE_RAD) -> bool:
    """Whether an answer is beyond 3.5 of its sigmas and an error that anybody would mind."""
    if isinstance(found, Refusal):
        return False
    basis = tangent_basis(nadir)
    off = basis.T @ (found.nadir_cam - nadir)
    squares = off @ np.linalg.solve(basis.T @ found.total_covariance_nadir_cam @ basis, off)
    return bool(np.linalg.norm(off) > least_rad and squares > FALSE_SIGMAS**2)


def disc(radius_px: float, out_px: float, at: float = 0.5, level: float = 1800.0) -> Change:
    """A bright disc whose rim is so far outside the limb, at a share of its length."""

    def change(image: np.ndarray, outside_px: np.ndarray) -> np.ndarray:
        centres = np.argwhere(np.abs(outside_px - out_px - radius_px) < 0.5)
        centres = centres[np.argsort(centres[:, 1])]
        row, column = centres[int(at * (len(centres) - 1))]
        v, u = np.indices(image.shape)
        return np.where(np.hypot(u - column, v - row) < radius_px, level, image)

    return change


def hidden_rows(image: np.ndarray, outside_px: np.ndarray) -> np.ndarray:
    image = image.copy()
    image[np.random.default_rng(0).choice(len(image), 20, replace=False)] = 0.0
    return image


QUICK: dict[str, Change] = {
    "clean": lambda image, _: image,
    "motion 5 px": lambda image, _: uniform_filter(image, (5, 1)),
    "twice": lambda image, _: 0.5 * (image + shift(image, (3.0, 0.0), order=1, mode="nearest")),
    "disc": disc(4.8, 8.0),
    "torn": lambda image, _: np.concatenate([image[:60], np.roll(image[60:], 3, axis=1)]),
    "interlaced": lambda image, _: np.where(np.arange(len(image))[:, None] % 2, np.roll(image, 2, axis=1), image),
    "upside down": lambda image, _: image[::-1, ::-1],
}
MANY: dict[str, Change] = {
    **{f"motion {n} px": (lambda image, _, n=n: uniform_filter(image, (n, 1))) for n in (3, 7, 9)},
    **{f"blur {s} px": (lambda image, _, s=s: gaussian_filter(image, s)) for s in (1.0, 2.5)},
    **{f"disc {r} + {d}": disc(r, d, at) for r in (3.0, 8.0) for d in (4.0, 8.0) for at in (0.3, 0.7)},
    "two discs": lambda image, x: disc(4.0, 6.0, 0.2)(disc(4.0, 9.0, 0.8)(image, x), x),
    "dim disc": disc(5.0, 5.0, level=500.0),
    "rows": hidden_rows,
    "hot": lambda image, _: np.where(np.random.default_rng(0).random(image.shape) < 0.02, 4095.0, image),
}


def profile_seen(seed: int, monkeypatch: pytest.MonkeyPatch) -> tuple[Observation, np.ndarray, np.ndarray]:
    """A drawn limb with its prior, its nadir, and how far pixels lie outside the limb."""
    air = table(modes=True)
    monkeypatch.setattr(known_profile, "shipped_templates", lambda *_: air)
    r, cam, rng = view(seed)
    prior = Prior(
        shape="sphere",
        radius_m=RADIUS_M,
        r_itrs=r + rng.normal(0.0, 1e3, 3),
        position_sigma_m=1e3,
        q_cam_from_itrs=(
            Rotation.from_rotvec(rng.normal(size=3) * np.radians(1.0)) * Rotation.from_matrix(cam)
        ).as_quat(),
        attitude_sigma_rad=np.radians([1.0, 1.0, 1.0]),
        epoch_utc=EPOCH,
    )
    nadir = -cam @ r / np.linalg.norm(r)
    angle = np.arccos(unproject(CAMERA, pixel_grid(CAMERA)) @ nadir) - np.arcsin(RADIUS_M / np.linalg.norm(r))
    outside_px = angle / np.hypot(*np.gradient(angle))
    seen = Observation(
        picture(cam, r, rng, modes=True),
        CAMERA,
        full_scale=4095.0,
        prior=prior,
        band_kind="thermal",
        band_um=(14.0, 16.3),
        lens=Lens(blur_px=0.6),
    )
    return seen, nadir, outside_px


def _tried(seed: int, cases: dict[str, Change], monkeypatch: pytest.MonkeyPatch) -> dict[str, Fit | Refusal]:
    seen, nadir, outside_px = profile_seen(seed, monkeypatch)
    method = limb_profile.ESTIMATOR
    found = {}
    for name, change in cases.items():
        image = np.clip(np.rint(change(seen.image, outside_px)), 0.0, 4095.0)
        found[name] = method.run(replace(seen, image=image))
        assert not is_false(found[name], nadir), (seed, name)
    return found


def test_a_disturbed_limb_is_refused_or_claimed_as_wide_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    found = _tried(3, QUICK, monkeypatch)
    assert isinstance(found["clean"], Fit), found["clean"]
    assert isinstance(found["disc"], Fit), found["disc"]
    for name, word in (("motion 5 px", "blurred"), ("interlaced", "jumps")):
        refusal = found[name]
        assert isinstance(refusal, Refusal), name
        assert word in refusal.reason, refusal


def test_a_prior_that_the_image_contradicts_widens_the_claim_or_refuses_it() -> None:
    """Each number is a standard deviation of its own prior; the image leaves a share of the height's variance."""
    information = np.diag([1e4, 1e4, 1e4, 1e-6, 1e-6, 1e-6, 1e-4])
    mean = LimbPose(np.eye(3), np.array([0.0, 0.0, -7e6]), 0.0)

    def told(departure: float, left: float) -> Refusal | np.ndarray:
        """What the departure of the height by so many sigmas does, if so much of its variance is left."""
        covariance = np.linalg.inv(information)
        covariance[5, 5] *= left
        pose = replace(mean, r_itrs=mean.r_itrs + np.array([0.0, 0.0, 1e3 * departure]))
        return pulled(pose, covariance, mean, information, np.zeros((0, 2)))

    assert not np.any(told(0.5, 0.9))
    widened = told(3.0, 0.9)
    assert isinstance(widened, np.ndarray)
    # The image alone has the height 3 / (1 - 0.9) sigma from the prior's.
    assert np.sqrt(widened[5, 5]) == pytest.approx(0.9 * 30.0 * 1e3)
    assert isinstance(told(30.0, 0.01), Refusal)


def test_lost_lines_are_left_out_and_black_space_is_not() -> None:
    rng = np.random.default_rng(0)
    image = np.zeros((60, 80))
    image[30:] = rng.normal(100.0, 3.0, (30, 80))
    assert without_lost_lines(image) is image
    for lines, lost in (((slice(40, 43),), 3 * 80), ((slice(None), 7), 60)):
        changed = image.copy()
        changed[lines] = 4095.0
        missing = np.isnan(without_lost_lines(changed))
        assert missing[lines].all()
        assert missing.sum() == lost
    image[50:52] = image[49]
    assert np.isnan(without_lost_lines(image)).sum() == 2 * 80


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 4])
def test_many_disturbances(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    _tried(seed, MANY, monkeypatch)


def test_light_at_one_end_of_the_limb_hides_that_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Light all round is left to the fit, which claims nothing false."""
    seen, nadir, outside_px = profile_seen(3, monkeypatch)
    rho, top = np.arcsin(RADIUS_M / (RADIUS_M + 600e3)), np.radians(2.0)
    assert without_foreign_light(seen.image, CAMERA, nadir, rho, top) is seen.image
    one = without_foreign_light(disc(4.0, 9.0, 0.1)(seen.image, outside_px), CAMERA, nadir, rho, top)
    assert 0.02 < np.isnan(one).mean() < 0.4
    cover = np.where((outside_px > 7.0) & (outside_px < 20.0), 1000.0, seen.image)
    assert without_foreign_light(cover, CAMERA, nadir, rho, top) is cover
    assert not is_false(limb_profile.run(replace(seen, image=cover)), nadir)


def lit_disc(radius_px: float, phase_rad: float, size: int, fine: int = 3) -> np.ndarray:
    """A Lambert sphere about the image's middle, the Sun above and to the right, eight bits."""
    middle = (np.arange(size * fine) + 0.5) / fine - 0.5 * size
    x, y = middle[None, :] / radius_px, middle[:, None] / radius_px
    z = np.sqrt(np.clip(1.0 - x * x - y * y, 0.0, None))
    sun = np.array([0.8 * np.sin(phase_rad), -0.6 * np.sin(phase_rad), np.cos(phase_rad)])
    light = np.clip(x * sun[0] + y * sun[1] + z * sun[2], 0.0, None) * (x * x + y * y < 1.0)
    means = light.reshape(size, fine, size, fine).mean(axis=(1, 3))
    return gaussian_filter(means, 0.8)


@pytest.mark.parametrize("black", [False, True], ids=["1 DN of noise", "black JPEG sky"])
@pytest.mark.parametrize("phase_deg", [0.0, 5.0, 10.0, 15.0])
def test_the_unlit_sliver_of_a_far_disc_is_in_the_claim(phase_deg: float, black: bool) -> None:
    """The circle's middle is off towards the Sun; a claim of a tenth of a pixel would be false."""
    size, focal = 181, 16000.0
    image = 180.0 * lit_disc(70.0, np.radians(phase_deg), size)
    if black:
        image = cv2.imdecode(cv2.imencode(".jpg", np.rint(image).astype(np.uint8))[1], 0).astype(float)
    else:
        image = np.clip(np.rint(2.0 + image + np.random.default_rng(1).normal(size=image.shape)), 0.0, 255.0)
    middle = 0.5 * (size - 1)
    seen = Observation(
        image, CameraModel(size, size, focal, focal, middle, middle), full_scale=255.0, band_kind="solar"
    )
    fit = limb_sphere.ESTIMATOR.run(seen)
    assert isinstance(fit, Fit), fit
    assert not is_false(fit, np.array([0.0, 0.0, 1.0]), 0.1 / focal)
    assert np.linalg.norm(fit.nadir_cam[:2]) * focal < 2.0


def test_a_low_camera_is_answered_where_its_altitude_is_known() -> None:
    """33 km up the Earth is a disc of 84.2 deg, which no orbit shows."""
    sphere = Sphere(160, 120, 130.0, (0.0, np.sin(np.radians(82.0)), np.cos(np.radians(82.0))), 33e3)
    camera = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
    image = noisy(sphere_picture(sphere), np.random.default_rng(0), 1.0)
    seen = Observation(image, camera, full_scale=255.0, band_kind="solar", band_um=(0.45, 0.7))
    refusal = limb_sphere.ESTIMATOR.run(seen)
    assert isinstance(refusal, Refusal)
    assert "no orbit's horizon" in refusal.reason
    known = replace(seen, prior=Prior(shape="sphere", altitude_m=33e3, altitude_sigma_m=1e3))
    fit = limb_sphere.ESTIMATOR.run(known)
    assert isinstance(fit, Fit), fit
    assert not is_false(fit, sphere.nadir)
    assert np.linalg.norm(fit.nadir_cam - sphere.nadir) < np.radians(2.0)
