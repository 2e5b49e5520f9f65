"""Thermal absorption of the six AFGL climates by correlated k: 16 g points in 7 bands, 500 to 1390 cm-1.

Inside a band the spectrum is sorted by absorption into 16 classes ("g points"), each with one profile k_g(z) and a
share w_g of the band; radiance is solved per class as if monochromatic and summed. The classes' Planck sources follow
a sensor's response R through a map F[i, g]: the share of class g that lies in the 10 cm-1 bin i::

    S[b, g](T) = w_g * width_b * sum over bins i of b of F[i, g] R_i B_nu(T, centre of i)

so that L = sum over b, g of the integral of S dTransmission, W m-2 sr-1. R_i is the bin's mean response, and B is
taken at the centroid of the response in the bin (the centre of the covered part for a top hat).

The tables come from RRTMG-LW as distributed with ecRad: H2O with continuum, CO2 (420 ppm), O3, N2O, CH4, and HNO3.
Accuracy on the limb in LTE: 14.0 to 16.3 um 3 to 5 % up to 26 km, 6 % at 30, 12 % at 36 to 46 (1.5 to 2 km in the
height of equal radiance), 15 % at 50, a factor 1.5 at 54 to 60 km; 8 to 14 um 6 % up to 6 km, 11 to 13 % up to 40 km,
unverified above. 10.5 to 12.5 um is right at the ground and 10 to 20 % off on its dim limb above 8 km. Features of the
response narrower than 20 cm-1 are not resolved. Left out: scattering, CFCs, non-LTE (above 75 km).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from horizonval.earth import bands
from horizonval.earth.column import FloatArray
from horizonval.earth.planck import radiance_per_wavenumber
from horizonval.earth.quadrature import composite_gauss
from horizonval.earth.tables import npz
from horizonval.errors import UserError
from horizonval.spec.camera import Band

_TABLE = "thermal_ck.npz"
MIN_PER_CM, MAX_PER_CM = 500.0, 1390.0
MIN_UM, MAX_UM = 1e4 / MAX_PER_CM, 1e4 / MIN_PER_CM


def climates() -> list[str]:
    """Return the names of the climates that have absorption tables."""
    return [str(name) for name in npz(_TABLE)["atmosphere"]]


def temperature_k(climate: str, altitude_m: ArrayLike) -> FloatArray:
    """Return the temperature the tables were made with, linear between their levels; altitude 0 to 100 km."""
    levels = np.asarray(npz(_TABLE)["altitude_m"], dtype=np.float64)
    temperature = np.asarray(npz(_TABLE)["temperature_k"][climates().index(climate)], dtype=np.float64)
    return np.interp(np.asarray(altitude_m, dtype=np.float64), levels, temperature)


@dataclass(frozen=True)
class GPoint:
    """One class of absorption in one RRTMG band, as a sensor's response sees it.

    Attributes
    ----------
    name : str
        ``"rrtmg4g07"``: band number and g point, both counted from 1.
    wavelength_um : float
        Centroid of the response inside the RRTMG band.
    absorption_per_m : ndarray, shape (n,)
        On the altitudes asked for.
    bin_wavenumber_per_cm, bin_weight_per_cm : ndarray, shape (m,)
        ``source = sum(bin_weight * B_nu(bin_wavenumber))``.
    """

    name: str
    wavelength_um: float
    absorption_per_m: FloatArray
    bin_wavenumber_per_cm: FloatArray
    bin_weight_per_cm: FloatArray

    def source(self, temperature_k: ArrayLike) -> FloatArray:
        """Return S(T) [W m-2 sr-1], shape of the temperature."""
        temperature = np.asarray(temperature_k, dtype=np.float64)[..., None]
        return radiance_per_wavenumber(self.bin_wavenumber_per_cm, temperature) @ self.bin_weight_per_cm

    def scaled(self, ratio: FloatArray) -> GPoint:
        """Return the point with its absorption times a ratio at every altitude, shape (n,)."""
        return replace(self, absorption_per_m=self.absorption_per_m * ratio)

    def weigh(self, per_wavenumber: FloatArray) -> float:
        """Return the node's share of a spectrum given at the bins [unit / cm-1], shape (m,)."""
        return float(per_wavenumber @ self.bin_weight_per_cm)


def _bin_response(band: Band) -> tuple[FloatArray, FloatArray]:
    """Return mean response and response centroid [cm-1] of every 10 cm-1 bin, shapes (89,)."""
    bins = np.asarray(npz(_TABLE)["bin_edges_per_cm"], dtype=np.float64)
    knots = 1e4 / bands.knots_um(band)
    edges = np.unique(np.concatenate([bins[:, 0], bins[-1:, 1], knots]))
    edges = edges[(edges >= MIN_PER_CM) & (edges <= MAX_PER_CM)]
    # R is linear in wavelength: over 10 cm-1 a smooth function of wavenumber for which 6 points are exact to 1e-12.
    nu, weight = composite_gauss(edges, 6)
    weight = weight * bands.response(band, 1e4 / nu)
    owner = np.searchsorted(bins[:, 0], nu[:, 0], side="right") - 1
    total, moment = np.zeros(len(bins)), np.zeros(len(bins))
    np.add.at(total, owner, weight.sum(axis=1))
    np.add.at(moment, owner, (weight * nu).sum(axis=1))
    centre = bins.mean(axis=1)
    centroid = np.where(total > 0, moment / np.where(total > 0, total, 1.0), centre)
    return total / (bins[:, 1] - bins[:, 0]), centroid


def g_points(climate: str | Mapping[str, float], band: Band, altitude_m: ArrayLike, *, where: str = "") -> list[GPoint]:
    """Return the g points that a sensor band needs: 16 for every RRTMG band it touches.

    Parameters
    ----------
    climate : str, or mapping of str to float
        One of :func:`climates`, or several with weights of sum 1: absorption is blended in its logarithm.
    band : Band
        Response per unit power.
    altitude_m : array_like, shape (n,)
        0 to 100 km; k is log-linear between the table's levels (0.5 km to 30 km, 1 km to 70 km, then 2 km).
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
    z = np.asarray(altitude_m, dtype=np.float64)
    levels = np.asarray(table["altitude_m"], dtype=np.float64)
    weights = {climate: 1.0} if isinstance(climate, str) else climate
    absorption = np.asarray(table["absorption_per_m"], dtype=np.float64)
    ln_k = np.asarray(sum(weight * np.log(absorption[climates().index(name)]) for name, weight in weights.items()))
    edges = np.asarray(table["band_edges_per_cm"], dtype=np.float64)
    share = np.asarray(table["gpoint_spectral_fraction"], dtype=np.float64)
    g_weight = np.asarray(table["g_weight"], dtype=np.float64)
    mean_response, centroid = _bin_response(band)
    points: list[GPoint] = []
    for b, number in enumerate(table["band_number"]):
        used = np.flatnonzero((table["bin_band_index"] == b) & (mean_response > 0))
        if not used.size:
            continue
        nu = centroid[used]
        wavelength_um = 1e4 * mean_response[used].sum() / (mean_response[used] @ nu)
        for g, w in enumerate(g_weight):
            points.append(
                GPoint(
                    name=f"rrtmg{number}g{g + 1:02d}",
                    wavelength_um=float(wavelength_um),
                    absorption_per_m=np.exp(np.interp(z, levels, ln_k[b, :, g])),
                    bin_wavenumber_per_cm=nu,
                    bin_weight_per_cm=w * (edges[b, 1] - edges[b, 0]) * share[used, g] * mean_response[used],
                )
            )
    return points
