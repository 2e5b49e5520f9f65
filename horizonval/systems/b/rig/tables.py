"""The bench's tables: what each imperfection does, and how large it may be."""

from __future__ import annotations

import numpy as np

from horizonval.systems.b.rig import design, runs
from horizonval.systems.b.rig.accelerometer import NOISE_MG, SAMPLES, STEP_MG
from horizonval.systems.b.rig.bench import STATED
from horizonval.systems.b.rig.panel import Panel
from horizonval.systems.b.rig.results import RigResults
from horizonval.systems.b.rig.runs import BenchRun
from horizonval.systems.result import Cell, Table

TARGET_DEG = 0.038


def ablation_table(results: RigResults) -> Table:
    """Return every imperfection with its size, its own RMS, and the RMS that is left without it and those above."""
    rows: list[tuple[Cell, ...]] = [("all together", "", None, round(results.whole.rms_deg, 3))]
    for name in results.order:
        rows.append((name, size_of(name), round(results.alone[name].rms_deg, 3), round(results.after[name].rms_deg, 3)))
    return Table(
        "The bench: imperfections one by one",
        ("imperfection", "size, either sign", "RMS with it alone, deg", "RMS after switching it off too, deg"),
        tuple(rows),
        f"Sixteen benches, tilts of {results.whole.tilts_deg[0]:g} to {results.whole.tilts_deg[-1]:g} deg. With none "
        f"the RMS is {results.perfect.rms_deg:.3f} deg, which is in every figure: two end pixels of the arc.",
    )


def sensitivity_table(whole: BenchRun) -> Table:
    """Return what each error of the bench does per unit, from the run of the whole design."""
    effects = design.main_effects(whole.error_deg)
    rows: list[tuple[Cell, ...]] = []
    for name, effect in zip(design.NAMES, effects, strict=True):
        size, unit = getattr(STATED, name), name.rpartition("_")[2]
        rms = float(np.sqrt(np.mean(effect**2)))
        allowed = f"{size * TARGET_DEG / rms:.2g} {unit}" if rms > 0.0 else None
        words = name.rpartition("_")[0].replace("_", " ")
        rows.append((words, f"{size:g} {unit}", round(rms, 3), round(rms / size, 4), allowed))
    noise = float(np.sqrt(np.mean(design.unused_effect(whole.error_deg) ** 2)))
    return Table(
        "The bench: sensitivities",
        ("error", "stated size", "its effect, deg rms", "per unit, deg", f"size that makes {TARGET_DEG} deg"),
        tuple(rows),
        "Main effects of the two-level design, all errors present; rms over the tilts. A contrast that no error uses "
        f"comes out at {noise:.3f} deg: effects of that size are noise, and their last two columns bounds.",
    )


def size_of(name: str) -> str:
    """Return the stated size of an imperfection in words."""
    panel = Panel()
    if name in runs.MOUNTING:
        fields = runs.MOUNTING[name]
        unit = fields[0].rpartition("_")[2]
        each = " each way" if len(fields) == 2 else ""
        return f"{getattr(STATED, fields[0]):g} {unit}{each}"
    return {
        runs.PIXELS: f"{panel.pitch_mm:g} mm, {panel.stripe_open:.0%} x {panel.row_open:.0%} open, 8 bit",
        runs.BACKLIGHT: f"{panel.backlight_fall:.0%} to the corners, {panel.backlight_slope:.0%} across",
        runs.FRAME_NOISE: "photons, read noise, dark current",
        runs.REFERENCE_NOISE: f"{NOISE_MG:g} mg, steps of {STEP_MG:g} mg, mean of {SAMPLES}",
    }[name]
