"""Study files: designs that are compared on the same frames, and what a design must reach."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Name, Positive, Whole
from horizonval.spec.suite import Keep, ProgramSpec, Scenes, SobolSpec
from horizonval.spec.units import unit

Price = Literal["pixel_rate", "processor"]
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
    cheapest_by: Price = "pixel_rate"
    """What the cheapest design costs least of: `pixel_rate`, or `processor` (seconds of an estimate)."""
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
    """Partial scenes with a `name`; `estimators` in one stands in place of the study's."""
    choices: dict[Name, Annotated[Scenes, Field(min_length=1)]] = {}
    """Several such lists by name, each an axis: keys that belong together change together."""
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
        return self


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
