"""The pass of Hadinejad & Amiri 2020: ENVISAT over two stations, with the element set that this project gives it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.geometry.orbit import ElementSet, gcrs_states, itrs_states
from horizonval.systems.e.localisation.pipeline import TwoStationPass
from horizonval.systems.e.localisation.stations import Station
from horizonval.systems.published import published

Figures = tuple[float, ...]

ENVISAT = ElementSet(
    "1 27386U 02009A   20001.54192287  .00000005  00000-0  15038-4 0  9994",
    "2 27386  98.1404  17.3951 0001257  86.5901  84.8559 14.37967408934480",
)
"""The paper does not give its own. This one stands above 48 degrees at both stations for the whole window."""

PUBLISHED = published("E")


def _station(name: str, longitude_deg: float, latitude_deg: float, height_m: float) -> Station:
    return Station(name, float(np.radians(longitude_deg)), float(np.radians(latitude_deg)), height_m)


_FIRST, _SECOND = (place for place, _ in PUBLISHED.tables["stations"].columns())
STATIONS = (_station("S1", **_FIRST), _station("S2", **_SECOND))

EPOCH_UTC = datetime.fromisoformat(str(PUBLISHED.figures["start"].value))
STEP_S = PUBLISHED.number("step")
LENGTH_S = PUBLISHED.number("length")

METHODS = ("plain", "smoothed", "filtered", "proposed", "batch")
QUANTITIES = (("right ascension", "arcsec"), ("declination", "arcsec"), ("distance", "km"))


def _printed(table: str, setting: str) -> tuple[tuple[float, ...], dict[str, tuple[Figures, ...]]]:
    """Return a table's settings, and the printed errors of both methods at each of them."""
    columns = list(PUBLISHED.tables[table].columns())
    errors = {
        method: tuple(tuple(read[f"{method} {quantity}"] or 0.0 for quantity, _ in QUANTITIES) for _, read in columns)
        for method in ("proposed", "plain")
    }
    return tuple(settings[setting] for settings, _ in columns), errors


ROUNDING_DEG, PUBLISHED_ROUNDING = _printed("rounding", "rounding_deg")
"""Root mean square errors at each rounding: right ascension, declination [arcsec], distance [km]."""
NOISE_ARCSEC, PUBLISHED_NOISE = _printed("noise", "noise_arcsec")
NOISE_ROUNDING_DEG = PUBLISHED.number("noise_rounding")


@dataclass(frozen=True)
class ExactPass:
    """The truth: times [s], angles as in :class:`TwoStationPass` [rad], positions [m]."""

    times_s: FloatArray
    angles_rad: FloatArray
    r_itrs: FloatArray
    r_gcrs: FloatArray

    def at(self, instants: Sequence[int]) -> ExactPass:
        """Return the truth at some of the instants."""
        i = np.asarray(instants, int)
        return ExactPass(self.times_s[i], self.angles_rad[i], self.r_itrs[i], self.r_gcrs[i])

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
