"""The hardware-in-the-loop experiment: the rendered bench through its tilts, with and without its imperfections.

Three questions. What RMS has the bench with all imperfections of stated size? What does each of them alone, and what is
left when they are switched off one after another, the largest first? And how large might each be?
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from horizonval.core import atomic
from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.spec.load import load_camera
from horizonval.systems.b.rig import figures, runs
from horizonval.systems.b.rig.bench import SAMPLES, STATED
from horizonval.systems.b.rig.film import RATE_DEG_S, SAMPLE_HZ, Film
from horizonval.systems.b.rig.frames import CAMERA, make_picture, show
from horizonval.systems.b.rig.runs import (
    FACTOR,
    IMPERFECTIONS,
    RANGE_PERCENT,
    RigResults,
    own_deviation_deg,
    percentile_of,
    plausible_benches,
)
from horizonval.systems.published import page_text, published
from horizonval.systems.result import ComparisonRow, Figure
from horizonval.systems.task_cache import TaskCache

TEXT = page_text("B")
PUBLISHED_RIG_DEG, PUBLISHED_MODEL_DEG = (published("B").number(key) for key in ("rig_rms", "model_rms"))
TILTS_DEG = (-20.0, -10.0, 0.0, 10.0, 20.0)
SHARP_LENS_PX = 0.0
LARGEST_PERFECT_DEG = 0.1


def measure_rig(cache: TaskCache) -> tuple[RigResults, str]:
    """Do the experiment; return what it measured and the file of the panel's picture."""
    picture = _picture_file(cache)
    return measure(cache, picture), picture


def perfect_row(cache: TaskCache, packed: str) -> ComparisonRow:
    """Return the row of the bench with every imperfection switched off, from the panel's packed picture."""
    perfect = runs.run_all(cache, _kept_picture(cache, packed), {"perfect": ((), TILTS_DEG)})["perfect"]
    return _perfect_row(perfect.rms_deg)


def film_rows(shown: Film) -> tuple[ComparisonRow, ...]:
    """Return the published error of the film at rest and in motion."""
    late_deg = RATE_DEG_S * SAMPLES / (2.0 * SAMPLE_HZ)
    return tuple(
        TEXT.row(
            "film",
            shown.deviation_deg(resting),
            state=TEXT.phrase("resting" if resting else "moving"),
            mean=shown.mean_deg(resting),
            frames=int(np.sum(shown.resting == resting)),
            late=late_deg,
        )
        for resting in (True, False)
    )


def rig_view(cache: TaskCache, picture: str) -> JsonObject:
    """Return one frame of the bench, for looking at."""
    return cache.each("bench pictures", show, {"view": _view(cache, picture)})["view"]


def rig_figures(results: RigResults, view: JsonObject) -> tuple[Figure, ...]:
    """Return the bench's figures."""
    return (
        TEXT.figure("rig-view", partial(figures.view, view)),
        TEXT.figure("rig-error", partial(figures.errors, results.whole, results.perfect)),
        TEXT.figure("rig-ablation", partial(figures.ablation, results, PUBLISHED_RIG_DEG, PUBLISHED_MODEL_DEG)),
    )


def measure(cache: TaskCache, picture: str) -> RigResults:
    """Run the bench as often as the experiment asks."""
    soft = (runs.PIXELS, runs.FRAME_NOISE)
    plans = {"whole": IMPERFECTIONS, "perfect": (), "soft": soft} | {name: (name,) for name in IMPERFECTIONS}
    first = runs.run_all(cache, picture, {name: (on, TILTS_DEG) for name, on in plans.items()})
    alone = {name: first[name] for name in IMPERFECTIONS}
    order = tuple(sorted(IMPERFECTIONS, key=lambda name: -alone[name].rms_deg))
    left = {name: order[i + 1 :] for i, name in enumerate(order)}
    after = runs.run_all(cache, picture, {name: (on, TILTS_DEG) for name, on in left.items()})
    sharp = runs.run_all(cache, picture, {"sharp": (soft, TILTS_DEG)}, blur_px=SHARP_LENS_PX)["sharp"]
    return RigResults(first["whole"], first["perfect"], alone, order, after, first["soft"], sharp)


def rig_rows(results: RigResults, rng: np.random.Generator) -> tuple[ComparisonRow, ...]:
    """Return the published figures beside ours; the result is the range over plausible benches, which has no bar."""
    benches = plausible_benches(results.whole, results.perfect.rms_deg, rng)
    deviation = own_deviation_deg(results.whole)
    ranges: dict[str, tuple[FloatArray, float]] = {
        "rig_range": (benches.rms_deg, results.whole.rms_deg),
        "rig_range_deviation": (benches.deviation_deg, deviation),
    }
    whole, perfect = results.whole.rms_deg, results.perfect.rms_deg
    largest = results.order[0]
    shares: dict[str, Any] = {name: 100 * share for name, share in results.families().items()}
    count = len(results.order)
    return (
        TEXT.row(
            "rig",
            whole,
            PUBLISHED_RIG_DEG,
            largest=largest,
            largest_deg=results.alone[largest].rms_deg,
            answered=results.whole.answered,
        ),
        TEXT.row(
            "rig_deviation",
            deviation,
            PUBLISHED_RIG_DEG,
            factor=PUBLISHED_RIG_DEG / deviation if deviation > 0.0 else math.inf,
        ),
        *(
            TEXT.row(
                key,
                float(np.median(values)),
                PUBLISHED_RIG_DEG,
                low=float(np.percentile(values, RANGE_PERCENT[0])),
                high=float(np.percentile(values, RANGE_PERCENT[1])),
                stated=stated,
                below=percentile_of(values, PUBLISHED_RIG_DEG),
                factor=FACTOR,
            )
            for key, (values, stated) in ranges.items()
        ),
        *(TEXT.row("rig_cause", 100.0 * share, cause=cause) for cause, share in results.causes().items()),
        TEXT.row(
            "rig_true",
            results.whole.true_rms_deg,
            percent=100.0 * (1.0 - (results.whole.true_rms_deg / whole) ** 2),
        ),
        _perfect_row(results.after[results.order[-1]].rms_deg),
        TEXT.row(
            "rig_switched_off",
            results.switched_off_below(LARGEST_PERFECT_DEG),
            bound=LARGEST_PERFECT_DEG,
            imperfections=count,
            whole=whole,
        ),
        TEXT.row(
            "rig_ratio",
            whole / perfect,
            round(PUBLISHED_RIG_DEG / PUBLISHED_MODEL_DEG, 1),
            factor=whole / PUBLISHED_MODEL_DEG,
            **shares,
        ),
        TEXT.row("rig_sum", results.root_sum_square_deg(), limit=0.1, against=whole, whole=whole),
        TEXT.row(
            "rig_lost",
            100.0 * results.sharp.lost,
            lost_deg=runs.LOST_DEG,
            blur_px=runs.LENS_BLUR_PX,
            soft=100.0 * results.soft.lost,
            soft_deg=results.soft.rms_deg,
        ),
    )


def _perfect_row(rms_deg: float) -> ComparisonRow:
    width = load_camera(CAMERA).camera.width
    return TEXT.row(
        "rig_perfect",
        rms_deg,
        TEXT.phrase("rig_model", model_deg=PUBLISHED_MODEL_DEG),
        limit=LARGEST_PERFECT_DEG,
        width=width,
        turn_deg=np.degrees(1.0 / width),
    )


def rig_summary(results: RigResults, rng: np.random.Generator) -> dict[str, float]:
    """Return the numbers of the page's summary: rms [deg], and shares of the mean square [%]."""
    shares = {name: 100 * share for name, share in results.families().items()}
    benches = plausible_benches(results.whole, results.perfect.rms_deg, rng)
    low, high = np.percentile(benches.rms_deg, RANGE_PERCENT)
    deviation = {"deviation": own_deviation_deg(results.whole)}
    return {
        "rms": results.whole.rms_deg,
        "perfect": results.perfect.rms_deg,
        "low": float(low),
        "high": float(high),
        **deviation,
        **shares,
    }


def _picture_file(cache: TaskCache) -> str:
    """Make the panel's picture; return its file, whose name is its digest."""
    return _kept_picture(cache, cache.each("panel's picture", make_picture, {"picture": {}})["picture"]["png"])


def _kept_picture(cache: TaskCache, text: str) -> str:
    """Write the panel's packed picture into the cache's folder; return its file."""
    path = cache.folder / f"panel-{hashlib.sha256(text.encode('ascii')).hexdigest()[:16]}.txt"
    atomic.write_text(path, text)
    return str(path)


def _view(cache: TaskCache, picture: str) -> JsonObject:
    return {
        "picture": picture,
        "panel": asdict(runs.panel_of(IMPERFECTIONS)),
        "errors": asdict(STATED),
        "tilts_deg": [10.0],
        "noise": True,
        "name": "view",
        "seed": cache.seed,
        "blur_px": runs.LENS_BLUR_PX,
    }
