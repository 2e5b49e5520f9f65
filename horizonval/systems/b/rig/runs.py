"""Runs of the bench with some of its imperfections: which there are, how they are switched, what comes of it.

A run is sixteen benches (:mod:`horizonval.systems.b.rig.design`) swept through tilts. The published error is the
estimate minus the accelerometer's reading; beside it stands the estimate minus the tilt that the stage really has.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.systems.b.rig import design
from horizonval.systems.b.rig.accelerometer import Accelerometer
from horizonval.systems.b.rig.bench import STATED, BenchErrors
from horizonval.systems.b.rig.frames import sweep
from horizonval.systems.b.rig.panel import Panel
from horizonval.systems.task_cache import TaskCache

PIXELS = "panel pixels: levels, stripes, moire"
BACKLIGHT = "uneven backlight"
FRAME_NOISE = "frame noise"
REFERENCE_NOISE = "accelerometer noise and steps"
MOUNTING: Mapping[str, tuple[str, ...]] = {
    "lens off the picture's middle": ("shift_x_mm", "shift_y_mm"),
    "lens off the stage's axis": ("eccentric_x_mm", "eccentric_y_mm"),
    "distance": ("distance_mm",),
    "boresight askew on the stage": ("axis_yaw_deg", "axis_pitch_deg"),
    "optical centre": ("centre_x_px", "centre_y_px"),
    "panel not level": ("panel_roll_deg",),
    "panel not square": ("panel_yaw_deg", "panel_pitch_deg"),
    "accelerometer askew on the camera": ("accelerometer_roll_deg",),
    "accelerometer zero": ("accelerometer_zero_mg",),
}
"""Imperfections that are errors of a bench, and their fields."""
IMPERFECTIONS = (*MOUNTING, PIXELS, BACKLIGHT, FRAME_NOISE, REFERENCE_NOISE)
LOST_DEG = 5.0
LENS_BLUR_PX = 0.7
"""Of the camera file."""
_ACCELEROMETER = ("accelerometer_roll_deg", "accelerometer_zero_mg")


@dataclass(frozen=True)
class BenchRun:
    """Sixteen benches with the same imperfections, swept.

    Attributes
    ----------
    tilts_deg : ndarray, shape (t,)
    estimated_deg, reference_deg : ndarray, shape (16, t)
        By the camera, NaN where it sees no arc, and by the accelerometer.
    """

    tilts_deg: FloatArray
    estimated_deg: FloatArray
    reference_deg: FloatArray

    @property
    def error_deg(self) -> FloatArray:
        """As published: estimate minus accelerometer, shape (16, t)."""
        return self.estimated_deg - self.reference_deg

    @property
    def rms_deg(self) -> float:
        """Root mean square of the published error, frames without an answer left out."""
        return _rms(self.error_deg)

    @property
    def true_rms_deg(self) -> float:
        """Root mean square of estimate minus true tilt."""
        return _rms(self.estimated_deg - self.tilts_deg)

    @property
    def answered(self) -> float:
        """Share of the frames with an answer."""
        return float(np.isfinite(self.estimated_deg).mean())

    @property
    def lost(self) -> float:
        """Share of the frames without an answer, or with one so far off that it is not of the horizon's arc."""
        off = (self.estimated_deg - self.tilts_deg + 180.0) % 360.0 - 180.0
        return float(np.mean(~(np.abs(off) <= LOST_DEG)))


def run_all(
    cache: TaskCache,
    picture: str,
    run_settings: Mapping[str, tuple[Iterable[str], tuple[float, ...]]],
    blur_px: float = LENS_BLUR_PX,
) -> dict[str, BenchRun]:
    """Return runs by their name.

    Parameters
    ----------
    picture : str
        File of the panel's picture.
    run_settings : mapping
        Name of the run to its imperfections and its tilts [deg].
    blur_px : float
        Of the lens.
    """
    items: dict[str, JsonObject] = {}
    plans: dict[str, list[str]] = {}
    for name, (imperfections, tilts) in run_settings.items():
        plans[name] = []
        for number, errors in enumerate(design.benches(errors_of(imperfections))):
            item = _item(cache, picture, set(imperfections), errors, tilts, number, blur_px)
            key = _digest(item)
            items[key] = item
            plans[name].append(key)
    swept = cache.each("bench", sweep, items)
    return {
        name: _run(cache, set(imperfections), tilts, [swept[key]["tilt_rad"] for key in plans[name]])
        for name, (imperfections, tilts) in run_settings.items()
    }


def errors_of(imperfections: Iterable[str]) -> BenchErrors:
    """Return the stated errors that belong to some imperfections, the others zero."""
    on = set(imperfections)
    off = [field for name, names in MOUNTING.items() if name not in on for field in names]
    return STATED.without(*off)


def panel_of(imperfections: Iterable[str]) -> Panel:
    """Return the panel with some imperfections."""
    on = set(imperfections)
    panel = Panel(smooth=PIXELS not in on)
    return panel if BACKLIGHT in on else replace(panel, backlight_fall=0.0, backlight_slope=0.0)


def _item(
    cache: TaskCache,
    picture: str,
    on: set[str],
    errors: BenchErrors,
    tilts: tuple[float, ...],
    number: int,
    blur_px: float,
) -> JsonObject:
    noise = FRAME_NOISE in on
    # What the camera does not see is left out, so that benches that look alike are rendered once...
    seen = errors.without(*_ACCELEROMETER)
    # ...but where they all look alike, each has its own noise.
    noise_number = number if seen == BenchErrors() else 0
    return {
        "picture": picture,
        "panel": asdict(panel_of(on)),
        "errors": {name: value + 0.0 for name, value in asdict(seen).items()},
        "tilts_deg": list(tilts),
        "noise": noise,
        "blur_px": blur_px,
        "name": f"bench {noise_number} {sorted(asdict(seen).items())}" if noise else "bench",
        "seed": cache.seed if noise else 0,
    }


def _run(cache: TaskCache, on: set[str], tilts: tuple[float, ...], found: list[list[float | None]]) -> BenchRun:
    estimated = np.array([[math.nan if value is None else value for value in row] for row in found], dtype=float)
    reference = [
        [
            Accelerometer(math.radians(errors.accelerometer_roll_deg), errors.accelerometer_zero_mg).tilt_rad(
                math.radians(tilt),
                cache.rng("accelerometer", str(number), f"{tilt:g}") if REFERENCE_NOISE in on else None,
            )
            for tilt in tilts
        ]
        for number, errors in enumerate(design.benches(errors_of(on)))
    ]
    return BenchRun(np.array(tilts), np.degrees(estimated), np.degrees(np.array(reference)))


def _digest(item: JsonObject) -> str:
    return hashlib.sha256(json.dumps(item, sort_keys=True).encode()).hexdigest()[:24]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))
