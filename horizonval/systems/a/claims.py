"""Everything that the source of the altitude-free sensor prints, judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from horizonval.core.json_types import JsonObject
from horizonval.systems.a.bank import SET_UPS
from horizonval.systems.a.rival_rows import errors, ratio
from horizonval.systems.a.table import TEXT, rms
from horizonval.systems.published import published
from horizonval.systems.result import Claim, ComparisonRow, Status

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
