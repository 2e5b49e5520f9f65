"""Many tests, one rate of false alarms: adjusted p-values (S. Holm, Scand. J. Statist. 6, 65, 1979).

The k-th smallest of m p-values is multiplied by m - k + 1, and no adjusted one may be smaller than one before it. The
chance that any true null hypothesis is rejected at level alpha is then at most alpha, however the tests depend on each
other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def holm(p_values: Sequence[float]) -> list[float]:
    """Return adjusted p-values in the given order.

    Raises
    ------
    ValueError
        A value that is no probability.
    """
    p = np.asarray(p_values, dtype=np.float64)
    if p.size == 0:
        return []
    if not np.all((p >= 0.0) & (p <= 1.0)):
        raise ValueError("p-values lie between 0 and 1")
    order = np.argsort(p, kind="stable")
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(p.size, 0, -1)), 1.0)
    return [float(value) for value in adjusted]
