"""From an ensemble of profiles to its mean and modes, place by place and smooth from one to the next.

At a place of the table with departures ``d`` from the mean, of covariance ``C`` over heights (of the place and, with a
half and a quarter of the weight, its neighbours, which share one climate), and weights ``W`` of heights::

    W^1/2 C W^1/2 = U S U^T,    a_k = S_k^-1/2 U_k^T W^1/2 d,    mode_k = E[a_k d] = S_k^-1/2 (U_k^T W^1/2 C)

so that ``a ~ (0, 1)`` and ``C = sum mode mode^T + rest``. Any rotation ``Q`` of the modes among themselves leaves this
as it is. It is chosen at every place to bring them nearest to those of the whole ensemble, ``R`` (Procrustes)::

    Q = V_1 V_2^T,      R W M^T = V_1 s V_2^T,     M the place's modes

without which modes of neighbouring places, of any sign and order, could not be interpolated.

Below are the places of the tables, and arrays that took long to make, stored so that an interrupted run resumes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.cache import cached_arrays, keep_arrays

BESIDE = 0.5
"""Weight of a place's neighbours along an axis, its own is 1."""


@dataclass(frozen=True)
class Modes:
    """Modes of departures (A, B, N, H): ``modes`` (A, B, K, H), ``left_variance`` and ``mean`` (A, B, H).

    ``coefficients`` (A, B, N, K): those of the ensemble's states.
    """

    mean: FloatArray
    modes: FloatArray
    left_variance: FloatArray
    coefficients: FloatArray


def smoothed(values: FloatArray, *, around: bool, beside: float = BESIDE) -> FloatArray:
    """Return values (A, B, ...) averaged with their neighbours; the second axis is a circle if ``around``."""
    for axis, closed in ((0, False), (1, around)):
        if values.shape[axis] == 1 or beside == 0.0:
            continue
        total, weight = np.zeros_like(values), np.zeros([n if k == axis else 1 for k, n in enumerate(values.shape)])
        places = np.arange(values.shape[axis])
        for shift in (-1, 0, 1):
            other = places + shift
            inside = np.full(len(places), True) if closed else (other >= 0) & (other < len(places))
            share = np.where(inside, beside if shift else 1.0, 0.0).reshape(weight.shape)
            total += share * np.take(values, other % len(places), axis=axis)
            weight += share
        values = total / weight
    return values


@dataclass(frozen=True)
class SceneMode:
    """``mode`` and ``mean`` (A, B, H); ``of_state`` (A, B, N, H): what a state's departures have of it."""

    mode: FloatArray
    mean: FloatArray
    of_state: FloatArray


def scene_mode(
    departures: FloatArray,
    has: FloatArray,
    chance: FloatArray | float,
    *,
    around: bool,
    shares: FloatArray | None = None,
    beside: float = BESIDE,
) -> SceneMode:
    """Return the mode of what a scene has everywhere or nowhere, clouds above all.

    With ``E`` the mean departure of states that have it and ``p`` its chance, a state's part is E or 0: of mean ``p E``
    and standard deviation ``sqrt(p (1 - p)) E``.

    ``departures``: (A, B, N, H); ``has``: (1, B, N) or (A, B, N), 1 of states that have it, else 0; ``chance``: a
    number or (A, B, 1); other parameters as of :func:`empirical_modes`.
    """
    weight = has * (1.0 if shares is None else shares)
    total = smoothed(
        np.einsum("abn,abnh->abh", np.broadcast_to(weight, departures.shape[:3]), departures),
        around=around,
        beside=beside,
    )
    count = smoothed(np.broadcast_to(weight.sum(axis=2), departures.shape[:2]), around=around, beside=beside)
    effect = total / np.maximum(count, 1e-12)[..., None]
    of_state = effect[:, :, None] * np.broadcast_to(has, departures.shape[:3])[..., None]
    return SceneMode(np.sqrt(chance * (1.0 - chance)) * effect, chance * effect, of_state)


def empirical_modes(
    departures: FloatArray,
    weights: FloatArray,
    count: int,
    *,
    around: bool,
    shares: FloatArray | None = None,
    beside: float = BESIDE,
) -> Modes:
    """Return the modes of an ensemble.

    ``departures``, (A, B, N, H): of N states from anything that is the same for all states of a place; ``weights``,
    (H,); ``count``: K; ``around``: whether the second axis is a circle; ``shares``, (N,): probabilities of the states,
    equal by default; ``beside``: weight of a place's neighbours, above 0 where states of a place are few.
    """
    share = np.full(departures.shape[2], 1.0 / departures.shape[2]) if shares is None else shares
    mean = smoothed(np.einsum("n,abnh->abh", share, departures), around=around, beside=beside)
    d = departures - mean[:, :, None]
    own = np.einsum("n,abnh,abng->abhg", share, d, d, optimize=True)
    covariance = smoothed(own, around=around, beside=beside)
    root = np.sqrt(weights)
    reference = _leading(covariance.mean(axis=(0, 1)), root, count)[0]
    shape = (*d.shape[:2], count, d.shape[3])
    modes, coefficients = np.zeros(shape), np.zeros((*d.shape[:3], count))
    for i, j in np.ndindex(*d.shape[:2]):
        found, reader = _leading(covariance[i, j], root, count)
        left, _, right = np.linalg.svd((reference * weights) @ found.T)
        modes[i, j] = (left @ right) @ found
        coefficients[i, j] = d[i, j] @ ((left @ right) @ reader).T
    left_variance = np.einsum("abhh->abh", covariance) - np.sum(modes**2, axis=2)
    return Modes(mean, modes, np.maximum(left_variance, 0.0), coefficients)


def _leading(covariance: FloatArray, root: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return modes (K, H), and what reads their coefficients off departures, (K, H); zero where there is nothing."""
    strength, vectors = np.linalg.eigh(root[:, None] * covariance * root)
    strength, vectors = strength[::-1][:count], vectors[:, ::-1][:, :count]
    known = strength > 1e-10 * max(float(strength[0]), 1e-300)
    reader = (
        np.where(known[:, None], (vectors * root[:, None]).T, 0.0) / np.sqrt(np.where(known, strength, 1.0))[:, None]
    )
    return reader @ covariance, reader


_BELOW_KM = (
    *(-400.0, -300.0, -220.0, -160.0, -120.0, -90.0, -65.0, -45.0, -30.0, -20.0),
    *(-14.0, -10.0, -7.0, -5.0, -3.5, -2.5, -1.5, -0.5),
)
_AROUND_GROUND_KM = (0.0, 0.5, 1.0, 1.4, 1.7, 2.0, 2.5)
_ABOVE_KM = (*range(3, 71), 73.0, 76.0, 80.0, 85.0, 90.0, 95.0)
HEIGHT_M = 1e3 * np.array([*_BELOW_KM, *_AROUND_GROUND_KM, *_ABOVE_KM])
"""Heights of the lines' lowest points. Refraction raises the apparent ground by 1.4 to 2 km: steps are fine there. No
radiance above the last."""

LATITUDE_DEG = np.linspace(-90.0, 90.0, 19)
MONTHS = np.arange(1.0, 13.0)
SUN_ZENITH_DEG = np.array([0.0, 25.0, 45.0, 60.0, 70.0, 76.0, 80.0, 83.0, 86.0, 88.0, 90.0, 92.0, 94.0, 96.0, 99.0])
SUN_AZIMUTH_DEG = np.array([0.0, 20.0, 45.0, 75.0, 105.0, 140.0, 180.0])
_KNOWN_HIGH = (0.0, 25.0, 45.0, 60.0, 69.0, 75.0, 79.0, 82.0, 84.5, 86.5)
_KNOWN_LOW = (*range(88, 94), 94.5, 96.0, 98.0, 100.0, 103.0)
KNOWN_ZENITH_DEG = np.array([*_KNOWN_HIGH, *_KNOWN_LOW])
KNOWN_AZIMUTH_DEG = np.array([0.0, 10.0, 20.0, 35.0, 50.0, 70.0, 90.0, 115.0, 145.0, 180.0])
"""Nodes of sunlit tables of one known air: splines through them leave 0.1 % of a profile's shape up to 88 deg, 0.6 %
(rms) from 88 to 95 deg; the ensemble's tables, whose spread of airs hides the error, leave 0.3 and 1.5 %."""


def edge_weights(height_m: FloatArray) -> FloatArray:
    """Return weights of heights for the choice of modes: kilometres of height from 30 km below the ground upwards.

    Deeper a profile is smooth, and a fit leaves its brightness free.
    """
    step = np.gradient(height_m) / 1e3
    return np.where(height_m >= -30e3, step, 0.0) * np.where(height_m < 0.0, 0.3, 1.0)


def kept_arrays(path: Path, names: Iterable[str], make: Callable[[], dict[str, FloatArray]]) -> dict[str, FloatArray]:
    """Return the arrays of a file; if it is missing, damaged or without these names, make them and put them there."""
    wanted = list(names)
    kept = cached_arrays(path, lambda arrays: {name: arrays[name] for name in wanted})
    if kept is None:
        kept = make()
        keep_arrays(path, kept)
    return kept
