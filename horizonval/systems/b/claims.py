"""Everything that the source of the two perpendicular cameras prints, judged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from horizonval.systems.published import published
from horizonval.systems.result import Claim, ComparisonRow, Status
from horizonval.systems.text import page_text

TEXT = page_text("B")
PRINTED = published("B").figures


def claims(
    rows: Sequence[ComparisonRow], summary: dict[str, float], verdict: dict[str, float], sun: Claim
) -> list[Claim]:
    """Return every printed figure and claim, from the rows that decide them, the bench's and the orbit's summary."""

    def row(key: str) -> ComparisonRow:
        begin = TEXT.rows[key].name.partition("{")[0]
        return next(one for one in rows if one.name.startswith(begin))

    def judged(key: str, status: Status, /, **fields: Any) -> Claim:
        return TEXT.claim(key, PRINTED[key].value if key.endswith("rms") else str(PRINTED[key].value), status, **fields)

    mean, single, shadow = row("model"), row("model_single"), row("shadow")
    both = mean.holds and single.holds
    model = Status.REPRODUCED if both else Status.BOUNDED if mean.holds or single.holds else Status.CONTRADICTED
    inside = summary["low"] <= PRINTED["rig_rms"].value <= summary["high"]  # type: ignore[operator]
    comparable = Status.BOUNDED if verdict["comparable"] else Status.CONTRADICTED
    return [
        judged("model_rms", model, mean=mean.measured, single=single.measured),
        judged("rig_rms", Status.BOUNDED if inside else Status.CONTRADICTED, **summary),
        judged("region", Status.NOT_DETERMINABLE, half_side=row("region").measured),
        judged("shadow", Status.REPRODUCED if shadow.holds else Status.CONTRADICTED, share=shadow.measured),
        sun,
        judged("infrared", comparable, **verdict),
    ]
