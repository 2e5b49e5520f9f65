"""RRTMG-LW's interpolation of a band's key gases in pressure, temperature and mixture.

Level m = 1 ... 59 stands at ln(p/hPa) = 6.96, 6.76 ... -4.64. Between levels j and j + 1 the weights are 1 - f and f,
``f = 5 (ln p_j - ln p)``; between the temperature nodes of each level u, ``u = (T - T_m) / 15 K`` less the node, not
limited. With one key gas its column is multiplied by the mean of the four nodes. With two, a and b, for each level

    C = c_a + r c_b,    r = chi_a / chi_b of the level's reference air,    eta = c_a / C

and C is multiplied by the mean over eta as well: linear, but in the lower atmosphere by a quartic over three nodes next
to eta = 0 and 1, where a gas comes in or goes out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.tables import npz

BOLTZMANN = 1.380649e-23
FILE = "rrtmg_lw.npz"
_PER_CM2 = 1e-24
"""From molecules per m3 to 1e20 molecules per cm2 in a metre."""
_LEAST = 1e-30
"""Mixing ratio that stands for none: eta needs both key gases."""
_NODES_K, _LEVELS_PER_LN = 15.0, 5.0
_LOWER_LEVELS = 13
_STRETCHED = 0.125
_SEAM_LN_HPA = 4.56

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
    """What a metre of air holds; arrays of shape (n,), columns in 1e20 molecules per cm2.

    Attributes
    ----------
    gas : mapping of str to ndarray
    air, dry : ndarray
        All molecules, and those that are not water vapour.
    vmr : mapping of str to ndarray
    ln_p : ndarray
        Of the pressure in hPa.
    temperature_k : ndarray
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
    """Where air lies in the tables of the key gases; arrays of shape (n,).

    Attributes
    ----------
    upper : bool
    level : ndarray of int
        j, counted from 1.
    fraction : ndarray
        f, weight of level j + 1.
    node : pair of ndarray of int
        For each of the two levels the lower temperature node, counted from 0.
    beyond : pair of ndarray
        u, weight of the node above it.
    """

    upper: bool
    level: np.ndarray
    fraction: FloatArray
    node: tuple[np.ndarray, np.ndarray]
    beyond: tuple[FloatArray, FloatArray]

    @classmethod
    def below(cls, ln_p: FloatArray, temperature_k: FloatArray) -> TablePlace:
        """Return the place of air above 95.58 hPa; f runs below 0 at more than 1054 hPa."""
        return cls._of(ln_p, temperature_k, 1, _LOWER_LEVELS - 1, upper=False)

    @classmethod
    def above(cls, ln_p: FloatArray, temperature_k: FloatArray) -> TablePlace:
        """Return the place of air below 95.58 hPa."""
        return cls._of(ln_p, temperature_k, _LOWER_LEVELS, 58, upper=True)

    @classmethod
    def at_seam(cls, temperature_k: FloatArray) -> TablePlace:
        """Return the lower atmosphere's place at 95.58 hPa."""
        return cls.below(np.full_like(temperature_k, _SEAM_LN_HPA), temperature_k)

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
    """Return the amount to multiply by, and nodes on the axis of eta with their weights."""
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
