"""Cameras that turn, pixels that lag, offsets that drift: against simulations that step through time.

The scenes are functions of direction; nothing is rendered. A camera whose axes turn at omega looks at the time t along
``exp(t [omega]x) d`` of the axes that it had at t = 0.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import constants, integrate
from scipy.spatial.transform import Rotation

from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.sensor import motion
from horizonval.sensor.detector import thermal
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec

PINHOLE = CameraModel(96, 72, 90.0, 90.0, 47.5, 35.5, distortion=(-0.12, 0.02, 0.001, -0.001, 0.0))
FISHEYE = CameraModel(96, 96, 30.0, 30.0, 47.5, 47.5, projection="fisheye")
RATE = np.radians([2.0, -5.0, 9.0])


def limb(d: np.ndarray) -> np.ndarray:
    """A limb 0.06 rad soft round an axis 50 deg off the boresight, and a bright spot 0.05 rad wide beside it."""
    nadir = np.array([0.0, math.sin(math.radians(50)), math.cos(math.radians(50))])
    spot = np.array([-0.25, -0.2, 1.0]) / math.sqrt(1.1025)
    angle = np.arccos(np.clip(d @ nadir, -1, 1))
    away = np.arccos(np.clip(d @ spot, -1, 1))
    return 1 / (1 + np.exp((angle - 0.9) / 0.06)) + 2 * np.exp(-0.5 * (away / 0.05) ** 2)


def stepped(
    camera: CameraModel, rate: np.ndarray, exposure_s: float, row_time_s: float, steps: int = 120
) -> np.ndarray:
    """Mean over the exposure of what every row sees, instant by instant."""
    d = unproject(camera, pixel_grid(camera))
    out = np.zeros((camera.height, camera.width))
    for row in range(camera.height):
        middle = (row - (camera.height - 1) / 2) * row_time_s
        for step in range(steps):
            t = middle + ((step + 0.5) / steps - 0.5) * exposure_s
            out[row] += limb(Rotation.from_rotvec(rate * t).apply(d[row]))
    return out / steps


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE], ids=["distorted pinhole", "fisheye"])
@pytest.mark.parametrize(("exposure_s", "row_time_s"), [(0.05, 0.0), (0.4, 0.0), (1e-3, 0.01), (0.3, 0.005)])
def test_motion_and_rolling_shutter_against_steps_in_time(camera, exposure_s, row_time_s):
    """10.5 deg/s: up to 7 px of blur and 12 px of slant. Bilinear sampling of the softest pixel: 1/8 of its curvature.

    The fisheye's spot has a width of 1.5 px and a height of 2: 1/8 * 2 / 1.5^2 = 0.11 at its peak alone.
    """
    still = limb(unproject(camera, pixel_grid(camera)))
    ours = motion.blur_by_motion(still, camera, RATE, exposure_s, row_time_s)
    exact = stepped(camera, RATE, exposure_s, row_time_s)
    # where pixels look into the still image at all times, its border being a guess
    inner = (slice(14, -14), slice(14, -14))
    error, change = (ours - exact)[inner], (still - exact)[inner]
    assert np.abs(error).max() < 0.12
    assert np.sqrt((error**2).mean()) < 0.012
    assert np.abs(error).mean() < 0.1 * np.abs(change).mean() + 1e-3


def test_slant_of_an_upright_edge():
    """A camera turning right at 10 deg/s: row by row the edge moves left by f omega row_time; to 0.02 px of 10."""
    camera = CameraModel(200, 101, 400.0, 400.0, 99.5, 50.0)
    still = 1 / (1 + np.exp(-(np.arange(200) - 99.5) / 2.0)) * np.ones((101, 1))
    moved = motion.blur_by_motion(still, camera, np.array([0.0, math.radians(10.0), 0.0]), 1e-6, 1.5e-3)
    edge = 200 - moved.sum(axis=1)
    slope = np.polyfit(np.arange(101), edge, 1)[0]
    assert slope == pytest.approx(-400 * math.radians(10.0) * 1.5e-3, rel=3e-3)
    assert edge[50] == pytest.approx(200 - still[50].sum(), abs=1e-9)


def test_a_long_blur_has_no_dots():
    """The Sun's disc, 3 px, drawn over 100 px: a line as even as a line can be, of the same light."""
    camera = CameraModel(220, 21, 2000.0, 2000.0, 109.5, 10.0)
    y, x = np.mgrid[0:21, 0:220]
    still = np.where((x - 110) ** 2 + (y - 10) ** 2 <= 2, 1e9, 1.0)
    drawn = motion.blur_by_motion(still, camera, np.array([0.0, 0.05, 0.0]), 1.0)
    middle = drawn[10, 70:150]
    assert middle.std() / middle.mean() < 0.02
    assert drawn.sum() == pytest.approx(still.sum(), rel=2e-3)


@pytest.mark.parametrize("drag_px", [0.5, 3.0, 8.0, 25.0])
def test_the_time_constant_against_the_equation_of_a_warming_pixel(drag_px):
    """dS / dt = (L(t) - S) / tau for a hot edge, 0.7 px soft, that passes while the camera turns."""
    camera = CameraModel(161, 3, 160.0, 160.0, 80.0, 1.0)
    tau = 0.012
    omega = drag_px / 160.0 / tau

    def edge(angle: Any) -> Any:
        return 0.5 * (1 + np.tanh(angle * 160.0 / 1.4))

    still = edge(
        np.arctan2(unproject(camera, pixel_grid(camera))[..., 0], unproject(camera, pixel_grid(camera))[..., 2])
    )
    ours = thermal.lag_by_time_constant(still, camera, np.array([0.0, omega, 0.0]), tau)[1]
    for column in (70, 78, 80, 82, 90, 100):
        azimuth = math.atan2(column - 80.0, 160.0)
        crossing = -azimuth / omega
        start = -25 * tau
        solved = integrate.solve_ivp(
            lambda t, s, a=azimuth: (edge(a + omega * t) - s) / tau,
            (start, 0.0),
            [float(edge(azimuth + omega * start))],
            rtol=1e-8,
            atol=1e-10,
            max_step=0.2 / 160 / omega,
            dense_output=False,
        )
        # bilinear pixels of an edge as steep as that: 1 %; an edge outside the image is not known
        if crossing > -2.0 * tau or drag_px < 8:
            assert ours[column] == pytest.approx(solved.y[0, -1], abs=0.015)


def planck(wavelength_m: float, kelvin: float) -> float:
    x = constants.h * constants.c / (wavelength_m * constants.k * kelvin)
    return 2 * constants.h * constants.c**2 / wavelength_m**5 / math.expm1(x)


def band_radiance(kelvin: float) -> float:
    return integrate.quad(planck, 8e-6, 14e-6, args=(kelvin,))[0]


THERMAL: dict[str, Any] = {
    "camera": {"name": "bench", "width": 160, "height": 120, "fov_deg": 0.1},
    "optics": {"f_number": 1.2, "transmission": 0.9},
    "band": [{"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0}],
    "detector": {"kind": "microbolometer", "pixel_pitch_um": 12.0, "netd_k": 0.05, "bits": 16},
}


def temporal_netd(make_frame: Any, tables: dict[str, Any]) -> float:
    """As in the laboratory: pairs of images of a 300 K body, over the response between 298 and 302 K."""
    spec = CameraSpec.model_validate(tables)

    def view(kelvin: float, seed: int) -> np.ndarray:
        return observe(make_frame(band_radiance(kelvin), tables), spec, seed=seed).dn.astype(float)

    per_kelvin = (view(302.0, 1).mean() - view(298.0, 1).mean()) / 4
    pairs = [(view(300.0, 2 * i) - view(300.0, 2 * i + 1)).std() / math.sqrt(2) for i in range(1, 4)]
    return float(np.mean(pairs) / per_kelvin)


@pytest.mark.parametrize(
    ("detector", "netd_k"),
    [
        ({"kind": "microbolometer", "netd_k": 0.05}, 0.05 * 1.2**2 / 0.9),
        ({"kind": "microbolometer", "netd_k": 0.05, "netd_f_number": 1.4}, 0.05 * (1.2 / 1.4) ** 2 / 0.9),
        ({"kind": "microbolometer", "netd_k": 0.05, "responsivity_rms": 0.03, "time_constant_s": 0.01}, 0.08),
        ({"kind": "thermopile", "netd_k": 0.11}, 0.11),
        ({"kind": "linear", "netd_k": 0.07}, 0.07 * 1.2**2 / 0.9),
        ({"kind": "linear", "netd_k": 0.07, "sensing": "pyroelectric"}, 0.07 * math.sqrt(2) * 1.2**2 / 0.9),
    ],
)
def test_netd_of_every_kind(make_frame, detector, netd_k):
    """Three pairs of 19 200 pixels: 0.3 %; the bar is 3 %."""
    tables = THERMAL | {"detector": {"pixel_pitch_um": 12.0, "bits": 16} | detector}
    assert temporal_netd(make_frame, tables) == pytest.approx(netd_k, rel=0.03)


def test_netd_of_a_detectivity(make_frame):
    """NEP = sqrt(A B) / D*; the pixel's power per kelvin is pi tau A / (4 N^2) dL/dT (on the axis)."""
    d_star, bandwidth, pitch_cm = 5e8, 30.0, 50e-4
    tables = THERMAL | {"camera": THERMAL["camera"] | {"width": 640, "height": 1}}
    tables["detector"] = {"kind": "linear", "pixel_pitch_um": 50.0, "bits": 16, "bandwidth_hz": bandwidth}
    tables["detector"] |= {"d_star_cm_rthz_per_w": d_star}
    nep_w = math.sqrt(pitch_cm**2 * bandwidth) / d_star
    per_kelvin = (band_radiance(300.5) - band_radiance(299.5)) * math.pi * 0.9 * (pitch_cm * 1e-2) ** 2 / (4 * 1.2**2)
    # 3 pairs of 640: 1.6 %
    assert temporal_netd(make_frame, tables) == pytest.approx(nep_w / per_kelvin, rel=0.06)


def test_drift_since_the_shutter(make_frame):
    """1000 small images, each after its own 10 minutes: the mean wanders by 0.2 K, each pixel by 0.05 K beside it."""
    detector = THERMAL["detector"] | {"netd_k": 1e-3, "minutes_since_correction": 10.0, "residue_k": 0.03}
    detector |= {"drift_k_per_min": 0.02, "drift_pattern_k_per_min": 0.005}
    tables = THERMAL | {"detector": detector, "camera": THERMAL["camera"] | {"width": 16, "height": 12}}
    spec = CameraSpec.model_validate(tables)
    frame = make_frame(band_radiance(300.0), tables)
    images = np.stack([observe(frame, spec, seed=s).dn for s in range(1000)]).astype(float)
    settings = observe(frame, spec, seed=0).observation
    kelvin = images * settings["radiance_per_dn"] + settings["radiance_at_zero"] - band_radiance(300.0)
    kelvin /= (band_radiance(300.5) - band_radiance(299.5)) * 1.0
    means = kelvin.mean(axis=(1, 2))
    # 1000 draws: 2.2 % standard error, times five
    assert means.std(ddof=1) == pytest.approx(0.2, rel=0.11)
    assert abs(means.mean()) < 4 * 0.2 / math.sqrt(1000)
    pattern = (kelvin - means[:, None, None]).std() * math.sqrt(192 / 191)
    assert pattern == pytest.approx(math.hypot(0.05, 0.03), rel=0.02)


def test_microbolometer_scale_is_that_of_black_bodies(make_frame):
    tables = {
        "camera": {"name": "bench", "width": 16, "height": 12, "fov_deg": 0.1},
        "band": [{"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0}],
        "detector": {"kind": "microbolometer", "pixel_pitch_um": 12.0, "netd_k": 0.05, "bits": 14},
    }
    tables["detector"] |= {"scene_min_k": 200.0, "scene_max_k": 320.0}  # type: ignore[operator]
    spec = CameraSpec.model_validate(tables)
    low, high = band_radiance(200.0), band_radiance(320.0)
    for temperature in (200.0, 233.0, 300.0, 320.0):
        dn = observe(make_frame(band_radiance(temperature), tables), spec, noise=False).dn
        expected = (band_radiance(temperature) - low) / (high - low) * (2**14 - 1)
        np.testing.assert_allclose(dn, expected, atol=0.51)
    assert (observe(make_frame(0.0, tables), spec).dn == 0).all()
