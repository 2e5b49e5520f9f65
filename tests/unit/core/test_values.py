"""Values of the core: digests of content, errors as one line, refusals."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace

import numpy as np
import pytest

from horizonval.core.digests import content_digest
from horizonval.core.errors import DamagedFileError, UserError, one_line
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Fit


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


def test_neighbours_do_not_run_together_and_content_is_needed() -> None:
    assert content_digest("a", "b") != content_digest("ab", "")
    assert content_digest((1,), (2, 3)) != content_digest((1, 2), (3,))
    with pytest.raises(TypeError, match="no digest of object"):
        content_digest([object()])


def _caught(error: BaseException) -> str:
    try:
        raise error
    except type(error) as e:
        return one_line(e)


def test_a_defect_is_told_with_its_place_and_without_folders() -> None:
    line = _caught(ValueError("two\n  lines"))
    assert line.startswith("ValueError at test_values.py:")
    assert line.endswith(": two lines")
    assert "/" not in line


def test_a_mistake_is_told_at_another_place() -> None:
    mistake = DamagedFileError("is 3", where="key", expected="4", fix="see there")
    moved = mistake.at("a.toml: table.key")
    assert type(moved) is DamagedFileError
    assert moved.line() == "a.toml: table.key: is 3; expected 4; see there"
    assert mistake.inside("a.toml").where == "a.toml: key"
    assert mistake.inside("a.toml: key").where == "a.toml: key"
    assert UserError("is 3").inside("a.toml").where == "a.toml"


def test_a_refusal_is_false_names_its_head_and_survives_pickling():
    assert not Refusal(Outcome.NO_LIMB, "nothing there")
    assert Fit(np.array([0.0, 0.0, 1.0]), np.eye(3), 0.0, 0.0)
    refusal = Refusal(Outcome.SHORT_ARC, "few points", np.ones((3, 2)))
    named = refusal.of_head("left")
    assert (named.status, named.reason) == (Outcome.SHORT_ARC, "head left: few points")
    assert named.points is refusal.points
    returned = pickle.loads(pickle.dumps(Refusal(Outcome.DARK, "night")))
    assert (returned.status, returned.reason, returned.points.shape) == (Outcome.DARK, "night", (0, 2))
