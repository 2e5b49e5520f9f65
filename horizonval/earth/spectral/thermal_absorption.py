"""Classes of thermal absorption by correlated k, and their sources: 16 g points in 7 bands, 500 to 1390 cm-1.

Inside a band the spectrum is sorted by absorption into 16 classes ("g points"), each with one profile k_g(z) and a
share w_g of the band; radiance is solved per class as if monochromatic and summed. The classes' Planck sources follow
a sensor's response R through a map F[i, g]: the share of class g that lies in the 10 cm-1 bin i::

    S[b, g](T) = w_g * width_b * sum over bins i of b of F[i, g] / 10 cm-1 * integral over bin i of R(nu) B_nu(T) dnu

so that L = sum over b, g of the integral of S dTransmission, W m-2 sr-1. The integral is done by Gauss's rule between
the knots of the response. Every row of the published map is scaled so that the classes fill their bin exactly
(``sum over g of w_g width_b F[i, g] = 10 cm-1``; 5e-8 as published, 0.45 % in one bin of 820 to 980 cm-1): the sources
of all classes add up to the band's Planck radiance. What is left open, the sum of a class over its band, is then right
to 5e-3 there and 1e-7 elsewhere.

What a class absorbs follows from the air: :mod:`horizonval.earth.gases.rrtmg`. The map was fitted to LOWTRAN7's spectra
of the six AFGL climates at 330 ppm of carbon dioxide; it does not know how the classes shift with other air.

Accuracy on the limb in LTE: see :mod:`horizonval.earth.spectral.thermal_accuracy`. Features of the response narrower
than 20 cm-1 are not resolved. Left out: scattering, non-LTE (above 75 km).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, lru_cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.digests import content_digest
from horizonval.core.errors import UserError
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.spectral import bands, sunlight
from horizonval.earth.spectral.quadrature import composite_gauss
from horizonval.earth.tables import npz
from horizonval.spec.camera import Band

_TABLE = "gpoint_map.npz"
MIN_PER_CM, MAX_PER_CM = 500.0, 1390.0
MIN_UM, MAX_UM = 1e4 / MAX_PER_CM, 1e4 / MIN_PER_CM
_POINTS = 4
"""Of Gauss's rule between two edges at most 10 cm-1 apart: 1e-12 of the integral of R B."""


def g_weights() -> FloatArray:
    """Return the share of a band that each of its classes holds, from the weakest to the strongest; shape (16,)."""
    return np.asarray(npz(_TABLE)["g_weight"], dtype=np.float64)


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
        Where the tables hold a class: places in :data:`horizonval.earth.gases.rrtmg.BANDS` and among the 16.
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

    def ln_absorption(self, state: GasState) -> FloatArray:
        """Return the logarithm of the absorption [1/m] of air, shape (g, ...) with the shape of its columns behind."""
        return _ln_absorption(_Asked(content_digest(self.table_band, self.table_g, *state.contents()), self, state))

    def sun_radiance(self) -> FloatArray:
        """Return the mean radiance of the Sun's disc in every class [W m-2 sr-1], shape (g,); the same on all days."""
        nu = self.wavenumber_per_cm
        per_cm = sunlight.irradiance(1e4 / nu) * 1e4 / nu**2
        return self.weight_per_cm @ per_cm / sunlight.disc_projected_solid_angle()


@dataclass(frozen=True)
class _Asked:
    """The absorption of some classes in some air, which are compared by their digest."""

    digest: str
    points: GPoints = field(compare=False)
    state: GasState = field(compare=False)


@lru_cache(maxsize=4)
def _ln_absorption(asked: _Asked) -> FloatArray:
    """Return :meth:`GPoints.ln_absorption`; that of the last few stays, as frames of one place have the same air."""
    bands, g = asked.points.table_band, asked.points.table_g
    touched, place = np.unique(bands, return_inverse=True)
    found = np.log(asked.state.absorption_per_m([int(band) for band in touched])[place, g])
    found.flags.writeable = False
    return found


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
