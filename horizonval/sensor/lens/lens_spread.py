"""The point spread of the whole lens: core and wings.

The share 1 - TIS of a point's light goes into the core (aberration, diffraction, defocus), the share TIS into the
scatter wings over the whole image. What diffraction throws beyond the core's square joins the wings.

Outside the image the core takes the scene to continue as in the border pixel and the wings as the mean of what they see
inside, a Sun excepted, so that an even scene stays even. The second guess is wrong by at most the contrast of the scene
times the wings' share outside, half of TIS on the border. The Sun outside: :mod:`horizonval.sensor.lens.stray_light`.

**Gaussian.** The kernel is the Gaussian at whole pixels, scaled to a sum of 1 and cut at 8 sigma, where it is below
1e-13 of its peak. Integration over the pixel is not in it: the renderer averages over pixels. Its variance is
``sigma^2`` within 0.3 % from sigma = 0.7 pixels on; below, whole pixels are too coarse (98 % at 0.6, 86 % at 0.5, 9 %
at 0.3), which matters little next to the pixel's own 0.29. The convolution is direct: rounding errors stay relative to
each pixel's value, so that a Sun 1e9 times brighter than the limb leaves no ripples.

**Over the field.** The standard deviation is given against the field angle, linear between entries, constant beyond.
Light between two entries is shared between their Gaussians so that the mixture has the right variance::

    w = (sigma^2 - sigma_a^2) / (sigma_b^2 - sigma_a^2)

No light is lost or made. The mixture is not Gaussian between the entries. An even scene gets a dent or a bump of some
0.6 % where the widening begins or ends abruptly (0.6 to 1.5 pixels over 30 deg of a 200-pixel image).

**Diffraction and defocus.** The transfer functions multiply::

    T(f) = T_diffraction(f)  exp(-2 pi^2 sigma^2 f^2)  2 J1(2 pi a f) / (2 pi a f),     a = |defocus| / (2 N)

the last being the evenly lit disc of a defocused detector (geometric, without rings). With W = |defocus| / (8 N^2) this
is within 0.06 of the exact modulation of a defocused pupil (H. H. Hopkins, Proc. R. Soc. A 231, 91 (1955)) from W = 3
wavelengths on and within 0.07 below a tenth of one; around half a wavelength it is too low by up to 0.22. The kernel is
the product's Fourier integral at whole pixels, cut at a square; beyond, diffraction goes on as its mean power law
(:func:`horizonval.sensor.lens.diffraction.far_pattern`) in the wings.

The frame's pixels are means over their area, so the kernel contains no pixel as long as nothing is left of T from one
cycle per pixel on. A finer pattern is averaged over the pixel, so that the kernel gives each pixel's share of a point's
light. The variance that this adds, 1/12 px^2, is subtracted from the Gaussian's; where sigma is below 0.29 px up to
1/12 px^2 is too much, which is the uncertainty of a point inside its pixel.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter
from scipy.special import j1

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.camera import CameraModel, field_angles
from horizonval.sensor.lens import convolution, diffraction, scatter
from horizonval.sensor.lens.convolution import Border
from horizonval.spec.camera import Band
from horizonval.spec.optics import Optics, Scatter

_CUT_SIGMA = 8.0


def blur(image: FloatArray, sigma_px: float, border: Literal["edge", "dark"] = "edge") -> FloatArray:
    """Return the blurred image, shape (H, W), in the image's unit; "dark" takes nothing to be outside it."""
    mode = "nearest" if border == "edge" else "constant"
    return gaussian_filter(image, sigma_px, mode=mode, truncate=_CUT_SIGMA) if sigma_px > 0 else image


def field_shares(
    angle_deg: FloatArray, table_deg: list[float], table_sigma: list[float]
) -> list[tuple[float, FloatArray]]:
    """Return for each entry its sigma and the share of every pixel's light, shape of ``angle_deg``, that it spreads."""
    share_by_entry = [np.zeros_like(angle_deg) for _ in table_deg]
    angle = np.clip(angle_deg, table_deg[0], table_deg[-1])
    low = np.clip(np.searchsorted(table_deg, angle, side="right") - 1, 0, max(len(table_deg) - 2, 0))
    for i in range(len(table_deg) - 1):
        here = low == i
        along = (angle[here] - table_deg[i]) / (table_deg[i + 1] - table_deg[i])
        a, b = table_sigma[i], table_sigma[i + 1]
        sigma = a + (b - a) * along
        share = along if a == b else (sigma**2 - a**2) / (b**2 - a**2)
        share_by_entry[i][here] += 1 - share
        share_by_entry[i + 1][here] += share
    if len(table_deg) == 1:
        share_by_entry[0][:] = 1.0
    return list(zip(table_sigma, share_by_entry, strict=True))


_PIXEL_VARIANCE = 1 / 12
_CARRIED = 1e-3
"""Transfer beyond one cycle per pixel above which whole pixels cannot carry the pattern."""
_LEAST_REACH = 16
MOST_CORE_REACH = 256
MOST_SPREAD_PX = 64.0
"""Lambda N beyond which the power law would begin inside the first rings."""


def core_kernel(
    sigma_px: float, defocus_radius_px: float, band: Band | None, f_number: float, pitch_m: float, reach: int
) -> FloatArray:
    """Return the core kernel, shape (2 reach + 1, 2 reach + 1), read-only.

    It holds the share of a point's light per pixel, none below 0, and sums up to 1 less what diffraction throws beyond.
    ``band`` None leaves diffraction out; ``reach`` is from :func:`core_reach_px`.
    """
    # Bands hold lists and cannot be keys of a cache; their text can.
    return _kernel(sigma_px, defocus_radius_px, band and band.model_dump_json(), f_number, pitch_m, reach)


def core_spread_px(band: Band, f_number: float, pitch_m: float) -> float:
    """Return the band's mean ``lambda N`` in pixels."""
    return diffraction.mean_wavelength_m(band) * f_number / pitch_m


def core_reach_px(sigma_px: float, defocus_radius_px: float, spread: float) -> int:
    """Return the half width of the kernel's square: the Gaussian and the disc inside, and a dozen of rings."""
    reach = max(8 * sigma_px + defocus_radius_px + 1, 12 * spread + defocus_radius_px)
    if spread:
        reach = max(reach, 4 * defocus_radius_px, _LEAST_REACH)
    return min(math.ceil(reach), MOST_CORE_REACH)


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
    spread = 0.0 if band is None else core_spread_px(band, f_number, pitch_m)
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
    """Return the pattern at whole pixels, shape (period, period), its centre at [0, 0]."""
    # Frequencies beyond half a cycle per pixel are folded back: that is what sampling does.
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


def spread(
    image: FloatArray,
    camera: CameraModel,
    lens: Optics,
    band: Band | None = None,
    pixel_pitch_m: float | None = None,
    border: Border = "edge",
) -> FloatArray:
    """Return the image as the lens spreads it, shape (H, W), in the image's unit.

    The image is not below 0. Band and pitch are needed for diffraction and defocus. ``border``: "edge" continues the
    scene outside, "dark" counts the light that is lost. UserError: something needed is missing, or the core is wider
    than a kernel can be.
    """
    core = None
    for sigma, share in _over_field(camera, lens):
        part = _core_of(image if share is None else share * image, sigma, lens, band, pixel_pitch_m, border)
        core = part if core is None else core + part
    assert core is not None
    return _with_wings(core, image, camera, lens, band, pixel_pitch_m, border)


def check(lens: Optics, band: Band, pixel_pitch_m: float) -> None:
    """Raise :class:`UserError` if the core is wider than a kernel can be."""
    if lens.diffraction or lens.defocus_um != 0:
        _core(lens, band, pixel_pitch_m)


def lost_share(
    camera: CameraModel, lens: Optics, band: Band | None = None, pixel_pitch_m: float | None = None
) -> FloatArray:
    """Return the share of every pixel's light that leaves the image over its border, shape (H, W).

    Kernels are even: what stays of a pixel's light is what its kernel makes of an image of ones that is dark outside.
    """
    ones = np.ones((camera.height, camera.width))
    core = np.zeros_like(ones)
    for sigma, share in _over_field(camera, lens):
        part = _core_of(ones, sigma, lens, band, pixel_pitch_m, "dark")
        core += part if share is None else share * part
    return 1 - _with_wings(core, ones, camera, lens, band, pixel_pitch_m, "dark")


def wing_quadrant(
    camera: CameraModel, lens: Optics, band: Band | None, pixel_pitch_m: float | None
) -> FloatArray | None:
    """Return the wings at offsets (0..H - 1, 0..W - 1), shape (H, W), read-only; None for a lens without."""
    if lens.diffraction:
        _, pitch, chosen, reach = _core(lens, band, pixel_pitch_m)
        assert chosen is not None
        return _wings_with_diffraction(camera, lens.scatter, core_spread_px(chosen, lens.f_number, pitch), reach)
    return None if lens.scatter is None else _scattered(camera, lens.scatter)


def _scattered(camera: CameraModel, rough: Scatter) -> FloatArray:
    return scatter.quadrant(rough, camera.height, camera.width, camera.fx, camera.fy)


@lru_cache(maxsize=2)
def _wings_with_diffraction(camera: CameraModel, rough: Scatter | None, spread_px: float, reach: int) -> FloatArray:
    tail = _diffraction_tail(camera, spread_px, reach)
    tail *= 1.0 if rough is None else 1 - rough.total
    wings = tail if rough is None else _scattered(camera, rough) + tail
    wings.flags.writeable = False
    return wings


def wings_of_point(
    camera: CameraModel, lens: Optics, band: Band | None, pixel_pitch_m: float | None, column: float, row: float
) -> FloatArray:
    """Return the share per pixel of the light of a point outside the image, shape (H, W): wings only."""
    y, x = np.arange(camera.height)[:, None] - row, np.arange(camera.width)[None, :] - column
    out = np.zeros((camera.height, camera.width))
    if lens.scatter is not None:
        rho_squared = (x / camera.fx) ** 2 + (y / camera.fy) ** 2
        out += scatter.image_share(lens.scatter, rho_squared) / (camera.fx * camera.fy)
    if lens.diffraction:
        _, pitch, chosen, reach = _core(lens, band, pixel_pitch_m)
        assert chosen is not None
        # Nearer than the core's reach the power law is no more than a bound: held level from there.
        tail = diffraction.far_pattern(np.maximum(np.hypot(x, y), reach), core_spread_px(chosen, lens.f_number, pitch))
        out += tail * (1.0 if lens.scatter is None else 1 - lens.scatter.total)
    return out


def _with_wings(
    core: FloatArray,
    image: FloatArray,
    camera: CameraModel,
    lens: Optics,
    band: Band | None,
    pixel_pitch_m: float | None,
    border: Border,
) -> FloatArray:
    """Return what the scatter leaves of the core, and the wings of the image."""
    scattered = 0.0 if lens.scatter is None else lens.scatter.total
    if lens.scatter is not None:
        core = core * (1 - scattered)
    wings = wing_quadrant(camera, lens, band, pixel_pitch_m)
    if wings is None:
        return core
    if border == "dark":
        return core + convolution.spread_wings(image, wings)
    total = scattered
    if lens.diffraction:
        _, pitch, chosen, reach = _core(lens, band, pixel_pitch_m)
        assert chosen is not None
        spread_px = core_spread_px(chosen, lens.f_number, pitch)
        total += (1 - scattered) * diffraction.share_outside(reach + 0.5, reach + 0.5, spread_px)
    return core + convolution.spread_wings(image, wings, total)


def _over_field(camera: CameraModel, lens: Optics) -> list[tuple[float, FloatArray | None]]:
    """Return the sigmas of the Gaussians and the share of every pixel's light that each spreads; None for all of it."""
    if not lens.psf_field_deg:
        return [(lens.psf_sigma_px, None)]
    angle_deg = np.degrees(field_angles(camera))
    # Pixels outside the image circle have no angle and no light.
    angle_deg = np.where(np.isnan(angle_deg), 180.0, angle_deg)
    return [*field_shares(angle_deg, lens.psf_field_deg, lens.psf_field_sigma_px)]


def _core_of(
    light: FloatArray, sigma_px: float, lens: Optics, band: Band | None, pixel_pitch_m: float | None, border: Border
) -> FloatArray:
    """Return the light spread by one Gaussian with the diffraction and the defocus."""
    if not lens.diffraction and lens.defocus_um == 0:
        return blur(light, sigma_px, border)
    radius, pitch, chosen, reach = _core(lens, band, pixel_pitch_m)
    kernel = core_kernel(sigma_px, radius, chosen, lens.f_number, pitch, reach)
    return convolution.spread_core(light, kernel, border)


def _core(lens: Optics, band: Band | None, pixel_pitch_m: float | None) -> tuple[float, float, Band | None, int]:
    """Return the defocus disc's radius [px], the pitch [m], the band to diffract, and the kernel's reach [px]."""
    if pixel_pitch_m is None or (lens.diffraction and band is None):
        key = "diffraction" if lens.diffraction else "defocus_um"
        raise UserError(f"optics.{key} needs the band and the detector's pixel pitch", where=f"optics.{key}")
    radius = abs(lens.defocus_um) * 1e-6 / (2 * lens.f_number * pixel_pitch_m)
    chosen = band if lens.diffraction else None
    spread_px = 0.0 if chosen is None else core_spread_px(chosen, lens.f_number, pixel_pitch_m)
    widest = max([lens.psf_sigma_px, *lens.psf_field_sigma_px])
    if spread_px > MOST_SPREAD_PX:
        raise UserError(
            f"diffraction at f_number = {lens.f_number:g} spreads lambda N = {spread_px:.3g} pixels of "
            f"pixel_pitch_um = {pixel_pitch_m * 1e6:g}",
            where="optics.diffraction",
            expected=f"at most {MOST_SPREAD_PX:g} pixels",
        )
    if 4 * widest + radius > MOST_CORE_REACH:
        raise UserError(
            f"a defocus disc of {radius:.4g} pixels (defocus_um = {lens.defocus_um:g}, f_number = {lens.f_number:g}) "
            f"and a blur of {widest:g} pixels",
            where="optics.defocus_um" if lens.defocus_um else "optics.psf_sigma_px",
            expected=f"radius and four sigma within {MOST_CORE_REACH} pixels",
        )
    return radius, pixel_pitch_m, chosen, core_reach_px(widest, radius, spread_px)


def _diffraction_tail(camera: CameraModel, spread_px: float, reach: int) -> FloatArray:
    """Return the diffraction beyond the core's square, scaled to hold exactly what the formula puts into the image."""
    y, x = np.arange(camera.height)[:, None], np.arange(camera.width)[None, :]
    outside = (y > reach) | (x > reach)
    tail = np.where(outside, diffraction.far_pattern(np.hypot(np.maximum(x, 1), y), spread_px), 0.0)
    if min(tail.shape) > reach + 1:
        exact = diffraction.share_outside(reach + 0.5, reach + 0.5, spread_px) - diffraction.share_outside(
            camera.width - 0.5, camera.height - 0.5, spread_px
        )
        tail *= exact / scatter.quadrant_sum(tail)
    return tail
