"""Each stage by itself, against its formula."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.geometry.camera import CameraModel, pixel_grid
from horizonval.sensor.detector import exposure, readout, thermal
from horizonval.sensor.lens import lens_spread, optics
from horizonval.sensor.streams import stream
from horizonval.spec.camera import Band
from horizonval.spec.optics import Optics


def test_streams_are_the_same_everywhere():
    """Pinned: archived images must come out again on other machines and in later versions."""
    assert stream("scene", "camera", "vis", "photon", 0).integers(0, 1000, 6).tolist() == [892, 524, 4, 703, 199, 332]


def test_streams_differ_in_every_part_of_their_identity():
    identities = [
        ("ab", "c", "vis", "photon", 0),
        ("a", "bc", "vis", "photon", 0),
        ("ab", "c", "ir", "photon", 0),
        ("ab", "c", "vis", "dark", 0),
        ("ab", "c", "vis", "photon", 1),
        ("ab", "c", "vis", "photon", 10),
    ]
    draws = np.array([stream(*identity).standard_normal(4000) for identity in identities])
    correlation = np.corrcoef(draws) - np.eye(len(draws))
    assert np.abs(correlation).max() < 0.08  # 5 standard errors of 1/sqrt(4000)


def test_cosine_fourth_law():
    camera = CameraModel(width=200, height=150, fx=120.0, fy=120.0, cx=99.5, cy=74.5)
    offset = pixel_grid(camera) - [camera.cx, camera.cy]
    cosine = 120 / np.sqrt(120**2 + (offset**2).sum(axis=-1))
    np.testing.assert_allclose(optics.relative_illumination(camera, Optics()), cosine**4, rtol=1e-12)
    assert optics.relative_illumination(camera, Optics()).min() < 0.25  # The corners are 46 deg off axis.


def test_power_on_the_axis_follows_the_sine_condition():
    """``P = pi tau L p^2 / (4 N^2)``, whatever the focal length."""
    for focal_px in (100.0, 5000.0):
        camera = CameraModel(width=3, height=3, fx=focal_px, fy=focal_px, cx=1.0, cy=1.0)
        power = optics.pixel_power_w(np.full((3, 3), 7.0), optics.etendue(camera, 5e-6, Optics(f_number=2.8)), 0.9)
        assert power[1, 1] == pytest.approx(math.pi * 0.9 * 7.0 * (5e-6) ** 2 / (4 * 2.8**2), rel=1e-12)


def test_distortion_carries_light_with_it():
    """A barrel lens puts the same scene on fewer pixels; what they collect in total stays the same."""

    def collected(k1: float) -> float:
        camera = CameraModel(width=601, height=601, fx=400.0, fy=400.0, cx=300.0, cy=300.0, distortion=(k1, 0, 0, 0, 0))
        r = np.hypot(*(pixel_grid(camera) - 300).T) / 400
        inside = r < 0.5 * (1 + k1 * 0.25)  # The image of a disc of tan(theta) = 0.5.
        return float(optics.etendue(camera, 5e-6, Optics(f_number=2.0))[inside].sum())

    # Exact: A pi sin^2(theta). Tolerance: 1e5 pixels, some hundred on the edge.
    exact = math.pi / 4 * (400 * 5e-6 / 2) ** 2 * math.pi * 0.2
    assert collected(0.0) == pytest.approx(exact, rel=3e-3)
    assert collected(-0.15) == pytest.approx(exact, rel=3e-3)


@pytest.mark.parametrize("sigma", [0.7, 1.0, 2.5])
def test_point_spread_of_a_point(sigma):
    image = np.zeros((61, 71))
    image[30, 35] = 5.0
    spread = lens_spread.blur(image, sigma)
    assert spread.sum() == pytest.approx(5.0, rel=1e-12)
    y, x = np.mgrid[:61, :71] - np.array([30, 35])[:, None, None]
    assert (spread * x * x).sum() / 5 == pytest.approx(sigma**2, rel=3e-3)
    assert (spread * y * y).sum() / 5 == pytest.approx(sigma**2, rel=3e-3)
    gauss = np.exp(-(x * x + y * y) / (2 * sigma**2)) / (2 * math.pi * sigma**2) * 5
    np.testing.assert_allclose(spread, gauss, atol=2e-3 * gauss.max())


@pytest.mark.parametrize("full_well", [1.0, 13500.0, 1e9])
def test_the_sun_saturates_and_does_not_overflow(full_well):
    counts = exposure.count(np.array([0.0, 1e12, 1e25, 1e300]), full_well, np.random.default_rng(1))
    assert counts[0] == 0
    assert (counts[1:] >= full_well).all()
    assert np.isfinite(counts).all()


def test_counts_below_the_cap_and_converter():
    expected = np.full(1000, 500.0)
    low = exposure.count(expected, 1e4, np.random.default_rng(1))
    np.testing.assert_array_equal(low, np.random.default_rng(1).poisson(expected))
    gain = readout.default_gain(13500.0, 10, 32.0)
    dn = readout.digitise(np.array([-1e6, 0.0, 0.49 * gain, 0.51 * gain, 13500.0, 1e9]), gain, 32.0, 10)
    assert dn.dtype == np.uint16
    assert dn.tolist() == [0, 32, 32, 33, 1023, 1023]
    assert readout.digitise(np.array([1e9]), 1.0, 0.0, 16).tolist() == [65535]
    assert readout.digitise(np.array([0.4, 0.6]), 1.0, 0.0, 1).tolist() == [0, 1]


BAND = Band(name="lwir", kind="thermal", lo_um=8.0, hi_um=14.0)


def test_black_body_radiance_in_the_band():
    """8 to 14 um at 300 K: 54.93 W m-2 sr-1 and 0.838 per kelvin, by numerical quadrature of Planck's law here."""
    from scipy import constants, integrate

    def planck(wavelength_m: float, temperature: float) -> float:
        x = constants.h * constants.c / (wavelength_m * constants.k * temperature)
        return 2 * constants.h * constants.c**2 / wavelength_m**5 / math.expm1(x)

    at = {t: integrate.quad(planck, 8e-6, 14e-6, args=(t,), epsrel=1e-12)[0] for t in (299.0, 300.0, 301.0)}
    assert thermal.blackbody_radiance(BAND, 300.0) == pytest.approx(at[300.0], rel=1e-9)
    # A central difference over 2 K against one over 0.1 K.
    assert thermal.radiance_per_kelvin(BAND) == pytest.approx((at[301.0] - at[299.0]) / 2, rel=1e-5)
    assert thermal.blackbody_radiance(BAND, 0.0) == 0


def test_a_weaker_response_brings_less_signal_and_the_same_netd():
    half = Band(name="h", kind="thermal", wavelength_um=[8.0, 11.0, 14.0], response=[0.0, 0.5, 0.0])
    full = Band(name="f", kind="thermal", wavelength_um=[8.0, 11.0, 14.0], response=[0.0, 1.0, 0.0])
    # Responses are relative: their peak is 1 either way.
    assert thermal.blackbody_radiance(half, 300.0) == thermal.blackbody_radiance(full, 300.0)
    sigma = thermal.from_netd(full, 0.05, 1.0, 1.0)
    assert sigma / thermal.radiance_per_kelvin(full) == pytest.approx(0.05)
