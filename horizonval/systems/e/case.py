"""The pass of Hadinejad & Amiri 2020: ENVISAT over two stations, with the element set that this project gives it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.geometry.tle import ElementSet, gcrs_states, itrs_states
from horizonval.systems.e.localisation.pipeline import TwoStationPass
from horizonval.systems.e.localisation.stations import Station

Figures = tuple[float, float, float]

ENVISAT = ElementSet(
    "1 27386U 02009A   20001.54192287  .00000005  00000-0  15038-4 0  9994",
    "2 27386  98.1404  17.3951 0001257  86.5901  84.8559 14.37967408934480",
)
"""The paper does not give its own. This one stands above 48 degrees at both stations for the whole window."""

STATIONS = (
    Station("S1", float(np.radians(48.3358)), float(np.radians(35.7061)), 1000.0),
    Station("S2", float(np.radians(54.7458)), float(np.radians(35.7161)), 200.0),
)

EPOCH_UTC = datetime(2019, 11, 26, 14, 38, 38, tzinfo=UTC)
STEP_S = 0.5
LENGTH_S = 120.0

METHODS = ("plain", "smoothed", "filtered", "proposed", "batch")
QUANTITIES = (("right ascension", "arcsec"), ("declination", "arcsec"), ("distance", "km"))

ROUNDING_DEG = (0.01, 0.1, 1.0)
PUBLISHED_ROUNDING: dict[str, tuple[Figures, ...]] = {
    "proposed": ((0.57, 0.54, 0.05), (3.80, 2.42, 0.30), (58.2, 16.41, 4.03)),
    "plain": ((0.94, 0.60, 0.08), (9.94, 6.01, 0.77), (106.77, 57.14, 8.10)),
}
"""Root mean square errors at each rounding: right ascension, declination [arcsec], distance [km]."""

NOISE_ARCSEC = (200.0, 300.0, 400.0)
NOISE_ROUNDING_DEG = 0.1
PUBLISHED_NOISE: dict[str, tuple[Figures, ...]] = {
    "proposed": ((5.02, 3.19, 0.37), (7.48, 5.09, 0.57), (9.02, 7.06, 0.79)),
    "plain": ((12.07, 8.42, 0.99), (18.55, 11.62, 1.50), (23.64, 13.48, 1.76)),
}


@dataclass(frozen=True)
class ExactPass:
    """The truth: times [s], angles as in :class:`TwoStationPass` [rad], positions [m]."""

    times_s: FloatArray
    angles_rad: FloatArray
    r_itrs: FloatArray
    r_gcrs: FloatArray

    def measured(self, angles_rad: FloatArray) -> TwoStationPass:
        """Return a pass in which these angles were measured."""
        return TwoStationPass(STATIONS, EPOCH_UTC, self.times_s, angles_rad)


@lru_cache(maxsize=1)
def exact_pass() -> ExactPass:
    """Return the truth, every half second of the window."""
    times = np.arange(0.0, LENGTH_S + 0.5 * STEP_S, STEP_S)
    r_itrs, _ = itrs_states(ENVISAT, EPOCH_UTC, times)
    r_gcrs, _ = gcrs_states(ENVISAT, EPOCH_UTC, times)
    angles = np.concatenate([np.stack(s.azimuth_elevation(r_itrs), axis=1) for s in STATIONS], axis=1)
    return ExactPass(times, angles, r_itrs, r_gcrs)


def rounded(angles_rad: FloatArray, quantum_deg: float, offset: ArrayLike = 0.0) -> FloatArray:
    """Return angles rounded to whole multiples of a quantum; ``offset`` shifts the grid by a share of it."""
    quantum = np.radians(quantum_deg)
    return (np.round(angles_rad / quantum - np.asarray(offset, float)) + offset) * quantum
