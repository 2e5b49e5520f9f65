"""Detectors against what a laboratory measures: photon transfer curve, absolute calibration, NETD.

Models: Janesick, *Photon Transfer* (2007), eq. 5.1 for the variance; the definition of NETD for thermal arrays.
"""

from __future__ import annotations

import math
import tomllib
from typing import Any

import numpy as np
import pytest
from scipy import constants, integrate

from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.files import shipped_path

SIZE = 512

# A field of 0.1 deg, so that every pixel is on the axis to 1e-6.
CMOS: dict[str, Any] = {
    "camera": {"name": "bench", "width": SIZE, "height": SIZE, "fov_deg": 0.1},
    "optics": {"f_number": 4.0, "transmission": 0.8},
    "band": [{"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6}],
    "detector": {
        "kind": "cmos",
        "pixel_pitch_um": 5.5,
        "exposure_s": 2e-4,
        "quantum_efficiency": 0.6,
        "full_well_e": 60000,
        "read_noise_e": 12,
        "dark_current_e_per_s": 2e5,
        "bits": 14,
        "black_level_dn": 100,
        "gain_e_per_dn": 4.0,
    },
}
DARK_E = 40.0


def expected_electrons(radiance: float) -> float:
    """Photoelectrons by hand: pi tau L p^2 / (4 N^2) * t * QE * lambda / (h c) at 0.55 um."""
    power = math.pi * 0.8 * radiance * (5.5e-6) ** 2 / (4 * 4.0**2)
    return power * 2e-4 * 0.6 * 0.55e-6 / (constants.h * constants.c)


@pytest.mark.parametrize("radiance", [0.0, 0.3, 3.0, 15.0, 50.0, 100.0])
def test_photon_transfer_curve(make_frame, radiance):
    """Mean and variance at six levels. 262 144 pixels: standard error of the variance 0.28 %."""
    dn = observe(make_frame(radiance, CMOS), CameraSpec.model_validate(CMOS), seed=1).dn.astype(float)
    electrons = expected_electrons(radiance) + DARK_E
    assert electrons < 50000
    mean, variance = 100 + electrons / 4, (electrons + 12**2) / 4**2 + 1 / 12
    assert dn.mean() == pytest.approx(mean, abs=5 * math.sqrt(variance) / SIZE)
    assert dn.var() == pytest.approx(variance, rel=0.01)


def test_noise_has_no_pattern(make_frame):
    image = observe(make_frame(15.0, CMOS), CameraSpec.model_validate(CMOS)).dn.astype(float)
    noise = (image - image.mean()) / image.std()
    limit = 5 / SIZE
    assert abs((noise[1:] * noise[:-1]).mean()) < limit
    assert abs((noise[:, 1:] * noise[:, :-1]).mean()) < limit
    assert noise.mean(axis=0).std() * math.sqrt(SIZE) == pytest.approx(1, abs=0.16)
    assert noise.mean(axis=1).std() * math.sqrt(SIZE) == pytest.approx(1, abs=0.16)


def planck(wavelength_m: float, temperature: float) -> float:
    x = constants.h * constants.c / (wavelength_m * constants.k * temperature)
    return 2 * constants.h * constants.c**2 / wavelength_m**5 / math.expm1(x)


def band_radiance(temperature: float) -> float:
    return integrate.quad(planck, 8e-6, 14e-6, args=(temperature,))[0]


@pytest.mark.parametrize(("f_number", "transmission"), [(1.0, 1.0), (1.1, 1.0), (1.4, 0.8)])
def test_netd_measured_as_in_the_laboratory(make_frame, f_number, transmission):
    """Noise of a 300 K scene over the response between 299 and 301 K. 19 200 pixels: standard error 0.5 %."""
    tables = {
        "camera": {"name": "bench", "width": 160, "height": 120, "fov_deg": 0.1},
        "optics": {"f_number": f_number, "transmission": transmission},
        "band": [{"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0}],
        "detector": {"kind": "microbolometer", "pixel_pitch_um": 12.0, "netd_k": 0.05, "bits": 16},
    }
    spec = CameraSpec.model_validate(tables)

    def view(temperature: float, seed: int) -> np.ndarray:
        return observe(make_frame(band_radiance(temperature), tables), spec, seed=seed).dn.astype(float)

    per_kelvin = (view(301, 1).mean() - view(299, 2).mean()) / 2
    netd = view(300, 3).std() / per_kelvin
    assert netd == pytest.approx(0.05 * f_number**2 / transmission, rel=0.03)


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


@pytest.mark.parametrize("name", ["vis-cmos-512-60deg", "vis-cmos-1024-60deg", "ir-bolometer-160-57deg"])
def test_shipped_cameras_expose_the_earth_well(make_frame, name):
    """A sunlit limb, 50 to 100 W m-2 sr-1 um-1, stays below saturation; so does warm ground in the infrared."""
    tables = tomllib.loads(shipped_path("camera", name).read_text())
    spec = CameraSpec.model_validate(tables)
    assert spec.camera.name == name
    assert spec.camera.source
    assert spec.detector is not None
    thermal = spec.detector.kind == "microbolometer"
    width_um = 6.0 if thermal else 0.26
    radiance = band_radiance(300.0) if thermal else 77 * width_um
    image = observe(make_frame(radiance, tables), spec, noise=False)
    centre = image.dn[spec.camera.height // 2, spec.camera.width // 2] / image.full_scale
    assert 0.25 < centre < 0.4 if thermal else 0.55 < centre < 0.7
