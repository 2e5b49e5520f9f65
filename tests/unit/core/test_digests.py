"""Digests of content: equal for equal values, different for every other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from horizonval.core.digests import content_digest


@dataclass(frozen=True)
class Column:
    name: str
    values: np.ndarray
    top_m: float | None = None


COLUMN = Column("air", np.linspace(0.0, 1.0, 7), 1e5)


def test_equal_content_has_one_digest() -> None:
    spread = np.zeros(14)
    spread[::2] = COLUMN.values
    again = Column("air", spread[::2], float(np.float64(1e5)))
    assert content_digest(again, (1, 2.0)) == content_digest(COLUMN, (1, 2.0))
    assert content_digest(np.float64(0.1)) == content_digest(0.1)


@pytest.mark.parametrize(
    "other",
    [
        replace(COLUMN, name="sea"),
        replace(COLUMN, values=np.nextafter(COLUMN.values, 2.0)),
        replace(COLUMN, values=COLUMN.values.astype(np.float32)),
        replace(COLUMN, values=COLUMN.values[:, None]),
        replace(COLUMN, top_m=np.nextafter(1e5, 0.0)),
        replace(COLUMN, top_m=None),
    ],
)
def test_the_last_bit_tells(other: Column) -> None:
    assert content_digest(other) != content_digest(COLUMN)


def test_neighbours_do_not_run_together() -> None:
    assert content_digest("a", "b") != content_digest("ab", "")
    assert content_digest((1,), (2, 3)) != content_digest((1, 2), (3,))


def test_objects_without_content_are_refused() -> None:
    with pytest.raises(TypeError, match="no digest of object"):
        content_digest([object()])
