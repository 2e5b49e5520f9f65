"""What RRTMG-LW adds to the key gases of a band: water vapour's continuum, minor gases, nitric acid, halocarbons.

Continuum, with w = c_H2O / dry air and the factor ``F = c_H2O (p / 1013 hPa) (296 K / T) / (1 + w)``: foreign
``F foreign(T)`` and self ``F w self(T)``. Minor gases: their column times a table over temperature, in some bands also
over the mixture of the key gases. Where a minor gas is so strong that it saturates within the classes, its column grows
more slowly beyond R0 times the reference air's, ``R = (c / dry) / chi``::

    column = (d + (R - d)^h) chi dry,    R > R0
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.gases.rrtmg_interpolation import (
    LOWER_KEY,
    UPPER_KEY,
    Columns,
    TablePlace,
    mixture_weights,
    reference_vmr,
    table,
)


@dataclass(frozen=True)
class _Minor:
    """A minor gas of a band: ``level`` of the reference air whose ratio of key gases makes its eta (0: no eta)."""

    gas: str
    level: int = 0
    saturation: tuple[float, float, float] | None = None


_N2O, _CO2_WINDOW = (1.5, 0.5, 0.65), (3.0, 2.0, 0.65)
_LOWER: dict[int, tuple[_Minor, ...]] = {
    3: (_Minor("n2o", 3, _N2O),),
    5: (_Minor("o3", 7),),
    6: (_Minor("co2", 0, (3.0, 2.0, 0.77)),),
    7: (_Minor("co2", 3, (3.0, 3.0, 0.79)),),
    8: (_Minor("co2", 0, _CO2_WINDOW), _Minor("o3"), _Minor("n2o")),
    9: (_Minor("n2o", 3, _N2O),),
}
_UPPER: dict[int, tuple[_Minor, ...]] = {
    3: (_Minor("n2o", 13, _N2O),),
    7: (_Minor("co2", 0, (3.0, 2.0, 0.79)),),
    8: (_Minor("co2", 0, _CO2_WINDOW), _Minor("n2o")),
    9: (_Minor("n2o", 0, _N2O),),
}
_HALOCARBONS: dict[int, dict[str, str]] = {
    5: {"ccl4": "b5_ccl4"},
    6: {"cfc11": "b6_cfc11", "cfc12": "b6_cfc12"},
    8: {"cfc12": "b8_cfc12", "hcfc22": "b8_cfc22"},
}
_NITRIC_ACID = (6, 9)


def continuum(band: int, columns: Columns, *, upper: bool) -> FloatArray:
    """Return the part of water vapour's continuum [1/m], shape (n, 16); above 95.58 hPa in band 3 only."""
    t, water = columns.temperature_k, columns.gas["h2o"]
    share = water / columns.dry
    factor = water * np.exp(columns.ln_p) * (296.0 / 1013.0) / t / (1.0 + share)
    foreign = table(f"b{band}_foreign")
    if upper:
        if band != 3:
            return np.zeros((len(t), foreign.shape[-1]))
        y = ((t - 188.0) / 36.0 - 1.0)[:, None]
        return factor[:, None] * (foreign[2] + y * (foreign[3] - foreign[2]))
    y = (332.0 - t) / 36.0
    i = np.clip(np.trunc(y).astype(int), 1, 2)
    total = factor[:, None] * _line(foreign, i, y - i)
    own = (t - 188.0) / 7.2
    i = np.clip(np.trunc(own).astype(int) - 7, 1, 9)
    return total + (factor * share)[:, None] * _line(table(f"b{band}_self"), i, own - i - 7)


def _line(values: FloatArray, i: np.ndarray, beyond: FloatArray) -> FloatArray:
    """Return the straight line through rows i and i + 1, counted from 1."""
    return values[i - 1] + beyond[:, None] * (values[i] - values[i - 1])


def minor_gases(band: int, place: TablePlace, columns: Columns, *, upper: bool) -> FloatArray:
    """Return the minor gases' part of k [1/m], shape (n, 16)."""
    y = (columns.temperature_k - 180.8) / 7.2
    row = np.clip(np.trunc(y).astype(int), 1, 18)
    beyond = (y - row)[:, None]
    total = np.zeros((len(y), 16))
    for minor in (_UPPER if upper else _LOWER).get(band, ()):
        k = table(f"b{band}_minor_{minor.gas}_{'up' if upper else 'low'}")
        amount = _amount(minor, place, columns)[:, None]
        mixtures = k.shape[1]
        if mixtures == 1:
            total += amount * (k[row - 1, 0] * (1.0 - beyond) + k[row, 0] * beyond)
            continue
        gases = (UPPER_KEY if upper else LOWER_KEY)[band]
        ratio = float(reference_vmr(gases[0])[minor.level - 1] / reference_vmr(gases[1])[minor.level - 1])
        _, node, v, _ = mixture_weights(gases, ratio, columns, mixtures)
        v = v[:, None]
        cold = k[row - 1, node] * (1.0 - v) + k[row - 1, node + 1] * v
        warm = k[row, node] * (1.0 - v) + k[row, node + 1] * v
        total += amount * (cold * (1.0 - beyond) + warm * beyond)
    return total


def _amount(minor: _Minor, place: TablePlace, columns: Columns) -> FloatArray:
    column = columns.gas[minor.gas]
    if minor.saturation is None:
        return column
    start, d, power = minor.saturation
    usual = reference_vmr(minor.gas)[place.level] * columns.dry
    ratio = column / usual
    return np.where(ratio > start, (d + np.maximum(ratio - d, 0.0) ** power) * usual, column)


def nitric_acid(band: int, columns: Columns) -> FloatArray | float:
    """Return nitric acid's part of k [1/m], shape (n, 16), or 0."""
    if band not in _NITRIC_ACID or "hno3" not in columns.vmr:
        return 0.0
    return (columns.vmr["hno3"] * columns.air)[:, None] * table(f"b{band}_hno3")


def halocarbons(band: int, columns: Columns) -> FloatArray | float:
    """Return the halocarbons' part of k [1/m], shape (n, 16), or 0."""
    total: FloatArray | float = 0.0
    for gas, name in _HALOCARBONS.get(band, {}).items():
        if gas in columns.vmr:
            total = total + (columns.vmr[gas] * columns.dry)[:, None] * table(name)
    return total
