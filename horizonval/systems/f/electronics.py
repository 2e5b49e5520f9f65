r"""From radiance along a scan to two phases: beam, detector, electronics, threshold.

*Beam.* The mean over a width w on the sky, which is ``w / sin g`` of phase.

*Time constants.* Detector and electronics are lags of first order, ``tau y' = x - y``. Between samples x is linear, for
which the recursion is exact. A step is found late by::

    rising: -tau ln(1 - f),     falling: -tau ln f         at the fraction f of its height

so that both edges are late, which shifts the middle of the chord, and by different amounts unless f is one half, which
changes its length. What a step does is known on the ground and taken off; a soft limb differs a little from a step.

*Threshold.* A fixed radiance, or a fraction of the plateau: the mean of what was seen between two angles inside of the
edge, each edge having its own. The edge is the first rise through the level and the last fall; how often the signal
passes the level in between is counted, since a cloud that is colder than the level looks like space.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal

ITERATIONS = 6
"""Edge and plateau move each other; the plateau is flat, and the third step is below 1e-4 deg already."""


@dataclass(frozen=True)
class Threshold:
    """An edge at ``level`` W m-2 sr-1, or at ``fraction`` of the plateau over ``plateau_rad`` inside it."""

    fraction: float
    level: float | None = None
    plateau_rad: tuple[float, float] = (math.radians(5.0), math.radians(11.0))


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
    """Earth-in and Earth-out: phases, slopes of the signal there (per rad), and further passages in between."""

    entered_rad: float
    left_rad: float
    slope_in: float
    slope_out: float
    spare: int


@dataclass(frozen=True)
class ScannerElectronics:
    """Beam and time constants of a scanner.

    ``beam_rad``: width; ``half_angle_rad``: of the scan cone; ``rate_rad_s``: of the turn; ``lags_s``: in series.
    """

    beam_rad: float
    half_angle_rad: float
    rate_rad_s: float
    lags_s: tuple[float, ...]

    def respond(self, phase_rad: FloatArray, radiance: FloatArray) -> ScanSignal:
        """Return the signal of radiances (n,) at even phases (n,) that begin in space."""
        step = float(phase_rad[1] - phase_rad[0])
        value = _running_mean(radiance, self.beam_rad / math.sin(self.half_angle_rad) / step)
        for lag in self.lags_s:
            value = first_order_lag(value, step / self.rate_rad_s, lag)
        return ScanSignal(phase_rad, value)

    def step_delays(self, fraction: float, step_rad: float) -> tuple[float, float]:
        """Return by how much phase isolated rising and falling steps are found late at a fraction of their height."""
        reach = 2.0 * self.beam_rad / math.sin(self.half_angle_rad) + 30.0 * self.rate_rad_s * sum(self.lags_s)
        count = 2 * math.ceil(reach / step_rad)
        phase = step_rad * (np.arange(4 * count, dtype=np.float64) - 0.5)
        # The steps lie half way between samples, where a linear interpolation has them too.
        inside = ((phase > step_rad * count) & (phase < step_rad * 2.5 * count)).astype(np.float64)
        signal = self.respond(phase, inside)
        up, down = level_crossings(signal, fraction)
        return float(up[0]) - step_rad * count, float(down[-1]) - step_rad * 2.5 * count


def first_order_lag(value: FloatArray, step_s: float, lag_s: float) -> FloatArray:
    """Return the output of a lag of first order, which starts at rest on the first sample; exact for linear pieces."""
    decay = math.exp(-step_s / lag_s)
    now = 1.0 - lag_s / step_s * (1.0 - decay)
    before = 1.0 - decay - now
    start = np.array([before * value[0] + decay * value[0]])
    out, _ = lfilter([now, before], [1.0, -decay], value, zi=start)
    return np.asarray(out)


def level_crossings(signal: ScanSignal, level: float) -> tuple[FloatArray, FloatArray]:
    """Return the phases of rises and of falls through a level, linear between samples."""
    above = signal.value >= level
    i = np.flatnonzero(above[1:] != above[:-1])
    low, high = signal.value[i], signal.value[i + 1]
    step = signal.phase_rad[1] - signal.phase_rad[0]
    phase = signal.phase_rad[i] + step * (level - low) / (high - low)
    return phase[~above[i]], phase[above[i]]


def find_edges(signal: ScanSignal, threshold: Threshold, half_angle_rad: float) -> ScanEdges | Refusal:
    """Return the Earth's edges, late as they come, or why there are none."""
    top = float(np.max(signal.value))
    levels = [threshold.level] * 2 if threshold.level is not None else [threshold.fraction * top] * 2
    entered = left = math.nan
    for _ in range(1 if threshold.level is not None else ITERATIONS):
        rises, falls = level_crossings(signal, levels[0])[0], level_crossings(signal, levels[1])[1]
        if not rises.size or not falls.size:
            return Refusal(Outcome.NO_LIMB, "the signal does not pass the threshold twice")
        entered, left = float(rises[0]), float(falls[-1])
        near, far = (angle / math.sin(half_angle_rad) for angle in threshold.plateau_rad)
        if left - entered < 2.0 * far:
            return Refusal(Outcome.SHORT_ARC, "the chord is too short for two plateaus")
        if threshold.level is None:
            inside = np.linspace(near, far, 25)
            levels = [threshold.fraction * float(np.mean(signal.at(p))) for p in (entered + inside, left - inside)]
    spare = sum(int(np.sum((p > entered) & (p < left))) for p in level_crossings(signal, min(levels)))
    small = 2.0 * (signal.phase_rad[1] - signal.phase_rad[0])
    slopes = [float(signal.at(p + small) - signal.at(p - small)) / (2.0 * small) for p in (entered, left)]
    return ScanEdges(entered, left, slopes[0], slopes[1], spare)


def _running_mean(value: FloatArray, samples: float) -> FloatArray:
    """Return the mean over so many samples around each, whole or not; the ends go on as they are."""
    whole = np.concatenate([[0.0], np.cumsum(value)])
    # The integral of samples, each over half a step on either side.
    places = np.arange(len(whole), dtype=np.float64)
    middle = np.arange(len(value)) + 0.5
    ends = [np.clip(middle + side * samples / 2.0, 0.0, len(value)) for side in (-1.0, 1.0)]
    low, high = (np.interp(end, places, whole) for end in ends)
    return np.asarray((high - low) / np.maximum(ends[1] - ends[0], 1e-12))
