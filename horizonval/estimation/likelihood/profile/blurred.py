r"""Profiles over height as lens and pixel blur them, and how they change with the height, the blur and the lens.

Across the limb the pixel's square, seen along the direction ``(c, d)`` of its columns and rows, is the convolution of
two boxes of ``c`` and ``d`` pixels. Where a pixel is ``m`` metres wide, on an even grid of distances across the limb
the transform of all is a product, with ``sinc x = sin x / x``::

    T(w) = L(w) sinc(w c m / 2) sinc(w d m / 2),      P_s = F^-1[T F[P]],      dP_s/dh = F^-1[i w T F[P]]

The lens is a Gaussian of ``s`` pixels. What a lens really is differs from it most at a period of two pixels, where it
lets more through: from a smooth Gaussian to one of samples at whole pixels, as wide, leads the unknown ``q``::

    L = (1 - q) exp(-(w s m)^2 / 2) + q G(w c m) G(w d m),      G(x) = sum_k exp(-k^2 / 2 s^2) cos k x / its value at 0

Of pixels that are small beside the limb's depth, or a blur of a pixel and more, both are the same.

The profiles are taken as even about both ends of the grid, so that a level there goes on as it is. They are
transformed once; a step of a fit takes the products alone.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from horizonval.core.arrays import FloatArray

REACH_BLURS = 5.0
"""To which samples at whole pixels are summed up: 4e-6 of the middle one."""
LEAST_BLUR_PX = 0.15
"""Below it no sample but the middle one is left."""


class BlurredProfiles:
    """Profiles at some places along the limb.

    Parameters
    ----------
    profiles : ndarray, shape (m, k, n)
        Of k functions at m places, on an even grid of heights.
    step_m : float
        Of the grid.
    boxes_m : ndarray, shape (m, 2)
        Height that a pixel is wide along its columns and along its rows.
    """

    def __init__(self, profiles: FloatArray, step_m: float, boxes_m: FloatArray) -> None:
        self._count = profiles.shape[-1]
        mirrored = np.concatenate([profiles, profiles[..., -2:0:-1]], axis=-1)
        frequency = np.fft.rfftfreq(mirrored.shape[-1], step_m)
        by_column, by_row = boxes_m[:, :1] * frequency, boxes_m[:, 1:] * frequency
        pixel = np.sinc(by_column) * np.sinc(by_row)
        self._transform = fft.rfft(mirrored, axis=-1) * pixel[:, None]
        self._wave = 2.0 * np.pi * frequency
        self._turns = np.cos(2.0 * np.pi * np.array([by_column, by_row]))
        self._wave_px = np.hypot(*boxes_m.T)[:, None] * self._wave
        nothing = np.empty((0, 0))
        self._known = np.nan, (nothing, nothing, nothing, nothing)

    def values(self, blur_px: float, sharpness: float) -> FloatArray:
        """Return the blurred profiles, shape (m, k, n); parameters as for :meth:`changes`."""
        return self._back(self._transform * self._lens(blur_px, sharpness)[:, None])

    def changes(self, weights: FloatArray, blur_px: float, sharpness: float, kind: int) -> FloatArray:
        """Return weighted sums of the functions, or what they change by, shape (m, n).

        Parameters
        ----------
        weights : ndarray, shape (m, k)
        blur_px : float
            The lens's ``s``.
        sharpness : float
            The lens's ``q``.
        kind : int
            0 for the sum itself, 1 for its derivative by the height, 2 by the logarithm of the blur, 3 by the
            sharpness.
        """
        summed = np.einsum("ij,ijk->ik", weights, self._transform)
        if kind == 0:
            return self._back(summed * self._lens(blur_px, sharpness))
        if kind == 1:
            return self._back(summed * (1j * self._wave) * self._lens(blur_px, sharpness))
        smooth, sampled, smooth_by_blur, sampled_by_blur = self._parts(blur_px)
        if kind == 2:
            return self._back(summed * (smooth_by_blur + sharpness * (sampled_by_blur - smooth_by_blur)))
        return self._back(summed * (sampled - smooth))

    def _lens(self, blur_px: float, sharpness: float) -> FloatArray:
        smooth, sampled, _, _ = self._parts(blur_px)
        return np.asarray(smooth + sharpness * (sampled - smooth))

    def _parts(self, blur_px: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the smooth and the sampled Gaussian's transform, shape (m, f) each, and both's change by the blur."""
        if self._known[0] == blur_px:
            return self._known[1]
        smooth = np.exp(-0.5 * (blur_px * self._wave_px) ** 2)
        place = np.arange(1, int(np.ceil(REACH_BLURS * blur_px)) + 1)
        weight = 2.0 * np.exp(-0.5 * (place / max(blur_px, LEAST_BLUR_PX)) ** 2)
        steeper = weight * (place / max(blur_px, LEAST_BLUR_PX)) ** 2
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
        parts = (
            smooth,
            one_way[0] * one_way[1],
            -((blur_px * self._wave_px) ** 2) * smooth,
            change[0] * one_way[1] + one_way[0] * change[1],
        )
        self._known = blur_px, parts
        return parts

    def _back(self, transform: np.ndarray) -> FloatArray:
        full = fft.irfft(transform, n=2 * self._count - 2, axis=-1)
        return np.asarray(full[..., : self._count])
