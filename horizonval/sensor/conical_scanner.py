r"""A conical scanner: from radiance along a scan to two edges of the Earth, and from these to roll and pitch.

The beam turns about the axis s at the half-angle g. With unit vectors e, f across s and the phase p (0 nearest to the
body's z axis, growing as s turns f behind e)::

    d(p) = s cos g + (e cos p + f sin p) sin g

*Beam and time constants.* The signal is the mean over the beam's width w, which is ``w / sin g`` of phase, behind lags
of first order, ``tau y' = x - y``. Between samples x is linear, for which the recursion is exact. A step is late by
``-tau ln(1 - f)`` where it rises and ``-tau ln f`` where it falls, at the fraction f of its height. What a step does is
subtracted; a soft limb differs a little from a step.

*Threshold.* A fixed level, or a fraction of the plateau: the mean of the signal between two angles inside of the edge,
each edge having its own. The edge is the first rise through the level and the last fall.

*Roll and pitch.* Newton's steps on ``limb_side(d_in) = limb_side(d_out) = 0`` over an ellipsoid, at a known position
and yaw. A phase that is off by dp moves the line of sight by ``d' dp``, which gives the covariance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid
from horizonval.geometry.frames import body_from_lvlh, inverse, rotate
from horizonval.geometry.horizon import limb_side, tangent_cone

ITERATIONS = 6
"""Edge and plateau move each other; the third iteration changes the edge by less than 1e-4 deg."""
ON_HORIZON = 1e-6
"""Largest value of the limb function on true roots: 1e-16 ahead of the observer, of order 1 behind."""
STEP_RAD = 1e-6
LEAST_SINE = 1e-3
"""Smallest sine between both crossings' effects; below it the chord cannot separate pitch from roll."""
NEWTON_STEPS, CONVERGED_RAD = 20, 1e-11


@dataclass(frozen=True)
class ScanSignal:
    """Amplifier output ``value`` at even steps ``phase_rad``, shape (n,)."""

    phase_rad: FloatArray
    value: FloatArray

    def at(self, phase_rad: FloatArray | float) -> FloatArray:
        """Return the signal at phases, linear between samples."""
        return np.asarray(np.interp(phase_rad, self.phase_rad, self.value))


@dataclass(frozen=True)
class ScanEdges:
    """The Earth's edges in a signal, step delays subtracted.

    ``entered_rad``, ``left_rad``: phases; ``slopes``: of the signal there [per rad]; ``plateaus``: of both edges;
    ``spare``: further passages of the level in between, as cold clouds cause them.
    """

    entered_rad: float
    left_rad: float
    slopes: tuple[float, float]
    plateaus: tuple[float, float]
    spare: int


@dataclass(frozen=True)
class ScannerFit:
    """An attitude; ``covariance``: shape (2, 2), of roll and pitch [rad2]."""

    roll_rad: float
    pitch_rad: float
    covariance: FloatArray


@dataclass(frozen=True)
class ConicalScanner:
    """A pencil beam that turns about an axis to the right of the body, and its electronics.

    The defaults are round numbers that are usual for scanners of the nineteen-seventies.

    Attributes
    ----------
    half_angle_rad, beam_rad, rate_rad_s : float
        Angle between beam and axis, the beam's width, rate of the turn.
    tilt_rad : float
        Turn of the axis from the body's y axis towards z.
    lags_s : tuple of float
        Time constants of detector and amplifier, in series.
    fraction, level : float, and float or None
        Threshold as a fraction of the plateau, or as a level in place of it.
    plateau_rad : (float, float)
        Angles inside of an edge between which its plateau is averaged.

    Examples
    --------
    >>> import horizonval as hv, numpy as np
    >>> scanner = hv.ConicalScanner()
    >>> phase = np.radians(np.arange(-90.0, 90.0, 0.05))
    >>> edges = scanner.edges(scanner.signal(phase, np.where(np.abs(phase) < 0.8, 5.0, 0.0)))
    >>> print(f"{edges.entered_rad:.3f} to {edges.left_rad:.3f} rad")
    -0.800 to 0.800 rad
    """

    half_angle_rad: float = math.radians(45.0)
    beam_rad: float = math.radians(1.0)
    rate_rad_s: float = 4.0 * math.pi
    tilt_rad: float = 0.0
    lags_s: tuple[float, ...] = (2e-3, 1e-3)
    fraction: float = 0.4
    level: float | None = None
    plateau_rad: tuple[float, float] = (math.radians(5.0), math.radians(11.0))

    @property
    def axes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Body vectors: the spin axis, and the directions across it at phase 0 and at a quarter turn."""
        c, s = math.cos(self.tilt_rad), math.sin(self.tilt_rad)
        axis, start = np.array([0.0, c, s]), np.array([0.0, -s, c])
        return axis, start, np.cross(axis, start)

    def directions(self, phase_rad: ArrayLike, off_rad: float = 0.0) -> FloatArray:
        """Return the beam at phases (...), shape (..., 3), in body axes; or a line that is off it by an angle."""
        axis, start, quarter = self.axes
        phase = np.asarray(phase_rad, dtype=np.float64)[..., None]
        g = self.half_angle_rad + off_rad
        return math.cos(g) * axis + math.sin(g) * (np.cos(phase) * start + np.sin(phase) * quarter)

    def signal(self, phase_rad: FloatArray, radiance: FloatArray) -> ScanSignal:
        """Return the signal of radiances (n,) at even phases (n,) that begin in space."""
        step = float(phase_rad[1] - phase_rad[0])
        value = _running_mean(radiance, self.beam_rad / math.sin(self.half_angle_rad) / step)
        for lag in self.lags_s:
            value = first_order_lag(value, step / self.rate_rad_s, lag)
        return ScanSignal(phase_rad, value)

    def step_delays(self, step_rad: float) -> tuple[float, float]:
        """Return by how much phase rising and falling steps are found late, in a signal of even steps."""
        reach = 2.0 * self.beam_rad / math.sin(self.half_angle_rad) + 30.0 * self.rate_rad_s * sum(self.lags_s)
        count = 2 * math.ceil(reach / step_rad)
        phase = step_rad * (np.arange(4 * count, dtype=np.float64) - 0.5)
        # The steps are half way between samples, where a linear interpolation has them too.
        inside = ((phase > step_rad * count) & (phase < step_rad * 2.5 * count)).astype(np.float64)
        up, down = level_crossings(self.signal(phase, inside), self.fraction)
        return float(up[0]) - step_rad * count, float(down[-1]) - step_rad * 2.5 * count

    def edges(self, signal: ScanSignal) -> ScanEdges | Refusal:
        """Return the Earth's edges in a signal, or why there are none."""
        near, far = (angle / math.sin(self.half_angle_rad) for angle in self.plateau_rad)
        inside = np.linspace(near, far, 25)
        levels = [self.fraction * float(np.max(signal.value)) if self.level is None else self.level] * 2
        entered = left = math.nan
        plateaus = (math.nan, math.nan)
        for _ in range(ITERATIONS if self.level is None else 1):
            rises, falls = level_crossings(signal, levels[0])[0], level_crossings(signal, levels[1])[1]
            if not rises.size or not falls.size:
                return Refusal(Outcome.NO_LIMB, "the signal does not pass the threshold twice")
            entered, left = float(rises[0]), float(falls[-1])
            if left - entered < 2.0 * far:
                return Refusal(Outcome.SHORT_ARC, "the chord is too short for two plateaus")
            plateaus = float(np.mean(signal.at(entered + inside))), float(np.mean(signal.at(left - inside)))
            if self.level is None:
                levels = [self.fraction * plateau for plateau in plateaus]
        spare = sum(int(np.sum((p > entered) & (p < left))) for p in level_crossings(signal, min(levels)))
        step = float(signal.phase_rad[1] - signal.phase_rad[0])
        slopes = [float(signal.at(p + 2 * step) - signal.at(p - 2 * step)) / (4.0 * step) for p in (entered, left)]
        late = self.step_delays(step)
        return ScanEdges(entered - late[0], left - late[1], (slopes[0], slopes[1]), plateaus, spare)

    def with_level(self, level: float) -> ConicalScanner:
        """Return the scanner with a fixed threshold."""
        return replace(self, level=level)

    def crossings(
        self, itrs_from_body: FloatArray, r_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84
    ) -> tuple[float, float] | None:
        """Return the phases at which the beam enters and leaves an ellipsoid, or None.

        With ``t = tan(p / 2)`` the vector ``(1 + t^2) d`` is a polynomial of second degree in t, so that the horizon
        ``d^T Q d = 0`` is one of fourth degree. ``itrs_from_body``: shape (3, 3); ``r_itrs``: observer [m].
        """
        q = tangent_cone(r_itrs, ellipsoid)
        c, s = math.cos(self.half_angle_rad), math.sin(self.half_angle_rad)
        fixed, start, quarter = (itrs_from_body @ v for v in np.array([c, s, s])[:, None] * np.array(self.axes))
        zero, one, two = fixed + start, 2.0 * quarter, fixed - start
        middle = 2 * two @ q @ zero + one @ q @ one
        roots = np.roots([two @ q @ two, 2 * two @ q @ one, middle, 2 * one @ q @ zero, zero @ q @ zero])
        phase = 2.0 * np.arctan(roots[np.abs(roots.imag) < 1e-9].real)
        direction = self.directions(phase) @ itrs_from_body.T
        phase = phase[np.abs(limb_side(direction, r_itrs, ellipsoid)) < ON_HORIZON]
        if len(phase) != 2:
            return None
        ahead = [self.directions(phase + sign * STEP_RAD) @ itrs_from_body.T for sign in (-1.0, 1.0)]
        before, after = (np.einsum("ij,jk,ik->i", d, q, d) for d in ahead)
        inwards = after > before
        entered, left = float(phase[inwards][0]), float(phase[~inwards][0])
        return entered, left if left > entered else left + math.tau

    def attitude(
        self,
        edges: ScanEdges,
        r_itrs: FloatArray,
        lvlh_from_itrs: FloatArray,
        ellipsoid: Ellipsoid = WGS84,
        noise: float = 0.0,
    ) -> ScannerFit | Refusal:
        """Return roll and pitch over an ellipsoid, at a known position [m] and no yaw.

        ``lvlh_from_itrs``: quaternion, scalar last; ``noise``: standard deviation of the signal, for the covariance.
        """
        phases = np.array([edges.entered_rad, edges.left_rad])

        def off_at(phase: FloatArray, roll: float, pitch: float) -> FloatArray:
            d_lvlh = rotate(inverse(body_from_lvlh(0.0, pitch, roll)), self.directions(phase))
            return limb_side(rotate(inverse(lvlh_from_itrs), d_lvlh), r_itrs, ellipsoid)

        def jacobian_at(roll: float, pitch: float) -> FloatArray:
            by_roll = off_at(phases, roll + STEP_RAD, pitch) - off_at(phases, roll - STEP_RAD, pitch)
            by_pitch = off_at(phases, roll, pitch + STEP_RAD) - off_at(phases, roll, pitch - STEP_RAD)
            return np.stack([by_roll, by_pitch], axis=-1) / (2.0 * STEP_RAD)

        roll = pitch = 0.0
        for _ in range(NEWTON_STEPS):
            jacobian = jacobian_at(roll, pitch)
            lengths = float(np.prod(np.linalg.norm(jacobian, axis=1)))
            if abs(float(np.linalg.det(jacobian))) < LEAST_SINE * lengths:
                return Refusal(Outcome.SHORT_ARC, "the chord cannot separate pitch from roll")
            step = np.linalg.solve(jacobian, off_at(phases, roll, pitch))
            roll, pitch = roll - float(step[0]), pitch - float(step[1])
            if max(abs(roll), abs(pitch)) > math.pi / 4:
                return Refusal(Outcome.NOT_CONVERGED, "the edges fit no attitude near the nadir")
            if np.max(np.abs(step)) < CONVERGED_RAD:
                per_phase = (off_at(phases + STEP_RAD, roll, pitch) - off_at(phases, roll, pitch)) / STEP_RAD
                sigma = noise / np.abs(edges.slopes)
                per_angle = np.linalg.solve(jacobian, np.diag(per_phase * sigma))
                return ScannerFit(roll, pitch, per_angle @ per_angle.T)
        return Refusal(Outcome.NOT_CONVERGED, "no attitude after the last step")


def first_order_lag(value: FloatArray, step_s: float, lag_s: float) -> FloatArray:
    """Return the output of a lag of first order, which starts at rest on the first sample; exact for linear pieces."""
    decay = math.exp(-step_s / lag_s)
    now = 1.0 - lag_s / step_s * (1.0 - decay)
    before = 1.0 - decay - now
    out, _ = lfilter([now, before], [1.0, -decay], value, zi=np.array([(before + decay) * value[0]]))
    return np.asarray(out)


def level_crossings(signal: ScanSignal, level: float) -> tuple[FloatArray, FloatArray]:
    """Return the phases of rises and of falls through a level, linear between samples."""
    above = signal.value >= level
    i = np.flatnonzero(above[1:] != above[:-1])
    low, high = signal.value[i], signal.value[i + 1]
    step = signal.phase_rad[1] - signal.phase_rad[0]
    phase = signal.phase_rad[i] + step * (level - low) / (high - low)
    return phase[~above[i]], phase[above[i]]


def _running_mean(value: FloatArray, samples: float) -> FloatArray:
    """Return the mean over so many samples around each, whole or not; the ends continue unchanged."""
    # The integral of samples, each over half a step on either side.
    whole = np.concatenate([[0.0], np.cumsum(value)])
    places = np.arange(len(whole), dtype=np.float64)
    middle = np.arange(len(value)) + 0.5
    low, high = (np.clip(middle + side * samples / 2.0, 0.0, len(value)) for side in (-1.0, 1.0))
    mean = (np.interp(high, places, whole) - np.interp(low, places, whole)) / np.maximum(high - low, 1e-12)
    return np.asarray(mean)
