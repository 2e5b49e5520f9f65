"""The bench's tables: what each imperfection does, and how large it may be."""

from __future__ import annotations

import numpy as np

from horizonval.systems.b.rig import design, runs
from horizonval.systems.b.rig.accelerometer import NOISE_MG, SAMPLES, STEP_MG
from horizonval.systems.b.rig.bench import STATED
from horizonval.systems.b.rig.panel import Panel
from horizonval.systems.b.rig.results import RigResults
from horizonval.systems.b.rig.runs import BenchRun
from horizonval.systems.published import published
from horizonval.systems.result import Cell, Table
from horizonval.systems.text import page_text

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
    effects = design.main_effects(whole.error_deg)
    rows: list[tuple[Cell, ...]] = []
    for name, effect in zip(design.NAMES, effects, strict=True):
        size, unit = getattr(STATED, name), name.rpartition("_")[2]
        rms = float(np.sqrt(np.mean(effect**2)))
        allowed = f"{size * TARGET_DEG / rms:.2g} {unit}" if rms > 0.0 else None
        error = name.rpartition("_")[0].replace("_", " ")
        rows.append((error, f"{size:g} {unit}", round(rms, 3), round(rms / size, 4), allowed))
    noise = float(np.sqrt(np.mean(design.unused_effect(whole.error_deg) ** 2)))
    return TEXT.table("sensitivity", rows, target_deg=TARGET_DEG, noise=noise)


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
