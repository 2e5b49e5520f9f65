"""System A: the altitude-free image horizon sensor of Raeisy and Ghofrani (2021), done again on rendered spheres.

The three set-ups, the check of the image generator, the convergence, and the error table over the full grid; beside the
published method (whole pixels, Newton's method with the pseudo-inverse) the closed form of the same equation, and both
of them on sub-pixel points.
"""

from __future__ import annotations

from collections.abc import Mapping

from horizonval.systems.a import figures as figures
from horizonval.systems.a.bank import grid, measure, set_ups
from horizonval.systems.a.check import check
from horizonval.systems.a.rows import (
    accuracy_rows,
    check_rows,
    closed_form_rows,
    convergence_rows,
    set_up_rows,
    trend_rows,
)
from horizonval.systems.a.solvers import DRAWS, POINTS, compare, conditions
from horizonval.systems.a.table import METHODS, Bank, bank_of, error_table, rms, values
from horizonval.systems.result import Figure, Reproduction, Table
from horizonval.systems.task_cache import Plain, TaskCache


def reproduce(cache: TaskCache) -> Reproduction:
    """Do the experiments of the paper again; see the module."""
    seed = cache.seed
    published = set_ups(seed)
    shown = cache.each("set-ups", measure, published)
    checks = cache.each("image generator", check, published)
    solvers = cache.each("solvers", compare, conditions(seed))
    items = grid(seed)
    bank = bank_of(items, cache.each("grid of conditions", measure, items))
    rows = [*set_up_rows(shown), *check_rows(checks), *convergence_rows(shown, bank)]
    rows += [*accuracy_rows(bank), *trend_rows(bank), *closed_form_rows(bank, solvers)]
    first = next(iter(shown.values()))
    return Reproduction(
        system="A",
        title="Altitude-free image horizon sensor",
        source='Raeisy and Ghofrani, "Imaged Based Earth Horizon Sensor with no Altitude Information", 2021',
        summary={"text": _summary(bank)},
        rows=tuple(rows),
        tables=(*(error_table(bank, method) for method in METHODS), solver_table(solvers)),
        figures=(
            Figure("set-ups", "The published set-ups, rendered; orange: Canny's pixels.",
                   figures.pictures(shown)),
            Figure("convergence", "Newton's method at 3000 km, 60 deg, 400 pixels, from two starts. The "
                   "summed error levels off at what whole pixels leave.", figures.convergence(first)),
            Figure("errors", "Median nadir error over roll and pitch, noise-free frames.",
                   figures.errors_with_pixels(bank)),
            Figure("solvers", f"Newton and closed form on the same {POINTS} points, noise 0.1 px of 1024 "
                   f"over 60 deg, {DRAWS} draws.", figures.solvers(solvers)),
        ),
        settings={"seed": seed, "frames": len(items) + len(published)},
    )  # fmt: skip


def solver_table(solvers: Mapping[str, Plain]) -> Table:
    """Return Newton and closed form side by side, on noisy arcs."""
    names = ["rho_deg", "arc_deg", "noise_px", "newton_rms", "newton_bias", "closed_rms", "closed_bias"]
    names += ["foretold_closed_bias", "newton_steps"]
    return Table(
        title="Newton and closed form on the same points",
        columns=(
            "rho [deg]", "arc [deg]", "noise [px]", "Newton rms [arcsec]", "Newton bias", "closed rms", "closed bias",
            "closed bias foretold", "Newton steps",
        ),
        rows=tuple(tuple(float(f"{one[name]:.4g}") for name in names) for one in solvers.values()),
        caption=f"Error of the nadir over {DRAWS} draws of {POINTS} points, a pixel being that of 1024 "
        "over 60 deg. The "
        "orthogonal plane's errors are Newton's to rounding. Cost: the closed form solves one n x 3 least-squares "
        "problem, Newton one a step.",
    )  # fmt: skip


def _summary(bank: Bank) -> str:
    sharp = [f for f in bank.values() if (f[0]["fov_deg"], f[0]["pixels"]) == (60.0, 1024)]
    least = min(bank.values(), key=lambda f: f[0]["altitude_km"])[0]["altitude_km"]
    low = {(i["fov_deg"], i["roll_deg"], i["pitch_deg"]) for i, _ in bank.values() if i["altitude_km"] == least}
    fields = sorted({fov for fov, _, _ in low})
    seen = ", ".join(f"{sum(f == fov for f, _, _ in low)} of the 16 attitudes at {fov:g} deg" for fov in fields)
    return (
        "Bare spheres under an overhead Sun, rendered at the paper's set-ups and over the grid of "
        "altitude, field, pixels "
        f"and attitude ({len(bank)} frames; roll and pitch in steps of 20 deg, moved by up to 1 deg). The camera looks "
        f"to the nadir at zero attitude, so that from {least:g} km a fifth of the image's width of horizon "
        "is in view in "
        f"few cases: {seen}. Newton's method as published is compared with the closed form of the same "
        "equation, linear "
        "in n / cos rho, each on Canny's whole pixels and on sub-pixel points. With sub-pixel points the nadir is good "
        f"to {rms(values(sharp, 'limb, newton', 'nadir_arcsec')):.2f} arcsec rms at 1024 pixels over 60 deg without "
        f"noise; with whole pixels to {rms(values(sharp, 'whole, newton', 'nadir_arcsec')):.0f}."
    )
