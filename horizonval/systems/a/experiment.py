"""System A: the altitude-free image horizon sensor of Raeisy and Ghofrani (2021), done again on rendered spheres.

The three set-ups, the check of the image generator, the convergence, and the error table over the full grid; beside the
published method (whole pixels, Newton's method with the pseudo-inverse) the closed form of the same equation, and both
of them on sub-pixel points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from horizonval.core.json_types import JsonObject
from horizonval.systems.a import figures as figures
from horizonval.systems.a import rivals
from horizonval.systems.a.bank import DRAWS, POINTS, SET_UPS, check, compare, conditions, grid, measure, set_ups
from horizonval.systems.a.rivals import errors, ratio, rival_rows, rival_table
from horizonval.systems.a.rows import (
    METHODS,
    TEXT,
    accuracy_rows,
    bank_of,
    check_rows,
    closed_form_rows,
    convergence_rows,
    error_table,
    lowest_attitudes,
    rms,
    set_up_rows,
    sharp_frames,
    solver_table,
    trend_rows,
    values,
)
from horizonval.systems.published import published
from horizonval.systems.result import Claim, ComparisonRow, Reproduction, Status
from horizonval.systems.task_cache import TaskCache

PRINTED = published("A").figures


def claims(rows: Sequence[ComparisonRow], compared: Mapping[str, JsonObject]) -> list[Claim]:
    """Return every printed figure and claim, from the rows and the comparison that decide them."""

    def row(key: str) -> ComparisonRow:
        begin = TEXT.rows[key].name.partition("{")[0]
        return next(one for one in rows if one.name.startswith(begin))

    def judged(key: str, holds: bool, good: Status = Status.REPRODUCED, **fields: Any) -> Claim:
        return TEXT.claim(key, str(PRINTED[key].value), good if holds else Status.CONTRADICTED, **fields)

    answered, three, grid, zero = (row(k) for k in ("set_ups", "update_three", "update_three_grid", "update_zero"))
    sphere, curve, pixels = (row(k) for k in ("stock_sphere", "curve", "pixels"))
    set_ups = "; ".join(f"{s['altitude_km']:g} km, {s['fov_deg']:g} deg, {s['pixels']:g} px" for s in SET_UPS)
    converged = Status.REPRODUCED if zero.holds and grid.holds else Status.BOUNDED
    updates: dict[str, Any] = {"three": three.measured, "grid": grid.measured, "zero": zero.measured}
    rivals: dict[str, Any] = {
        key: ratio(compared, key) for key in ("known_altitude", "known_altitude_off", "straight_line")
    }
    free_rms, off_rms = (rms(errors(compared, m).values()) for m in ("altitude_free", "known_altitude_off"))
    everywhere = Status.REPRODUCED if free_rms < off_rms else Status.BOUNDED
    all_answered = Status.REPRODUCED if answered.holds else Status.CONTRADICTED
    return [
        TEXT.claim("set_ups", set_ups, all_answered, answered=answered.measured, count=len(SET_UPS)),
        judged("cross_check", bool(sphere.holds) and bool(curve.holds), px=sphere.measured, curve_px=curve.measured),
        judged("fourth_update", bool(three.holds), converged, **updates),
        judged("error_with_pixels", bool(pixels.holds), factor=pixels.measured),
        TEXT.claim("percent_error", str(PRINTED["percent_error"].value), Status.NOT_DETERMINABLE),
        judged(
            "no_altitude", rivals["known_altitude_off"] < 1.0, everywhere, free_rms=free_rms, off_rms=off_rms, **rivals
        ),
    ]


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
