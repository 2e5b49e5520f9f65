"""Sixteen benches, each with every error at its stated size: a two-level design of experiments.

The signs of the errors are unknown, and the RMS of one bench depends on them: errors add up or cancel. So sixteen
benches are rendered whose signs are the columns of a Hadamard matrix (Plackett and Burman, Biometrika 33, 305, 1946).
Any two columns are orthogonal. To first order the mean square over the benches is then the sum of the squares that the
errors cause one by one, whatever the signs; and the mean of ``sign * error of the tilt`` over the benches is what one
error alone does, so that one run of the design gives all sensitivities.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from scipy.linalg import hadamard

from horizonval.core.arrays import FloatArray
from horizonval.systems.b.rig.bench import BenchErrors

BENCHES = 16
NAMES = tuple(f.name for f in fields(BenchErrors))


def signs() -> FloatArray:
    """Return the sign of every error on every bench, shape (16, 14), in the order of :data:`NAMES`."""
    return np.asarray(hadamard(BENCHES)[:, 1 : 1 + len(NAMES)], dtype=float)


def benches(stated: BenchErrors) -> list[BenchErrors]:
    """Return the sixteen benches; equal ones, where errors are zero, are kept."""
    return [stated.times(row) for row in signs()]


def main_effects(values: FloatArray) -> FloatArray:
    """Return what each error at its stated, positive size does to a value, shape (14, ...).

    Parameters
    ----------
    values : ndarray, shape (16, ...)
        Of the benches, in order.

    Notes
    -----
    Products of two errors are left in: of the second order, 0.02 deg at the stated sizes.
    """
    return np.asarray(np.tensordot(signs(), values, axes=(0, 0)) / BENCHES)


def unused_effect(values: FloatArray) -> FloatArray:
    """Return the contrast of the one column that no error has, shape (...): noise, and products of errors."""
    return np.asarray(np.tensordot(hadamard(BENCHES)[:, -1].astype(float), values, axes=(0, 0)) / BENCHES)
