"""The learned estimator finds a limb like those that it learned from, and says nothing of anything else."""

from __future__ import annotations

import importlib
import itertools
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.frames import compose
from horizonval.geometry.horizon import signed_limb_angle
from horizonval.geometry.rotation import angle_between, tangent_basis

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "examples" / "learned"))

from horizonval_learned import first_cone, fit, network, patch  # noqa: E402
from horizonval_learned.plugin import ESTIMATOR  # noqa: E402

CAMERA = CameraModel(160, 120, 56.0, 56.0, 79.5, 59.5)
R_ITRS = 6900e3 * np.array([0.6, 0.48, 0.64])
FULL_SCALE = 16383.0
"""All as of the suite `learning`."""


def camera_from_itrs(roll_deg: float = 55.0, yaw_deg: float = 40.0) -> np.ndarray:
    """An attitude that looks at the limb."""
    down = -R_ITRS / np.linalg.norm(R_ITRS)
    level = Rotation.from_matrix(np.column_stack([tangent_basis(down), down]).T).as_quat()
    return compose(Rotation.from_euler("zx", [yaw_deg, roll_deg], degrees=True).as_quat(), level)


def limb_image(q_cam_from_itrs: np.ndarray, camera: CameraModel = CAMERA, height_deg: float = 0.1) -> np.ndarray:
    """A warm Earth whose light fades over some tenths of a degree of height, behind a lens that darkens."""
    light = np.zeros((camera.height, camera.width))
    for across, down in itertools.product((-0.25, 0.25), repeat=2):
        rays = unproject(camera, pixel_grid(camera) + np.array([across, down]))
        inside = signed_limb_angle(Rotation.from_quat(q_cam_from_itrs).inv().apply(rays.reshape(-1, 3)), R_ITRS, WGS84)
        above = np.degrees(-inside).reshape(light.shape)
        light += 0.25 * 3500.0 / (1.0 + np.exp((above - height_deg) / 0.2)) * rays[..., 2] ** 4
    return gaussian_filter(light, 0.6) + np.random.default_rng(3).normal(0.0, 2.0, light.shape)


def seen(image: np.ndarray, **known: object) -> hv.Observation:
    fields = {"camera": CAMERA, "full_scale": FULL_SCALE, "band_kind": "thermal"} | known
    return hv.Observation(image=image, **fields)  # type: ignore[arg-type]


def placed(q_cam_from_itrs: np.ndarray) -> hv.Prior:
    sigma = np.full(3, np.radians(2.0))
    place = {"r_itrs": R_ITRS, "position_sigma_m": 1e3}
    return hv.Prior(shape="wgs84", q_cam_from_itrs=q_cam_from_itrs, attitude_sigma_rad=sigma, **place)  # type: ignore[arg-type]


def nadir_of(q_cam_from_itrs: np.ndarray) -> np.ndarray:
    return np.asarray(Rotation.from_quat(q_cam_from_itrs).apply(-R_ITRS / np.linalg.norm(R_ITRS)))


def test_the_start_is_within_a_third_of_a_pixel():
    # A pixel is 1 deg here; the Earth's flattening alone is 0.15 deg.
    q = camera_from_itrs()
    start = first_cone.first_cone(seen(limb_image(q)))
    assert isinstance(start, tuple), start
    assert np.degrees(angle_between(start[0], nadir_of(q))) < 0.33


def test_a_patch_has_the_limb_where_it_is():
    """Profiles about the true horizon fall at the height of the light, at every azimuth, in either lens."""
    q = camera_from_itrs()
    for camera in (CAMERA, CameraModel(320, 240, 90.0, 90.0, 150.0, 125.0, (-0.02, 0.0, 0.0, 0.0, 0.0))):
        observation = seen(limb_image(q, camera), camera=camera, prior=placed(q))
        horizon = patch.horizon_rad(observation, nadir_of(q))
        assert horizon is not None
        profiles = patch.Sampler(observation).patch(nadir_of(q), horizon)
        assert len(profiles.azimuth_rad) > 60
        assert np.allclose(profiles.profiles[:, :5].mean(axis=1), 1.0)
        half = [np.interp(-0.5, -profile, np.degrees(patch.OFFSETS_RAD)) for profile in profiles.profiles]
        # The lens darkens the Earth's side of a profile, by which its half level is elsewhere.
        assert np.abs(np.median(half) - 0.1) < 0.15
        assert np.std(half) < 0.15


def test_rows_give_back_a_tilt_and_say_how_surely():
    azimuth = np.radians(np.arange(-60.0, 61.0))
    truth = np.array([2e-3, -1e-3, 4e-3, 0.0, 0.0])
    offset = truth[0] * np.cos(azimuth) + truth[1] * np.sin(azimuth) + truth[2]
    sigma = 1e-3
    model = fit.Model(spread=1.0, tilt_km=1e-6, shape_km=1e-6, height_km=1e6)
    rows = fit.rows_of(azimuth)
    equations = rows.T @ rows / sigma**2, rows.T @ offset / sigma**2
    unknowns, covariance = fit.solve(*equations, model, 2600.0, np.inf)
    assert np.allclose(unknowns, truth, atol=1e-8)
    # Three unknowns of a straight fit.
    straight = rows[:, :3]
    assert np.allclose(covariance[:3, :3], sigma**2 * np.linalg.inv(straight.T @ straight), rtol=1e-6)
    known = fit.solve(*equations, fit.Model(1.0, 1e-6, 1e-6, 1e-6), 2600.0, 0.0)[1]
    # A known radius leaves less of the tilt towards the arc open.
    assert known[0, 0] < 0.1 * covariance[0, 0]


@pytest.fixture(scope="module")
def image():
    """A frame of the kind that was learned from, of a place that was not."""
    camera = hv.Camera.from_file("ir-bolometer-160-57deg").changed(camera={"fov_deg": 110.0})
    known = {"position_sigma_km": 1.0, "attitude_sigma_deg": [2.0, 2.0, 2.0]}
    place = {"altitude_km": 550.0, "latitude_deg": 40.0, "yaw_deg": 30.0, "mount_roll_deg": 55.0}
    scene = hv.Scene(camera, **place, render={"subsamples": 2, "nodes": 64}, prior=known)
    return hv.render(scene).observe(seed=1)


def test_a_limb_is_found(image):
    # With the place a fortieth of a pixel, without it the flattening, 0.15 deg, more.
    placed = hv.score(hv.estimate(image, ESTIMATOR), image)
    assert placed.nadir_error_deg < 0.1
    assert placed.nees_nadir < 20.0
    alone = hv.score(hv.estimate(image, ESTIMATOR, prior=hv.Prior()), image)
    assert alone.nadir_error_deg < 0.4
    assert alone.nees_nadir < 20.0
    assert alone.sigma_nadir_arcsec > 2.0 * placed.sigma_nadir_arcsec


def test_it_is_found_in_a_turned_camera(image):
    """Nothing hangs on which side of the image the sky is."""
    upright = hv.estimate(image, ESTIMATOR, prior=hv.Prior())
    turned = ESTIMATOR.run(seen(image.dn[::-1, ::-1].astype(float)))
    assert isinstance(upright, hv.Fit)
    assert isinstance(turned, hv.Fit)
    # The detector's noise is the same, the azimuths of the profiles are not.
    assert np.degrees(angle_between(turned.nadir_cam * [-1.0, -1.0, 1.0], upright.nadir_cam)) < 0.02


def test_a_limb_at_another_height_is_refused_where_the_place_is_known(image):
    # 40 km of altitude are 0.9 deg of the Earth's radius.
    known = hv.estimate(image, ESTIMATOR)
    assert known
    prior = {"shape": "wgs84", "position_sigma_m": 1e3, "attitude_sigma_rad": np.full(3, 0.03)}
    truth = image.truth
    wrong = hv.Prior(
        r_itrs=np.array(truth.r_itrs) * (1.0 + 40.0 / 6900.0), q_cam_from_itrs=truth.q_cam_from_itrs, **prior
    )
    result = hv.estimate(image, ESTIMATOR, prior=wrong)
    assert isinstance(result, hv.Refusal)
    assert "stands" in result.reason


def test_profiles_that_contradict_each_other_are_refused():
    # Light that fades over less than air does, undersampled: every profile is fine, together they make no horizon.
    q = camera_from_itrs(60.0)
    coarse = limb_image(q)
    coarse[:, 1::2] = np.roll(coarse, 2, axis=0)[:, 1::2]
    for known in (placed(q), hv.Prior()):
        assert isinstance(ESTIMATOR.run(seen(coarse, prior=known)), hv.Refusal)


def test_the_same_image_gives_the_same_bytes(image):
    first, second = hv.estimate(image, ESTIMATOR), hv.estimate(image, ESTIMATOR)
    assert isinstance(first, hv.Fit)
    assert isinstance(second, hv.Fit)
    assert first.nadir_cam.tobytes() == second.nadir_cam.tobytes()
    assert first.covariance_nadir_cam.tobytes() == second.covariance_nadir_cam.tobytes()


def noise(sigma: float = 2.0) -> np.ndarray:
    return np.random.default_rng(5).normal(0.0, sigma, (120, 160))


def falloff() -> np.ndarray:
    return np.asarray(unproject(CAMERA, pixel_grid(CAMERA))[..., 2] ** 4)


def sun() -> np.ndarray:
    image = noise()
    image[40:44, 70:74] = FULL_SCALE
    return gaussian_filter(image, 1.0)


NOTHING = {
    "black": lambda: np.zeros((120, 160)),
    "space": noise,
    "ground": lambda: 2500.0 * falloff() + noise(),
    "ground with patches": lambda: (2500.0 + 400.0 * gaussian_filter(noise(10.0), 8.0)) * falloff() + noise(),
    "the Sun": sun,
    "a hard edge": lambda: 2500.0 * (np.arange(120)[:, None] > 60) * np.ones((120, 160)) + noise(),
    "not a number": lambda: np.full((120, 160), np.nan),
    "of two pixels": lambda: np.array([[0.0, 1.0]]),
}


@pytest.mark.parametrize("name", NOTHING)
def test_what_is_no_limb_is_refused(name):
    image = NOTHING[name]()
    camera = CameraModel(image.shape[1], image.shape[0], 56.0, 56.0, image.shape[1] / 2, image.shape[0] / 2)
    for known in (hv.Prior(), placed(camera_from_itrs())):
        result = ESTIMATOR.run(seen(image, camera=camera, prior=known))
        assert isinstance(result, hv.Refusal), result
        assert result.reason


def test_a_limb_of_another_shape_is_refused():
    """A dark Earth in front of a bright sky, and a limb with a bright rim: neither is in the training."""
    q = camera_from_itrs()
    image = limb_image(q)
    rim = 0.3 * image + 4e3 * np.maximum(gaussian_filter(image, 1.0) - gaussian_filter(image, 4.0), 0.0) / 500.0
    for other in (image.max() - image, rim):
        result = ESTIMATOR.run(seen(other, prior=placed(q)))
        assert isinstance(result, hv.Refusal), result


def test_visible_bands_are_refused():
    result = ESTIMATOR.run(seen(limb_image(camera_from_itrs()), band_kind="solar"))
    assert isinstance(result, hv.Refusal)
    assert result.status is hv.Outcome.BAD_INPUT


def test_the_page_is_that_of_its_numbers():
    page = importlib.import_module("horizonval_learned.page")
    folder = ROOT / "results" / "learned"
    digest = json.loads((folder / "learned.json").read_text(encoding="utf-8"))
    assert (folder / "README.md").read_text(encoding="utf-8") == page.page(digest)
    made = network.load().made
    assert digest["made"] == made
    assert digest["dataset"]["sha256"] == made["digest"]
