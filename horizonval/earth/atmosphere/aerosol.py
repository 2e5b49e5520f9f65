"""Particles of LOWTRAN7: models of the whole column, by their extinction at 550 nm and by spectra of six kinds.

Every model gives the extinction at 550 nm on levels from 0 to 100 km and the kind of particle at each altitude. In the
first three: rural air of 70 % humidity below 2 km, tropospheric background to 10 km, stratospheric (background, or aged
volcanic) to 30 km, meteoric dust above.

===================== ============= =========== ==================================================================
model                 depth, 550 nm above 11 km represents
===================== ============= =========== ==================================================================
``none``              0             0           molecules alone
``background``        0.148         0.0069      the Earth's mean haze below a quiet stratosphere
``volcanic_moderate`` 0.168         0.027       one to two years after a large eruption
``volcanic_high``     0.235         0.094       the year after one such as Pinatubo's
``polar``             0.137         0.0074      clean air of 50 km visibility in a cold season, a low tropopause
``dust``              0.454         0.0069      desert dust, well mixed up to 5 km, below the quiet stratosphere
===================== ============= =========== ==================================================================

LOWTRAN7's haze of 23 km visibility below 10 km has an optical depth of 0.316, more than twice the Earth's mean. It is
scaled by one factor to 0.14 (:data:`MEAN_DEPTH_BELOW_10_KM`), after the means of MODIS on Aqua (Remer et al. 2008, J.
Geophys. Res. 113, D14S07: 0.13 over the sea, 0.19 over land). The shape in height stays: 65 % lies below 2 km, where
CALIOP has 62 to 69 % in the boundary layer (Gui et al. 2021, Atmos. Chem. Phys. 21, 15309; Bourgeois et al. 2018,
Atmos. Chem. Phys. 18, 7709). A scene may set another depth: open ocean has 0.05 to 0.1, industry and smoke 0.3 to 1.

``polar`` is LOWTRAN7's tropospheric haze of 50 km visibility with the fall and winter set, whose stratospheric
particles lie lower; here they begin above 8 km, the tropopause of high latitudes. ``dust`` takes its spectrum from
LOWTRAN7's desert model (Longtin et al. 1988, AFGL-TR-88-0112) at 10 m/s and its height from the Saharan air layer
(Carlson and Prospero 1972, J. Appl. Meteorol. 11, 283): 0.08 per km to 5 km, falling to the background at 6 km.

Between levels the extinction is log-linear in altitude (LOWTRAN7's rule). Where one kind of particle replaces another,
its share falls linearly to 0 over one level, so that extinction, scattering and asymmetry have no steps. Between the 36
tabulated wavelengths the extinction is linear in logarithms; single-scattering albedo and asymmetry are linear in the
logarithm of the wavelength.

Neglected: variation with humidity, season and place (particles over the sea are coarser, less blue and absorb less),
and phase functions other than Henyey and Greenstein's: single scattering towards the Sun and straight back may be wrong
by tens of per cent, more for dust, whose grains are not spheres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, nearest
from horizonval.earth.clouds import layers
from horizonval.earth.tables import json_object

_TABLE = "aerosol.json"
NONE = "none"
MIN_UM, MAX_UM = 0.2, 18.5
MEAN_DEPTH_BELOW_10_KM = 0.14
"""Optical depth of the Earth's mean haze at 550 nm."""
_HAZY = ("background", "volcanic_moderate", "volcanic_high")
"""Models with LOWTRAN7's haze of 23 km visibility."""
_TROPOSPHERE_KM = 10.0


@dataclass(frozen=True)
class AerosolOptics:
    """Optical properties relative to the extinction at 550 nm, one entry per wavelength.

    ``extinction``, ``scattering``: per unit of extinction at 550 nm. ``asymmetry``: the g of Henyey and Greenstein.
    """

    extinction: FloatArray
    scattering: FloatArray
    asymmetry: FloatArray


@dataclass(frozen=True)
class Aerosol:
    """The particles of an atmosphere on given altitudes.

    ``kinds``: of particles, from the ground upwards (:func:`optics`); ``extinction_550_per_m``: shape (len(kinds), n).
    """

    kinds: tuple[str, ...]
    extinction_550_per_m: FloatArray

    def at(self, wavelength_um: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return extinction [1/m], scattering [1/m] and asymmetry at every altitude, each of shape (n,).

        The asymmetry is the mean over the kinds weighted with their scattering, 0 where nothing scatters.

        Raises ``UserError``: wavelength outside 0.2 to 18.5 um.
        """
        kinds = [optics(kind, wavelength_um) for kind in self.kinds]
        extinction, scattering, weighted = (
            np.einsum("k,kn->n", np.array(factor, dtype=np.float64), self.extinction_550_per_m)
            for factor in (
                [k.extinction for k in kinds],
                [k.scattering for k in kinds],
                [k.scattering * k.asymmetry for k in kinds],
            )
        )
        asymmetry = np.divide(weighted, scattering, out=np.zeros_like(scattering), where=scattering > 0)
        return extinction, scattering, asymmetry


def names() -> list[str]:
    """Return the names of the models, ``none`` first."""
    return [NONE, *json_object(_TABLE)["profiles"]]


def aerosol(name: str, altitude_m: ArrayLike, *, depth_below_10_km: float | None = None, where: str = "") -> Aerosol:
    """Return a model on altitudes.

    ``name``: one of :func:`names`; ``altitude_m``: shape (n,), nothing above 100 km (1e-11 of the ground's extinction),
    below 0 counts as 0; ``depth_below_10_km``: optical depth at 550 nm below 10 km, without effect above 11 km;
    ``where``: file and key of the name, for the error message. Raises ``UserError``: unknown name, with the most
    similar names.
    """
    if name not in names():
        raise UserError(
            f"unknown aerosol {name!r}", where=where, expected="one of " + ", ".join(nearest(name, names()))
        )
    z = np.asarray(altitude_m, dtype=np.float64) * 1e-3
    if name == NONE:
        return Aerosol((), np.zeros((0, len(z))))
    table = json_object(_TABLE)
    levels = np.array(table["altitude_km"], dtype=np.float64)
    model: dict[str, Any] = table["profiles"][name]
    values = np.array(model["extinction_550_per_km"], dtype=np.float64) * 1e-3
    total = np.exp(np.interp(z, levels, np.log(values)))
    total[z > levels[-1]] = 0.0
    depth = MEAN_DEPTH_BELOW_10_KM if depth_below_10_km is None and name in _HAZY else depth_below_10_km
    if depth is not None:
        # as if the levels up to 10 km were so many times larger
        total *= (depth / _depth(levels, values)) ** np.interp(z, [_TROPOSPHERE_KM, _TROPOSPHERE_KM + 1.0], [1.0, 0.0])
    regions = model["regions"]
    owner = np.searchsorted([region["altitude_km"][1] for region in regions], levels)
    shares = [np.interp(z, levels, owner == i) for i in range(len(regions))]
    return Aerosol(tuple(region["spectrum"] for region in regions), np.array(shares) * total)


def _depth(levels_km: FloatArray, extinction_per_m: FloatArray) -> float:
    """Return the optical depth below 10 km of an extinction that is exponential between levels."""
    below = extinction_per_m[levels_km <= _TROPOSPHERE_KM]
    lower, upper = below[:-1], below[1:]
    changes = lower != upper
    # the logarithmic mean; of two that agree, their value
    ratio = np.where(changes, lower / upper, math.e)
    mean = np.where(changes, (lower - upper) / np.log(ratio), lower)
    return float(np.sum(mean * np.diff(levels_km[levels_km <= _TROPOSPHERE_KM]) * 1e3))


def optics(kind: str, wavelength_um: ArrayLike) -> AerosolOptics:
    """Return the spectra of one kind of particle of the table or of thin cloud (:mod:`horizonval.earth.clouds.layers`).

    Raises ``UserError``: wavelength outside 0.2 to 18.5 um.
    """
    if layers.is_particle(kind):
        return AerosolOptics(*layers.sunlit(kind, wavelength_um))
    wavelength = np.asarray(wavelength_um, dtype=np.float64)
    tolerance = 1e-12
    if wavelength.size and not (wavelength.min() >= MIN_UM - tolerance and wavelength.max() <= MAX_UM + tolerance):
        raise UserError(
            f"no optical properties of aerosol at {wavelength.min():g} to {wavelength.max():g} um",
            expected=f"wavelengths within {MIN_UM:g} to {MAX_UM:g} um",
        )
    table = json_object(_TABLE)
    ln_table = np.log(np.array(table["wavelength_um"], dtype=np.float64))
    extinction, absorption, asymmetry = (
        np.array(table["spectra"][kind][key], dtype=np.float64)
        for key in ("extinction_rel_550", "absorption_rel_550", "asymmetry")
    )
    ln_wavelength = np.log(wavelength)
    relative_extinction = np.exp(np.interp(ln_wavelength, ln_table, np.log(extinction)))
    albedo = np.interp(ln_wavelength, ln_table, 1 - absorption / extinction)
    return AerosolOptics(
        relative_extinction, relative_extinction * albedo, np.interp(ln_wavelength, ln_table, asymmetry)
    )
