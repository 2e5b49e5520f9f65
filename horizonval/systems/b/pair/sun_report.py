"""Rows and table of the Sun in the frame."""

from __future__ import annotations

from horizonval.core.json_types import JsonObject
from horizonval.systems.b.pair.applicability import LIMIT_DEG, PUBLISHED
from horizonval.systems.b.pair.sun import GOOD, HAZY, HIGHEST_IN_FRAME_DEG, LIMB_ZENITH_DEG
from horizonval.systems.result import ComparisonRow, Table
from horizonval.systems.text import page_text

TEXT = page_text("B")


def sun_rows(found: dict[str, dict[float, JsonObject]]) -> list[ComparisonRow]:
    """Return the rows of the Sun in the frame."""
    rows = []
    for lens in (GOOD, HAZY):
        views = [one for zenith, one in found[lens].items() if zenith >= HIGHEST_IN_FRAME_DEG]
        asked = [one["searched"]["error_deg"].get("SIGHT") for one in views]
        claims = [error for error in asked if error is not None]
        false = sum(error > LIMIT_DEG for error in claims)
        wrong = [one for one in views if one["error_deg"].get("SIGHT", 0.0) > LIMIT_DEG]
        none = [one for one in views if not one["error_deg"]]
        worst = max((one["error_deg"].get("SIGHT", 0.0) for one in views), default=0.0)
        share = (len(wrong) + len(none)) / len(views)
        rows += [
            TEXT.row(
                "sun",
                share,
                PUBLISHED.figures["sun"].value,
                lens=lens,
                views=len(views),
                wrong=len(wrong),
                worst=worst,
                refused=len(none),
            ),
            TEXT.row(
                "sun_search",
                false,
                lens=lens,
                views=len(views),
                refused=len(views) - len(claims),
                right=len(claims) - false,
            ),
        ]
    return rows


def sun_table(found: dict[str, dict[float, JsonObject]]) -> Table:
    """Return the table of the Sun's heights."""
    lines = []
    for lens, views in found.items():
        for zenith, one in views.items():
            asked = one["searched"]
            lines.append(
                (
                    lens,
                    LIMB_ZENITH_DEG - zenith,
                    100.0 * one["saturated"]["forward"],
                    one["error_deg"].get("SIGHT"),
                    one.get("sigma_deg"),
                    one["reason"],
                    asked["error_deg"].get("SIGHT"),
                    asked["reason"],
                )
            )
    return TEXT.table("sun", lines)
