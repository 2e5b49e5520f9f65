"""The hardware-in-the-loop experiment: the rendered bench through its tilts, with and without its imperfections.

Three questions. What RMS has the bench with all imperfections of stated size? What does each of them alone, and what is
left when they are switched off one after another, the largest first? And how large might each be?
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from functools import partial

import numpy as np

from horizonval.core import atomic
from horizonval.core.json_types import JsonObject
from horizonval.spec.load import load_camera
from horizonval.systems.b.rig import figures, runs
from horizonval.systems.b.rig.bench import STATED
from horizonval.systems.b.rig.frames import CAMERA, make_picture, show
from horizonval.systems.b.rig.results import RigResults
from horizonval.systems.b.rig.runs import IMPERFECTIONS
from horizonval.systems.b.rig.tables import ablation_table, sensitivity_table
from horizonval.systems.result import ComparisonRow, Figure, Table
from horizonval.systems.task_cache import TaskCache

TILTS_DEG = (-20.0, -10.0, 0.0, 10.0, 20.0)
SHARP_LENS_PX = 0.0
PUBLISHED_RIG_DEG, PUBLISHED_MODEL_DEG = 0.752, 0.038
LARGEST_RIG_DEG, SMALLEST_RIG_DEG, LARGEST_PERFECT_DEG = 1.0, 0.5, 0.1


def rig_parts(cache: TaskCache) -> tuple[tuple[ComparisonRow, ...], tuple[Table, ...], tuple[Figure, ...], str]:
    """Do the experiment; return its rows, tables and figures, and a paragraph about it."""
    picture = _picture_file(cache)
    results = measure(cache, picture)
    view = cache.each("bench pictures", show, {"view": _view(cache, picture)})["view"]
    drawn = (
        Figure(
            "rig-view",
            "The rendered bench. Left: what its camera takes of the panel at a tilt of 10 deg, all imperfections on. "
            "Right, at the limb: the panel under a magnifier, red, green and blue stripes as the camera's band weighs "
            "them; the camera's pixels behind a lens without blur, where the stripes beat with the pixels; and behind "
            "its own lens.",
            partial(figures.view, view),
        ),
        Figure(
            "rig-error",
            "Estimate minus accelerometer against tilt: sixteen benches with every imperfection at its stated size "
            "and another choice of signs, and the perfect bench.",
            partial(figures.errors, results.whole, results.perfect),
        ),
        Figure(
            "rig-ablation",
            "RMS of the published error. Left: with one imperfection alone. Right: what is left when they are "
            "switched off one after another, from the top.",
            partial(figures.ablation, results, PUBLISHED_RIG_DEG, PUBLISHED_MODEL_DEG),
        ),
    )
    return rows(results), (ablation_table(results), sensitivity_table(results.whole)), drawn, summary(results)


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


def rows(results: RigResults) -> tuple[ComparisonRow, ...]:
    """Return the published figures beside ours."""
    whole, perfect = results.whole.rms_deg, results.perfect.rms_deg
    largest = results.order[0]
    family = results.families()
    width = load_camera(CAMERA).camera.width
    return (
        ComparisonRow(
            "hardware in the loop: RMS, estimate minus accelerometer",
            PUBLISHED_RIG_DEG,
            whole,
            "deg",
            f"The largest imperfection alone ({largest}) makes {results.alone[largest].rms_deg:.2f} deg; the published "
            f"text gives no sizes, ours are what a careful student reaches. {results.whole.answered:.0%} of the frames "
            "have an answer.",
            limit=0.5 * (LARGEST_RIG_DEG - SMALLEST_RIG_DEG),
            against=0.5 * (LARGEST_RIG_DEG + SMALLEST_RIG_DEG),
        ),
        ComparisonRow(
            "hardware in the loop: RMS, estimate minus true tilt",
            None,
            results.whole.true_rms_deg,
            "deg",
            "Known on a rendered bench only: without the accelerometer's own errors "
            f"{100.0 * (1.0 - (results.whole.true_rms_deg / whole) ** 2):.0f} % of the mean square go.",
        ),
        ComparisonRow(
            "hardware in the loop: RMS with every imperfection switched off",
            f"{PUBLISHED_MODEL_DEG} (the model)",
            results.after[results.order[-1]].rms_deg,
            "deg",
            f"Two end pixels decide the chord: one pixel up or down at one end of {width} turns it by "
            f"{np.degrees(1.0 / width):.2f} deg.",
            limit=LARGEST_PERFECT_DEG,
        ),
        ComparisonRow(
            f"hardware in the loop: imperfections to switch off, largest first, until the RMS is below "
            f"{LARGEST_PERFECT_DEG:g} deg",
            None,
            results.switched_off_below(LARGEST_PERFECT_DEG),
            f"of {len(results.order)}",
            f"From {whole:.3f} deg with all of them; the table has the RMS after each.",
            limit=len(results.order),
        ),
        ComparisonRow(
            "hardware in the loop: RMS over that of the perfect bench",
            round(PUBLISHED_RIG_DEG / PUBLISHED_MODEL_DEG, 1),
            whole / perfect,
            "",
            f"Over the published model the bench has a factor of {whole / PUBLISHED_MODEL_DEG:.0f}; "
            f"{100 * family['mounting']:.0f} % of the mean square come from how camera and panel are mounted, "
            f"{100 * family['accelerometer']:.0f} % from the accelerometer, {100 * family['light']:.0f} % from panel "
            "pixels, backlight and frame noise.",
        ),
        ComparisonRow(
            "hardware in the loop: root of the sum of squares of the single imperfections",
            None,
            results.root_sum_square_deg(),
            "deg",
            f"Independent imperfections would make the {whole:.3f} deg of all at once.",
            limit=0.1,
            against=whole,
        ),
        ComparisonRow(
            f"hardware in the loop: frames {runs.LOST_DEG:g} deg off by pixels and noise alone, lens without blur",
            None,
            100.0 * results.sharp.lost,
            "%",
            "Moire at its worst, which no real lens shows: its edges are taken for the horizon. Behind the camera's "
            f"own lens, of {runs.LENS_BLUR_PX} px, {100.0 * results.soft.lost:.0f} % are off as far and the RMS is "
            f"{results.soft.rms_deg:.3f} deg.",
        ),
    )


def summary(results: RigResults) -> str:
    """Return a paragraph for the page."""
    family = results.families()
    return (
        "**The bench.** Mitsuba renders a camera of 512 pixels and 60 deg before a 24 inch panel that shows a limb "
        "frame of ours, pixel by pixel with its stripes; the camera is turned about its boresight and an "
        "accelerometer says how far. The published text gives no sizes of its rig's imperfections; ours were written "
        "down before anything was rendered. Sixteen benches with both signs of each give "
        f"{results.whole.rms_deg:.3f} deg RMS (published {PUBLISHED_RIG_DEG}), the perfect bench "
        f"{results.perfect.rms_deg:.3f} deg. Of the two causes that the publication names, imperfections of "
        "the rig and frame noise, the shares in the mean square are: "
        f"mounting of camera and panel {100 * family['mounting']:.0f} %, the accelerometer "
        f"{100 * family['accelerometer']:.0f} %, panel pixels, backlight and frame noise "
        f"{100 * family['light']:.0f} %."
    )


def _picture_file(cache: TaskCache) -> str:
    """Make the panel's picture; return its file, whose name is its digest."""
    text = cache.each("panel's picture", make_picture, {"picture": {}})["picture"]["png"]
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
