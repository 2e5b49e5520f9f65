"""System A: the altitude-free image horizon sensor of Raeisy and Ghofrani (2021), done again on rendered spheres.

The three set-ups, the check of the image generator, the convergence, and the error table over the full grid; beside the
published method (whole pixels, Newton's method with the pseudo-inverse) the closed form of the same equation, and both
of them on sub-pixel points.
"""

from __future__ import annotations

from functools import partial

from horizonval.systems.a import figures as figures
from horizonval.systems.a import rivals
from horizonval.systems.a.bank import grid, measure, set_ups
from horizonval.systems.a.check import check
from horizonval.systems.a.claims import claims
from horizonval.systems.a.rival_rows import rival_rows, rival_table
from horizonval.systems.a.rows import (
    accuracy_rows,
    check_rows,
    closed_form_rows,
    convergence_rows,
    set_up_rows,
    trend_rows,
)
from horizonval.systems.a.solvers import DRAWS, POINTS, compare, conditions
from horizonval.systems.a.table import (
    METHODS,
    TEXT,
    bank_of,
    error_table,
    lowest_attitudes,
    rms,
    sharp_frames,
    solver_table,
    values,
)
from horizonval.systems.result import Reproduction
from horizonval.systems.task_cache import TaskCache


def reproduce(cache: TaskCache) -> Reproduction:
    """Do the experiments of the paper again; see the module."""
    seed = cache.seed
    published = set_ups(seed)
    shown = cache.each("set-ups", measure, published)
    checks = cache.each("image generator", check, published)
    compared = cache.each("rivals", rivals.compare, rivals.items(seed))
    solvers = cache.each("solvers", compare, conditions(seed))
    items = grid(seed)
    bank = bank_of(items, cache.each("grid of conditions", measure, items))
    lowest_km, seen = lowest_attitudes(bank)
    sharp = sharp_frames(bank)
    rows = (
        *set_up_rows(shown),
        *check_rows(checks),
        *convergence_rows(shown, bank),
        *accuracy_rows(bank),
        *rival_rows(compared),
        *trend_rows(bank),
        *closed_form_rows(bank, solvers),
    )
    return TEXT.reproduction(
        rows=rows,
        claims=claims(rows, compared),
        tables=(rival_table(compared), *(error_table(bank, method) for method in METHODS), solver_table(solvers)),
        figures=(
            TEXT.figure("set-ups", partial(figures.draw_set_ups, shown)),
            TEXT.figure("convergence", partial(figures.draw_convergence, next(iter(shown.values())))),
            TEXT.figure("errors", partial(figures.draw_errors, bank)),
            TEXT.figure("solvers", partial(figures.draw_solvers, solvers), points=POINTS, draws=DRAWS),
        ),
        settings={"seed": seed, "frames": len(items) + len(published)},
        frames=len(bank),
        lowest_km=lowest_km,
        seen=seen,
        sub_pixel_arcsec=rms(values(sharp, "limb, newton", "nadir_arcsec")),
        whole_arcsec=rms(values(sharp, "whole, newton", "nadir_arcsec")),
    )
