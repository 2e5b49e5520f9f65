"""The bound of rendered frames, against the renderer's own derivatives; and that it is kept with the image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval.api.derivatives import level_axes
from horizonval.frame import RadianceFrame
from horizonval.scoring.bound import bound_of
from horizonval.scoring.information import carried, information_of, informed, limb_motion
from horizonval.sensor.expected_image import expected_image
from horizonval.sensor.observe import observe
from horizonval.store.exr import read_image, write_image

SCENE = {
    "scene": {"name": "bound"},
    "platform": {
        "epoch_utc": "2026-03-20T12:00:00Z",
        "altitude_km": 500.0,
        "latitude_deg": 10.0,
        "longitude_deg": 5.0,
        "heading_deg": 350.0,
    },
    "atmosphere": {"profile": "us_standard"},
    "camera": {"file": "ir-bolometer-160-57deg", "mount_roll_deg": 62.0},
}
POSE = ("rotation_x", "rotation_y", "rotation_z", "east", "north", "up", "limb_height")


@pytest.fixture(scope="module")
def frame() -> hv.Frame:
    return hv.render(hv.Scene.from_dict(SCENE), progress=False)


@pytest.fixture(scope="module")
def by_the_renderer(frame) -> np.ndarray:
    """Return the information (7, 7) that derivatives of the radiance give, brought through lens and detector."""
    spec, truth = frame.camera.spec, frame.truth
    band = spec.band[0].name
    slopes = frame.derivatives(parameters=POSE, progress=False)
    radiance = frame.radiance[band].astype(np.float64)
    rows = []
    for name in POSE:
        slope = slopes.images[name][band].astype(np.float64)
        step = 1e-3 * radiance.max() / np.abs(slope).max()

        def seen(change: np.ndarray, step: float = step) -> np.ndarray:
            changed = {band: radiance + step * np.maximum(change, 0.0)}
            return expected_image(RadianceFrame(changed, frame.maps, truth), spec).mean

        # Two images of positive changes: radiance is never below zero, and all that follows is linear.
        rows.append((seen(slope) - seen(-slope)) / step)
    expected = expected_image(frame, spec)
    u, v = np.meshgrid(np.arange(160.0), np.arange(120.0))
    motion = limb_motion(
        truth.camera_model,
        np.stack([u, v], axis=-1).reshape(-1, 2),
        Rotation.from_quat(truth.q_cam_from_itrs).as_matrix(),
        np.array(truth.r_itrs),
        truth.ellipsoid.axes_m,
    )
    near = motion.distance_px < 12.0
    jacobian = np.array(rows).reshape(7, -1)[:, near] / np.sqrt(expected.variance.ravel()[near])
    axes = np.zeros((7, 7))
    axes[:3, :3] = Rotation.from_quat(truth.q_cam_from_body).inv().as_matrix()
    axes[3:6, 3:6] = level_axes(np.array(truth.r_itrs), truth.ellipsoid).T
    axes[6, 6] = 1.0
    return np.asarray(axes @ jacobian @ jacobian.T @ axes.T)


@pytest.mark.slow
@pytest.mark.parametrize(
    "prior",
    [{}, {"altitude_sigma_km": 1.0}, {"position_sigma_km": 1.0, "attitude_sigma_deg": [2.0, 2.0, 2.0]}],
    ids=["nothing", "altitude", "place"],
)
def test_the_bound_by_noise_is_that_of_the_renderers_derivatives(frame, by_the_renderer, prior):
    """Pixels of 16 km sample the limb coarsely, and what a spline makes of them is right to some per cent."""
    found = information_of(frame, frame.camera.spec)
    truth = replace(frame.truth, scene={**frame.truth.scene, "prior": prior})
    band = frame.camera.spec.band[0].name
    # The renderer's unknowns are without the planet's shape, which is known here.
    mine, reference = (
        bound_of(replace(found, by_noise=matrix), truth, band).noise_rad
        for matrix in (found.by_noise, np.pad(by_the_renderer, (0, 5)))
    )
    assert mine == pytest.approx(reference, rel=0.04)


def test_an_image_keeps_its_bound_in_its_file(frame, tmp_path):
    image = informed(frame.observe(seed=3), frame)
    write_image(tmp_path / "image.exr", image)
    back = read_image(tmp_path / "image.exr")
    found, kept = carried(image), carried(back)
    band = image.band
    assert bound_of(kept, back.truth, band) == bound_of(found, image.truth, band)
    assert np.array_equal(back.dn, frame.observe(seed=3).dn)
    assert carried(frame.observe(seed=3)) is None


@pytest.mark.parametrize("camera", ["ir-bolometer-160-57deg-full", "vis-cmos-512-60deg"])
def test_draws_of_an_image_have_its_mean_and_variance(frame, camera):
    """48 draws of other seeds: the mean of 4 800 pixels to 5 % of the noise, their variance to 3 %.

    The pattern of unlike pixels is the same in all draws, and part of the variance: it is added by hand. A drift that
    all pixels have in common is a level of space, which no bound takes for known: it is taken out.
    """
    spec = hv.Camera.from_file(camera).spec
    band = spec.band[0].name
    small = spec.model_copy(
        update={"camera": spec.camera.model_copy(update={"width": 80, "height": 60, "cx": None, "cy": None})}
    )
    truth = replace(frame.truth, camera=small.model_dump(mode="json"))
    levels = np.linspace(0.1, 1.0, 80)[None, :] * np.ones((60, 1))
    brightest = {"ir-bolometer-160-57deg-full": 20.0, "vis-cmos-512-60deg": 4.0}[camera]
    even = RadianceFrame({band: (brightest * levels).astype(np.float32)}, {}, truth)
    expected = expected_image(even, small)
    draws = np.array([observe(even, small, seed=seed).dn.astype(np.float64) for seed in range(48)])
    drift = np.median(draws - expected.mean, axis=(1, 2), keepdims=True) if camera.startswith("ir") else 0.0
    draws = draws - drift
    used = expected.reads & (expected.mean > 3.0 * np.sqrt(expected.variance))
    assert used.mean() > 0.5
    scatter = draws.var(axis=0, ddof=1)[used].mean()
    pattern = ((draws.mean(axis=0) - expected.mean)[used] ** 2).mean() - scatter / 48
    assert scatter + pattern == pytest.approx(expected.variance[used].mean(), rel=0.05)
    offset = (draws.mean(axis=0) - expected.mean)[used].mean()
    assert abs(offset) < 0.05 * np.sqrt(expected.variance[used].mean()) + 0.05
