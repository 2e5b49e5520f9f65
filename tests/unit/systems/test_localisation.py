"""System E: the rounding table, in which nothing is random, holds; the committed figures are today's."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from horizonval.systems.e.experiment import SYSTEM, quick
from horizonval.systems.task_cache import TaskCache

PAGES = Path(__file__).parents[3] / "results" / "published"


def test_the_rounding_table_is_reproduced(tmp_path: Path) -> None:
    rows = list(SYSTEM.rows(quick(TaskCache(tmp_path))))
    assert sum(isinstance(row.published, float) for row in rows) == 18
    assert not [row.name for row in rows if row.holds is False]
    committed = {row["name"]: row["measured"] for row in json.loads((PAGES / "E.json").read_text())["rows"]}
    assert {row.name: row.measured for row in rows} == pytest.approx({row.name: committed[row.name] for row in rows})
