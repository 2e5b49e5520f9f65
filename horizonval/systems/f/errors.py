"""From scans to errors of attitude, by band, sky and threshold.

The scanner is calibrated once, on clear scans: the fixed level is its fraction of their mean plateau, and the height of
the horizon it is told of is the one that leaves no mean roll error. What is left in clear scans is what the air does;
what clouds add is the difference of the same scan with and without them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Refusal
from horizonval.geometry.ellipsoid import WGS84
from horizonval.systems.f.attitude import ScannerFit, attitude_over_ellipsoid
from horizonval.systems.f.electronics import ScanEdges, ScanSignal, Threshold, find_edges
from horizonval.systems.f.settings import (
    ALTITUDE_KM,
    CONE,
    ELECTRONICS,
    FRACTION,
    HALF_ANGLE_RAD,
    NOISE_SHARE,
    PHASE_STEP_RAD,
    TURNS,
)
from horizonval.systems.weather_viewpoints import WeatherPlace

SKIES = ("clear", "clouds")
THRESHOLDS = ("fixed", "fraction")
LOWEST_M, HIGHEST_M = -20e3, 80e3
"""Between which the calibrated height of the horizon is looked for."""
MARGIN_RAD = math.radians(12.0)


@dataclass(frozen=True)
class BandErrors:
    """Errors [deg] of one threshold in one band; arrays of shape (places,), nan where a scan is refused.

    Attributes
    ----------
    pitch, roll : dict of ndarray
        By sky.
    height_km : float
        Of the calibrated horizon.
    level : float or None
        Of a fixed threshold, W m-2 sr-1.
    spare : int
        Cloudy scans whose signal passes the threshold more than twice.
    refused : int
        Cloudy scans without an answer.
    sigma : ndarray, shape (2,)
        Claimed of roll and pitch, mean over clear scans.
    """

    pitch: dict[str, FloatArray]
    roll: dict[str, FloatArray]
    height_km: float
    level: float | None
    spare: int
    refused: int
    sigma: FloatArray

    def added(self, axis: str) -> FloatArray:
        """Return what clouds add to the error of an axis [deg], scan by scan."""
        errors = self.pitch if axis == "pitch" else self.roll
        return errors["clouds"] - errors["clear"]

    @property
    def worst_axis(self) -> str:
        """The axis to which clouds add more."""
        return max(("pitch", "roll"), key=lambda axis: float(np.nanstd(self.added(axis))))


def signal_of(phase_rad: FloatArray, radiance: FloatArray) -> ScanSignal:
    """Return the amplifier's output of radiances at rising phases, zero beyond them."""
    steps = np.arange(phase_rad[0] - MARGIN_RAD, phase_rad[-1] + 2.0 * MARGIN_RAD, PHASE_STEP_RAD)
    return ELECTRONICS.respond(steps, np.interp(steps, phase_rad, radiance, left=0.0, right=0.0))


def plateaus(edges: ScanEdges, signal: ScanSignal, threshold: Threshold) -> tuple[float, float]:
    """Return the plateaus that belong to both edges."""
    near, far = (angle / math.sin(HALF_ANGLE_RAD) for angle in threshold.plateau_rad)
    inside = np.linspace(near, far, 25)
    return float(np.mean(signal.at(edges.entered_rad + inside))), float(np.mean(signal.at(edges.left_rad - inside)))


def band_errors(scans: Mapping[str, JsonObject], places: Mapping[str, JsonObject], kind: str) -> BandErrors:
    """Return the errors of all scans of a band with a threshold of a kind of :data:`THRESHOLDS`."""
    threshold = Threshold(FRACTION)
    signals = {sky: [signal_of(np.array(s["phase_rad"]), np.array(s[sky])) for s in scans.values()] for sky in SKIES}
    if kind == "fixed":
        found = [(find_edges(s, threshold, HALF_ANGLE_RAD), s) for s in signals["clear"]]
        seen = [plateaus(edges, s, threshold) for edges, s in found if isinstance(edges, ScanEdges)]
        threshold = replace(threshold, level=FRACTION * float(np.mean(seen)))
    edges = {sky: [find_edges(s, threshold, HALF_ANGLE_RAD) for s in found] for sky, found in signals.items()}
    days = [WeatherPlace.of(item) for item in places.values()]

    def fits(sky: str, height_m: float) -> list[ScannerFit | Refusal]:
        return [
            e if isinstance(e, Refusal) else fit_edges(e, day, height_m, s)
            for e, day, s in zip(edges[sky], days, signals[sky], strict=True)
        ]

    def mean_roll(height_m: float) -> float:
        return float(np.mean([f.roll_rad for f in fits("clear", height_m) if isinstance(f, ScannerFit)]))

    height = float(brentq(mean_roll, LOWEST_M, HIGHEST_M, xtol=1.0))
    answers = {sky: fits(sky, height) for sky in SKIES}
    claimed = [np.sqrt(np.diag(f.covariance)) for f in answers["clear"] if isinstance(f, ScannerFit)]
    return BandErrors(
        pitch={sky: np.array([_deg(f, "pitch_rad") for f in found]) for sky, found in answers.items()},
        roll={sky: np.array([_deg(f, "roll_rad") for f in found]) for sky, found in answers.items()},
        height_km=height / 1e3,
        level=threshold.level,
        spare=sum(isinstance(e, ScanEdges) and e.spare > 0 for e in edges["clouds"]),
        refused=sum(isinstance(f, Refusal) for f in answers["clouds"]),
        sigma=np.degrees(np.mean(claimed, axis=0)),
    )


def fit_edges(edges: ScanEdges, day: WeatherPlace, height_m: float, signal: ScanSignal) -> ScannerFit | Refusal:
    """Return the attitude of one scan: step delays taken off, the ellipsoid raised by the calibrated height."""
    late = ELECTRONICS.step_delays(FRACTION, PHASE_STEP_RAD)
    noise = NOISE_SHARE * float(np.max(signal.value)) / math.sqrt(TURNS)
    sigma = noise / abs(edges.slope_in), noise / abs(edges.slope_out)
    entered, left = edges.entered_rad - late[0], edges.left_rad - late[1]
    return attitude_over_ellipsoid(
        CONE, entered, left, day.position(ALTITUDE_KM), day.lvlh(), WGS84.raised(height_m), sigma
    )


def plateau_deficits(scans: Mapping[str, JsonObject]) -> FloatArray:
    """Return by how much clouds lower both plateaus, as shares of the clear ones: shape (places, 2), in and out."""
    threshold, out = Threshold(FRACTION), []
    for s in scans.values():
        clear, cloudy = (signal_of(np.array(s["phase_rad"]), np.array(s[sky])) for sky in SKIES)
        edges = find_edges(clear, threshold, HALF_ANGLE_RAD)
        assert isinstance(edges, ScanEdges)
        bare, under = plateaus(edges, clear, threshold), plateaus(edges, cloudy, threshold)
        out.append([1.0 - under[i] / bare[i] for i in (0, 1)])
    return np.array(out)


def _deg(fit: ScannerFit | Refusal, name: str) -> float:
    return math.degrees(getattr(fit, name)) if isinstance(fit, ScannerFit) else math.nan
