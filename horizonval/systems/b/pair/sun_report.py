"""Rows and table of the Sun inside and outside the frame."""

from __future__ import annotations

import numpy as np

from horizonval.systems.b.pair.applicability import LIMIT_DEG, PUBLISHED
from horizonval.systems.b.pair.sun import (
    ATTITUDES_DEG,
    FIXED,
    LIMB_ZENITH_DEG,
    ORDINARY,
    ZENITH_DEG,
    GlareOutcome,
    is_right,
)
from horizonval.systems.result import Cell, ComparisonRow, Table
from horizonval.systems.text import page_text

TEXT = page_text("B")
Outcomes = dict[tuple[str, str], GlareOutcome]


def sun_rows(found: Outcomes, rng: np.random.Generator) -> list[ComparisonRow]:
    """Return the difference that the Sun in the frame makes, with its interval, for every lens and exposure.

    The bar is on the ordinary lens with the fixed exposure, which the source's cameras will have had: the lower end of
    the interval is a view or more.
    """
    rows = []
    for (lens, exposure), one in found.items():
        low, high = one.interval(rng)
        barred = (lens, exposure) == (ORDINARY, FIXED)
        rows.append(
            TEXT.row(
                "sun",
                low if barred else one.difference,
                PUBLISHED.figures["sun"].value if barred else None,
                limit=1.0 / len(one.inside) if barred else None,
                at_least=barred,
                lens=lens,
                exposure=exposure,
                what=TEXT.phrase("lower_end" if barred else "difference"),
                difference=one.difference,
                low=low,
                high=high,
                inside=1.0 - float(np.mean(one.inside)),
                outside=1.0 - float(np.mean(one.outside)),
                twins=len(one.inside),
            )
        )
        asked = [v["searched"]["error_deg"].get("SIGHT") for (place, _, _), v in one.views.items() if place == "inside"]
        claims = [error for error in asked if error is not None]
        false = sum(error > LIMIT_DEG for error in claims)
        fields = {"views": len(asked), "refused": len(asked) - len(claims), "right": len(claims) - false}
        rows.append(TEXT.row("sun_search", false, lens=lens, exposure=exposure, **fields))
    return rows


def sun_table(found: Outcomes) -> Table:
    """Return what became of the views of every height, Sun inside and outside."""
    lines: list[tuple[Cell, ...]] = []
    for (lens, exposure), one in found.items():
        for zenith in ZENITH_DEG:
            cells: list[Cell] = [lens, exposure, LIMB_ZENITH_DEG - zenith]
            for place in ("inside", "outside"):
                views = [one.views[place, zenith, k] for k in range(len(ATTITUDES_DEG))]
                errors = [e for v in views if (e := v["error_deg"].get("SIGHT")) is not None]
                cells += [
                    100.0 * float(np.mean([v["saturated"]["forward"] for v in views])),
                    f"{sum(map(is_right, views))} of {len(views)}",
                    float(np.median(errors)) if errors else None,
                ]
            lines.append(tuple(cells))
    return TEXT.table("sun", lines)
