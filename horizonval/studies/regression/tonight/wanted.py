"""What a night is asked to do, and whether it can."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.progress import Progress
from horizonval.spec.load import Suite
from horizonval.spec.suite import Lane, RegressionSpec
from horizonval.store.folder import read_json
from horizonval.studies.regression.baseline import history
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.statistics.gates import GateInputs
from horizonval.suites.mistakes import check_heads
from horizonval.suites.plan import CasePlan, plan_of

NIGHT_SCHEMA = 2
NightLane = Lane | Literal["published"]
LANES: tuple[NightLane, ...] = ("replay", "rerender", "fresh", "published")
WORK = ".work"
PUBLISHED = "published"
"""The lane without gates, and its folder in that of the work."""
Published = Callable[[Path, Progress], Sequence[JsonObject]]
"""Computes key figures of the published systems in a folder, each a plain
``{system, name, unit, accepted, measured, verdict}``."""


@dataclass(frozen=True)
class Wanted:
    """What a night is asked to do.

    Attributes
    ----------
    suite : str
        File or shipped name.
    out : Path
    baseline : Path
    night : str
        Label, and seed of the fresh scenes: a date.
    lanes : tuple of str
    workers : int, optional
    reference : Path, optional
        Folder of a night of the same label made by another version: fresh scenes are then compared in pairs.
    """

    suite: str
    out: Path
    baseline: Path
    night: str
    lanes: tuple[NightLane, ...] = LANES
    workers: int | None = None
    reference: Path | None = None


def seed_of_night(suite: str, night: str, batch: int) -> int:
    """Return the seed of a night's fresh scenes."""
    digest = hashlib.sha256(json.dumps(["fresh", suite, night, batch]).encode()).digest()
    return int.from_bytes(digest[:7], "big")


def checked(suite: Suite) -> tuple[RegressionSpec, CasePlan]:
    """Return a suite's gates and plan, if it can be a nightly."""
    if suite.regression is None:
        raise UserError(
            "has no [regression] table",
            where=suite.source,
            expected="a suite that declares gates",
            fix="scenes/suites/nightly.toml is one",
        )
    plan = plan_of(suite)
    check_heads(suite, plan)
    return suite.regression, plan


def reference_of(folder: Path, suite: str, night: str) -> GateInputs:
    """Return the fresh rows of another version's night."""
    data = read_json(folder / "night.json")
    if data is None:
        raise UserError("no night.json", where=str(folder), expected="the folder of another version's night")
    if (data["suite"], data["night"]) != (suite, night):
        raise UserError(
            f"is night {data['night']!r} of suite {data['suite']!r}",
            where=str(folder),
            expected=f"night {night!r} of {suite!r}",
            fix="give both runs the same --night",
        )
    return GateInputs(fresh=[ReplicateRow.from_dict(row) for row in data["fresh"]], fresh_night=data["night"])


def check_folder(out: Path) -> None:
    """Refuse a folder that is neither new nor empty nor one of ours."""
    if not out.parent.is_dir():
        raise UserError("no such folder", where=str(out.parent), fix="create it first")
    if out.exists() and not out.is_dir():
        raise UserError("is a file", where=str(out), expected="a folder")
    ours = any((out / name).exists() for name in (WORK, "night.json", history.FILE))
    if out.is_dir() and any(out.iterdir()) and not ours:
        raise UserError("holds something else", where=str(out), expected="a new folder, or one of this command")
