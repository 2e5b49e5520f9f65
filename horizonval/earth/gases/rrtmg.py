"""Thermal absorption of any clear air: RRTMG-LW's look-up, bands 3 to 9 (500 to 1390 cm-1), 16 g points each.

Inside a band the spectrum is sorted by absorption into 16 classes ("g points"), from weak to strong. What each absorbs
follows from pressure p, temperature T and the gases' volume mixing ratios x. With the air's number density
``n = p / (k T)`` and columns ``c = x n`` of a metre in 1e20 molecules per cm2,

    k = sum over the key gases' table + water vapour's continuum + minor gases + halocarbons and nitric acid

Key gases (two of them in most bands) are tabulated at 59 levels 0.2 apart in ln p, five temperatures 15 K apart around
that of the midlatitude summer, and up to nine mixtures ``eta = c_a / (c_a + r c_b)`` (:mod:`.rrtmg_interpolation`); all
the rest depends on temperature alone, see :mod:`.rrtmg_rest`. One set of tables serves pressures above 95.58 hPa
(ln p/hPa > 4.56), another those below: gases and their order change there, and k jumps, by a factor of 6 (median over
the classes) in band 8, 1.5 in band 9 and 4 % and less elsewhere.

Added to RRTMG: nitric acid in bands 6 and 9 (LOWTRAN7's coefficients on the g points); band 6 above 95.58 hPa, where
RRTMG has nothing (its lower tables at 95.58 hPa, their key part in proportion to the pressure); air above 0.00966 hPa
(absorption per molecule goes on as between 0.0263 and 0.00966 hPa, with an exponent of the pressure from 0 to 1).

The look-up equals the compiled original (ecRad's setcoef and gas optical depths, 4000 random states) to 2e-8 in the
median, 3e-6 in 99.9 % and 9e-4 at worst, next to a change of sign. It is exact with respect to RRTMG, not to nature:
see :mod:`horizonval.earth.spectral.thermal_accuracy`. Temperatures beyond the nodes go on linearly, as in RRTMG (an
eighth of real levels below 60 km are colder, by up to 43 K: continuing ln k instead would move the height of half the
14.0 to 16.3 um plateau by up to 0.18 km in the polar winter, 0.12 km elsewhere); where that turns k negative it is 0
(0.01 % of a band in real states). Local thermodynamic equilibrium; no scattering.

Source: Mlawer et al. 1997, J. Geophys. Res. 102, 16663; tables of RRTMG-LW v4.85 as distributed with ecRad.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.gases.rrtmg_interpolation import Columns, TablePlace, key_absorption, table
from horizonval.earth.gases.rrtmg_rest import continuum, halocarbons, minor_gases, nitric_acid

BANDS = (3, 4, 5, 6, 7, 8, 9)
"""RRTMG-LW's numbers; the first axis of what :func:`absorption_per_m` returns."""
CLASSES = 16
KEY_GASES = ("h2o", "co2", "o3", "n2o", "ch4")
"""Must be given; the rest may be left out."""
OTHER_GASES = ("hno3", "cfc11", "cfc12", "hcfc22", "ccl4")
SEAM_LN_HPA = 4.56
SEAM_LN_PA = SEAM_LN_HPA + float(np.log(100.0))
SEAM_PA = 100.0 * float(np.exp(SEAM_LN_HPA))
"""Where the lower atmosphere's tables end and the upper ones begin."""
FLOOR_PER_M = 1e-16
_TOP_LN_HPA = -4.64
_UPPER_FACTOR = (4, 7)
_BLOCK = 4096
"""Levels looked up at a time: what they need stays in the processor's cache."""


def absorption_per_m(
    pressure_pa: FloatArray,
    temperature_k: FloatArray,
    vmr: Mapping[str, FloatArray],
    bands: Sequence[int] = tuple(range(len(BANDS))),
    upper_share: FloatArray | None = None,
) -> FloatArray:
    """Return the absorption coefficient of clear air for every class of every band.

    Parameters
    ----------
    pressure_pa, temperature_k : ndarray, shape (...)
    vmr : mapping of str to ndarray
        Volume mixing ratios, broadcast to that shape: ``h2o``, ``co2``, ``o3``, ``n2o``, ``ch4`` (parts of the moist
        air; at least 1e-30 is taken) and, where there are any, ``hno3`` (likewise), ``cfc11``, ``cfc12``, ``hcfc22``,
        ``ccl4`` (of the dry air).
    bands : sequence of int
        Places in :data:`BANDS`; default all seven.
    upper_share : ndarray, shape (...), optional
        Weights, 0 to 1, of the upper atmosphere's tables; default 0 above 95.58 hPa and 1 below.

    Returns
    -------
    ndarray, shape (len(bands), 16, ...)
        1/m, at least 1e-16.

    Raises
    ------
    ValueError
        A key gas missing, or a gas that is not known.
    """
    unknown = sorted(set(vmr) - {*KEY_GASES, *OTHER_GASES})
    missing = [gas for gas in KEY_GASES if gas not in vmr]
    if unknown or missing:
        raise ValueError(f"gases unknown: {unknown}, missing: {missing}")
    pressure, temperature = np.broadcast_arrays(
        np.asarray(pressure_pa, dtype=np.float64), np.asarray(temperature_k, dtype=np.float64)
    )
    shape = pressure.shape
    p, t = pressure.ravel(), temperature.ravel()
    x = {gas: np.broadcast_to(np.asarray(value, dtype=np.float64), shape).ravel() for gas, value in vmr.items()}
    ln_p = np.log(p / 100.0)
    k = np.zeros((len(bands), p.size, CLASSES))
    by_pressure = (ln_p <= SEAM_LN_HPA).astype(np.float64)
    upper = by_pressure if upper_share is None else np.broadcast_to(upper_share, shape).ravel()
    top = ln_p < _TOP_LN_HPA
    parts = ((_lower, 1.0 - upper), (_upper, np.where(top, 0.0, upper)), (_top, np.where(top, upper, 0.0)))
    for function, share in parts:
        chosen = np.flatnonzero(share)
        for first in range(0, chosen.size, _BLOCK):
            i = chosen[first : first + _BLOCK]
            columns = Columns.of(ln_p[i], t[i], {gas: value[i] for gas, value in x.items()})
            found = np.maximum(function(columns, bands), 0.0) + _additions(columns, bands)
            k[:, i] += share[i][:, None] * found
    return np.moveaxis(np.maximum(k, FLOOR_PER_M), 2, 1).reshape(len(bands), CLASSES, *shape)


def _lower(columns: Columns, bands: Sequence[int]) -> FloatArray:
    """Return k above 95.58 hPa, shape (bands, n, 16)."""
    place = TablePlace.below(columns.ln_p, columns.temperature_k)
    total = []
    for b in bands:
        band = BANDS[b]
        k = key_absorption(band, place, columns) + continuum(band, columns, upper=False)
        total.append(k + minor_gases(band, place, columns, upper=False))
    return np.stack(total)


def _upper(columns: Columns, bands: Sequence[int]) -> FloatArray:
    """Return k from 95.58 hPa to 0.00966 hPa, shape (bands, n, 16)."""
    place, seam = TablePlace.above(columns.ln_p, columns.temperature_k), TablePlace.at_seam(columns.temperature_k)
    total = []
    for b in bands:
        band = BANDS[b]
        if band == 6:
            k = key_absorption(band, seam, columns) * np.exp(columns.ln_p - SEAM_LN_HPA)[:, None]
            k = k + continuum(band, columns, upper=False) + minor_gases(band, seam, columns, upper=False)
        else:
            k = key_absorption(band, place, columns) + continuum(band, columns, upper=True)
            k = k + minor_gases(band, place, columns, upper=True)
            if band in _UPPER_FACTOR:
                k = k * table(f"b{band}_up_factor")
        total.append(k)
    return np.stack(total)


def _top(columns: Columns, bands: Sequence[int]) -> FloatArray:
    """Return k above 0.00966 hPa, shape (bands, n, 16): per molecule a power of the pressure."""
    per_molecule = []
    for ln_there in (_TOP_LN_HPA, _TOP_LN_HPA + 1.0):
        there = Columns.of(np.full_like(columns.ln_p, ln_there), columns.temperature_k, columns.vmr)
        per_molecule.append(np.maximum(_upper(there, bands), FLOOR_PER_M) / there.air[:, None])
    slope = np.clip(np.log(per_molecule[1] / per_molecule[0]), 0.0, 1.0)
    return per_molecule[0] * np.exp(slope * (columns.ln_p - _TOP_LN_HPA)[:, None]) * columns.air[:, None]


def _additions(columns: Columns, bands: Sequence[int]) -> FloatArray:
    """Return what nitric acid and halocarbons absorb at any height, shape (bands, n, 16)."""
    k = np.zeros((len(bands), len(columns.ln_p), CLASSES))
    for row, b in enumerate(bands):
        k[row] += nitric_acid(BANDS[b], columns) + halocarbons(BANDS[b], columns)
    return k
