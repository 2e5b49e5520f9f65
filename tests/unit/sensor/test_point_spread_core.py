"""Diffraction, aberration and defocus against the closed forms of optics books."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import j1

from horizonval.sensor.lens import diffraction, lens_spread
from horizonval.spec.camera import Band

GREEN = Band(name="green", kind="solar", lo_um=0.5499, hi_um=0.5501)
VISIBLE = Band(name="vis", kind="solar", lo_um=0.45, hi_um=0.75)
INFRARED = Band(name="lwir", kind="thermal", lo_um=8.0, hi_um=14.0)


def offsets(kernel: np.ndarray) -> np.ndarray:
    reach = len(kernel) // 2
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.hypot(x, y)


@pytest.fixture(scope="module")
def airy() -> np.ndarray:
    """One wavelength with lambda N = 10 pixels: the pattern is carried by whole pixels as it is."""
    return lens_spread.core_kernel(0.0, 0.0, GREEN, 10.0, 0.55e-6, 150)


def test_airy_pattern_of_one_wavelength(airy):
    r = offsets(airy)
    x = np.pi * np.maximum(r, 1e-9) / 10
    exact = np.pi / 4 / 10**2 * (2 * j1(x) / x) ** 2
    # The kernel's sum is fixed by the mean power law beyond the square; the ring on its border is off that by 3e-4.
    np.testing.assert_allclose(airy, exact, atol=5e-4 * exact.max())


def test_share_outside_a_rectangle_is_the_integral_of_the_power_law():
    """Polar integration over the angle: outside the border at distance R is ``2 spread / (2 pi^3 R)`` per radian."""
    angle = np.linspace(0, 2 * np.pi, 200001)
    border = np.minimum(30 / np.maximum(np.abs(np.cos(angle)), 1e-12), 20 / np.maximum(np.abs(np.sin(angle)), 1e-12))
    exact = np.trapezoid(0.7 / math.pi**3 / border, angle)
    assert diffraction.share_outside(30.0, 20.0, 0.7) == pytest.approx(exact, rel=1e-6)


def test_transfer_is_the_overlap_of_two_discs():
    y, x = np.mgrid[-1:1:801j, -1:1:801j]
    for v in (0.2, 0.5, 0.9):
        both = (np.hypot(x - v, y) < 1) & (np.hypot(x + v, y) < 1)
        overlap = both.sum() / (np.hypot(x, y) < 1).sum()
        assert diffraction.transfer(np.array(v), 1.0) == pytest.approx(overlap, abs=2e-3)
    assert diffraction.transfer(np.array([0.0, 1.0, 3.0]), 1.0).tolist() == [1.0, 0.0, 0.0]


def test_band_is_the_mean_of_its_wavelengths_counted_as_photons():
    frequency = np.array([5e4, 2e5, 4e5])
    wavelength = np.linspace(0.45e-6, 0.75e-6, 20001)
    exact = [np.average(diffraction.transfer(f, wavelength * 4), weights=wavelength) for f in frequency]
    np.testing.assert_allclose(diffraction.band_transfer(frequency, VISIBLE, 4.0), exact, atol=2e-5)
    assert diffraction.mean_wavelength_m(INFRARED) == pytest.approx(11e-6, rel=1e-9)


@pytest.mark.parametrize(
    ("sigma", "radius", "band", "f_number", "pitch"),
    [
        (0.0, 0.0, VISIBLE, 4.0, 5.5e-6),
        (0.7, 0.0, VISIBLE, 4.0, 5.5e-6),
        (0.6, 0.0, INFRARED, 1.1, 12e-6),
        (0.5, 2.0, VISIBLE, 8.0, 3e-6),
        (0.0, 3.0, None, 2.0, 5e-6),
        (1.2, 0.0, None, 2.0, 5e-6),
    ],
)
def test_kernels_hold_all_light_and_none_below_zero(sigma, radius, band, f_number, pitch):
    spread = 0.0 if band is None else lens_spread.core_spread_px(band, f_number, pitch)
    reach = lens_spread.core_reach_px(sigma, radius, spread)
    kernel = lens_spread.core_kernel(sigma, radius, band, f_number, pitch, reach)
    assert kernel.min() >= 0
    beyond = diffraction.share_outside(reach + 0.5, reach + 0.5, spread)
    assert kernel.sum() + beyond == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(kernel, kernel[::-1], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(kernel, kernel.T, rtol=1e-9, atol=1e-15)
    if band is not None:
        # The core goes over into the wings: the mean over the last three columns is the power law's. Rings of the
        # infrared band are still 2 % there.
        edge = np.zeros_like(kernel, dtype=bool)
        edge[:, -3:] = True
        law = diffraction.far_pattern(offsets(kernel)[edge], spread).mean()
        assert kernel[edge].mean() == pytest.approx(law, rel=0.05)


@pytest.mark.parametrize("sigma", [0.7, 1.0])
def test_pixel_average_is_taken_off_the_gaussian(sigma):
    """A fine Airy pattern adds nothing to the modulation of a coarse Gaussian but its own loss."""
    kernel = lens_spread.core_kernel(sigma, 0.0, VISIBLE, 4.0, 5.5e-6, 16)
    x = np.arange(-16, 17)
    for f in (0.1, 0.2):
        measured = (kernel.sum(axis=0) * np.cos(2 * math.pi * f * x)).sum()
        lens = diffraction.band_transfer(np.array([f / 5.5e-6]), VISIBLE, 4.0)[0]
        wanted = math.exp(-2 * (math.pi * sigma * f) ** 2) * lens
        # What is beyond the kernel's square, 0.5 %, is missing; box and Gaussian of one variance differ by f^4.
        assert measured == pytest.approx(wanted, abs=7e-3)
