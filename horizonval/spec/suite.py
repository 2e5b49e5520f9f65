"""Suite files: many scenes that share defaults, and the estimators to score on them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Positive
from horizonval.spec.regression import RegressionSpec
from horizonval.spec.stability import StabilitySpec

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")]
Keep = Literal["all", "failures", "none"]
Scenes = list[dict[str, Any]]
Names = list[str]
SHARE_TOLERANCE = 1e-6


class SuiteHead(Model):
    """What the suite is.

    ``keep``: which frames and images stay in the archive: ``all``, ``failures`` (of frames with an outcome that was not
    the expected one, or false) or ``none``. What is not kept can be made again from the suite and the case's name.
    ``time_limit_s`` and ``memory_limit_mb`` are those of one estimate. ``frames`` is the number of scenes that Sobol
    points with a ``share`` divide among them. ``draws``: how often every frame is observed, each time with other noise;
    what the estimates scatter by then tests the noise that they claim. All else is that of the first draw.
    """

    name: Name
    title: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    estimators: Annotated[list[str], Field(min_length=1)]
    frames: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    draws: Annotated[int, Field(ge=1, le=1000)] = 1
    keep: Keep = "all"
    time_limit_s: Positive = 60.0
    memory_limit_mb: Annotated[int, Field(ge=64)] = 4096


class ProgramSpec(Model):
    """A program as an estimator: it is run with the paths of an image and of a camera file, and prints JSON.

    ``{image}`` and ``{camera}`` in the command stand for the paths, which otherwise come last. A relative path of the
    program starts from the suite's folder. What it prints has the keys of ``horizonval estimate --json``.
    """

    name: Name
    command: Annotated[str, Field(min_length=1)]
    estimates: Literal["geocentric", "geodetic"] = "geocentric"


class SobolSpec(Model):
    """``n`` points of a scrambled Sobol sequence over ranges of keys; the suite's seed and the table's name draw it.

    In place of ``n`` a ``share`` of ``suite.frames`` can be given: so many scenes all that the table makes of them are
    to be, so that one number sets the size of a suite. Fewer points are the first of more.

    A range is ``[from, to]``, or a table ``{from, to, scale}`` with the scale ``linear``, ``log`` or ``sine`` (evenly
    in the sine of an angle in degrees: latitudes evenly over the globe). Epochs can be ranges.
    """

    n: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    share: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    seed: Annotated[int, Field(ge=0)] = 0
    ranges: Annotated[dict[str, Any], Field(min_length=1)]

    @model_validator(mode="after")
    def _one_count(self) -> SobolSpec:
        if (self.n is None) == (self.share is None):
            raise ValueError("give one of n and share")
        return self


class CasesSpec(Model):
    """Many frames at once: ``base`` with everything that ``list``, ``grid``, ``sobol`` and ``orbit`` make of it.

    ``base`` is a partial scene over the suite's defaults. ``list`` holds partial scenes; ``grid`` an axis for each key,
    a list of values or ``{from, to, step}`` or ``{from, to, n}``. Where several are given, every one of the first goes
    with every one of the next. Keys of grid and sobol are dotted: a key of the scene, ``camera.<table>.<key>`` for one
    of the camera file (``camera.band.<name>.<key>`` of a band), ``orbit.<key>`` for one of the orbit.

    ``estimators``: those of the suite's that run on these frames; all of them by default.
    """

    name: Name
    estimators: Annotated[Names, Field(min_length=1)] | None = None
    base: dict[str, Any] = {}
    list: Annotated[Scenes, Field(min_length=1)] | None = None
    grid: Annotated[dict[str, Any], Field(min_length=1)] | None = None
    sobol: SobolSpec | None = None
    orbit: dict[str, Any] | None = None

    @model_validator(mode="after")
    def _something_to_vary(self) -> CasesSpec:
        if self.list is None and self.grid is None and self.sobol is None and self.orbit is None:
            raise ValueError("give at least one of list, grid, sobol and orbit")
        return self


class FigureSpec(Model):
    """A figure of the report over the frames of one ``[[cases]]`` table, or of all.

    ``timeline``: outcomes and errors along the time; ``map``: the error over the keys ``x`` and ``y``; ``sweep``: the
    error and the share of right answers over the key ``x``; ``exclusion``: the same over the Sun's distance from the
    boresight, with the angle beyond which every answer is right. Keys are dotted, as in ``grid``. ``by``: a figure for
    each value of this key.
    """

    kind: Literal["timeline", "map", "sweep", "exclusion"]
    cases: Name | None = None
    x: str | None = None
    y: str | None = None
    by: str | None = None
    title: str = ""

    @model_validator(mode="after")
    def _axes_belong_to_the_kind(self) -> FigureSpec:
        wanted = {"map": ("x", "y"), "sweep": ("x",)}.get(self.kind, ())
        for key in ("x", "y"):
            if (getattr(self, key) is not None) != (key in wanted):
                raise ValueError(f'kind = "{self.kind}" {"needs" if key in wanted else "has no"} {key}')
        return self


class SuiteSpec(Model):
    """One suite file.

    ``[defaults]`` is a partial scene; every ``[[frame]]`` is a partial scene laid over it, with a unique
    ``scene.name`` and, if it wants, ``estimators`` of its own; every ``[[cases]]`` table makes many. ``[[estimator]]``
    adds programs to the estimators that are known by name. ``[[figure]]`` asks for figures on a page of their own,
    ``[stability]`` for a study of the infrared horizon beside the frames, ``[regression]`` says how
    `horizonval regress` compares nights.
    """

    suite: SuiteHead
    defaults: dict[str, Any] = {}
    frame: list[dict[str, Any]] = []
    cases: list[CasesSpec] = []
    estimator: list[ProgramSpec] = []
    figure: list[FigureSpec] = []
    stability: StabilitySpec | None = None
    regression: RegressionSpec | None = None

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
