"""The experiment filmed: one bench through five tilts, in slow motion between them, with the accelerometer's samples.

The stage rests at each of five tilts and moves on at a constant rate. The camera takes a frame a second; the
accelerometer is sampled a hundred times a second, and what it says at a frame is the mean of the last 64 samples, as on
a hobby board. Such a mean is late by half of its length: while the stage moves, the published error (estimate minus
accelerometer) has

    rate x 64 / (2 x 100 Hz)

of it, which is no error of the camera. At rest what is left is the bench's offset and the frame noise.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.systems.b.rig import runs
from horizonval.systems.b.rig.bench import NOISE_MG, SAMPLES, STATED, STEP_MG, benches
from horizonval.systems.b.rig.frames import sweep
from horizonval.systems.b.rig.runs import IMPERFECTIONS
from horizonval.systems.task_cache import TaskCache

TILTS_DEG = (-20.0, -10.0, 0.0, 10.0, 20.0)
REST_S, RATE_DEG_S, FRAME_S, SAMPLE_HZ = 5.0, 1.0, 1.0, 100.0
BENCH = 1
"""Which of the sixteen: the first one whose signs differ."""


@dataclass(frozen=True)
class Film:
    """Times [s], true, estimated (NaN without an arc) and accelerometer's tilts [deg], and whether the stage rests."""

    times_s: FloatArray
    true_deg: FloatArray
    estimated_deg: FloatArray
    reference_deg: FloatArray
    resting: np.ndarray

    @property
    def error_deg(self) -> FloatArray:
        """As published: estimate minus accelerometer."""
        return self.estimated_deg - self.reference_deg

    def deviation_deg(self, resting: bool) -> float:
        """Return the standard deviation of the error at rest, or in motion."""
        return float(np.nanstd(self.error_deg[self.resting == resting]))

    def mean_deg(self, resting: bool) -> float:
        """Return the mean error at rest, or in motion."""
        return float(np.nanmean(self.error_deg[self.resting == resting]))


def tilt_at(times_s: FloatArray) -> FloatArray:
    """Return the stage's tilt [deg] at times from the begin of the film; it rests at its first tilt before."""
    knots_s, knots_deg, t = [], [], 0.0
    for k, tilt in enumerate(TILTS_DEG):
        if k:
            t += abs(tilt - TILTS_DEG[k - 1]) / RATE_DEG_S
        knots_s += [t, t + REST_S]
        knots_deg += [tilt, tilt]
        t += REST_S
    return np.asarray(np.interp(times_s, knots_s, knots_deg))


def length_s() -> float:
    """Return how long the film is."""
    return len(TILTS_DEG) * REST_S + float(np.abs(np.diff(TILTS_DEG)).sum()) / RATE_DEG_S


def reading_deg(time_s: float, roll_deg: float, zero_mg: float, rng: np.random.Generator) -> float:
    """Return the accelerometer's tilt at a time: the mean of its last samples, each with its noise and steps."""
    at = time_s - np.arange(SAMPLES) / SAMPLE_HZ
    angle = np.radians(tilt_at(at) + roll_deg)
    gravity_mg = 1e3 * np.stack([np.sin(angle), np.cos(angle)], axis=1) + np.array([zero_mg, 0.0])
    samples = STEP_MG * np.rint((gravity_mg + NOISE_MG * rng.standard_normal(gravity_mg.shape)) / STEP_MG)
    x, y = samples.mean(axis=0)
    return math.degrees(math.atan2(x, y))


def film(cache: TaskCache, picture: str) -> Film:
    """Render the film and read it."""
    times = np.arange(0.0, length_s() + 0.5 * FRAME_S, FRAME_S)
    tilts = tilt_at(times)
    errors = benches(STATED)[BENCH]
    seen = errors.without("accelerometer_roll_deg", "accelerometer_zero_mg")
    items: dict[str, JsonObject] = {
        f"second {time:g}": {
            "picture": picture,
            "panel": asdict(runs.panel_of(IMPERFECTIONS)),
            "errors": asdict(seen),
            "tilts_deg": [float(tilt)],
            "noise": True,
            "blur_px": runs.LENS_BLUR_PX,
            "name": f"film {time:g}",
            "seed": cache.seed,
        }
        for time, tilt in zip(times, tilts, strict=True)
    }
    found = [one["tilt_rad"][0] for one in cache.each("bench film", sweep, items).values()]
    estimated = np.degrees(np.array([math.nan if value is None else value for value in found]))
    rng = cache.rng("accelerometer", "film")
    roll_deg, zero_mg = errors.accelerometer_roll_deg, errors.accelerometer_zero_mg
    reference = np.array([reading_deg(float(time), roll_deg, zero_mg, rng) for time in times])
    window = np.stack([tilt_at(times - SAMPLES / SAMPLE_HZ), tilt_at(times + 1e-6)])
    return Film(times, tilts, estimated, reference, np.ptp(window, axis=0) < 1e-9)
