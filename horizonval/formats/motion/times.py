"""Times as text, in the two ways that the standards of CCSDS and ISO write them, as UTC."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt

EXPECTED = "a UTC time as 2026-03-20T12:00:00.25"


def utc_of(text: str, where: str) -> datetime:
    """Return the time of ``2026-03-20T12:00:00`` or ``2026-079T12:00:00``; a Z and parts of a second may follow."""
    plain = text.strip().removesuffix("Z")
    try:
        whole, _, part = plain.partition(".")
        form = "%Y-%jT%H:%M:%S" if len(whole.split("T")[0].split("-")) == 2 else "%Y-%m-%dT%H:%M:%S"
        found = datetime.strptime(whole.replace(" ", "T"), form).replace(tzinfo=UTC)
        if part:
            found = found.replace(microsecond=min(round(float(f"0.{part}") * 1e6), 999_999))
    except ValueError:
        raise UserError(f'found "{excerpt(text)}"', where=where, expected=EXPECTED) from None
    return found


def seconds_after(epoch_utc: datetime, times: Sequence[datetime]) -> FloatArray:
    """Return how long after an epoch some times are, shape (n,) [s]; leap seconds between them are not counted."""
    return np.array([(time - epoch_utc).total_seconds() for time in times])
