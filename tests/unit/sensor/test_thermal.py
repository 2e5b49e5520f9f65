"""Thermal detectors: noise, offsets and time constant against their formulas."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from horizonval.sensor.detector import thermal
from horizonval.sensor.observe import observe
from horizonval.spec.camera import Band, CameraSpec

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


def test_chopped_elements_have_no_offsets(kelvin):
    keys = {"kind": "linear", "netd_k": 0.001, "sensing": "pyroelectric", "residue_k": 5.0}
    assert np.abs(kelvin(300.0, keys)).max() < 0.02


def test_without_noise_all_pixels_are_alike(kelvin):
    keys = {"kind": "microbolometer", "netd_k": 0.05, "residue_k": 1.0, "responsivity_rms": 0.1}
    image = kelvin(300.0, keys, noise=False)
    # a number of the converter is 2.06 mK
    assert np.ptp(image) < 2.1e-3
    assert abs(image[0, 0]) < 2e-3


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
