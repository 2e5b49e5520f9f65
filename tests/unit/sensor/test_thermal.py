"""Thermal detectors: noise, offsets and time constant against their formulas."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import constants

from horizonval.geometry.camera import CameraModel
from horizonval.sensor.detector import thermal
from horizonval.sensor.observe import observe
from horizonval.sensor.streams import stream
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Microbolometer

BAND = Band(name="lwir", kind="thermal", lo_um=8.0, hi_um=14.0)


def tables(detector: dict[str, Any], *, f_number: float = 1.0, size: tuple[int, int] = (160, 120)) -> dict[str, Any]:
    return {
        "camera": {"name": "bench", "width": size[0], "height": size[1], "fov_deg": 0.1},
        "optics": {"f_number": f_number, "transmission": 0.8},
        "band": [{"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0}],
        "detector": {"pixel_pitch_um": 12.0, "bits": 16, "scene_min_k": 200.0, "scene_max_k": 360.0} | detector,
    }


@pytest.fixture
def kelvin(make_frame):
    """Observe a uniform scene; return what the numbers stand for, as temperature differences of a 300 K scene."""

    def run(
        scene_k: float, detector: dict[str, Any], *, seed: int = 0, noise: bool = True, **camera: Any
    ) -> np.ndarray:
        made = tables(detector, **camera)
        frame = make_frame(thermal.blackbody_radiance(BAND, scene_k), made)
        image = observe(frame, CameraSpec.model_validate(made), seed=seed, noise=noise)
        note = image.observation
        radiance = note["radiance_at_zero"] + image.dn.astype(float) * note["radiance_per_dn"]
        return (radiance - thermal.blackbody_radiance(BAND, 300.0)) / thermal.radiance_per_kelvin(BAND)

    return run


@pytest.mark.parametrize(
    ("detector", "netd_k"),
    [
        ({"kind": "microbolometer", "netd_k": 0.05}, 0.05 * 1.4**2 / 0.8),
        ({"kind": "microbolometer", "netd_k": 0.05, "netd_f_number": 1.4}, 0.05 / 0.8),
        # the data sheet's figure is the module's, whatever the lens
        ({"kind": "thermopile", "netd_k": 0.1}, 0.1),
        ({"kind": "linear", "netd_k": 0.2, "netd_f_number": 1.4}, 0.2 / 0.8),
        ({"kind": "linear", "netd_k": 0.2, "netd_f_number": 1.4, "sensing": "pyroelectric"}, 0.2 * math.sqrt(2) / 0.8),
    ],
)
def test_netd_of_every_kind(kelvin, detector, netd_k):
    """19 200 pixels: the standard error of their spread is 0.5 %."""
    assert kelvin(300.0, detector, f_number=1.4).std() == pytest.approx(netd_k, rel=0.025)


def test_noise_of_a_detectivity():
    """By hand: 1 cm2 element of D* = 1e9, 1 Hz, f/1 without losses: NEP 1e-9 W over an etendue of pi/4 cm2 sr."""
    sigma = thermal.from_detectivity(1e9, 1.0, 1e4, 1.0, 1.0)
    assert sigma == pytest.approx(1e-9 / (1e-4 * constants.pi / 4), rel=1e-12)
    assert thermal.from_detectivity(1e9, 4.0, 1e4, 2.0, 0.5) == pytest.approx(2 * 4 * 2 * sigma)
    # smaller elements: NEP falls with the side, the power with the area
    assert thermal.from_detectivity(1e9, 1.0, 1e3, 1.0, 1.0) == pytest.approx(10 * sigma)


def test_a_linear_array_by_detectivity(make_frame):
    """160 elements in a row; the noise in an image is the formula's."""
    made = tables(
        {"kind": "linear", "d_star_cm_rthz_per_w": 5e8, "bandwidth_hz": 30.0, "pixel_pitch_um": 100.0},
        size=(160, 1),
    )
    spec = CameraSpec.model_validate(made)
    frame = make_frame(thermal.blackbody_radiance(BAND, 280.0), made)
    images = np.array([observe(frame, spec, seed=s).dn.astype(float) for s in range(100)])
    note = observe(frame, spec).observation
    expected = math.sqrt(1e-2**2 * 30.0) / 5e8 / (0.8 * 1e-8 * math.pi / 4)
    assert note["sigma_radiance"] == pytest.approx(expected, rel=1e-9)
    # 16 000 samples: 0.6 % standard error
    assert images.std() * note["radiance_per_dn"] == pytest.approx(expected, rel=0.03)


def test_responsivity_shows_in_contrast(kelvin):
    """At 320 K the pattern is that of the radiance; it is the same in every frame of a unit."""
    keys = {"kind": "microbolometer", "netd_k": 0.001, "responsivity_rms": 0.01}
    images = [kelvin(320.0, keys, seed=s) for s in (1, 2)]
    level = thermal.blackbody_radiance(BAND, 320.0) / thermal.radiance_per_kelvin(BAND)
    assert images[0].std() == pytest.approx(0.01 * level, rel=0.025)
    assert np.corrcoef(images[0].ravel(), images[1].ravel())[0, 1] > 0.999


def test_the_shutter_leaves_a_new_pattern_each_time(kelvin):
    keys = {"kind": "microbolometer", "netd_k": 0.001, "residue_k": 0.1}
    images = [kelvin(300.0, keys, seed=s) for s in (1, 2)]
    assert images[0].std() == pytest.approx(0.1, rel=0.025)
    assert abs(np.corrcoef(images[0].ravel(), images[1].ravel())[0, 1]) < 0.036  # 5 standard errors


def test_drift_grows_with_the_minutes(kelvin):
    keys = {"kind": "microbolometer", "netd_k": 0.001, "drift_pattern_k_per_min": 0.02, "drift_k_per_min": 0.05}
    spread = [kelvin(300.0, keys | {"minutes_since_correction": m}).std() for m in (0.0, 2.0, 10.0)]
    np.testing.assert_allclose(spread[1:], [0.04, 0.2], rtol=0.025)
    assert spread[0] < 0.002
    detector = Microbolometer.model_validate(
        {"pixel_pitch_um": 12.0, "bits": 14, "minutes_since_correction": 10.0} | keys
    )
    draws = [stream("s", "c", "b", "drift", seed) for seed in range(4000)]
    common = [np.mean(thermal.offsets_k(detector, (40, 40), draw, draw)) for draw in draws]
    # 4000 draws: 1.1 % standard error, times five; the pattern's own mean adds 0.2 K / 40
    assert np.std(common) == pytest.approx(0.5, rel=0.055)


def test_chopped_elements_have_no_offsets(kelvin):
    keys = {"kind": "linear", "netd_k": 0.001, "sensing": "pyroelectric", "residue_k": 5.0}
    assert np.abs(kelvin(300.0, keys)).max() < 0.02


def test_without_noise_all_pixels_are_alike(kelvin):
    keys = {"kind": "microbolometer", "netd_k": 0.05, "residue_k": 1.0, "responsivity_rms": 0.1}
    image = kelvin(300.0, keys, noise=False)
    # a number of the converter is 2.06 mK
    assert np.ptp(image) < 2.1e-3
    assert abs(image[0, 0]) < 2e-3


WIDE = CameraModel(width=200, height=60, fx=200.0, fy=200.0, cx=99.5, cy=29.5)


def test_the_time_constant_drags_an_edge():
    """An edge seen while turning becomes ``1 - exp(-x / (omega f tau))`` behind its place."""
    edge = np.zeros((60, 200))
    edge[:, 100:] = 1.0
    tau, rate = 0.3, math.radians(10.0)
    image = thermal.lag_by_time_constant(edge, WIDE, np.array([0.0, rate, 0.0]), tau)
    # turning right, the scene moves left: what the pixel saw before was further left, so the edge lags to the right
    length = 200.0 * rate * tau
    row = image[30]
    for x in (3.0, 10.0, 25.0):
        # Gauss-Laguerre of a step is coarse: 0.1 of the step; its mean place is what counts below
        assert row[100 + int(x)] == pytest.approx(1 - math.exp(-x / length), abs=0.1)
    lag = (edge - image)[30].sum()
    assert lag == pytest.approx(length, rel=0.03)  # one pixel of bilinear smoothing on 10.5; the lens's tangent 1 %
    assert thermal.lag_by_time_constant(edge, WIDE, np.zeros(3), tau) is edge
    assert thermal.lag_by_time_constant(edge, WIDE, np.array([0.0, rate, 0.0]), 0.0) is edge


def test_wide_pixels_blur(make_frame):
    """A pixel response of 3 px full width: a line gets the variance of that Gaussian, 3^2 / (8 ln 2)."""
    made = tables({"kind": "thermopile", "netd_k": 0.1, "response_fwhm_px": 3.0})
    scene = np.full((120, 160), thermal.blackbody_radiance(BAND, 250.0))
    scene[:, 80] *= 1.5
    image = observe(make_frame(scene, made), CameraSpec.model_validate(made), noise=False).dn.astype(float)
    line = image[60] - image[60, 40]
    offset = np.arange(160) - 80.0
    variance = (line * offset**2).sum() / line.sum()
    assert variance == pytest.approx(9.0 / (8.0 * math.log(2.0)), rel=0.01)  # 30 000 numbers high, whole numbers


@pytest.mark.parametrize(
    ("detector", "words"),
    [
        ({"kind": "linear"}, "exactly one of netd_k and d_star"),
        ({"kind": "linear", "netd_k": 0.1, "d_star_cm_rthz_per_w": 1e8, "bandwidth_hz": 1.0}, "exactly one"),
        ({"kind": "linear", "d_star_cm_rthz_per_w": 1e8}, "go together"),
        ({"kind": "thermopile", "netd_k": 0.1, "scene_min_k": 400.0}, "scene_max_k = 360.0 must be above scene_min_k"),
        ({"kind": "microbolometer", "netd_k": -0.1}, "netd_k"),
    ],
)
def test_contradictions_are_refused(detector, words):
    with pytest.raises(ValidationError, match=words):
        CameraSpec.model_validate(tables(detector))


def test_keys_left_alone_leave_no_trace():
    made = tables({"kind": "microbolometer", "netd_k": 0.05})
    detector = CameraSpec.model_validate(made).model_dump(mode="json")["detector"]
    assert set(detector) == {"kind", "pixel_pitch_um", "netd_k", "bits", "scene_min_k", "scene_max_k"}
