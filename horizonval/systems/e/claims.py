"""Everything that the source of the two-station localisation prints, judged."""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.systems.e.case import Figures
from horizonval.systems.e.noise import NoiseReading
from horizonval.systems.e.tables import TEXT, Rows, as_published, cases, mean
from horizonval.systems.result import Claim, Status

NEAR = 0.15
"""Share by which a plain figure may be off: another element set of the same satellite."""
FACTOR = 2.0
"""By which the published order may miss its figures under the width that was chosen for it."""


def claims(rows: Rows, nearest: NoiseReading, draws: int) -> list[Claim]:
    """Return every printed error, judged: three at a time. Settings of the experiment are no results."""
    out = []
    for key, case, printed in cases():
        table = "rounding" if key.startswith("rounded") else "noise"
        plain = mean(rows, key, "plain")
        fields = {"case": case, "reading": nearest.description, "draws": str(draws), "measured": _three(plain)}
        off = float(np.abs(plain / np.array(printed["plain"]) - 1.0).max())
        near = Status.REPRODUCED if table == "rounding" else Status.BOUNDED
        status = near if off <= NEAR else Status.CONTRADICTED
        out.append(TEXT.claim(f"plain_{table}", _three(printed["plain"]), status, figure=table, **fields))
        smoothed, filtered = (as_published(rows, key, stage) for stage in (0, 1))
        ratio = smoothed / np.array(printed["proposed"])
        status = Status.BOUNDED if ratio.max() <= FACTOR and ratio.min() >= 1.0 / FACTOR else Status.CONTRADICTED
        fields |= {"smoothed": _three(smoothed), "filtered": _three(filtered)}
        fields |= {"best": _three(mean(rows, key, "proposed")), "batch": _three(mean(rows, key, "batch"))}
        out.append(TEXT.claim("proposed", _three(printed["proposed"]), status, figure=table, **fields))
    out.append(
        TEXT.claim("unit", "200, 300, 400 arcsec", Status.NOT_DETERMINABLE, figure="noise", reading=nearest.description)
    )
    return out


def _three(figures: FloatArray | Figures) -> str:
    """Return right ascension, declination and distance."""
    a, b, c = figures
    return f"{a:.3g}, {b:.3g} arcsec, {c:.2g} km"
