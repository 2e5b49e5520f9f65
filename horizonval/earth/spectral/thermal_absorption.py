"""Thermal absorption of the six AFGL climates by correlated k: 16 g points in 7 bands, 500 to 1390 cm-1.

Inside a band the spectrum is sorted by absorption into 16 classes ("g points"), each with one profile k_g(z) and a
share w_g of the band; radiance is solved per class as if monochromatic and summed. The classes' Planck sources follow
a sensor's response R through a map F[i, g]: the share of class g that lies in the 10 cm-1 bin i::

    S[b, g](T) = w_g * width_b * sum over bins i of b of F[i, g] / 10 cm-1 * integral over bin i of R(nu) B_nu(T) dnu

so that L = sum over b, g of the integral of S dTransmission, W m-2 sr-1. The integral is done by Gauss's rule between
the knots of the response. Every row of the published map is scaled so that the classes fill their bin exactly
(``sum over g of w_g width_b F[i, g] = 10 cm-1``; 5e-8 as published, 0.45 % in one bin of 820 to 980 cm-1): the sources
of all classes add up to the band's Planck radiance. What is left open, the sum of a class over its band, is then right
to 5e-3 there and 1e-7 elsewhere.

The tables come from RRTMG-LW as distributed with ecRad: H2O with continuum, CO2, O3, N2O, CH4, and HNO3. They exist for
330 and 420 ppm of CO2. Between the two ln k is linear in the logarithm of the concentration, exact at both; beyond, it
goes on with the same slope, held between 0 and 1 (more of a gas never absorbs less, nor more than in proportion: the
slope of a few coefficients near the tables' floor means nothing). Where CO2 alone absorbs that is exact; where it
shares a class with other gases k would rather be linear, and is at most 0.9 % above this at 280 ppm and 2 % at 560.

Accuracy on the limb in LTE: see :mod:`horizonval.earth.spectral.thermal_accuracy`. Features of the response narrower
than 20 cm-1 are not resolved. Left out: scattering, CFCs, non-LTE (above 75 km).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.spectral import bands, sunlight
from horizonval.earth.spectral.quadrature import composite_gauss
from horizonval.earth.tables import npz
from horizonval.spec.sensor.camera import Band

_TABLE = "thermal_ck.npz"
MIN_PER_CM, MAX_PER_CM = 500.0, 1390.0
MIN_UM, MAX_UM = 1e4 / MAX_PER_CM, 1e4 / MIN_PER_CM
CO2_PPM, LOW_CO2_PPM = 420.0, 330.0
"""Concentrations of CO2 in the lower atmosphere that there are tables for; both fall alike above 75 km."""
_POINTS = 4
"""Of Gauss's rule between two edges at most 10 cm-1 apart: 1e-12 of the integral of R B."""


def climates() -> list[str]:
    """Return the names of the climates that have absorption tables."""
    return [str(name) for name in npz(_TABLE)["atmosphere"]]


def levels_m() -> FloatArray:
    """Return the altitudes of the tables: 0.5 km apart up to 30 km, 1 km to 70 km, then 2 km to 100 km; shape (k,)."""
    return np.asarray(npz(_TABLE)["altitude_m"], dtype=np.float64)


def g_weights() -> FloatArray:
    """Return the share of a band that each of its classes holds, from the weakest to the strongest; shape (16,)."""
    return np.asarray(npz(_TABLE)["g_weight"], dtype=np.float64)


def temperature_k(climate: str, altitude_m: ArrayLike) -> FloatArray:
    """Return the temperature the tables were made with, linear between their levels; altitude 0 to 100 km."""
    temperature = np.asarray(npz(_TABLE)["temperature_k"][climates().index(climate)], dtype=np.float64)
    return np.interp(np.asarray(altitude_m, dtype=np.float64), levels_m(), temperature)


def blended_temperature_k(weights: Mapping[str, float]) -> FloatArray:
    """Return the temperature of a blend of climates at the tables' levels, shape (k,)."""
    return np.asarray(sum(weight * temperature_k(name, levels_m()) for name, weight in weights.items()))


@dataclass(frozen=True)
class GPoints:
    """The classes of absorption that a sensor band needs: 16 for every RRTMG band it touches.

    Attributes
    ----------
    name : tuple of str, length g
        ``"rrtmg4g07"``: band number and g point, both counted from 1.
    wavelength_um : ndarray, shape (g,)
        Centroid of the response inside the RRTMG band.
    table_band, table_g : ndarray of int, shape (g,)
        Where the tables hold a class.
    wavenumber_per_cm : ndarray, shape (q,)
    weight_per_cm : ndarray, shape (g, q)
        ``S_g(T) = sum_q weight[g, q] B_nu(wavenumber[q], T)``.
    """

    name: tuple[str, ...]
    wavelength_um: FloatArray
    table_band: np.ndarray
    table_g: np.ndarray
    wavenumber_per_cm: FloatArray
    weight_per_cm: FloatArray

    def ln_absorption(self, weights: Mapping[str, float], co2_ppm: float = CO2_PPM) -> FloatArray:
        """Return the logarithm of the absorption [1/m] at the tables' levels, shape (g, k).

        Parameters
        ----------
        weights : mapping of str to float
            Climates and their shares, of sum 1: absorption is blended in its logarithm.
        co2_ppm : float
            Concentration of CO2 in the lower atmosphere.
        """
        per_e = 1.0 / math.log(CO2_PPM / LOW_CO2_PPM)
        total = np.zeros((len(self.name), len(levels_m())))
        for name, weight in weights.items():
            i = climates().index(name)
            high, low = (_ln_table(key)[i, self.table_band, :, self.table_g] for key in _CO2_TABLES)
            slope = (high - low) * per_e
            if co2_ppm >= CO2_PPM:
                ln_k = high + np.clip(slope, 0.0, 1.0) * math.log(co2_ppm / CO2_PPM)
            elif co2_ppm <= LOW_CO2_PPM:
                ln_k = low + np.clip(slope, 0.0, 1.0) * math.log(co2_ppm / LOW_CO2_PPM)
            else:
                ln_k = high + slope * math.log(co2_ppm / CO2_PPM)
            total += weight * ln_k
        return total

    def sun_radiance(self) -> FloatArray:
        """Return the mean radiance of the Sun's disc in every class [W m-2 sr-1], shape (g,); the same on all days."""
        nu = self.wavenumber_per_cm
        per_cm = sunlight.irradiance(1e4 / nu) * 1e4 / nu**2
        return self.weight_per_cm @ per_cm / sunlight.disc_projected_solid_angle()


_CO2_TABLES = ("absorption_per_m", "absorption_co2_330ppm_per_m")


@cache
def _ln_table(key: str) -> FloatArray:
    table = np.log(np.asarray(npz(_TABLE)[key], dtype=np.float64))
    table.setflags(write=False)
    return table


@cache
def _share() -> FloatArray:
    """Return the map F with every row scaled to fill its bin, shape (bins, 16)."""
    table = npz(_TABLE)
    share = np.asarray(table["gpoint_spectral_fraction"], dtype=np.float64)
    bins = np.asarray(table["bin_edges_per_cm"], dtype=np.float64)
    widths = np.diff(np.asarray(table["band_edges_per_cm"], dtype=np.float64), axis=1)[table["bin_band_index"], 0]
    filled = share @ g_weights() * widths / np.diff(bins, axis=1)[:, 0]
    return share / filled[:, None]


def _sampled(band: Band) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Return wavenumbers [cm-1], quadrature weights with the response in them [cm-1], and the bin each lies in."""
    bins = np.asarray(npz(_TABLE)["bin_edges_per_cm"], dtype=np.float64)
    knots = 1e4 / bands.knots_um(band)
    edges = np.unique(np.concatenate([bins[:, 0], bins[-1:, 1], knots]))
    edges = edges[(edges >= max(knots.min(), MIN_PER_CM)) & (edges <= min(knots.max(), MAX_PER_CM))]
    nu, weight = composite_gauss(edges, _POINTS)
    nu, weight = nu.ravel(), weight.ravel()
    return nu, weight * bands.response(band, 1e4 / nu), np.searchsorted(bins[:, 0], nu, side="right") - 1


def g_points(band: Band, *, where: str = "") -> GPoints:
    """Return the classes that a sensor band needs.

    Parameters
    ----------
    band : Band
        Response per unit power.
    where : str, optional
        File and key of the band, for the error message.

    Raises
    ------
    UserError
        Response reaching outside 7.194 to 20 um.
    """
    lo, hi = bands.limits_um(band)
    tolerance = 1e-9
    if lo < MIN_UM - tolerance or hi > MAX_UM + tolerance:
        raise UserError(
            f"thermal band {band.name!r} spans {lo:g} to {hi:g} um",
            where=where,
            expected=f"a response within {np.ceil(MIN_UM * 1e3) / 1e3:g} to {MAX_UM:g} um "
            f"({MIN_PER_CM:g} to {MAX_PER_CM:g} cm-1), where there is an absorption table",
        )
    table = npz(_TABLE)
    g_weight = g_weights()
    bins = np.asarray(table["bin_edges_per_cm"], dtype=np.float64)
    edges = np.asarray(table["band_edges_per_cm"], dtype=np.float64)
    nu, weight, bin_of = _sampled(band)
    band_of = np.asarray(table["bin_band_index"])[bin_of]
    touched = [b for b in range(len(edges)) if weight[band_of == b].sum() > 0]
    rows = []
    for b in touched:
        # Share of class g per cm-1, times the width it stands for.
        density = _share()[bin_of] / np.diff(bins, axis=1)[bin_of] * (edges[b, 1] - edges[b, 0])
        rows.append((density * g_weight * (weight * (band_of == b))[:, None]).T)
    centroid = [1e4 * weight[band_of == b].sum() / (weight @ (nu * (band_of == b))) for b in touched]
    g = np.arange(len(g_weight))
    return GPoints(
        name=tuple(f"rrtmg{table['band_number'][b]}g{i + 1:02d}" for b in touched for i in g),
        wavelength_um=np.repeat(centroid, len(g)),
        table_band=np.repeat(touched, len(g)),
        table_g=np.tile(g, len(touched)),
        wavenumber_per_cm=nu,
        weight_per_cm=np.concatenate(rows),
    )
