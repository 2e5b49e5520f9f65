"""Thermal absorption of any clear air: RRTMG-LW's tables, bands 3 to 9 (500 to 1390 cm-1), 16 g points each.

Inside a band the spectrum is sorted by absorption into 16 classes ("g points"), from weak to strong. The absorption of
each follows from pressure p, temperature T and the gases' volume mixing ratios x. With the air's number density ``n = p
/ (k T)`` and columns ``c = x n`` of a metre in 1e20 molecules per cm2,

    k = sum over the key gases' table + water vapour's continuum + minor gases + halocarbons and nitric acid

One set of tables applies above 95.58 hPa (ln p/hPa > 4.56), another below: gases and their order change there, and k
jumps, by a factor of 6 (median over the classes) in band 8, 1.5 in band 9 and 4 % and less elsewhere.

**Key gases** (two in most bands) are tabulated at 59 levels ln(p/hPa) = 6.96, 6.76 ... -4.64, five temperatures 15 K
apart around that of the midlatitude summer, and up to nine mixtures eta. Between levels j and j + 1 the weights are 1 -
f and f, ``f = 5 (ln p_j - ln p)``; between the temperature nodes of each level u, ``u = (T - T_m) / 15 K`` less the
node, not limited. A single key gas's column is multiplied by the mean of the four nodes. With two, a and b, for each
level

    C = c_a + r c_b,    r = chi_a / chi_b of the level's reference air,    eta = c_a / C

and C is multiplied by the mean over eta as well: linear, but in the lower atmosphere by a quartic over three nodes next
to eta = 0 and 1, where a gas appears or disappears.

**Continuum**, with w = c_H2O / dry air and the factor ``F = c_H2O (p / 1013 hPa) (296 K / T) / (1 + w)``: foreign ``F
foreign(T)`` and self ``F w self(T)``.

**Minor gases**: their column times a table over temperature, in some bands also over the mixture of the key gases. The
column of a gas that saturates within the classes grows more slowly beyond R0 times the reference air's, ``R = (c / dry)
/ chi``::

    column = (d + (R - d)^h) chi dry,    R > R0

**Added to RRTMG**: nitric acid in bands 6 and 9 (LOWTRAN7's coefficients on the g points); band 6 below 95.58 hPa,
where RRTMG has nothing (its lower tables at 95.58 hPa, their key part in proportion to the pressure); air below 0.00966
hPa (absorption per molecule continues as between 0.0263 and 0.00966 hPa, with an exponent of the pressure from 0 to 1).

The result equals the compiled original (ecRad's setcoef and gas optical depths, 4000 random states) to 2e-8 in the
median, 3e-6 in 99.9 % and 9e-4 at worst, next to a change of sign. :mod:`horizonval.earth.spectral.thermal_absorption`
states the accuracy with respect to nature. Temperatures beyond the nodes are extrapolated linearly, as in RRTMG;
negative k becomes 0 (0.01 % of a band in real states). Local thermodynamic equilibrium; no scattering.

Source: Mlawer et al. 1997, J. Geophys. Res. 102, 16663; tables of RRTMG-LW v4.85 as distributed with ecRad.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.tables import npz

BOLTZMANN = 1.380649e-23
FILE = "rrtmg_lw.npz"
_PER_CM2 = 1e-24
"""Factor from molecules per m3 to 1e20 molecules per cm2 in a metre."""
_LEAST = 1e-30
"""Mixing ratio that replaces zero: eta needs both key gases."""
_NODES_K, _LEVELS_PER_LN = 15.0, 5.0
_LOWER_LEVELS = 13
_STRETCHED = 0.125
SEAM_LN_HPA = 4.56
"""Logarithm of the pressure [hPa] between the tables of the lower and the upper atmosphere."""

LOWER_KEY: dict[int, tuple[str, ...]] = {
    3: ("h2o", "co2"), 4: ("h2o", "co2"), 5: ("h2o", "co2"), 6: ("h2o",), 7: ("h2o", "o3"), 8: ("h2o",),
    9: ("h2o", "ch4"),
}  # fmt: skip
UPPER_KEY: dict[int, tuple[str, ...]] = {
    3: ("h2o", "co2"), 4: ("o3", "co2"), 5: ("o3", "co2"), 7: ("o3",), 8: ("o3",), 9: ("ch4",),
}  # fmt: skip


def table(name: str) -> FloatArray:
    """Return an array of the tables."""
    return np.asarray(npz(FILE)[name])


@cache
def reference_vmr(gas: str) -> FloatArray:
    """Return the mixing ratio of a gas in the reference air, shape (59,), level 1 first."""
    row = [str(name) for name in table("gas")].index(gas)
    return table("ref_vmr")[row]


@dataclass(frozen=True)
class Columns:
    """Contents of a metre of air; arrays of shape (n,), columns in 1e20 molecules per cm2.

    ``gas``: columns by name. ``air``, ``dry``: all molecules, and those that are not water vapour. ``vmr``: mixing
    ratios by name. ``ln_p``: of the pressure in hPa.
    """

    gas: Mapping[str, FloatArray]
    air: FloatArray
    dry: FloatArray
    vmr: Mapping[str, FloatArray]
    ln_p: FloatArray
    temperature_k: FloatArray

    @classmethod
    def of(cls, ln_p: FloatArray, temperature_k: FloatArray, vmr: Mapping[str, FloatArray]) -> Columns:
        """Return the columns of an ideal gas."""
        air = 100.0 * np.exp(ln_p) / (BOLTZMANN * temperature_k) * _PER_CM2
        gas = {name: np.maximum(x, _LEAST) * air for name, x in vmr.items()}
        return cls(gas, air, air - gas["h2o"], vmr, ln_p, temperature_k)


@dataclass(frozen=True)
class TablePlace:
    """Position of air in the tables of the key gases; arrays of shape (n,).

    ``upper``: of the upper atmosphere; ``level``: j, counted from 1; ``fraction``: f, weight of level j + 1; ``node``:
    for each of the two levels the lower temperature node, counted from 0; ``beyond``: u, weight of the node above it.
    """

    upper: bool
    level: np.ndarray
    fraction: FloatArray
    node: tuple[np.ndarray, np.ndarray]
    beyond: tuple[FloatArray, FloatArray]

    @classmethod
    def below(cls, ln_p: FloatArray, temperature_k: FloatArray) -> TablePlace:
        """Return the position for pressures above 95.58 hPa; f is negative at more than 1054 hPa."""
        return cls._of(ln_p, temperature_k, 1, _LOWER_LEVELS - 1, upper=False)

    @classmethod
    def above(cls, ln_p: FloatArray, temperature_k: FloatArray) -> TablePlace:
        """Return the position for pressures below 95.58 hPa."""
        return cls._of(ln_p, temperature_k, _LOWER_LEVELS, 58, upper=True)

    @classmethod
    def at_seam(cls, temperature_k: FloatArray) -> TablePlace:
        """Return the lower atmosphere's position at 95.58 hPa."""
        return cls.below(np.full_like(temperature_k, SEAM_LN_HPA), temperature_k)

    @classmethod
    def _of(cls, ln_p: FloatArray, temperature_k: FloatArray, first: int, last: int, *, upper: bool) -> TablePlace:
        level = np.clip(np.trunc(36.0 - 5.0 * (ln_p + 0.04)).astype(int), first, last)
        fraction = _LEVELS_PER_LN * (table("ref_log_pressure_hpa")[level - 1] - ln_p)
        nodes, beyond = [], []
        for m in (level, level + 1):
            t = (temperature_k - table("ref_temperature_k")[m - 1]) / _NODES_K
            node = np.clip(np.trunc(3.0 + t).astype(int), 1, 4)
            nodes.append(node - 1)
            beyond.append(t - (node - 3))
        return cls(upper, level, fraction, (nodes[0], nodes[1]), (beyond[0], beyond[1]))


def key_absorption(band: int, place: TablePlace, columns: Columns) -> FloatArray:
    """Return the key gases' part of k [1/m], shape (n, 16)."""
    k = table(f"b{band}_up" if place.upper else f"b{band}_low")
    first = _LOWER_LEVELS if place.upper else 1
    mixtures = k.shape[2]
    flat = k.reshape(-1, k.shape[-1])
    gases = (UPPER_KEY if place.upper else LOWER_KEY)[band]
    total = np.zeros((len(place.level), k.shape[-1]))
    for step, share in ((0, 1.0 - place.fraction), (1, place.fraction)):
        level = place.level + step
        amount, terms = _mixture(gases, level, columns, mixtures, stretched=not place.upper)
        node, u = place.node[step], place.beyond[step]
        row = ((level - first) * k.shape[1] + node) * mixtures
        for offset, weight in terms:
            colder = share * amount * weight
            total += (colder * (1.0 - u))[:, None] * flat[row + offset]
            total += (colder * u)[:, None] * flat[row + mixtures + offset]
    return total


def mixture_weights(
    gases: tuple[str, ...], ratio: FloatArray | float, columns: Columns, mixtures: int
) -> tuple[FloatArray, np.ndarray, FloatArray, FloatArray]:
    """Return C, the lower node on the axis of eta, the weight of the node above it, and eta; shape (n,) each."""
    a, b = columns.gas[gases[0]], columns.gas[gases[1]]
    amount = a + ratio * b
    eta = np.minimum(a / amount, 1.0 - 1e-6)
    at = (mixtures - 1) * eta
    node = np.floor(at).astype(int)
    return amount, node, at - node, eta


def _mixture(
    gases: tuple[str, ...], level: np.ndarray, columns: Columns, mixtures: int, *, stretched: bool
) -> tuple[FloatArray, list[tuple[np.ndarray, FloatArray]]]:
    """Return the factor C, and nodes on the axis of eta with their weights."""
    if len(gases) == 1:
        return columns.gas[gases[0]], [(np.zeros_like(level), np.ones(len(level)))]
    ratio = reference_vmr(gases[0])[level - 1] / reference_vmr(gases[1])[level - 1]
    amount, node, v, eta = mixture_weights(gases, ratio, columns, mixtures)
    if not stretched:
        return amount, [(node, 1.0 - v), (node + 1, v)]
    low, high = eta < _STRETCHED, eta > 1.0 - _STRETCHED
    q = np.where(low, v - 1.0, -v)
    fourth = q**4
    end, middle, third = fourth, 1.0 - q - 2.0 * fourth, q + fourth
    # Next to 0: nodes e, e + 1, e + 2 with end, middle, third; next to 1: e + 1, e, e - 1; between: e, e + 1.
    first = np.where(low, end, np.where(high, middle, 1.0 - v))
    second = np.where(low, middle, np.where(high, end, v))
    outer = np.where(low, node + 2, np.where(high, node - 1, node))
    return amount, [(node, first), (node + 1, second), (outer, np.where(low | high, third, 0.0))]


@dataclass(frozen=True)
class _Minor:
    """A minor gas of a band: ``level`` of the reference air for the ratio of key gases in its eta (0: no eta)."""

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
    """Return the part of water vapour's continuum [1/m], shape (n, 16); in the upper atmosphere in band 3 only."""
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


BANDS = (3, 4, 5, 6, 7, 8, 9)
"""RRTMG-LW's numbers; the first axis of the result of :func:`absorption_per_m`."""
CLASSES = 16
KEY_GASES = ("h2o", "co2", "o3", "n2o", "ch4")
"""Required gases; all others are optional."""
OTHER_GASES = ("hno3", "cfc11", "cfc12", "hcfc22", "ccl4")
SEAM_LN_PA = SEAM_LN_HPA + float(np.log(100.0))
FLOOR_PER_M = 1e-16
_TOP_LN_HPA = -4.64
_UPPER_FACTOR = (4, 7)
_BLOCK = 4096
"""Number of levels evaluated at a time, for the processor's cache."""


def absorption_per_m(
    pressure_pa: FloatArray,
    temperature_k: FloatArray,
    vmr: Mapping[str, FloatArray],
    bands: Sequence[int] = tuple(range(len(BANDS))),
    upper_share: FloatArray | None = None,
) -> FloatArray:
    """Return the absorption coefficient of clear air for every class of every band [1/m], at least 1e-16.

    ``pressure_pa``, ``temperature_k``: shape (...); ``vmr``: volume mixing ratios, broadcast to that shape: ``h2o``,
    ``co2``, ``o3``, ``n2o``, ``ch4`` (in moist air, at least 1e-30) and optionally ``hno3`` (likewise), ``cfc11``,
    ``cfc12``, ``hcfc22``, ``ccl4`` (in dry air); ``bands``: indices into :data:`BANDS`; ``upper_share``: shape (...),
    weights, 0 to 1, of the upper atmosphere's tables, default 0 above 95.58 hPa and 1 below. Raises ``ValueError``: a
    key gas missing, or an unknown gas.
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
    """Return k at more than 95.58 hPa, shape (bands, n, 16)."""
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
    """Return k at less than 0.00966 hPa, shape (bands, n, 16): per molecule a power of the pressure."""
    per_molecule = []
    for ln_there in (_TOP_LN_HPA, _TOP_LN_HPA + 1.0):
        there = Columns.of(np.full_like(columns.ln_p, ln_there), columns.temperature_k, columns.vmr)
        per_molecule.append(np.maximum(_upper(there, bands), FLOOR_PER_M) / there.air[:, None])
    slope = np.clip(np.log(per_molecule[1] / per_molecule[0]), 0.0, 1.0)
    return per_molecule[0] * np.exp(slope * (columns.ln_p - _TOP_LN_HPA)[:, None]) * columns.air[:, None]


def _additions(columns: Columns, bands: Sequence[int]) -> FloatArray:
    """Return the absorption of nitric acid and halocarbons at any height, shape (bands, n, 16)."""
    k = np.zeros((len(bands), len(columns.ln_p), CLASSES))
    for row, b in enumerate(bands):
        k[row] += nitric_acid(BANDS[b], columns) + halocarbons(BANDS[b], columns)
    return k
