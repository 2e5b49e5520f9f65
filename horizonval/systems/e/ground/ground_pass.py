"""One pass over one station: where the satellite is seen from instant to instant, and where the mount points.

An observer who is fixed to the Earth sees a satellite, to first order in v / c, in the Earth-fixed direction that it
had when its light left it: light time and the station's aberration together (what is left, the Coriolis bend of the
light's path, is 0.04 arcsec). Refraction lifts that direction (:mod:`refraction`).
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from numpy.typing import ArrayLike
from scipy.constants import speed_of_light

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.air import air_of
from horizonval.earth.gases import rayleigh
from horizonval.geometry.orbit import ElementSet, itrs_states
from horizonval.geometry.sun_and_moon import sun_angular_radius, sun_itrs, sun_visible_fraction
from horizonval.systems.e.ground.refraction import Correction, RefractingAir, apparent_elevation
from horizonval.systems.e.ground.sky import sky_scene
from horizonval.systems.e.localisation.stations import Station, enu_directions

WAVELENGTH_UM = 0.62
"""At which refraction is taken: the middle of the tracker's band. Dispersion over the band (0.4 arcsec at 48 deg) is
left out: it blurs, far less than the point spread."""


@dataclass(frozen=True)
class Pass:
    """A satellite over a station."""

    elements: ElementSet
    station: Station
    epoch_utc: datetime

    def geometric_enu(self, seconds: ArrayLike) -> FloatArray:
        """Return station to satellite [m] at instants after the epoch, shape (..., 3), in east, north, up."""
        r, _ = itrs_states(self.elements, self.epoch_utc, seconds)
        return (r - self.station.r_itrs) @ self.station.itrs_from_enu

    def retarded_enu(self, seconds: ArrayLike) -> FloatArray:
        """Return the same for the satellite as it is seen: where it was when its light left it."""
        t = np.asarray(seconds, float)
        distance = np.linalg.norm(self.geometric_enu(t), axis=-1)
        # Once is enough: in the light time of 3 ms the distance changes by 20 m, or 0.07 microseconds.
        return self.geometric_enu(t - distance / speed_of_light)

    def apparent_enu(self, air: RefractingAir, seconds: ArrayLike) -> FloatArray:
        """Return unit vectors in which the satellite is seen through the air, shape (..., 3)."""
        d = self.retarded_enu(seconds)
        azimuth, elevation = azimuth_elevation(d)
        lifted = apparent_elevation(air, self.station.height_m, elevation, np.linalg.norm(d, axis=-1))
        return enu_directions(azimuth, lifted)

    def light(self, seconds: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the phase angle [rad] at the satellite and the share of the Sun's disc it sees, shape (...).

        The Sun is taken where it is in the middle of the times: it moves by 15 arcsec a second in Earth-fixed axes.
        """
        t = np.asarray(seconds, float)
        r, _ = itrs_states(self.elements, self.epoch_utc, t)
        middle = self.epoch_utc + timedelta(seconds=float(np.mean(t)))
        sun, distance = sun_itrs(middle)
        to_observer = self.station.r_itrs - r
        across = np.linalg.norm(np.cross(to_observer, sun), axis=-1)
        return np.arctan2(across, to_observer @ sun), sun_visible_fraction(r, sun, float(sun_angular_radius(distance)))


def azimuth_elevation(d_enu: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return azimuth in ``[0, 2 pi)`` and elevation [rad], shape (...), of vectors (..., 3) in east, north, up."""
    d = np.asarray(d_enu, float)
    return np.mod(np.arctan2(d[..., 0], d[..., 1]), 2.0 * np.pi), np.arctan2(d[..., 2], np.hypot(d[..., 0], d[..., 1]))


def standard_air(station: Station, epoch_utc: datetime) -> tuple[RefractingAir, Correction]:
    """Return the refracting air of the sky's scene, and what an observer with barometer and thermometer knows of it."""
    state = air_of(sky_scene(station, epoch_utc, 0.0)).state
    air = RefractingAir(state.altitude_m, rayleigh.refractivity(state.number_density_air, [WAVELENGTH_UM]))
    pressure = float(np.exp(np.interp(station.height_m, state.altitude_m, np.log(state.pressure_pa))))
    temperature = float(np.interp(station.height_m, state.altitude_m, state.temperature_k))
    return air, Correction.of(pressure * 1e-2, temperature - 273.15, station.height_m, WAVELENGTH_UM)
