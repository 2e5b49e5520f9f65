"""Rows and table of the Sun in the frame."""

from __future__ import annotations

from horizonval.core.json_types import JsonObject
from horizonval.systems.b.pair.applicability import LIMIT_DEG
from horizonval.systems.b.pair.sun import GOOD, HAZY, HIGHEST_IN_FRAME_DEG, LIMB_ZENITH_DEG
from horizonval.systems.result import ComparisonRow, Table


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
        rows.append(
            ComparisonRow(
                f"Sun in the frame, {lens}: share of views without a right answer",
                "washed out",
                (len(wrong) + len(none)) / len(views),
                "",
                f"Of {len(views)} heights of the Sun, {len(wrong)} claims wrong by more than 1 deg (worst "
                f"{worst:.1f} deg) and {len(none)} refusals.",
            )
        )
        rows.append(
            ComparisonRow(
                f"Sun in the frame, {lens}: claims wrong by more than 1 deg, search that asks",
                None,
                false,
                f"of {len(views)}",
                f"It refuses {len(views) - len(claims)} of the same views, and {len(claims) - false} of its answers "
                "are right.",
            )
        )
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
    columns = (
        "lens",
        "Sun over the limb [deg]",
        "saturated, forward [%]",
        "error [deg]",
        "claimed sigma [deg]",
        "refusal",
        "error, search that asks [deg]",
        "its refusal",
    )
    return Table(
        "The Sun in the frame",
        columns,
        tuple(lines),
        "Two things go wrong together as the Sun sinks: veil and ghost around it, and the ground going dark under the "
        "satellite and behind it, so that the longest edge is no longer the horizon.",
    )
