"""Convolution that keeps the rounding errors of a Sun 1e9 times brighter than the limb away from faint pixels.

Fourier transforms leave rounding errors that are even over the image, some 1e-16 of its root of summed squares. Two
cases avoid this:

* The core of a point spread is narrow and steep. The few pixels above 1000 times the median of the lit ones are taken
  out and their kernels added one by one, exact relative to themselves; the rest is transformed.
* The wings are wide and flat, none of their values above a thousandth or so, and the errors shrink with them: 1e-9 of
  the limb for that Sun.

Transforms are padded, so that nothing wraps round. Where the exact result is 0 the transform leaves a rounding error of
either sign; values below 0 are set to 0, and a value farther below than rounding explains is an error. The bytes do not
depend on the number of cores.

Light that leaves the image is lost. The scene outside is guessed: for the core it is the border pixel, for the wings
the mean of what they see inside. A bright pixel is in neither guess.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from horizonval.core.arrays import FloatArray

Border = Literal["edge", "dark"]
"""What lies outside the image: the same as in the border pixel, or nothing."""

_BRIGHT = 1e3
_FEW = 0.01
_MOST_BRIGHT = 4096
_ROUNDING = 1e-14
_ALL_CORES = -1
_KEPT_BYTES = 64_000_000
"""Of the transforms of kernels that stay as they are: those of a camera of 1024 x 1024 pixels."""


def spread_core(image: FloatArray, kernel: FloatArray, border: Border = "edge") -> FloatArray:
    """Return the image (H, W), not below 0, spread with a small kernel (2 r + 1, 2 r + 1), not below 0 and even.

    A bright pixel at the border is not repeated outside: that would be a row of Suns.
    """
    reach = len(kernel) // 2
    bright = _bright_pixels(image)
    rest = image.copy()
    rest[bright] = 0.0
    padded = np.pad(rest, reach, mode="edge" if border == "edge" else "constant")
    height, width = image.shape
    shape = tuple(fft.next_fast_len(n + 2 * reach, real=True) for n in image.shape)
    # The kernel's centre lies on [reach, reach]; with the padding of the image that makes 2 reach.
    transformed = _transformed(kernel, shape, lambda: kernel)
    out = _product(padded, transformed, shape)[2 * reach : 2 * reach + height, 2 * reach : 2 * reach + width].copy()
    _without_rounding_below_zero(out, padded, transformed)
    for row, column in zip(*bright, strict=True):
        top, left = max(row - reach, 0), max(column - reach, 0)
        part = kernel[top - row + reach : height - row + reach, left - column + reach : width - column + reach]
        out[top : top + part.shape[0], left : left + part.shape[1]] += image[row, column] * part
    return out


def spread_wings(image: FloatArray, quadrant: FloatArray, total: float | None = None) -> FloatArray:
    """Return the image spread with a kernel as large as itself, shape (H, W).

    ``quadrant`` (H, W) is the kernel at offsets (0..H - 1, 0..W - 1), even in both. ``total`` is its sum over the whole
    plane: the scene outside the image is then taken, for each pixel, to be the kernel's mean over what is inside
    (bright pixels excepted), so that an even image stays even. Without it the outside is dark.
    """
    if total is None:
        return _dark_outside(image, quadrant)
    limit = _bright_limit(image)
    rest = np.where(image > limit, 0.0, image)
    inside = share_inside(quadrant)
    # A pixel of an image smaller than the core sees none of it through the wings: there they see its mean.
    seen = inside > 0
    out = np.where(seen, _dark_outside(rest, quadrant) * (total / np.where(seen, inside, 1.0)), total * rest.mean())
    bright = image - rest
    return out + _dark_outside(bright, quadrant) if bright.any() else out


def share_inside(quadrant: FloatArray) -> FloatArray:
    """Return the kernel's sum over the image from each of its pixels, shape (H, W); ``quadrant`` as above."""
    corner = quadrant.copy()
    corner[0] /= 2
    corner[:, 0] /= 2
    part = corner.cumsum(axis=0).cumsum(axis=1)
    part += part[::-1]
    return part + part[:, ::-1]


def _dark_outside(image: FloatArray, quadrant: FloatArray) -> FloatArray:
    height, width = image.shape
    shape = tuple(fft.next_fast_len(2 * n - 1, real=True) for n in image.shape)
    transformed = _transformed(quadrant, shape, lambda: _all_quadrants(quadrant, shape))
    out = _product(image, transformed, shape)[:height, :width].copy()
    _without_rounding_below_zero(out, image, transformed)
    return out


def _all_quadrants(quadrant: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return the cyclic kernel of a shape that is even in both offsets."""
    height, width = quadrant.shape
    kernel = np.zeros(shape)
    kernel[:height, :width] = quadrant
    kernel[shape[0] - height + 1 :, :width] = quadrant[:0:-1]
    kernel[:, shape[1] - width + 1 :] = kernel[:, width - 1 : 0 : -1]
    return kernel


def _bright_limit(image: FloatArray) -> float:
    """Return 1000 times the median of what is lit; 0 where next to nothing is lit."""
    lit = image[image > 0]
    return _BRIGHT * float(np.median(lit)) if lit.size > _FEW * image.size else 0.0


def _bright_pixels(image: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the pixels above the limit; at most the 4096 brightest."""
    rows, columns = np.divmod(np.flatnonzero(image > _bright_limit(image)), image.shape[1])
    brightest = np.argsort(-image[rows, columns], kind="stable")[:_MOST_BRIGHT]
    return rows[brightest], columns[brightest]


@dataclass(frozen=True)
class _Transformed:
    """A kernel's transform and the sum of its squares; ``source``: the values that it was made of."""

    source: FloatArray
    spectrum: NDArray[np.complex128]
    squares: float


_kept: OrderedDict[tuple[int, tuple[int, ...]], _Transformed] = OrderedDict()
"""Those of read-only kernels, which cameras have for life; by identity, which holds as long as the source is kept."""


def _transformed(source: FloatArray, shape: tuple[int, ...], lay_out: Callable[[], FloatArray]) -> _Transformed:
    """Return the transform over ``shape`` of the kernel that ``lay_out`` makes of its source."""
    key = (id(source), shape)
    if key in _kept:
        _kept.move_to_end(key)
        return _kept[key]
    kernel = lay_out()
    spectrum = fft.rfft2(kernel, s=shape, workers=_ALL_CORES)
    transformed = _Transformed(source, spectrum, float(np.square(kernel).sum()))
    if not source.flags.writeable:
        _kept[key] = transformed
        while sum(one.spectrum.nbytes + one.source.nbytes for one in _kept.values()) > _KEPT_BYTES:
            _kept.popitem(last=False)
    return transformed


def _product(image: FloatArray, kernel: _Transformed, shape: tuple[int, ...]) -> FloatArray:
    """Return the cyclic convolution over ``shape``."""
    spectrum = fft.rfft2(image, s=shape, workers=_ALL_CORES)
    spectrum *= kernel.spectrum
    out: FloatArray = fft.irfft2(spectrum, s=shape, overwrite_x=True, workers=_ALL_CORES)
    return out


def _without_rounding_below_zero(out: FloatArray, image: FloatArray, kernel: _Transformed) -> None:
    least = float(out.min())
    # Sums of squares and not norms, which would wake every thread of the linear algebra for a small image.
    bound = _ROUNDING * math.sqrt(float(np.square(image).sum()) * kernel.squares)
    if least < -bound:
        raise ArithmeticError(f"convolution left {least:.3g}, rounding explains {bound:.3g}")
    np.maximum(out, 0.0, out=out)
