"""Air between the places of a user's profiles (:mod:`horizonval.earth.atmosphere.profile_file`).

At every height temperature, ln p and the logarithms of the mixing ratios are weighted sums over the profiles. The
weights depend on the place alone and add up to 1:

- **latitudes alone**: linear in the sine of latitude between neighbours, constant beyond the outermost, independent of
  longitude;
- **latitudes and longitudes**: ordinary kriging with a variogram linear in the chord r between two places (G. Matheron,
  Economic Geology 58, 1246 (1963), with nugget 0; scipy's ``RBFInterpolator``)::

      value(x) = c + sum_i a_i r(x, x_i),    sum_i a_i = 0,    value(x_i) = value of profile i

  The profiles are reproduced at their places; half way between two lone places the result is their mean. Poles and the
  date line need no special treatment.

**Extrapolation**: where no profiles surround a place its air is that of the nearest, with a part of their trend that
levels off with distance. No climate is involved: profiles of one region describe the whole globe by that region.

Blending at equal height preserves the layers of each column; a sharp tropopause at two heights becomes a step at each.
The blend of hydrostatic columns is hydrostatic to second order in their difference (0.7 % of a scale height half way
between columns 40 K apart). For random weather the temperature error grows from 0.3 K rms for profiles 5 deg apart to
3.3 K for 30 deg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.profile_file import PlacedProfile
from horizonval.earth.gases.gas_state import GasState


@dataclass(frozen=True)
class PlacedProfiles:
    """One profile, or profiles of many places: all with longitudes or all without."""

    profiles: Sequence[PlacedProfile]

    @property
    def vary(self) -> bool:
        """Whether the air differs from place to place."""
        return len(self.profiles) > 1

    def columns(self, latitude_deg: FloatArray, longitude_deg: FloatArray, altitude_m: FloatArray) -> GasState:
        """Return columns of air, shape (c, k), at geodetic positions (c,) and heights (k,) of 0 to 120 km."""
        z = np.asarray(altitude_m, dtype=np.float64)
        states = [one.profile.at(z).gas_state() for one in self.profiles]
        weights = self._weights(np.asarray(latitude_deg, dtype=np.float64), np.asarray(longitude_deg, dtype=np.float64))

        def logarithmic(rows: list[FloatArray]) -> FloatArray:
            return np.exp(weights @ np.log(rows))

        return GasState(
            z,
            logarithmic([state.pressure_pa for state in states]),
            weights @ np.array([state.temperature_k for state in states]),
            {gas: logarithmic([state.vmr[gas] for state in states]) for gas in states[0].vmr},
        )

    def _weights(self, latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
        """Return the weights of the profiles at places (c,), shape (c, profiles)."""
        latitude = np.array([one.latitude_deg for one in self.profiles], dtype=np.float64)
        each = np.eye(len(latitude))
        if self.profiles[0].longitude_deg is None:
            order = np.argsort(latitude)
            own, at = np.sin(np.radians(latitude[order])), np.sin(np.radians(latitude_deg))
            return np.stack([np.interp(at, own, row) for row in each[:, order]], axis=-1)
        longitude = np.array([one.longitude_deg for one in self.profiles], dtype=np.float64)
        own, at = _unit(latitude, longitude), _unit(latitude_deg, longitude_deg)
        return np.asarray(RBFInterpolator(own, each, kernel="linear", degree=0)(at))


def _unit(latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    across = np.cos(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)], axis=-1)
