"""One case: render, observe, estimate, score, archive. A pure function of the case's identity, plus timings.

What a case has already is used again: a finished case file is kept if everything it names is still in the archive and
undamaged; a frame that was rendered before the run was cut off is not rendered again.

Where a suite asks for several draws of the noise, each estimator runs on all of them; image, record and row are those
of the first, and the row says how far the fits scatter by the noise that they claim.

The heads of one scene are made together where an estimator needs all of them: every head has its own record, and the
scene one more, whose rows are those of that estimator.
"""

from __future__ import annotations

import contextlib
import faulthandler
import hashlib
import math
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from horizonval.core.errors import UserError, one_line
from horizonval.core.refusal import Refusal
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.process.sandbox import sandbox_of
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.scoring.errors import score
from horizonval.scoring.expected import Expected, expected_of_heads, expected_outcome
from horizonval.scoring.repeats import mean_noise_nees
from horizonval.scoring.row import Row, make_row
from horizonval.spec.load import Case
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.store.store import Store
from horizonval.suites.identity import frame_identity, unit_identity
from horizonval.suites.observation import method_radius_m, observation_of, observation_of_heads
from horizonval.suites.plan import CasePlan, Unit
from horizonval.suites.record import Record, camera_name, details_of, failed_record, record_of

PROCESSOR = "processor "
"""With an estimator's name, the stage of its processor time; ``estimate`` with the name is that of the clock."""

DRAWS = "draws"
"""The stage of everything about the second and further draws of the noise: what a frame costs does not hang on them."""


@dataclass
class Stopwatch:
    """Seconds by stage, kept out of everything that must be reproducible."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add(name, time.perf_counter() - start)

    def add(self, name: str, seconds: float) -> None:
        """Add seconds to a stage."""
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds


@dataclass(frozen=True)
class Brief:
    """What a run keeps of a record in memory: its rows, and why there is no result."""

    rows: list[Row]
    error: str | None


@dataclass
class _Taken:
    """One case on its way: frame, images, results by band and estimator, or why it failed.

    ``redrawn``: by band, the images with other noise.
    """

    frame: RadianceFrame
    frame_address: str | None
    images: dict[str, DetectorImage]
    redrawn: dict[str, list[DetectorImage]] = field(default_factory=dict)
    rows: list[Row] = field(default_factory=list)
    details: dict[str, Any] = field(default_factory=dict)
    expected: dict[tuple[str, str], Expected] = field(default_factory=dict)

    def expected_of(self, band: str, needs: Literal["image", "pose", "heads"]) -> Expected:
        """Return the expected outcome, worked out once for all estimators that need the same."""
        if (band, needs) not in self.expected:
            self.expected[band, needs] = expected_outcome(self.frame.truth, band, needs=needs)
        return self.expected[band, needs]


def run_unit(unit: Unit, plan: CasePlan, folder: RunFolder) -> tuple[dict[str, Brief], dict[str, float]]:
    """Make a unit, write its files, and return what became of each result and the seconds each stage took.

    A defect anywhere is recorded in the case (``error``, rows with ``bad_input``), so that one bad frame does not cost
    the others. A frame that takes longer than the plan allows ends this process.
    """
    watch = Stopwatch()
    with _ended_after(plan.frame_limit_s * len(unit.cases)):
        records = _records(unit, plan, folder, watch)
    for name, record in records.items():
        write_json(folder.case(name), record, indent=None)
    seconds = {stage: round(spent, 4) for stage, spent in watch.seconds.items()}
    return {name: _brief(record) for name, record in records.items()}, seconds


def finished(unit: Unit, plan: CasePlan, folder: RunFolder) -> dict[str, Brief] | None:
    """Return what is finished of a unit that needs no work, or ``None``."""
    identity = unit_identity(unit, plan)
    store = Store(folder.archive)
    found = {}
    for name in unit.names:
        record = read_json(folder.case(name))
        if record is None or record.get("identity") != identity or record.get("error") is not None:
            return None
        addresses = [a for a in (record["truth_frame"], *record["images"].values()) if a is not None]
        if not all(_is_intact(store, address) for address in addresses):
            return None
        found[name] = _brief(record)
    return found


def _brief(record: Record) -> Brief:
    return Brief([Row.from_dict(row) for row in record["rows"]], record["error"])


def give_up(unit: Unit, plan: CasePlan, folder: RunFolder, error: str) -> dict[str, Brief]:
    """Write records for a unit that cannot be made, and return what became of it."""
    briefs = {}
    for name, record in _failed(unit, plan, dict.fromkeys(unit.names, error)).items():
        write_json(folder.case(name), record, indent=None)
        briefs[name] = _brief(record)
    return briefs


def _records(unit: Unit, plan: CasePlan, folder: RunFolder, watch: Stopwatch) -> dict[str, Record]:
    taken: dict[str, _Taken] = {}
    errors: dict[str, str] = {}
    for case in unit.cases:
        with _recorded(errors, case.name):
            taken[case.name] = _take(case, plan, folder, watch)
    scene: _Taken | None = None
    if unit.heads:
        if errors:
            first = next(iter(errors))
            errors[unit.name] = f"{first} failed: {errors[first]}"
        else:
            with _recorded(errors, unit.name):
                scene = _take_together(unit, taken, plan, watch)
    results = [*taken.values(), *([scene] if scene is not None else [])]
    kept = plan.keep == "all" or (plan.keep == "failures" and any(row.is_failure for t in results for row in t.rows))
    records: dict[str, Record] = {}
    addresses: dict[str, dict[str, str]] = {}
    identity = unit_identity(unit, plan)
    for case in unit.cases:
        if case.name in taken:
            with _recorded(errors, case.name):
                one = taken[case.name]
                addresses[case.name] = _archive(one, folder, watch) if kept else {}
                records[case.name] = record_of(
                    case.name, identity, one.frame.truth, one.rows, one.details if kept else {}, addresses[case.name]
                )
    if scene is not None:
        first = unit.cases[0].name
        with _recorded(errors, unit.name):
            records[unit.name] = record_of(
                unit.name, identity, scene.frame.truth, scene.rows, scene.details if kept else {}, addresses[first]
            )
    return records | _failed(unit, plan, errors)


def _failed(unit: Unit, plan: CasePlan, errors: Mapping[str, str]) -> dict[str, Record]:
    identity = unit_identity(unit, plan)
    cases = {case.name: case for case in unit.cases}
    records = {}
    for name, error in errors.items():
        whole = unit.heads and name == unit.name
        case = unit.cases[0] if whole else cases[name]
        estimators = plan.together(case) if whole else plan.alone(case)
        records[name] = failed_record(name, identity, case, estimators, plan, error)
    return records


def _take(case: Case, plan: CasePlan, folder: RunFolder, watch: Stopwatch) -> _Taken:
    from horizonval.sensor.observe import observe

    frame, address = _frame(case, plan, folder, watch)
    taken = _Taken(frame, address, {})
    for number, band in enumerate(case.camera.band):
        with watch.stage("observe"):
            taken.images[band.name] = image = observe(frame, case.camera, band=band.name)
        redrawn = taken.redrawn.setdefault(band.name, [])
        for seed in range(1, plan.draws):
            with watch.stage(DRAWS):
                redrawn.append(observe(frame, case.camera, band=band.name, seed=seed))
        for name in plan.alone(case):
            estimator = plan.estimator(name)
            observations = (observation_of(drawn, estimator) for drawn in (image, *redrawn))
            _score(taken, case.name, case, band.name, number, name, observations, plan, watch)
    return taken


def _take_together(unit: Unit, taken: Mapping[str, _Taken], plan: CasePlan, watch: Stopwatch) -> _Taken:
    """Run the estimators that need all heads; frame and images are then the first head's."""
    case = unit.cases[0]
    first = taken[case.name]
    scene = _Taken(first.frame, first.frame_address, first.images)
    for number, band in enumerate(case.camera.band):
        heads = {str(other.scene.camera.head): taken[other.name] for other in unit.cases}
        draws = [{head: one.images[band.name] for head, one in heads.items()}]
        draws += [{head: one.redrawn[band.name][k] for head, one in heads.items()} for k in range(plan.draws - 1)]
        seen = [taken[other.name].expected_of(band.name, "heads") for other in unit.cases]
        scene.expected[band.name, "heads"] = expected_of_heads(seen)
        for name in plan.together(case):
            estimator = plan.estimator(name)
            observations = (observation_of_heads(images, estimator) for images in draws)
            _score(scene, unit.name, case, band.name, number, name, observations, plan, watch)
    # The Sun troubles the head it is nearest to, which need not be the first.
    nearest_rad = min(taken[other.name].frame.truth.sun_boresight_rad for other in unit.cases)
    scene.rows = [replace(row, sun_boresight_deg=math.degrees(nearest_rad)) for row in scene.rows]
    return scene


def _score(
    taken: _Taken,
    name: str,
    case: Case,
    band: str,
    band_number: int,
    estimator_name: str,
    observations: Iterator[Observation],
    plan: CasePlan,
    watch: Stopwatch,
) -> None:
    """Run one estimator on the observations of a frame, one for every draw of the noise, and add its row."""
    estimator, truth = plan.estimator(estimator_name), taken.frame.truth
    with watch.stage(f"estimate {estimator_name}"):
        sandbox = sandbox_of(plan.limits)
        result: Fit | Refusal = sandbox.run(estimator_name, next(observations))
    if sandbox.spent_s is not None:
        watch.add(PROCESSOR + estimator_name, sandbox.spent_s)
    results = [result]
    for other in observations:
        with watch.stage(DRAWS):
            results.append(sandbox.run(estimator_name, other))
    fits = [one for one in results if isinstance(one, Fit)]
    with watch.stage("score"):
        scored = score(truth, estimator, result, earth_radius_m=method_radius_m(truth))
        if plan.draws > 1:
            scored = replace(scored, nees_noise=mean_noise_nees(fits), noise_draws=len(fits))
        taken.rows.append(
            make_row(
                case=name,
                camera=camera_name(case),
                band=band,
                estimator=estimator_name,
                truth=truth,
                expected=taken.expected_of(band, estimator.needs),
                score=scored,
            )
        )
    # The report draws the first band; further bands keep their own entry beside it.
    taken.details[estimator_name if band_number == 0 else f"{estimator_name} [{band}]"] = details_of(result)


def _frame(case: Case, plan: CasePlan, folder: RunFolder, watch: Stopwatch) -> tuple[RadianceFrame, str | None]:
    """Return the frame and its address: from the archive if it was rendered before, else rendered.

    Where everything is kept it is stored at once, so that a run that is cut off has it.
    """
    from horizonval.renderer.scene.frame import render_frame

    store, pointer_path = Store(folder.archive), folder.frame_pointer(case.name)
    identity = frame_identity(case)
    pointer = read_json(pointer_path) if plan.keep == "all" else None
    if pointer is not None and pointer.get("identity") == identity and _is_intact(store, str(pointer.get("frame"))):
        with watch.stage("read"):
            return store.read_frame(pointer["frame"]), pointer["frame"]
    with watch.stage("render"):
        frame = render_frame(case.scene, case.camera)
    if plan.keep != "all":
        return frame, None
    with watch.stage("archive"):
        address = store.add_frame(frame)
        write_json(pointer_path, {"identity": identity, "frame": address})
    return frame, address


def _archive(taken: _Taken, folder: RunFolder, watch: Stopwatch) -> dict[str, str]:
    """Store frame and images, write their addresses into the rows, and return them; the frame's is under ``""``."""
    store = Store(folder.archive)
    with watch.stage("archive"):
        address = taken.frame_address or store.add_frame(taken.frame)
        images = {band: store.add_image(image) for band, image in taken.images.items()}
    return {"": address, **images}


def _is_intact(store: Store, address: str) -> bool:
    """Whether an entry is there and is what was added."""
    try:
        with store.path(address).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() == address
    except (UserError, OSError):
        return False


@contextlib.contextmanager
def _recorded(errors: dict[str, str], name: str) -> Iterator[None]:
    """Turn whatever goes wrong inside into one line under a name."""
    try:
        yield
    except Exception as e:
        errors[name] = one_line(e)


@contextlib.contextmanager
def _ended_after(limit_s: float) -> Iterator[None]:
    """End this process after a time, also inside foreign code that never comes back."""
    with open(os.devnull, "w") as nowhere:
        faulthandler.dump_traceback_later(limit_s, exit=True, file=nowhere)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()
