"""The core of the point spread: diffraction, aberration and defocus as one kernel on whole pixels.

The transfer functions of the three multiply::

    T(f) = T_diffraction(f)  exp(-2 pi^2 sigma^2 f^2)  2 J1(2 pi a f) / (2 pi a f),     a = |defocus| / (2 N)

the last being the evenly lit disc of a detector that stands ``defocus`` beside the focus (geometric, without the
rings of diffraction in it). With W = |defocus| / (8 N^2) this is within 0.06 of the exact modulation of a defocused
pupil (H. H. Hopkins, Proc. R. Soc. A 231, 91 (1955)) from W = 3 wavelengths on and within 0.07 below a tenth of one;
between, around half a wavelength, it is too low by up to 0.22. The kernel is the product's Fourier integral at whole
pixels.

The frame's pixels are means over their area already, so that the kernel has no pixel in it as long as whole pixels can
carry the pattern, that is, as long as nothing is left of T from one cycle per pixel on. A finer pattern would be caught
on or between its rings by chance. It is therefore averaged over the pixel after all: the kernel then says which share
of a point's light falls on which pixel. The variance that this adds, 1/12 px^2, is taken off the Gaussian's, so that
the total is as wide as it should; where sigma is below 0.29 px the Gaussian is left out and up to 1/12 px^2 is too
much, which is what one cannot know of a point inside its pixel.

The kernel is cut at a square. What diffraction throws beyond goes on as its mean power law
(:func:`horizonval.sensor.lens.diffraction.far_pattern`) in the wings.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy import fft
from scipy.special import j1

from horizonval.core.arrays import FloatArray
from horizonval.sensor.lens import diffraction
from horizonval.spec.camera import Band

_PIXEL_VARIANCE = 1 / 12
_CARRIED = 1e-3
"""Transfer beyond one cycle per pixel above which whole pixels cannot carry the pattern."""
_LEAST_REACH = 16
MOST_REACH = 256
MOST_SPREAD_PX = 64.0
"""Lambda N beyond which the power law would begin inside the first rings."""


def kernel(
    sigma_px: float, defocus_radius_px: float, band: Band | None, f_number: float, pitch_m: float, reach: int
) -> FloatArray:
    """Return the core kernel, shape (2 reach + 1, 2 reach + 1), read-only.

    It holds the share of a point's light per pixel, none below 0, and sums up to 1 less what diffraction throws beyond.

    Parameters
    ----------
    sigma_px, defocus_radius_px : float
        Gaussian and disc.
    band : Band or None
        None leaves diffraction out.
    f_number, pitch_m : float
        For diffraction.
    reach : int
        From :func:`reach_px`.
    """
    # Bands hold lists and cannot be keys of a cache; their text can.
    return _kernel(sigma_px, defocus_radius_px, band and band.model_dump_json(), f_number, pitch_m, reach)


def spread_px(band: Band, f_number: float, pitch_m: float) -> float:
    """Return the band's mean ``lambda N`` in pixels."""
    return diffraction.mean_wavelength_m(band) * f_number / pitch_m


def reach_px(sigma_px: float, defocus_radius_px: float, spread: float) -> int:
    """Return the half width of the kernel's square: the Gaussian and the disc inside, and a dozen of rings."""
    reach = max(8 * sigma_px + defocus_radius_px + 1, 12 * spread + defocus_radius_px)
    if spread:
        reach = max(reach, 4 * defocus_radius_px, _LEAST_REACH)
    return min(math.ceil(reach), MOST_REACH)


@lru_cache(maxsize=32)
def _kernel(
    sigma_px: float, defocus_radius_px: float, band_text: str | None, f_number: float, pitch_m: float, reach: int
) -> FloatArray:
    band = None if band_text is None else Band.model_validate_json(band_text)
    # Over a whole cycle, not at its start alone: a disc's transfer has zeros.
    folded = _transfer_at(np.linspace(1.0, 2.0, 201), sigma_px, defocus_radius_px, band, f_number, pitch_m)
    pixel_averaged = bool(np.abs(folded).max() > _CARRIED)
    sigma = math.sqrt(max(sigma_px**2 - _PIXEL_VARIANCE, 0.0)) if pixel_averaged else sigma_px
    # The period is long against the reach, so that what comes round from the neighbouring period is faint.
    period = fft.next_fast_len(max(256, 6 * reach), real=True)
    values = _sampled(period, sigma, defocus_radius_px, band, f_number, pitch_m, pixel_averaged)
    offsets = np.arange(-reach, reach + 1)
    core = np.maximum(values[np.ix_(offsets, offsets)], 0.0)
    # Cutting and the little that came round are made good in proportion.
    spread = 0.0 if band is None else spread_px(band, f_number, pitch_m)
    core *= (1 - diffraction.share_outside(reach + 0.5, reach + 0.5, spread)) / core.sum()
    core.flags.writeable = False
    return core


def _transfer_at(
    frequency: FloatArray, sigma: float, radius: float, band: Band | None, f_number: float, pitch_m: float
) -> FloatArray:
    """Return the product of the transfer functions at frequencies in cycles per pixel."""
    out = np.exp(-2 * (math.pi * sigma * frequency) ** 2)
    if radius > 0:
        x = 2 * math.pi * radius * frequency
        out = out * np.where(x > 1e-6, 2 * j1(x) / np.where(x > 1e-6, x, 1.0), 1.0)
    if band is not None:
        out = out * diffraction.band_transfer(frequency / pitch_m, band, f_number)
    return out


def _sampled(
    period: int, sigma: float, radius: float, band: Band | None, f_number: float, pitch_m: float, averaged: bool
) -> FloatArray:
    """Return the pattern at whole pixels, shape (period, period), its centre at [0, 0].

    Frequencies beyond half a cycle per pixel are folded back: that is what sampling does.
    """
    folds = _folds(sigma, radius, band, f_number, pitch_m)
    base = fft.fftfreq(period)
    total = np.zeros((period, period // 2 + 1))
    radial = np.linspace(0.0, math.sqrt(2) * (folds + 1), 20001)
    modulation = _transfer_at(radial, sigma, radius, band, f_number, pitch_m)
    half = base[: period // 2 + 1].copy()
    half[-1] = abs(half[-1])
    for row in range(-folds, folds + 1):
        fy = base + row
        for column in range(-folds, folds + 1):
            fx = half + column
            part = np.interp(np.hypot(fy[:, None], fx[None, :]), radial, modulation)
            if averaged:
                part = part * np.sinc(fy)[:, None] * np.sinc(fx)[None, :]
            total += part
    return fft.irfft2(total, s=(period, period))


def _folds(sigma: float, radius: float, band: Band | None, f_number: float, pitch_m: float) -> int:
    """Return how many times the spectrum must be folded until less than 1e-4 of it is left."""
    frequency = np.linspace(0.0, 12.0, 2401)
    left = np.abs(_transfer_at(frequency, sigma, radius, band, f_number, pitch_m)) > 1e-4
    return min(math.ceil(float(frequency[left].max()) - 0.5), 12) if left.any() else 0
