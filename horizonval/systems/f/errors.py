"""From scans to errors of attitude, by band, sky and threshold.

The scanner is calibrated once, on clear scans: the fixed level is its fraction of their mean plateau, and the height of
the horizon it is given is the one that leaves no mean roll error. What is left in clear scans is what the air does;
what clouds add is the difference of the same scan with and without them.

*Pitch and roll* from the two phases of a scan: Newton's steps on ``limb_side(d_in) = limb_side(d_out) = 0`` for roll
and pitch, the position and the yaw being known: the exact horizon, raised by one constant height.

*Covariance*: a phase off by dp moves the line of sight by ``d' dp``; to first order ``d . dn = -(d' . n) dp`` for both
crossings, two equations for the two angles.

``worst_error_deg`` runs the whole chain on an Earth without air, whose edges are known in closed form: what sampling
and lags leave.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Outcome, Refusal
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid
from horizonval.geometry.frames import body_from_lvlh, inverse, rotate
from horizonval.geometry.horizon import limb_side
from horizonval.systems.f.electronics import ScanEdges, ScanSignal, Threshold, find_edges
from horizonval.systems.f.scan_cone import (
    ALTITUDE_KM,
    CONE,
    ELECTRONICS,
    FRACTION,
    HALF_ANGLE_RAD,
    NOISE_SHARE,
    PHASE_STEP_RAD,
    TURNS,
    ScanCone,
    ellipsoid_crossings,
)
from horizonval.systems.weather_viewpoints import WeatherPlace

Residual = Callable[[float, float], FloatArray]
"""How far both crossings are off the horizon at a roll and a pitch."""
STEP_RAD = 1e-6
LEAST_SINE = 1e-3
"""Smallest sine between both crossings' effects; below it the chord cannot separate pitch from roll."""
NEWTON_STEPS, CONVERGED_RAD = 20, 1e-11


@dataclass(frozen=True)
class ScannerFit:
    """An attitude; ``covariance``: shape (2, 2), of roll and pitch [rad2]."""

    roll_rad: float
    pitch_rad: float
    covariance: FloatArray


def attitude_over_ellipsoid(
    cone: ScanCone,
    entered_rad: float,
    left_rad: float,
    r_itrs: FloatArray,
    lvlh_from_itrs: FloatArray,
    ellipsoid: Ellipsoid,
    sigma_rad: tuple[float, float],
) -> ScannerFit | Refusal:
    """Return roll and pitch over an ellipsoid, at a known position [m] and no yaw; ``lvlh_from_itrs``: a quaternion."""
    phases = np.array([entered_rad, left_rad])
    d = cone.directions(phases)

    def off_of(directions: FloatArray, roll: float, pitch: float) -> FloatArray:
        d_lvlh = rotate(inverse(body_from_lvlh(0.0, pitch, roll)), directions)
        return limb_side(rotate(inverse(lvlh_from_itrs), d_lvlh), r_itrs, ellipsoid)

    def off(roll: float, pitch: float) -> FloatArray:
        return off_of(d, roll, pitch)

    roll = pitch = 0.0
    for _ in range(NEWTON_STEPS):
        jacobian = _jacobian(off, roll, pitch)
        if _sine(jacobian) < LEAST_SINE:
            return Refusal(Outcome.SHORT_ARC, "the chord does not tell pitch from roll")
        step = np.linalg.solve(jacobian, off(roll, pitch))
        roll, pitch = roll - float(step[0]), pitch - float(step[1])
        if max(abs(roll), abs(pitch)) > math.pi / 4:
            return Refusal(Outcome.NOT_CONVERGED, "the edges fit no attitude near the nadir")
        if np.max(np.abs(step)) < CONVERGED_RAD:
            moved = off_of(cone.directions(phases + STEP_RAD), roll, pitch)
            return _with_covariance(roll, pitch, off, (moved - off(roll, pitch)) / STEP_RAD, sigma_rad)
    return Refusal(Outcome.NOT_CONVERGED, "no attitude after the last step")


def _with_covariance(
    roll: float, pitch: float, off: Residual, per_phase: FloatArray, sigma_rad: tuple[float, float]
) -> ScannerFit | Refusal:
    jacobian = _jacobian(off, roll, pitch)
    if _sine(jacobian) < LEAST_SINE:
        return Refusal(Outcome.SHORT_ARC, "the chord does not tell pitch from roll")
    per_angle = np.linalg.solve(jacobian, np.diag(per_phase * np.asarray(sigma_rad)))
    return ScannerFit(roll, pitch, per_angle @ per_angle.T)


def _jacobian(off: Residual, roll: float, pitch: float) -> FloatArray:
    by_roll = off(roll + STEP_RAD, pitch) - off(roll - STEP_RAD, pitch)
    by_pitch = off(roll, pitch + STEP_RAD) - off(roll, pitch - STEP_RAD)
    return np.stack([by_roll, by_pitch], axis=-1) / (2.0 * STEP_RAD)


def _sine(jacobian: FloatArray) -> float:
    return abs(float(np.linalg.det(jacobian))) / max(float(np.prod(np.linalg.norm(jacobian, axis=1))), 1e-30)


SKIES = ("clear", "clouds")
THRESHOLDS = ("fixed", "fraction")
LOWEST_M, HIGHEST_M = -20e3, 80e3
"""Range of the calibrated height of the horizon."""
MARGIN_RAD = math.radians(12.0)


@dataclass(frozen=True)
class BandErrors:
    """Errors [deg] of one threshold in one band, shape (places,), nan for refused scans.

    ``pitch``, ``roll``: by sky; ``height_km``: of the calibrated horizon; ``level``: of a fixed threshold [W m-2 sr-1];
    ``spare``: cloudy scans with more than two crossings; ``refused``: cloudy scans without an answer; ``sigma``: shape
    (2,), claimed, mean over clear scans.
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


TILTS_DEG = (0.0, 10.0, 20.0)
ATTITUDES_DEG = (-3.0, 0.0, 3.0)
LATITUDES_DEG = (0.0, 40.0, 70.0)


def worst_error_deg() -> float:
    """Return the largest error of roll and pitch over spin-axis tilts, attitudes and latitudes, without noise."""
    late, worst = ELECTRONICS.step_delays(FRACTION, PHASE_STEP_RAD), 0.0
    for tilt, roll, pitch, latitude in itertools.product(TILTS_DEG, ATTITUDES_DEG, ATTITUDES_DEG, LATITUDES_DEG):
        cone = ScanCone.to_the_right(HALF_ANGLE_RAD, math.radians(tilt))
        day = WeatherPlace(latitude, 0.0, 30.0, 1, 0, 0)
        r, lvlh = day.position(ALTITUDE_KM), day.lvlh()
        lvlh_from_body = inverse(body_from_lvlh(0.0, math.radians(pitch), math.radians(roll)))
        to_itrs = rotate(inverse(lvlh), rotate(lvlh_from_body, np.eye(3))).T
        exact = ellipsoid_crossings(cone, to_itrs, r, WGS84)
        assert exact is not None
        phase = np.arange(exact[0] - 0.5, exact[1] + 1.0, PHASE_STEP_RAD)
        # A sample is the share of its own step that lies on the Earth: any finer edge would be lost between samples.
        share = np.clip((np.minimum(phase - exact[0], exact[1] - phase)) / PHASE_STEP_RAD + 0.5, 0.0, 1.0)
        edges = find_edges(ELECTRONICS.respond(phase, share), Threshold(FRACTION), HALF_ANGLE_RAD)
        assert isinstance(edges, ScanEdges)
        fit = attitude_over_ellipsoid(
            cone, edges.entered_rad - late[0], edges.left_rad - late[1], r, lvlh, WGS84, (1e-4, 1e-4)
        )
        if isinstance(fit, Refusal):
            return math.inf
        off = math.degrees(fit.roll_rad) - roll, math.degrees(fit.pitch_rad) - pitch
        worst = max(worst, *(abs(o) for o in off))
    return worst
