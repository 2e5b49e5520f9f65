"""Runs of the bench with some of its imperfections: which there are, how they are switched, what comes of it.

A run is sixteen benches (:mod:`horizonval.systems.b.rig.bench`) swept through tilts. The published error is the
estimate minus the accelerometer's reading; the estimate minus the stage's true tilt is reported too.

*The range over plausible benches* lets every stated size be twice as large or half. The published text gives no sizes
of its rig's imperfections, and ours were not chosen blind, so one figure at the stated sizes proves nothing. To first
order a bench's error at the tilt t is the sum of what its imperfections do,

    e(t) = sum_i s_i f_i m_i(t),

with the main effects ``m_i`` of the two-level design at the stated sizes (:mod:`horizonval.systems.b.rig.bench`),
signs ``s_i`` that nobody knows and factors ``f_i`` spread evenly in their logarithm over [1/2, 2]. No frame is rendered
again.

The paper's word for its figure may mean two things, which differ by a factor of several for errors that are mostly
constant: the root of the mean square of the error, and its standard deviation about the bench's own mean.
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
from horizonval.systems.b.rig.bench import (
    NAMES,
    NOISE_MG,
    SAMPLES,
    STATED,
    STEP_MG,
    Accelerometer,
    BenchErrors,
    benches,
    main_effects,
    unused_effect,
)
from horizonval.systems.b.rig.frames import sweep
from horizonval.systems.b.rig.scene import Panel
from horizonval.systems.published import page_text, published
from horizonval.systems.result import Cell, Table
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
"""Blur of the camera file's lens."""
_ACCELEROMETER = ("accelerometer_roll_deg", "accelerometer_zero_mg")


@dataclass(frozen=True)
class BenchRun:
    """Sixteen benches with the same imperfections, swept.

    ``tilts_deg``: shape (t,); ``estimated_deg``, ``reference_deg``: shape (16, t), of camera (NaN without arc) and
    accelerometer.
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

    ``picture``: file of the panel's picture; ``run_settings``: name of the run to its imperfections and its tilts
    [deg]; ``blur_px``: of the lens.
    """
    items: dict[str, JsonObject] = {}
    plans: dict[str, list[str]] = {}
    for name, (imperfections, tilts) in run_settings.items():
        plans[name] = []
        for number, errors in enumerate(benches(errors_of(imperfections))):
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
        for number, errors in enumerate(benches(errors_of(on)))
    ]
    return BenchRun(np.array(tilts), np.degrees(estimated), np.degrees(np.array(reference)))


def _digest(item: JsonObject) -> str:
    return hashlib.sha256(json.dumps(item, sort_keys=True).encode()).hexdigest()[:24]


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


@dataclass(frozen=True)
class RigResults:
    """All measurements.

    ``whole``, ``perfect``: with all imperfections and none; ``alone``: with one each; ``order``: imperfections by their
    RMS, the largest first; ``after``: by the imperfection switched off last; ``soft``, ``sharp``: panel pixels and
    frame noise with the camera's lens and with a sharper one.
    """

    whole: BenchRun
    perfect: BenchRun
    alone: Mapping[str, BenchRun]
    order: tuple[str, ...]
    after: Mapping[str, BenchRun]
    soft: BenchRun
    sharp: BenchRun

    def families(self) -> dict[str, float]:
        """Return the shares of three families in the sum of squares of single imperfections, floor subtracted.

        ``mounting`` of camera and panel, ``accelerometer``, and ``light``: panel pixels, backlight, frame noise.
        """
        excess = {name: max(self._excess(name), 0.0) for name in self.alone}
        total = sum(excess.values())
        reference = (*(name for name in MOUNTING if name.startswith("accelerometer")), REFERENCE_NOISE)
        light = (PIXELS, BACKLIGHT, FRAME_NOISE)
        shares = {
            "accelerometer": sum(excess[name] for name in reference) / total,
            "light": sum(excess[name] for name in light) / total,
        }
        return shares | {"mounting": 1.0 - sum(shares.values())}

    def causes(self) -> dict[str, float]:
        """Return the share of every cause in the sum of squares, the floor taken off."""
        excess = {name: max(self._excess(name), 0.0) for name in self.order}
        total = sum(excess.values())
        return {name: value / total for name, value in excess.items()}

    def switched_off_below(self, limit_deg: float) -> int:
        """Return how many of the largest imperfections must go for the RMS to stay below a limit."""
        above = [k for k, name in enumerate(self.order) if self.after[name].rms_deg >= limit_deg]
        return above[-1] + 2 if above else 1

    def root_sum_square_deg(self) -> float:
        """Return the RMS that independent imperfections of their single sizes would have together."""
        return math.sqrt(self.perfect.rms_deg**2 + sum(self._excess(name) for name in self.alone))

    def _excess(self, name: str) -> float:
        """Return what an imperfection adds to the mean square [deg2]; noise may make it negative."""
        return self.alone[name].rms_deg ** 2 - self.perfect.rms_deg**2


FACTOR = 2.0
DRAWS = 20_000
RANGE_PERCENT = (5.0, 95.0)


@dataclass(frozen=True)
class Benches:
    """Root mean square and standard deviation [deg] of every drawn bench over its tilts, shape (draws,)."""

    rms_deg: FloatArray
    deviation_deg: FloatArray


def plausible_benches(whole: BenchRun, floor_deg: float, rng: np.random.Generator) -> Benches:
    """Draw benches; ``floor_deg`` is the scatter of a bench without imperfections, added to both as a square."""
    effects = main_effects(whole.error_deg)
    factors = FACTOR ** rng.uniform(-1.0, 1.0, (DRAWS, len(effects)))
    signs = rng.choice([-1.0, 1.0], factors.shape)
    error = (signs * factors) @ effects
    return Benches(np.sqrt(np.mean(error**2, axis=1) + floor_deg**2), np.sqrt(np.var(error, axis=1) + floor_deg**2))


def own_deviation_deg(run: BenchRun) -> float:
    """Return the scatter of the published error about each bench's own mean, root mean square over the benches."""
    return float(np.sqrt(np.nanmean(np.nanvar(run.error_deg, axis=1))))


def percentile_of(values: FloatArray, figure: float) -> float:
    """Return the share [%] of values below a figure."""
    return 100.0 * float(np.mean(values < figure))


TEXT = page_text("B")
TARGET_DEG = published("B").number("model_rms")


def ablation_table(results: RigResults) -> Table:
    """Return every imperfection with its size, its own RMS, and the RMS that is left without it and those above."""
    rows: list[tuple[Cell, ...]] = [("all together", "", None, round(results.whole.rms_deg, 3))]
    for name in results.order:
        rows.append((name, size_of(name), round(results.alone[name].rms_deg, 3), round(results.after[name].rms_deg, 3)))
    lowest, highest = results.whole.tilts_deg[[0, -1]]
    return TEXT.table("ablation", rows, lowest=lowest, highest=highest, perfect=results.perfect.rms_deg)


def sensitivity_table(whole: BenchRun) -> Table:
    """Return what each error of the bench does per unit, from the run of the whole design."""
    effects = main_effects(whole.error_deg)
    rows: list[tuple[Cell, ...]] = []
    for name, effect in zip(NAMES, effects, strict=True):
        size, unit = getattr(STATED, name), name.rpartition("_")[2]
        rms = float(np.sqrt(np.mean(effect**2)))
        allowed = f"{size * TARGET_DEG / rms:.2g} {unit}" if rms > 0.0 else None
        error = name.rpartition("_")[0].replace("_", " ")
        rows.append((error, f"{size:g} {unit}", round(rms, 3), round(rms / size, 4), allowed))
    noise = float(np.sqrt(np.mean(unused_effect(whole.error_deg) ** 2)))
    return TEXT.table("sensitivity", rows, target_deg=TARGET_DEG, noise=noise)


def size_of(name: str) -> str:
    """Return the stated size of an imperfection in words."""
    panel = Panel()
    if name in MOUNTING:
        fields = MOUNTING[name]
        unit = fields[0].rpartition("_")[2]
        each = " each way" if len(fields) == 2 else ""
        return f"{getattr(STATED, fields[0]):g} {unit}{each}"
    return {
        PIXELS: f"{panel.pitch_mm:g} mm, {panel.stripe_open:.0%} x {panel.row_open:.0%} open, 8 bit",
        BACKLIGHT: f"{panel.backlight_fall:.0%} to the corners, {panel.backlight_slope:.0%} across",
        FRAME_NOISE: "photons, read noise, dark current",
        REFERENCE_NOISE: f"{NOISE_MG:g} mg, steps of {STEP_MG:g} mg, mean of {SAMPLES}",
    }[name]
