"""Particles of LOWTRAN7: models of the whole column, by their extinction at 550 nm and by spectra of six kinds.

Every model gives the extinction at 550 nm on levels from 0 to 100 km and says which kind of particle fills which
altitudes: in the first three rural air of 23 km visibility and 70 % humidity below 2 km, tropospheric background to
10 km, stratospheric (background, or aged volcanic) to 30 km, meteoric dust above.

===================== ============= =========== ==================================================================
model                 depth, 550 nm above 11 km what it stands for
===================== ============= =========== ==================================================================
``none``              0             0           molecules alone
``background``        0.324         0.0069      quiet stratosphere; below it haze, about twice the Earth's mean
``volcanic_moderate`` 0.344         0.027       one to two years after a large eruption
``volcanic_high``     0.411         0.094       the year after one such as Pinatubo's
``polar``             0.137         0.0074      clean air of 50 km visibility in a cold season, a low tropopause
``dust``              0.454         0.0069      desert dust, well mixed up to 5 km, below the quiet stratosphere
===================== ============= =========== ==================================================================

``polar`` is LOWTRAN7's tropospheric haze of 50 km visibility with the fall and winter set, whose stratospheric
particles lie lower (0.0006 per km from 12 to 17 km); chosen here is that they begin above 8 km, the tropopause of high
latitudes. ``dust`` takes its spectrum from LOWTRAN7's desert model (Longtin et al. 1988, AFGL-TR-88-0112) at the wind
of 10 m/s that LOWTRAN7 takes where none is given. Its height is that of the Saharan air layer (Carlson and Prospero
1972, J. Appl. Meteorol. 11, 283: up to 500 to 550 hPa); chosen here are an even 0.08 per km, that is 0.4 in 5 km, an
ordinary summer's, and the fall to the background at 6 km.

Between the levels the extinction is log-linear in altitude (LOWTRAN7's rule; straight lines would give optical depths
2 % larger). Where one kind of particle gives way to the next, its share falls linearly from 1 at the last level of its
region to 0 at the next level, 1 km higher (5 km above 30 km): extinction, scattering and asymmetry have no steps.

In wavelength, between the 36 entries of the table, the extinction is linear in logarithms, single-scattering albedo and
asymmetry are linear in the logarithm of the wavelength.

Neglected: humidity, season and place (one model serves the whole frame, and nothing chooses it by the latitude), and
phase functions other than Henyey and Greenstein's: single scattering towards the Sun and straight back from it may be
wrong by tens of per cent, more for dust, whose grains are no spheres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.suggest import nearest
from horizonval.earth.clouds import layer_optics
from horizonval.earth.tables import json_object

_TABLE = "aerosol.json"
NONE = "none"
MIN_UM, MAX_UM = 0.2, 18.5


@dataclass(frozen=True)
class AerosolOptics:
    """Optical properties relative to the extinction at 550 nm, one entry per wavelength.

    Attributes
    ----------
    extinction, scattering : ndarray
        Per unit of extinction at 550 nm.
    asymmetry : ndarray
        The g of Henyey and Greenstein.
    """

    extinction: FloatArray
    scattering: FloatArray
    asymmetry: FloatArray


@dataclass(frozen=True)
class Aerosol:
    """The particles of an atmosphere on given altitudes.

    Attributes
    ----------
    kinds : tuple of str
        Kinds of particles, from the ground upwards; see :func:`optics`.
    extinction_550_per_m : ndarray, shape (len(kinds), n)
        Extinction at 550 nm of each kind.
    """

    kinds: tuple[str, ...]
    extinction_550_per_m: FloatArray

    def at(self, wavelength_um: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return extinction [1/m], scattering [1/m] and asymmetry at every altitude, each of shape (n,).

        The asymmetry is the mean over the kinds weighted with what they scatter, 0 where nothing scatters.

        Raises
        ------
        UserError
            Wavelength outside 0.2 to 18.5 um.
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


def aerosol(name: str, altitude_m: ArrayLike, *, where: str = "") -> Aerosol:
    """Return a model on altitudes.

    Parameters
    ----------
    name : str
        One of :func:`names`.
    altitude_m : array_like, shape (n,)
        Nothing is left above 100 km (1e-11 of the ground's extinction); below 0 counts as 0.
    where : str, optional
        File and key that gave the name, for the error message.

    Raises
    ------
    UserError
        Unknown name; lists the known ones, the most similar first.
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
    regions = model["regions"]
    owner = np.searchsorted([region["altitude_km"][1] for region in regions], levels)
    shares = [np.interp(z, levels, owner == i) for i in range(len(regions))]
    return Aerosol(tuple(region["spectrum"] for region in regions), np.array(shares) * total)


def kinds() -> list[str]:
    """Return the names of the kinds of particles."""
    return list(json_object(_TABLE)["spectra"])


def optics(kind: str, wavelength_um: ArrayLike) -> AerosolOptics:
    """Return the spectra of one kind of particle.

    Parameters
    ----------
    kind : str
        One of :func:`kinds`, or a particle of thin cloud (:mod:`horizonval.earth.clouds.layer_optics`).
    wavelength_um : array_like

    Raises
    ------
    UserError
        Wavelength outside 0.2 to 18.5 um.
    """
    if layer_optics.is_particle(kind):
        return AerosolOptics(*layer_optics.sunlit(kind, wavelength_um))
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
