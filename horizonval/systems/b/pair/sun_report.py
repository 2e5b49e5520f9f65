"""Rows and tables of the Sun's own light in the lens, with it and without."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from horizonval.systems.b.pair.applicability import LIMIT_DEG, PUBLISHED
from horizonval.systems.b.pair.sun import LIMB_ZENITH_DEG, ORDINARY, VIEWS, Paired, SunOutcome, difference
from horizonval.systems.result import Cell, Claim, ComparisonRow, Status, Table
from horizonval.systems.text import page_text

TEXT = page_text("B")
HEIGHTS_DEG = ((0.0, 10.0), (10.0, 25.0), (25.0, 52.0))
"""Of the Sun over the limb: the lines of the second table."""
WASHED_OUT = 0.5
"""Share of views lost from which on a picture is called washed out; below it in all cases is contradicted."""


def sun_rows(found: SunOutcome) -> list[ComparisonRow]:
    """Return what the Sun's own light costs, with its interval, for every lens, exposure and side of the sky.

    The bars are on the ordinary lens with the Sun in the frame, for both exposures: the lower end of the interval is
    above 0.
    """
    rows = []
    for (lens, exposure, place), one in found.pairs.items():
        n = len(one.lit)
        lost, gained = one.lost_and_gained()
        change, low, high = difference(lost, gained, n)
        barred = lens == ORDINARY and place == "inside"
        rows.append(
            TEXT.row(
                "sun",
                low if barred else change,
                PUBLISHED.figures["sun"].value if barred else None,
                limit=0.0 if barred else None,
                at_least=barred,
                lens=lens,
                exposure=exposure,
                place=TEXT.phrase(place),
                what=TEXT.phrase("lower_end" if barred else "difference"),
                change=change,
                low=low,
                high=high,
                lost=lost,
                gained=gained,
                views=n,
                with_light=n - int(one.right(True).sum()),
                without=n - int(one.right(False).sum()),
            )
        )
    return rows


def sun_claim(rows: Sequence[ComparisonRow], found: SunOutcome) -> Claim:
    """Return the judged claim that the Sun in the frame washes the picture out."""
    barred = [row for row in rows if row.holds is not None]
    ends = {
        exposure: difference(*one.lost_and_gained(), len(one.lit))
        for (lens, exposure, place), one in found.pairs.items()
        if lens == ORDINARY and place == "inside"
    }
    if all(row.holds for row in barred):
        status = Status.REPRODUCED
    elif any(row.holds for row in barred):
        status = Status.BOUNDED
    elif all(high < WASHED_OUT for _, _, high in ends.values()):
        status = Status.CONTRADICTED
    else:
        status = Status.NOT_DETERMINABLE
    measured = "; ".join(
        TEXT.phrase("sun_measured", exposure=exposure, change=change, low=low, high=high)
        for exposure, (change, low, high) in ends.items()
    )
    return TEXT.claim(
        "sun", str(PUBLISHED.figures["sun"].value), status, measured=measured, views=VIEWS["inside"], share=WASHED_OUT
    )


def sun_table(found: SunOutcome, rng: np.random.Generator) -> Table:
    """Return what became of all views, with the Sun's light and without."""
    lines: list[tuple[Cell, ...]] = []
    for (lens, exposure, place), one in found.pairs.items():
        for searched in (False, True):
            lost, gained = one.lost_and_gained(searched)
            change, low, high = difference(lost, gained, len(one.lit))
            error = None if searched else one.change_deg(rng)
            cells: list[Cell] = [lens, exposure, TEXT.phrase(place), TEXT.phrase("searched" if searched else "longest")]
            cells += [_counts(one, searched, lit) for lit in (False, True)]
            cells += [f"{lost}, {gained}", f"{change:+.2f} ({low:+.2f} to {high:+.2f})"]
            cells.append("–" if error is None else "{:+.3f} ({:+.3f} to {:+.3f})".format(*error))
            lines.append(tuple(cells))
    return TEXT.table("sun", lines, inside=VIEWS["inside"], outside=VIEWS["outside"], limit=LIMIT_DEG)


def height_table(found: SunOutcome) -> Table:
    """Return what is right at which height of the Sun, with its light and without, Sun in the frame and outside."""
    over = LIMB_ZENITH_DEG - np.array([sky.zenith_deg for sky in found.skies])
    lines: list[tuple[Cell, ...]] = []
    for (lens, exposure, place), one in found.pairs.items():
        cells: list[Cell] = [lens, exposure, TEXT.phrase(place)]
        for low, high in HEIGHTS_DEG:
            here = (over[: len(one.lit)] >= low) & (over[: len(one.lit)] < high)
            cells.append(f"{one.right(False)[here].sum()} → {one.right(True)[here].sum()} of {here.sum()}")
        lines.append(tuple(cells))
    heads = {f"band{k}": f"{low:g} to {high:g} deg" for k, (low, high) in enumerate(HEIGHTS_DEG)}
    return TEXT.table("sun_heights", lines, **heads)


def _counts(one: Paired, searched: bool, lit: bool) -> str:
    right, refused = int(one.right(lit, searched).sum()), int(one.refused(lit, searched).sum())
    return f"{right}, {len(one.lit) - right - refused}, {refused}"
