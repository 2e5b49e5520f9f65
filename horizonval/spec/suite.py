"""Suite files, many scenes that share defaults, and study files, designs that are compared on the same frames.

Every night has the margins of :data:`STANDING`. The table ``[regression]`` of a suite is the one place for others: each
is in the unit of its metric, with its engineering reason.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from horizonval.core.errors import excerpt
from horizonval.spec.base import Model, Name, PlainName, Positive, Whole, unit
from horizonval.spec.requirement import Requirement

Lane = Literal["replay", "rerender", "fresh"]
Metric = Literal[
    "crashes",
    "availability",
    "false_valid",
    "roll_mean",
    "pitch_mean",
    "roll_scatter",
    "pitch_scatter",
    "nadir_error",
    "nadir_error_median",
    "altitude_mean",
    "altitude_error",
    "error_over_bound",
    "honesty",
    "claimed_sigma",
    "without_sigma",
    "limb_radiance",
    "disc_radiance",
    "limb_displacement",
    "noise",
]


@dataclass(frozen=True)
class Standing:
    """Margin of a metric in every night: ``margin`` in ``unit``, or the share ``of_base`` of the baseline's value where
    that is larger. ``fresh``: the same margins for scenes drawn anew, None where the metric is not compared there.
    """

    unit: str
    margin: float | None
    of_base: float = 0.0
    fresh: tuple[float, float] | None = None


POINTS = "percentage points"
STANDING: dict[Metric, Standing] = {
    "crashes": Standing("frames", 0.0, fresh=(0.0, 0.0)),
    "availability": Standing(POINTS, 1.5, fresh=(20.0, 0.0)),
    "false_valid": Standing(POINTS, 1.0, fresh=(8.0, 0.0)),
    "roll_mean": Standing("arcsec", 20.0),
    "pitch_mean": Standing("arcsec", 20.0),
    "roll_scatter": Standing("arcsec", 20.0, 0.1),
    "pitch_scatter": Standing("arcsec", 20.0, 0.1),
    "nadir_error": Standing("arcsec", 20.0, 0.1, fresh=(20.0, 0.5)),
    "nadir_error_median": Standing("arcsec", 20.0, 0.1),
    "altitude_mean": Standing("km", 2.0),
    "altitude_error": Standing("km", 2.0, 0.1),
    "error_over_bound": Standing("1", None),
    "honesty": Standing("factor", 1.5),
    "claimed_sigma": Standing(POINTS, 1.5),
    "without_sigma": Standing("factor", 1.5),
    "limb_radiance": Standing("%", 1.0),
    "disc_radiance": Standing("%", 1.0),
    "limb_displacement": Standing("px", 0.1),
    "noise": Standing("%", 5.0),
}
"""Gates that every ``[regression]`` has, by metric; ``docs/howto/nightly.md`` has the reasons of their margins."""
IMAGE_METRICS: tuple[Metric, ...] = ("limb_radiance", "disc_radiance", "limb_displacement", "noise")
FRESH_METRICS: tuple[Metric, ...] = ("crashes", "availability", "false_valid", "nadir_error", "error_over_bound")


class GateSpec(Model):
    """Another margin for a metric in one lane, in place of the standing one, and why. Of several the smallest holds."""

    name: Name
    """Name of the gate."""
    lane: Lane
    """`replay` (frozen images through today's estimators), `rerender` (the same scenes and noise again) or `fresh`
    (scenes drawn anew).
    """
    metric: Metric
    """`crashes`: frames that crash and did not before. `availability`: answers that are lost. `false_valid`: frames
    whose answer became false. `roll_mean`, `pitch_mean`, `altitude_mean`: change of the mean error. `roll_scatter`,
    `pitch_scatter`: change of the standard deviation about it. `nadir_error`, `nadir_error_median`: change of the root
    mean square and of the median of the angle between claimed and true nadir (`fresh`: of its mean). `altitude_error`:
    change of the root mean square of the altitude's error; an altitude that was not claimed before had none.
    `error_over_bound`: change of the mean of that angle over what the limb in the frame allows any method; without a
    gate it is not compared. `honesty`: factor by which the mean squared error over the claimed covariance changes,
    either way. `claimed_sigma`: claims whose sigma changes by more than a factor of 1.5, either way. `without_sigma`:
    the same of the number of claims without a usable covariance. `limb_radiance`, `disc_radiance`: bias of the region's
    mean in a scene. `limb_displacement`: root mean square along the limb of a scene. `noise`: change of the detector
    noise's standard deviation, in space.
    """
    margin: Annotated[Positive, unit("that of the key `unit`")]
    """Largest change that does not matter."""
    unit: str
    """Unit of the margin; each metric has its own."""
    reason: Annotated[str, Field(min_length=20)]
    """Engineering reason of the margin."""
    estimators: list[str] = []
    """Estimators that the gate looks at; all where it is empty."""
    cases: list[str] = []
    """Tables `[[cases]]` that the gate looks at; all where it is empty."""

    @model_validator(mode="after")
    def _sense(self) -> GateSpec:
        if self.unit != (expected := STANDING[self.metric].unit):
            raise ValueError(f'unit of {self.metric} is "{expected}"')
        if expected == "factor" and self.margin <= 1.0:
            raise ValueError(f"margin of {self.metric} is a factor above 1")
        if self.metric in IMAGE_METRICS and self.lane != "rerender":
            raise ValueError(f'{self.metric} compares images; lane must be "rerender"')
        if self.lane == "fresh" and self.metric not in FRESH_METRICS:
            raise ValueError(f"{self.metric} is not compared on scenes drawn anew")
        return self


class RegressionSpec(Model):
    """What a night does with the suite.

    The fresh lane draws the suite's Sobol tables again with a seed of the night.
    """

    replicates: Annotated[int, Field(ge=1, le=1000), unit("1")] = 4
    """Detector images of every frame, each with noise of its own."""
    most_batches: Annotated[int, Field(ge=1, le=10), unit("1")] = 2
    """Batches that the fresh lane takes at most: further ones where its gates are inconclusive."""
    published: bool = False
    """Whether a night also computes key figures of the published systems again, and compares them with those of the
    committed pages. They are the program's and not the suite's: seven systems, whatever the suite renders.
    """
    gate: list[GateSpec] = []
    """Margins that differ from the standing ones."""

    @model_validator(mode="after")
    def _unique_names(self) -> RegressionSpec:
        names = [gate.name for gate in self.gate]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"two gates are named {twice[0]!r}")
        return self


Month = Annotated[int, Field(ge=1, le=12), unit("1")]


class StabilityBand(Model):
    """A thermal band with a rectangular response."""

    name: PlainName
    """Name of the band."""
    lo_um: Positive
    """Lower end."""
    hi_um: Positive
    """Upper end."""

    @model_validator(mode="after")
    def _limits(self) -> StabilityBand:
        if self.hi_um <= self.lo_um:
            raise ValueError("lo_um must be below hi_um")
        return self


class StabilitySpec(Model):
    """A circular orbit, months and bands; four horizon heads look forward, right, aft and left.

    The air is the blend of mean climates by latitude and month. Edge sensors locate half of their own plateau, the
    steepest fall and a fixed radiance; a field sensor measures the mean radiance in a square field.
    """

    altitude_km: Annotated[float, Field(ge=200, le=40_000)]
    """Altitude of the circular orbit, above the equator's radius."""
    inclination_deg: Annotated[float, Field(ge=0, le=180)] = 90.0
    """Inclination of the orbit."""
    positions: Annotated[int, Field(ge=4, le=720), unit("1")] = 72
    """Positions, evenly spread over the orbit."""
    months: Annotated[list[Month], Field(min_length=1, max_length=12)] = list(range(1, 13))
    """Months of the year, 1 to 12."""
    field_deg: Annotated[float, Field(ge=0.1, le=5)] = 2.0
    """Side of the field sensor's field."""
    band: Annotated[list[StabilityBand], Field(min_length=1)]
    """Thermal bands."""

    @model_validator(mode="after")
    def _nothing_twice(self) -> StabilitySpec:
        names = [band.name for band in self.band]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"two bands are named {twice[0]!r}")
        if len(set(self.months)) != len(self.months):
            raise ValueError("months holds a month twice")
        return self


Keep = Literal["all", "failures", "none"]
Scenes = list[dict[str, Any]]
Names = list[str]


def _each_once(names: list[str]) -> list[str]:
    if len(set(names)) < len(names):
        twice = next(name for name, times in Counter(names).items() if times > 1)
        raise ValueError(f"estimator {excerpt(twice)!r} is named more than once")
    return names


Estimators = Annotated[list[str], Field(min_length=1), AfterValidator(_each_once)]
SHARE_TOLERANCE = 1e-6


class SuiteHead(Model):
    """What the suite is."""

    name: Name
    """Name of the suite."""
    title: str = ""
    """Title of its report."""
    seed: Whole = 0
    """Another number draws other Sobol points, clouds and noise."""
    estimators: Estimators
    """Names of estimators (`horizonval list estimators`, or of `[[estimator]]` tables)."""
    frames: Annotated[int, Field(ge=1, le=1_000_000), unit("1")] | None = None
    """Number of scenes that Sobol points with a `share` divide among them."""
    draws: Annotated[int, Field(ge=1, le=1000), unit("1")] = 1
    """How often every frame is observed, each time with other noise; what the estimates scatter by then tests the noise
    that they claim. All else is that of the first draw.
    """
    keep: Keep = "all"
    """Which frames and images stay in the archive: `all`, `failures` (of frames with an outcome that was not the
    expected one, or false) or `none`. What is not kept can be recomputed from the suite and the case's name.
    """
    time_limit_s: Positive = 60.0
    """Processor time that one estimate may use, with the processes it starts; by the clock it gets ten times as long,
    and at least a minute.
    """
    memory_limit_mb: Annotated[int, Field(ge=64)] = 4096
    """Memory limit of one estimate."""


class ProgramSpec(Model):
    """A program as an estimator: it is run with the paths of an image and of a camera file, and prints JSON.

    What it prints has the keys of `horizonval estimate --json`.
    """

    name: Name
    """Name of the estimator."""
    command: Annotated[str, Field(min_length=1)]
    """The command line. `{image}` and `{camera}` stand for the paths, which otherwise come last, `{prior}` for that of
    a file with the prior. A relative path of the program starts from the suite's folder.
    """
    estimates: Literal["geocentric", "geodetic"] = "geocentric"
    """Which nadir it estimates."""


class SobolSpec(Model):
    """Points of a scrambled Sobol sequence over ranges of keys; the suite's seed and the table's name draw it.

    Fewer points are the first of more.
    """

    n: Annotated[int, Field(ge=1, le=1_000_000), unit("1")] | None = None
    """Number of points."""
    share: Annotated[float, Field(gt=0.0, le=1.0), unit("1")] | None = None
    """In place of `n`, a share of `suite.frames`: so many scenes all that the table makes of them are to be, so that
    one number sets the size of a suite.
    """
    seed: Whole = 0
    """Draws other points of this table alone."""
    ranges: Annotated[dict[str, Any], Field(min_length=1)]
    """By dotted key a range `[from, to]`, or a table `{from, to, scale}` with the scale `linear`, `log` or `sine`
    (evenly in the sine of an angle in degrees: latitudes evenly over the globe). Epochs can be ranges.
    """

    @model_validator(mode="after")
    def _one_count(self) -> SobolSpec:
        if (self.n is None) == (self.share is None):
            raise ValueError("give one of n and share")
        return self


class CasesSpec(Model):
    """Many frames at once: `base` with everything that `list`, `grid`, `sobol` and `orbit` make of it.

    Where several are given, every one of the first goes with every one of the next. Keys of grid and sobol are dotted:
    a key of the scene, `camera.<table>.<key>` for one of the camera file (`camera.band.<name>.<key>` of a band),
    `orbit.<key>` for one of the orbit.
    """

    name: Name
    """Name of the table; the frames' names begin with it."""
    estimators: Estimators | None = None
    """Those of the suite's that run on these frames; all of them by default."""
    base: dict[str, Any] = {}
    """Partial scene over the suite's defaults."""
    list: Annotated[Scenes, Field(min_length=1)] | None = None
    """Partial scenes; each makes frames of its own."""
    grid: Annotated[dict[str, Any], Field(min_length=1)] | None = None
    """An axis for each dotted key: a list of values, `{from, to, step}` or `{from, to, n}`; with `n` also a `scale`,
    `linear`, `log` or `sine`.
    """
    sobol: SobolSpec | None = None
    """Points of a Sobol sequence over ranges of keys."""
    orbit: dict[str, Any] | None = None
    """An orbit whose samples are frames."""

    @model_validator(mode="after")
    def _something_to_vary(self) -> CasesSpec:
        if self.list is None and self.grid is None and self.sobol is None and self.orbit is None:
            raise ValueError("give at least one of list, grid, sobol and orbit")
        return self


class DatasetSpec(Model):
    """What `horizonval dataset` makes of the suite: every scene is a place, an instant and an air, seen many times."""

    frames_per_scene: Annotated[int, Field(ge=1, le=100_000), unit("1")] = 100
    """Number of frames of each scene. A suite with `suite.frames` draws as many scenes as that takes; another one has
    its own scenes, among which all frames are divided.
    """
    attitudes: dict[str, Any] = {}
    """Ranges of keys of `attitude` and `camera.mount_*`, as in `sobol.ranges`: each scene draws its own points of them.
    Without ranges the frames of a scene differ in their noise alone.
    """
    split: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=3, max_length=3), unit("1")] = [8, 1, 1]
    """Parts of the scenes that go to training, validation and test. Scenes that share place, instant and air stay
    together.
    """

    @model_validator(mode="after")
    def _something_to_learn_from(self) -> DatasetSpec:
        if not 1 <= sum(self.split) <= 1000:
            raise ValueError("the parts of split must add up to 1 to 1000")
        return self


class FigureSpec(Model):
    """A figure of the report over the frames of one `[[cases]]` table, or of all."""

    kind: Literal["timeline", "map", "sweep", "exclusion"]
    """`timeline`: outcomes and errors along the time; `map`: the error over the keys `x` and `y`; `sweep`: the error
    and the share of right answers over the key `x`; `exclusion`: the same over the Sun's distance from the boresight,
    with the angle beyond which every answer is right.
    """
    cases: Name | None = None
    """Name of the table; all frames without the key."""
    x: str | None = None
    """Dotted key of the horizontal axis, as in `grid`."""
    y: str | None = None
    """Dotted key of the vertical axis of a map."""
    by: str | None = None
    """Dotted key: a figure for each of its values."""
    title: str = ""
    """Title of the figure."""

    @model_validator(mode="after")
    def _axes_belong_to_the_kind(self) -> FigureSpec:
        wanted = {"map": ("x", "y"), "sweep": ("x",)}.get(self.kind, ())
        for key in ("x", "y"):
            if (getattr(self, key) is not None) != (key in wanted):
                raise ValueError(f'kind = "{self.kind}" {"needs" if key in wanted else "has no"} {key}')
        return self


class SuiteSpec(Model):
    """One suite file: many scenes that share defaults, and the estimators to score on them."""

    suite: SuiteHead
    """What the suite is."""
    defaults: dict[str, Any] = {}
    """Partial scene below all others."""
    frame: list[dict[str, Any]] = []
    """A partial scene laid over the defaults, with a unique `scene.name` and, if it wants, `estimators` of its own."""
    cases: list[CasesSpec] = []
    """Tables that make many frames each."""
    estimator: list[ProgramSpec] = []
    """Programs, in addition to the estimators that are known by name."""
    requirement: list[Requirement] = []
    """What each method must reach with each camera; the report says which are met."""
    figure: list[FigureSpec] = []
    """Figures on a page of their own."""
    stability: StabilitySpec | None = None
    """A study of the infrared horizon in addition to the frames."""
    regression: RegressionSpec | None = None
    """How `horizonval regress` compares nights."""
    dataset: DatasetSpec | None = None
    """How `horizonval dataset` makes frames to learn from of the scenes."""

    @model_validator(mode="after")
    def _unique_names(self) -> SuiteSpec:
        if not self.frame and not self.cases:
            raise ValueError("frame is missing; add [[frame]] or [[cases]] tables")
        seen: set[str] = set()
        for i, frame in enumerate(self.frame):
            name = frame.get("scene", {}).get("name") if isinstance(frame.get("scene", {}), dict) else None
            if not isinstance(name, str):
                raise ValueError(f"frame {i + 1} has no scene.name")
            if name in seen:
                raise ValueError(f"two frames are named {name!r}")
            seen.add(name)
        for kind, names in (
            ("cases", [table.name for table in self.cases]),
            ("estimator", [program.name for program in self.estimator]),
            ("requirement", [one.id for one in self.requirement]),
        ):
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise ValueError(f"two tables [[{kind}]] are named {twice[0]!r}")
        shares = [
            table.sobol.share for table in self.cases if table.sobol is not None and table.sobol.share is not None
        ]
        if shares and abs(sum(shares) - 1.0) > SHARE_TOLERANCE:
            raise ValueError(f"the shares of the [[cases]] tables are {sum(shares):g} together, not 1")
        if bool(shares) != (self.suite.frames is not None):
            raise ValueError("suite.frames and sobol.share go together")
        tables = {table.name for table in self.cases}
        for figure in self.figure:
            if figure.cases is not None and figure.cases not in tables:
                raise ValueError(f"a figure asks for the table [[cases]] {figure.cases!r}, which is not there")
        for gate in self.regression.gate if self.regression is not None else ():
            if unknown := sorted(set(gate.cases) - tables):
                raise ValueError(f"gate {gate.name!r} asks for the table [[cases]] {unknown[0]!r}, which is not there")
            if unknown := sorted(set(gate.estimators) - {*self.suite.estimators, *(p.name for p in self.estimator)}):
                raise ValueError(f"gate {gate.name!r} asks for the estimator {unknown[0]!r}, which the suite has not")
        return self


LIST_AXIS = "design"
"""The axis of ``design.list``; its values are the entries' names."""


class StudyHead(Model):
    """What the study is."""

    name: Name
    """Name of the study."""
    title: str = ""
    """Title of its report."""
    seed: Whole = 0
    """Another number draws other Sobol points, clouds and noise."""
    estimators: Estimators
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
    keep: Keep = "none"
    """Which frames and images stay in the archive; see a suite's `keep`."""
    time_limit_s: Positive = 60.0
    """Processor time that one estimate may use, with the processes it starts; by the clock it gets ten times as long,
    and at least a minute.
    """
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
    requirement: Annotated[list[Requirement], Field(min_length=1)] = [
        Requirement(id="default", error_deg=0.05, availability=0.99)
    ]
    """What a design must reach. Errors of the first one with `error_deg` are the limit of the page's tables."""

    @model_validator(mode="after")
    def _a_limit_of_the_error(self) -> StudySpec:
        ids = [one.id for one in self.requirement]
        if twice := sorted({name for name in ids if ids.count(name) > 1}):
            raise ValueError(f"two tables [[requirement]] have the id {twice[0]!r}")
        if all(one.error_deg is None for one in self.requirement):
            raise ValueError("one [[requirement]] needs error_deg; the page counts the answers within it")
        return self
