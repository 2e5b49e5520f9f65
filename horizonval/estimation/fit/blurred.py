"""Profiles over height, blurred by lens and pixel, and their derivatives by blur and lens.

Across the limb the pixel's square, seen along the direction ``(c, d)`` of its columns and rows, is the convolution of
two boxes of ``c`` and ``d`` pixels. Where a pixel is ``m`` metres wide, on an even grid of distances across the limb,
with ``sinc x = sin x / x``::

    T(w) = L(w) sinc(w c m / 2) sinc(w d m / 2),      P_s = F^-1[T F[P]]

The profiles on the grid are means over its steps; ``T`` is divided by their ``sinc``. The lens is a Gaussian of ``s``
pixels. The unknown ``q`` leads from a smooth Gaussian to an equally wide one sampled at whole pixels, which passes more
at periods near two pixels::

    L = (1 - q) exp(-(w s m)^2 / 2) + q G(w c m) G(w d m),      G(x) = sum_k exp(-k^2 / 2 s^2) cos k x / its value at 0

If a pixel is small compared with the limb's depth, or the blur a pixel and more, both are equal.

Where the blur varies over the field, the transform is

    L = sum_b w_b(place) L_b,        s_b = r_b s,

with ``r_b`` the blur at some angles from the axis relative to a common one, and ``w_b`` the interpolation weights of a
position. A round aperture multiplies it by ``(2 a - sin 2 a) / pi``, ``cos a = w d m / 2 pi`` with ``d = lambda N`` in
pixels (M. Born and E. Wolf, Principles of Optics, 9.5.2), at the mean wavelength.

The profiles are continued evenly at both ends of the grid, so that a level there goes on: cosine transforms. They are
transformed once; a step of a fit computes the products only.

Between the places of the grid a profile is a cubic spline, whose second derivative is continuous, so that prediction
and derivatives are of one smooth function. Its coefficients are the samples over ``(2 + cos w h) / 3`` in the transform
(M. Unser, IEEE Signal Process. Mag. 16(6), 22, 1999); a wave of ``w`` is right to ``(w h)^4 / 720``.
"""

from __future__ import annotations

from functools import cached_property, reduce

import numpy as np
from scipy import fft

from horizonval.core.arrays import FloatArray
from horizonval.estimation.observation import Lens

REACH_BLURS = 5.0
"""Range of sampled sums, in blurs: 4e-6 of the central sample."""
AROUND = np.arange(-1, 3)
"""Places of the grid whose coefficients make a spline between one place and the next."""


def around_of(share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weights, shape (4, n), of coefficients around shares of a step: of value and slope per step."""
    rest = 1.0 - share
    weights = np.array([rest**3, 4.0 - 3.0 * share**2 * (1.0 + rest), 4.0 - 3.0 * rest**2 * (1.0 + share), share**3])
    steeper = np.array([-(rest**2), share * (3.0 * share - 4.0), rest * (4.0 - 3.0 * rest), share**2])
    return weights / 6.0, 0.5 * steeper


class BlurredProfiles:
    """k functions at m positions along the limb.

    ``profiles``: shape (m, k, n), means over the steps of an even grid of heights with step ``step_m``; ``boxes_m``:
    shape (m, 2), height per pixel along columns and rows; ``off_axis_rad``: shape (m,), for a lens whose blur varies
    over the field.
    """

    def __init__(
        self,
        profiles: FloatArray,
        step_m: float,
        boxes_m: FloatArray,
        lens: Lens | None = None,
        off_axis_rad: FloatArray | None = None,
    ) -> None:
        lens = lens or Lens()
        self._ratios = lens.ratios
        self._shares = lens.shares(np.zeros(len(profiles)) if off_axis_rad is None else off_axis_rad)
        self._profiles, count = profiles, profiles.shape[-1]
        frequency = np.arange(count) / (2.0 * (count - 1) * step_m)
        by_column, by_row = boxes_m[:, :1] * frequency, boxes_m[:, 1:] * frequency
        spline = (2.0 + np.cos(2.0 * np.pi * frequency * step_m)) / 3.0
        self._pixel = np.sinc(by_column) * np.sinc(by_row) / np.sinc(frequency * step_m) / spline
        self._wave = 2.0 * np.pi * frequency
        self._turns = np.cos(2.0 * np.pi * np.array([by_column, by_row]))
        self._wave_px = np.hypot(*boxes_m.T)[:, None] * self._wave
        if lens.diffraction_px:
            self._pixel *= _through_aperture(np.hypot(by_column, by_row) * lens.diffraction_px)
        self._known_parts: dict[float, FloatArray] = {}

    @cached_property
    def _transform(self) -> FloatArray:
        """Transforms of all functions, shape (m, k, n)."""
        return np.asarray(fft.dct(self._profiles, type=1) * self._pixel[:, None])

    def values(self, blur_px: float, sharpness: float, count: int | None = None) -> FloatArray:
        """Return spline coefficients of the first ``count`` blurred profiles, shape (m, k, n)."""
        smooth, sampled, _, _ = self._parts(blur_px)
        lens = (smooth + sharpness * (sampled - smooth))[:, None]
        return np.asarray(fft.idct(self._transform[:, :count] * lens, type=1, overwrite_x=True))

    def changes(self, weights: FloatArray, blur_px: float, sharpness: float) -> FloatArray:
        """Return spline coefficients, shape (3, m, n), of sums of functions and its derivatives by ln blur, sharpness.

        ``weights``: shape (m, k), of the first ones; ``blur_px``: the lens's ``s``; ``sharpness``: the lens's ``q``.
        """
        summed = (weights[:, None] @ self._transform[:, : weights.shape[1]])[:, 0]
        smooth, sampled, smooth_by_blur, sampled_by_blur = self._parts(blur_px)
        changes = np.empty((3, *summed.shape))
        changes[0] = summed * (smooth + sharpness * (sampled - smooth))
        changes[1] = summed * (smooth_by_blur + sharpness * (sampled_by_blur - smooth_by_blur))
        changes[2] = summed * (sampled - smooth)
        return np.asarray(fft.idct(changes, type=1, overwrite_x=True))

    def pull(self, weights: FloatArray, blur_px: float, sharpness: float) -> FloatArray:
        """Return sums over the grid of the functions' coefficients times weights (m, n), shape (m, k).

        The weights are transformed instead of every function.
        """
        smooth, sampled, _, _ = self._parts(blur_px)
        doubled = weights.copy()
        doubled[..., [0, -1]] *= 2.0
        lens = (smooth + sharpness * (sampled - smooth)) / (2.0 * (weights.shape[-1] - 1))
        lens[:, [0, -1]] *= 0.5
        waves = fft.dct(doubled, type=1, overwrite_x=True) * lens
        return np.asarray((self._transform @ waves[:, :, None])[:, :, 0])

    def _parts(self, blur_px: float) -> FloatArray:
        """Return the smooth and the sampled lens's transform, and both's change by the blur, shape (4, m, f)."""
        if blur_px not in self._known_parts:
            each = (self._gaussian(float(ratio) * blur_px) for ratio in self._ratios)
            mixed = (share[:, None] * part for share, part in zip(self._shares, each, strict=True))
            # A step asks three times for one blur.
            self._known_parts = {blur_px: reduce(np.add, mixed)}
        return self._known_parts[blur_px]

    def _gaussian(self, blur_px: float) -> FloatArray:
        """Return :meth:`_parts` of one Gaussian."""
        smooth = np.exp(-0.5 * (blur_px * self._wave_px) ** 2)
        least_px = 0.15  # below it only the central sample remains
        place = np.arange(1, int(np.ceil(REACH_BLURS * blur_px)) + 1)
        weight = 2.0 * np.exp(-0.5 * (place / max(blur_px, least_px)) ** 2)
        steeper = weight * (place / max(blur_px, least_px)) ** 2
        # Chebyshev: cos (k + 1) x = 2 cos x cos k x - cos (k - 1) x.
        before, now = np.ones_like(self._turns), self._turns
        total, by_blur = np.ones_like(self._turns), np.zeros_like(self._turns)
        for one, steep in zip(weight, steeper, strict=True):
            total += one * now
            by_blur += steep * now
            before, now = now, 2.0 * self._turns * now - before
        scale = 1.0 / (1.0 + weight.sum())
        one_way = total * scale
        change = (by_blur - one_way * steeper.sum()) * scale
        sampled, sampled_by_blur = one_way[0] * one_way[1], change[0] * one_way[1] + one_way[0] * change[1]
        return np.array([smooth, sampled, -((blur_px * self._wave_px) ** 2) * smooth, sampled_by_blur])


def _through_aperture(v: FloatArray) -> FloatArray:
    """Return the transfer of a round aperture at frequencies in units of its cut-off: two discs' overlap."""
    half_angle = np.arccos(np.minimum(v, 1.0))
    return np.asarray((2.0 * half_angle - np.sin(2.0 * half_angle)) / np.pi)
