"""One case: render, observe, estimate, score, archive. A pure function of the case's identity, plus timings.

Frames of an interrupted run are not rendered again. With several noise samples each estimator runs on all of them;
image, record and row belong to the first, and the row gives the scatter of the fits relative to the claimed noise. The
heads of a scene are made together if an estimator needs all of them: every head has a record, and the scene one more
with the rows of that estimator.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from horizonval.core.errors import UserError, one_line
from horizonval.frame import RadianceFrame
from horizonval.jobs.progress import Stopwatch
from horizonval.spec.load import Case
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.store.store import Store
from horizonval.suites.identity import frame_identity
from horizonval.suites.plan import CasePlan, Unit
from horizonval.suites.record import Record, failed_record, record_of
from horizonval.suites.units.scored import DRAWS, Observed, score_alone, score_together


@dataclass
class _Made:
    """A case in progress: its frame, the frame's address if stored, and the observed images."""

    frame: RadianceFrame
    frame_address: str | None
    observed: Observed


def records_of(unit: Unit, plan: CasePlan, folder: RunFolder, watch: Stopwatch) -> dict[str, Record]:
    """Make a unit and return its records by name.

    A failure is recorded in its case (``error``, rows with ``bad_input``) and does not affect others.
    """
    made: dict[str, _Made] = {}
    errors: dict[str, str] = {}
    for case in unit.cases:
        with _recorded(errors, case.name):
            made[case.name] = _make(case, plan, folder, watch)
    scene: Observed | None = None
    if unit.heads:
        if errors:
            first = next(iter(errors))
            errors[unit.name] = f"{first} failed: {errors[first]}"
        else:
            with _recorded(errors, unit.name):
                heads = {str(case.scene.camera.head): made[case.name].observed for case in unit.cases}
                scene = score_together(heads, unit.name, plan.together(unit.cases[0]), plan, watch)
    rows = [row for one in made.values() for row in one.observed.rows] + ([] if scene is None else scene.rows)
    stored = plan.keep == "all" or (plan.keep == "failures" and any(row.is_failure for row in rows))
    records: dict[str, Record] = {}
    addresses: dict[str, dict[str, str]] = {}
    for case in unit.cases:
        if case.name in made:
            with _recorded(errors, case.name):
                one = made[case.name]
                addresses[case.name] = _archive(one, folder, watch) if stored else {}
                seen = one.observed
                details = seen.details if stored else {}
                records[case.name] = record_of(case.name, one.frame.truth, seen.rows, details, addresses[case.name])
    if scene is not None:
        first = unit.cases[0].name
        with _recorded(errors, unit.name):
            details, truth = scene.details if stored else {}, made[first].frame.truth
            records[unit.name] = record_of(unit.name, truth, scene.rows, details, addresses[first])
    return records | failed_records(unit, plan, errors)


def failed_records(unit: Unit, plan: CasePlan, errors: Mapping[str, str]) -> dict[str, Record]:
    """Return records with the reason for results that cannot be made."""
    cases = {case.name: case for case in unit.cases}
    records = {}
    for name, error in errors.items():
        whole = unit.heads and name == unit.name
        case = unit.cases[0] if whole else cases[name]
        estimators = plan.together(case) if whole else plan.alone(case)
        records[name] = failed_record(name, case, estimators, plan, error)
    return records


def _make(case: Case, plan: CasePlan, folder: RunFolder, watch: Stopwatch) -> _Made:
    from horizonval.scoring.information import informed
    from horizonval.sensor.observe import observe

    frame, address = _frame(case, plan, folder, watch)
    observed = Observed({})
    for band in (one.name for one in case.camera.band):
        with watch.stage("observe"):
            image = observe(frame, case.camera, band=band)
        with watch.stage("bound"):
            observed.images[band] = informed(image, frame)
        redrawn = observed.redrawn.setdefault(band, [])
        for seed in range(1, plan.draws):
            with watch.stage(DRAWS):
                redrawn.append(observe(frame, case.camera, band=band, seed=seed))
    score_alone(observed, case.name, plan.alone(case), plan, watch)
    return _Made(frame, address, observed)


def _frame(case: Case, plan: CasePlan, folder: RunFolder, watch: Stopwatch) -> tuple[RadianceFrame, str | None]:
    """Return the frame and its address, from the archive or rendered; with ``keep = "all"`` it is stored at once."""
    from horizonval.renderer.frame import render_in_turn

    store = Store(folder.archive)
    known = rendered(case, plan, folder)
    if known is not None and store.is_intact(known):
        with watch.stage("read"):
            return store.read_frame(known), known
    with watch.stage("render"):
        frame = render_in_turn(case.scene, case.camera)
    if plan.keep != "all":
        return frame, None
    with watch.stage("archive"):
        address = store.add_frame(frame)
        point_to(case, folder, address)
    return frame, address


def rendered(case: Case, plan: CasePlan, folder: RunFolder) -> str | None:
    """Return the recorded address of a case's frame; the entry may be missing."""
    if plan.keep != "all":
        return None
    try:
        pointer = read_json(folder.frame_pointer(case.name))
    except UserError:
        return None
    if pointer is None or pointer.get("identity") != frame_identity(case):
        return None
    return str(pointer.get("frame"))


def point_to(case: Case, folder: RunFolder, address: str) -> None:
    """Record the address of a case's frame."""
    pointer = {"case": case.name, "identity": frame_identity(case), "frame": address}
    write_json(folder.frame_pointer(case.name), pointer)


def _archive(made: _Made, folder: RunFolder, watch: Stopwatch) -> dict[str, str]:
    """Store frame (``""``) and images, and return their addresses."""
    store = Store(folder.archive)
    with watch.stage("archive"):
        address = made.frame_address or store.add_frame(made.frame)
        images = {band: store.add_image(image) for band, image in made.observed.images.items()}
    return {"": address, **images}


@contextlib.contextmanager
def _recorded(errors: dict[str, str], name: str) -> Iterator[None]:
    """Turn any exception inside into one line under a name."""
    try:
        yield
    except Exception as e:
        errors[name] = one_line(e)
