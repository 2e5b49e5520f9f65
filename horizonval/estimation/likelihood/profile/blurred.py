r"""Profiles over height as lens and pixel blur them, and how they change with the height and with the blur.

Across the limb the lens is a Gaussian of ``s`` pixels, and the pixel's square, seen along the direction ``(c, d)`` of
its columns and rows, the convolution of two boxes of ``c`` and ``d`` pixels. Where a pixel is ``m`` metres wide, on an
even grid of distances across the limb the transform of all is a product, with ``sinc x = sin x / x``::

    T(w) = exp(-(w s m)^2 / 2) sinc(w c m / 2) sinc(w d m / 2),      P_s = F^-1[T F[P]]
    dP_s/dh = F^-1[i w T F[P]],      dP_s / d ln s = -F^-1[(w s m)^2 T F[P]]

The profiles are taken as even about both ends of the grid, so that a level there goes on as it is. They are
transformed once; a step of a fit takes the products alone.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from horizonval.core.arrays import FloatArray


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
        pixel = np.sinc(boxes_m[:, :1] * frequency) * np.sinc(boxes_m[:, 1:] * frequency)
        self._transform = fft.rfft(mirrored, axis=-1) * pixel[:, None]
        self._wave = 2.0 * np.pi * frequency

    def values(self, sigma_m: FloatArray) -> FloatArray:
        """Return the profiles, blurred at every place by a Gaussian of its own, shape (m, k, n)."""
        return self._back(self._transform * self._gauss(sigma_m)[:, None])

    def changes(self, weights: FloatArray, sigma_m: FloatArray, kind: int) -> FloatArray:
        """Return weighted sums of the functions, or what they change by, shape (m, n).

        Parameters
        ----------
        weights : ndarray, shape (m, k)
        sigma_m : ndarray, shape (m,)
        kind : int
            0 for the sum itself, 1 for its derivative by the height, 2 by the logarithm of the blur.
        """
        summed = np.einsum("ij,ijk->ik", weights, self._transform) * self._gauss(sigma_m)
        if kind == 1:
            summed = summed * (1j * self._wave)
        elif kind == 2:
            summed = summed * -((sigma_m[:, None] * self._wave) ** 2)
        return self._back(summed)

    def _gauss(self, sigma_m: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-0.5 * (sigma_m[:, None] * self._wave) ** 2))

    def _back(self, transform: np.ndarray) -> FloatArray:
        full = fft.irfft(transform, n=2 * self._count - 2, axis=-1)
        return np.asarray(full[..., : self._count])
