"""Study files: designs that are compared on the same frames, and what a design must reach."""

from __future__ import annotations

import math
import re
from typing import Annotated, Any

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Name, Positive, Whole
from horizonval.spec.suite import Keep, ProgramSpec, Scenes, SobolSpec
from horizonval.spec.units import unit

LIST_AXIS = "design"
"""The axis of ``design.list``; its values are the entries' names."""


class Requirement(Model):
    """The nadir within `error_deg` in at least the share `availability` of all conditions.

    A refusal is a miss like an error that is too large: one share answers for accuracy and availability together.
    """

    error_deg: Positive = 0.05
    """Largest angle between claimed and true nadir."""
    availability: Annotated[float, Field(gt=0, lt=1), unit("1")] = 0.99
    """Share of all conditions in which it is kept."""


class StudyHead(Model):
    """What the study is."""

    name: Name
    """Name of the study."""
    title: str = ""
    """Title of its report."""
    seed: Whole = 0
    """Another number draws other Sobol points, clouds and noise."""
    estimators: Annotated[list[str], Field(min_length=1)]
    """Names (`horizonval list estimators`, or of `[[estimator]]` tables). Each of them makes a design of its own of
    every entry of `[design]`.
    """
    frame_rate_hz: Positive = 1.0
    """Estimates per second; turns the pixels of an estimate into a pixel rate."""
    cheapest_by: Annotated[str, Field(min_length=1, max_length=500)] = "pixel_rate"
    """What the cheapest design has least of: an expression over columns, as `mass_g + 20 * power_w`. Columns are those
    of `designs.csv` (`pixel_rate`, `pixels`, `p95_deg`, `within`), `processor_s` (seconds of an estimate) and the
    numbers that `cost` tables give; with them go `+ - * / **`, parentheses, `min`, `max`, `abs` and `sqrt`.
    """
    requirement: Requirement = Requirement()
    """What a design must reach."""
    keep: Keep = "none"
    """Which frames and images stay in the archive; see a suite's `keep`."""
    time_limit_s: Positive = 60.0
    """Time limit of one estimate."""
    memory_limit_mb: Annotated[int, Field(ge=64)] = 4096
    """Memory limit of one estimate."""


class DesignSpec(Model):
    """What is varied between designs: every entry of `list` and of each of `choices` with every point of `grid`."""

    list: Annotated[Scenes, Field(min_length=1)] | None = None
    """Partial scenes with a `name`; `estimators` in one stands in place of the study's, `cost` is what it costs."""
    choices: dict[Name, Annotated[Scenes, Field(min_length=1)]] = {}
    """Several such lists by name, each an axis: keys that belong together change together."""
    cost: dict[str, float] = {}
    """Numbers of every design that `study.cheapest_by` may use, by names of your own, as `mass_g`. A table `cost` in an
    entry of `list` or `choices` adds to them: what a design costs is what all its options cost together.
    """
    grid: Annotated[dict[str, Any], Field(min_length=1)] | None = None
    """An axis for each dotted key, as in a suite's `[[cases]]`: of the scene, of the camera file
    (`camera.<table>.<key>`), of the frames' orbit (`orbit.<key>`; the season is `orbit.epoch_utc` or
    `platform.epoch_utc`).
    """

    @property
    def lists(self) -> dict[str, Scenes]:
        """All lists by the name of their axis; that of ``list`` is ``design``."""
        return ({LIST_AXIS: self.list} if self.list is not None else {}) | self.choices

    @model_validator(mode="after")
    def _named(self) -> DesignSpec:
        if self.list is not None and LIST_AXIS in self.choices:
            raise ValueError(f"choices.{LIST_AXIS} and list are the same axis; rename the first")
        for axis, items in self.lists.items():
            where = "list" if axis == LIST_AXIS and self.list is not None else f"choices.{axis}"
            names = [item.get("name") for item in items]
            for i, name in enumerate(names, start=1):
                if not isinstance(name, str) or not name:
                    raise ValueError(f'{where}[{i}] has no name = "..."')
                if names.count(name) > 1:
                    raise ValueError(f"two entries of {where} are named {name!r}")
            _check_costs([item.get("cost", {}) for item in items], where)
        _check_costs([self.cost], "cost")
        return self


_COST_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def _check_costs(tables: list[Any], where: str) -> None:
    """Costs are finite numbers by name. What one entry has all have: a name spelt wrong would count nothing."""
    for i, table in enumerate(tables, start=1):
        if not isinstance(table, dict):
            raise ValueError(f"{where}[{i}].cost is no table of numbers")
        for name, value in table.items():
            if not _COST_NAME.fullmatch(name):
                raise ValueError(f"{where}[{i}].cost has the name {name!r}: letters, digits and _ are expected")
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise ValueError(f"{where}[{i}].cost.{name} is {value!r}: a number is expected")
    names = {name for table in tables for name in table}
    for i, table in enumerate(tables, start=1):
        if missing := sorted(names - set(table)):
            raise ValueError(f"{where}[{i}].cost has no {missing[0]}, which other entries have")


class FramesSpec(Model):
    """The conditions that every design meets: `base` with all that the other tables make of it.

    Every design meets the same conditions, with the same draw of clouds and noise, so that two designs can be compared
    frame by frame.
    """

    base: dict[str, Any] = {}
    """Partial scene over the defaults."""
    list: Annotated[Scenes, Field(min_length=1)] | None = None
    """Partial scenes; each makes conditions of its own."""
    grid: Annotated[dict[str, Any], Field(min_length=1)] | None = None
    """An axis for each dotted key, as in a suite's `[[cases]]`."""
    sobol: SobolSpec | None = None
    """Points of a Sobol sequence over ranges of keys."""
    orbit: dict[str, Any] | None = None
    """An orbit whose samples are conditions."""

    @model_validator(mode="after")
    def _points_are_counted(self) -> FramesSpec:
        if self.sobol is not None and self.sobol.n is None:
            raise ValueError("sobol.share is for suites; give sobol.n")
        return self


class StudySpec(Model):
    """One study file: designs that are compared on the same frames, and what a design must reach."""

    study: StudyHead
    """What the study is."""
    defaults: dict[str, Any] = {}
    """Partial scene below all others."""
    design: DesignSpec = DesignSpec()
    """What is varied between designs."""
    frames: FramesSpec
    """The conditions that every design meets."""
    estimator: list[ProgramSpec] = []
    """Programs as estimators."""
