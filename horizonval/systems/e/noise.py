"""What "Gaussian noise of variance n arcsec on top of 0.1 degree rounding" may mean, and which meaning comes nearest.

The paper gives no unit of a variance (arcsec squared) and no order of noise and rounding. Every reading here is run
through the plain two-ray least squares and compared with the paper's own plain column: nine figures, the distance
being the root mean square of the logarithm of their ratios.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.rotation import itrs_from_gcrs, turn
from horizonval.systems.e.case import (
    EPOCH_UTC,
    NOISE_ARCSEC,
    NOISE_ROUNDING_DEG,
    PUBLISHED_NOISE,
    STATIONS,
    exact_pass,
    rounded,
)
from horizonval.systems.e.localisation.celestial import ARCSEC, celestial_errors, rms
from horizonval.systems.e.localisation.triangulation import triangulate


@dataclass(frozen=True)
class NoiseReading:
    """One reading: the distribution's shape, and whether noise comes before the rounding, after it, or alone."""

    shape: str
    order: str

    @property
    def description(self) -> str:
        """For people."""
        return f"{SHAPES[self.shape][0]}, {ORDERS[self.order]}"


Draw = Callable[[np.random.Generator, tuple[int, ...]], FloatArray]

SHAPES: dict[str, tuple[str, Draw]] = {
    "sigma": ("standard deviation n", lambda rng, shape: rng.standard_normal(shape)),
    "two-sigma": ("n is two standard deviations", lambda rng, shape: 0.5 * rng.standard_normal(shape)),
    "three-sigma": ("n is three standard deviations", lambda rng, shape: rng.standard_normal(shape) / 3.0),
    "fwhm": ("n is the full width at half maximum", lambda rng, shape: rng.standard_normal(shape) / 2.3548),
    "uniform": ("uniform within +-n", lambda rng, shape: rng.uniform(-1.0, 1.0, shape)),
    "variance": ("variance n arcsec^2", lambda rng, shape: rng.standard_normal(shape)),
}
ORDERS = {
    "before": "before rounding",
    "after": "after rounding",
    "alone": "without rounding",
}
MEANINGS = tuple(NoiseReading(shape, order) for shape in SHAPES for order in ORDERS)
LARGEST = NoiseReading("sigma", "before")
"""The reading with the most noise."""


def noisy(
    meaning: NoiseReading,
    amount: float,
    rng: np.random.Generator,
    draws: int | None = None,
    angles_rad: FloatArray | None = None,
) -> FloatArray:
    """Return angles with noise and rounding, shape (n, 4), or (draws, n, 4); the pass's exact ones, or those given."""
    exact = exact_pass().angles_rad if angles_rad is None else angles_rad
    scale = np.sqrt(amount) if meaning.shape == "variance" else amount
    shape = exact.shape if draws is None else (draws, *exact.shape)
    noise = scale * ARCSEC * SHAPES[meaning.shape][1](rng, shape)
    if meaning.order == "before":
        return rounded(exact + noise, NOISE_ROUNDING_DEG)
    if meaning.order == "after":
        return rounded(exact, NOISE_ROUNDING_DEG) + noise
    return exact + noise


def plain_rms(angles_rad: FloatArray) -> FloatArray:
    """Return the errors, shape (..., 3), of the plain way from angles of shape (..., n, 4)."""
    truth = exact_pass()
    first, second = STATIONS
    u1 = first.directions_itrs(angles_rad[..., 0], angles_rad[..., 1])
    u2 = second.directions_itrs(angles_rad[..., 2], angles_rad[..., 3])
    r_itrs = triangulate(first.r_itrs, second.r_itrs, u1, u2)[0]
    back = np.swapaxes(itrs_from_gcrs(EPOCH_UTC, truth.times_s), -1, -2)
    return rms(celestial_errors(turn(back, r_itrs), truth.r_gcrs))


def plain_column(meaning: NoiseReading, rng: np.random.Generator, draws: int) -> FloatArray:
    """Return the plain column's nine figures, shape (3, 3), averages over independent draws."""
    return np.array([plain_rms(noisy(meaning, n, rng, draws)).mean(axis=0) for n in NOISE_ARCSEC])


def distance(column: FloatArray) -> float:
    """Return how far a plain column is from the published one: 0.1 is about 10 %."""
    return float(np.sqrt(np.mean(np.log(column / np.array(PUBLISHED_NOISE["plain"])) ** 2)))
