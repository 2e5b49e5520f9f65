"""A pointing budget of a suite: every frame with all error sources, without each of them, and without any.

The row of a source is the difference of the answers with it and without it, frame by frame, where both were answered.
Every state is observed with the same draws of the detector's noise. A row is the mean difference of a frame's draws;
its variance loses the part of the noise, which is the variance among the draws over their number. The
row of the noise is the deviation of the first draw from the mean of all, times ``sqrt(K / (K - 1))`` for K draws. The
estimator's row is the mean error with all sources off. ``alone`` repeats the frame with one source on: for small errors
its difference from the estimator's row equals the row.

Files: ``budget.json`` (all numbers), ``budget.csv`` (a line for each row and axis), ``index.html``.
"""

from __future__ import annotations

import csv
import hashlib
import io
import itertools
import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import atomic
from horizonval.core.arrays import FloatArray
from horizonval.core.code import code_digest, code_version
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Outcome
from horizonval.core.progress import Progress, Silent
from horizonval.estimation.observation import Estimator, Observation
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.geometry import clock
from horizonval.jobs.engine import Record, Recorded, do
from horizonval.jobs.pool import Execution
from horizonval.jobs.progress import Stopwatch
from horizonval.plugins import registry
from horizonval.renderer.frame import render_in_turn
from horizonval.renderer.frame_cost import shared_view
from horizonval.scoring.errors import score
from horizonval.sensor.knowledge import believed_prior, calibration_of, drawn_prior, errors_of, stated_sigmas
from horizonval.sensor.observe import observe
from horizonval.spec.load import Case, Suite
from horizonval.spec.scene import SceneSpec
from horizonval.store.folder import RunFolder, write_json
from horizonval.store.verify import amend_manifest
from horizonval.studies.budget import statistics
from horizonval.studies.budget.sources import (
    EMPIRICAL,
    FIELD,
    NOISE,
    NORMAL,
    SOURCES,
    camera_without,
    prior_without,
    scene_without,
    sources_in,
    truth_without,
)
from horizonval.suites.identity import code_of, frame_identity
from horizonval.suites.observation import observation_of, scene_prior
from horizonval.suites.plan import CasePlan, Unit, plan_of, units_of

WHOLE, ESTIMATOR, ALONE = "whole", "estimator", "alone "
FILE, TABLE, PAGE = "budget.json", "budget.csv", "index.html"
FILES = (FILE, TABLE, PAGE)
AXES = ("roll", "pitch")
CLOSED = 0.1
"""Largest relative difference of the root sum square of the rows and the whole of a budget that closes."""
NOT_IN_IT = ("thermo-elastic drift of the mounting", "ageing of the lens and detector")
"""Error sources that the model does not have; every export names them."""


def states_of(sources: Collection[str], alone: bool) -> dict[str, frozenset[str]]:
    """Return the sources that are off, by the name of the state: the whole, one for each source, the estimator."""
    every = frozenset(sources)
    states = {WHOLE: frozenset[str](), ESTIMATOR: every}
    for name in sources:
        states[name] = frozenset({name})
        if alone:
            states[f"{ALONE}{name}"] = every - {name}
    return states


class BudgetWork(Recorded[Unit]):
    """The answers of a frame in all states, each frame a record in the folder ``budget``."""

    def __init__(self, plan: CasePlan, folder: Path, draws: int, alone: bool) -> None:
        self.plan, self.draws, self.alone = plan, draws, alone
        self.folder: Path | None = folder
        self.records = folder

    def name(self, item: Unit) -> str:
        return item.name

    def group(self, item: Unit) -> str:
        """Return the key of units that share view tables."""
        return shared_view(item.cases[0].scene, item.cases[0].camera)

    def path(self, item: Unit) -> Path:
        return self.records / f"{item.name}.json"

    def identity(self, item: Unit) -> str:
        """Return the digest of the frames, the estimators and the code."""
        names = self.plan.of(item.cases[0])
        parts = [*(frame_identity(case) for case in item.cases), self.plan.content(names), f"{self.draws} {self.alone}"]
        return hashlib.sha256(json.dumps([*parts, code_digest(*code_of(names))]).encode()).hexdigest()

    def record(self, item: Unit, watch: Stopwatch) -> Record:
        """Render and observe a frame in all states, and return the errors of every answer [arcsec]."""
        cases = [replace(case, scene=_with_draw(case.scene)) for case in item.cases]
        frames: dict[tuple[str, str], RadianceFrame] = {}

        def frame_of(case: Case, off: Collection[str]) -> RadianceFrame:
            scene = scene_without(case.scene, off)
            key = (case.name, scene.model_dump_json())
            if key not in frames:
                with watch.stage("render"):
                    frames[key] = render_in_turn(scene, case.camera, maps=False)
            return frames[key]

        first = frame_of(cases[0], ())
        sources = sources_in(cases[0].scene, cases[0].camera, first.truth)
        answers: dict[str, dict[str, list[JsonObject]]] = {}
        bands = [one.name for one in cases[0].camera.band]
        for state, off in states_of(sources, self.alone).items():
            for band, seed in itertools.product(bands, range(self.draws)):
                images = {}
                for case in cases:
                    with watch.stage("observe"):
                        images[case.head or ""] = _image(frame_of(case, off), case, band, seed, off)
                for name in self.plan.of(cases[0]):
                    with watch.stage("estimate"):
                        found = _answer(self.plan.estimator(name), images, off, item.heads)
                    if found is not None:
                        answers.setdefault(f"{name}, {band}", {}).setdefault(state, []).append(found)
        truth = first.truth
        return {"case": item.name, "epoch_utc": truth.epoch_utc, "sources": list(sources), "answers": answers}


def _with_draw(scene: SceneSpec) -> SceneSpec:
    """Return a scene whose noise is drawn under its name, whatever else changes in it."""
    draw = scene.scene.draw or scene.scene.name
    return scene.model_copy(update={"scene": scene.scene.model_copy(update={"draw": draw})})


def _image(frame: RadianceFrame, case: Case, band: str, seed: int, off: Collection[str]) -> DetectorImage:
    """Return the image of a frame without some sources; its truth states the calibration errors that are left."""
    image = observe(frame, camera_without(case.camera, off), band=band, seed=seed)
    return replace(image, truth=truth_without(image.truth, off))


def _answer(
    estimator: Estimator, images: Mapping[str, DetectorImage], off: Collection[str], heads: bool
) -> JsonObject | None:
    """Return the errors of an answer, or the refusal; None where the estimator needs other images."""
    if (estimator.needs == "heads") != heads:
        return None
    seen: dict[str, Observation] = {}
    for head, image in images.items():
        truth, spec = image.truth, scene_prior(image.truth)
        drawn = prior_without(drawn_prior(spec, truth, image.band), truth, off)
        known = believed_prior(drawn, spec, truth, errors_of(truth), stated_sigmas(calibration_of(truth)))
        seen[head] = observation_of(image, estimator, known=known)
    observation = next(iter(seen.values()))
    result = registry.run_safely(estimator, replace(observation, heads=seen) if heads else observation)
    truth = next(iter(images.values())).truth
    scored = score(truth, estimator, result)
    if result.status is not Outcome.VALID:
        return {"status": str(result.status)}
    return {"status": scored.status, "roll": scored.roll_error_arcsec, "pitch": scored.pitch_error_arcsec}


def run_budget(
    suite: Suite,
    out_dir: Path,
    *,
    window_s: float | None = None,
    draws: int = 4,
    alone: bool = False,
    execution: Execution | None = None,
    progress: Progress | None = None,
) -> JsonObject:
    """Make the budget of a suite, or resume; write it and return the content of ``budget.json``.

    Parameters
    ----------
    suite : Suite
        Flights are the values of ``calibration.draw``, or else the orbits; samples of one orbit are its times.
    window_s : float, optional
        Window of the knowledge errors; a tenth of the longest flight without it.
    draws : int
        Draws of the detector's noise in every frame, at least 2.
    alone : bool
        Also run every frame with one source on, for the check of every row.

    Raises
    ------
    UserError
        A mistake in the suite, no back-end, a frame that failed, a folder with files of others.
    """
    plan = plan_of(suite)
    folder = RunFolder(out_dir)
    folder.refuse_files_of_others(("budget", *FILES))
    atomic.make_folder(out_dir)
    units = units_of(suite.cases, plan)
    with folder.locked():
        work = BudgetWork(plan, out_dir / "budget", draws, alone)
        done = do(work, units, execution or Execution(), progress or Silent(), unit="frames")
        failed = {name: one.error for name, one in done.items() if one.error is not None}
        if failed:
            name, error = next(iter(failed.items()))
            raise UserError(f"{name}: {error}", where=str(out_dir), fix="mend it and run again; finished frames stay")
        records = {name: one.result for name, one in done.items() if one.result is not None}
        result = conclude(suite, units, records, window_s, alone)
        write(result, out_dir)
        amend_manifest(out_dir, [out_dir / name for name in FILES])
    return result


def conclude(
    suite: Suite,
    units: Sequence[Unit],
    records: Mapping[str, Record],
    window_s: float | None,
    alone: bool,
) -> JsonObject:
    """Return the budget of finished records, by camera and method."""
    groups: dict[tuple[str, str], dict[str, list[Record]]] = {}
    names = {unit.name: unit for unit in units}
    for name, record in records.items():
        case = names[name].cases[0]
        camera = case.camera.camera.name or case.scene.camera.file
        for method in record["answers"]:
            groups.setdefault((camera, method), {}).setdefault(_flight(case), []).append(record)
    made = []
    for (camera, method), flights in sorted(groups.items()):
        ordered = [sorted(one, key=lambda record: record["epoch_utc"]) for _, one in sorted(flights.items())]
        made.append({"camera": camera, "method": method, **_budget(ordered, method, window_s, alone)})
    return {
        "schema": 1,
        "suite": suite.name,
        "version": code_version(),
        "not_modelled": list(NOT_IN_IT),
        "budgets": made,
    }


def _flight(case: Case) -> str:
    """Return the flight of a frame: its draw of the calibration, else its orbit, else the frame itself."""
    table = case.scene.calibration
    if table is not None and table.draw is not None:
        return table.draw
    return f"{case.table}/{case.variant}" if case.sample else case.name


def _budget(flights: Sequence[Sequence[Record]], method: str, window_s: float | None, alone: bool) -> JsonObject:
    start = datetime.fromisoformat(min(record["epoch_utc"] for one in flights for record in one))
    times = [
        np.array([clock.elapsed_s(start, datetime.fromisoformat(record["epoch_utc"])) for record in one])
        for one in flights
    ]
    window = window_s or max((float(t[-1] - t[0]) for t in times), default=0.0) / 10.0 or 1.0

    def errors(state: str, axis: str) -> list[FloatArray]:
        """Return the errors of each flight, shape (frames, draws)."""
        draws = len(flights[0][0]["answers"][method][WHOLE])
        missing: list[JsonObject] = [{}] * draws
        return [
            np.array(
                [[_number(one, axis) for one in record["answers"][method].get(state, missing)] for record in flight]
            )
            for flight in flights
        ]

    def row(with_it: str, without: str) -> JsonObject:
        return _row(
            {axis: [a - b for a, b in zip(errors(with_it, axis), errors(without, axis), strict=True)] for axis in AXES},
            times,
        )

    present = [s for s in SOURCES if any(s.name in record["sources"] for one in flights for record in one)]
    whole = {axis: errors(WHOLE, axis) for axis in AXES}
    noise = {axis: [_noise_of(one) for one in whole[axis]] for axis in AXES}
    rows: list[JsonObject] = [
        {
            "source": "noise",
            "title": "read and shot noise",
            "class": NOISE,
            "distribution": NORMAL,
            **_row(noise, times),
        }
    ]
    for source in present:
        about: JsonObject = {
            "source": source.name,
            "title": source.title,
            "class": source.error_class,
            "distribution": source.distribution,
        }
        about |= row(WHOLE, source.name)
        if alone:
            about["alone"] = row(f"{ALONE}{source.name}", ESTIMATOR)["axes"]
        rows.append(about)
    left = _row({axis: errors(ESTIMATOR, axis) for axis in AXES}, times)
    rows.append(
        {"source": ESTIMATOR, "title": "estimator, all sources off", "class": FIELD, "distribution": EMPIRICAL, **left}
    )
    first = {axis: [one[:, :1] for one in whole[axis]] for axis in AXES}
    total = _row(first, times)
    answers = [record["answers"][method][WHOLE][0]["status"] for one in flights for record in one]
    return {
        "flights": len(flights),
        "frames": len(answers),
        "answered": sum(status == Outcome.VALID for status in answers),
        "window_s": window,
        "rows": rows,
        "whole": total,
        "closure": {axis: _closure(rows, total, axis) for axis in AXES},
        "knowledge": {
            axis: statistics.knowledge_errors([one[:, 0] for one in first[axis]], times, window) for axis in AXES
        },
    }


def _number(answer: Mapping[str, Any], axis: str) -> float:
    value = answer.get(axis)
    return math.nan if value is None else float(value)


def _noise_of(errors: FloatArray) -> FloatArray:
    """Return the first draw's deviation from the mean of all draws, with the variance of one draw, shape (n, 1)."""
    draws = errors.shape[1]
    return math.sqrt(draws / (draws - 1.0)) * (errors[:, :1] - errors.mean(axis=1, keepdims=True))


def _row(errors: Mapping[str, Sequence[FloatArray]], times: Sequence[FloatArray]) -> JsonObject:
    """Return the statistics of errors by axis, for each flight an array (frames, draws)."""
    series = {axis: [one.mean(axis=1) for one in errors[axis]] for axis in AXES}
    both = [np.concatenate(series[axis]) for axis in AXES]
    known = np.isfinite(both[0]) & np.isfinite(both[1])
    varies = known.sum() > 2 and all(np.std(one[known]) > 0.0 for one in both)
    axes = {}
    for axis in AXES:
        noise = _noise_variance(errors[axis])
        found = statistics.two_levels(series[axis], noise)
        axes[axis] = found | statistics.correlation(series[axis], times, noise)
    return {
        "axes": axes,
        "roll_pitch_correlation": float(np.corrcoef(both[0][known], both[1][known])[0, 1]) if varies else None,
    }


def _noise_variance(errors: Sequence[FloatArray]) -> float:
    """Return the variance of the mean over draws by noise; 0 of a single draw."""
    table = np.concatenate(errors)
    table = table[np.isfinite(table).all(axis=1)]
    draws = table.shape[1]
    return float(table.var(axis=1, ddof=1).mean() / draws) if draws > 1 and len(table) else 0.0


def _closure(rows: Sequence[JsonObject], whole: JsonObject, axis: str) -> JsonObject:
    """Return the root sum square of the rows, mean and standard deviation together, and of the whole, in arcsec."""
    found = [one["axes"][axis] for one in (*rows, whole)]
    squares = [(one["mean"] or 0.0) ** 2 + (one["mixed"] or 0.0) ** 2 for one in found]
    spread = [(one["mixed"] or 0.0) ** 2 for one in found]
    rss, rms = math.sqrt(sum(squares[:-1])), math.sqrt(squares[-1])
    sigma_rss, sigma = math.sqrt(sum(spread[:-1])), math.sqrt(spread[-1])
    return {
        "rss": rss,
        "rms": rms,
        "sigma_rss": sigma_rss,
        "sigma": sigma,
        "ratio": sigma_rss / sigma if sigma > 0.0 else None,
        "closes": sigma > 0.0 and abs(sigma_rss / sigma - 1.0) <= CLOSED,
    }


COLUMNS = (
    "mean", "mixed", "ensemble", "temporal", "q9973", "three_sigma", "white", "correlated", "e_fold_s", "n",
)  # fmt: skip


def write(result: JsonObject, out_dir: Path) -> None:
    """Write a budget as JSON, CSV and a page."""
    from horizonval.studies.budget.page import text_of

    write_json(out_dir / FILE, result)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["camera", "method", "source", "class", "distribution", "axis"]
        + [f"{name}_arcsec" if name not in ("e_fold_s", "n") else name for name in COLUMNS]
        + ["roll_pitch_correlation", "heavy_tails"]
    )
    for budget in result["budgets"]:
        total = {"title": "total", "class": "", "distribution": "", **budget["whole"]}
        for row in (*budget["rows"], total):
            for axis in AXES:
                found = row["axes"][axis]
                values = [found.get(name) for name in COLUMNS] + [row["roll_pitch_correlation"], found["tails"]]
                head = [budget["camera"], budget["method"], row["title"], row["class"], row["distribution"], axis]
                writer.writerow([*head, *("" if value is None else value for value in values)])
    for missing in result["not_modelled"]:
        writer.writerow(["", "", missing, "not modelled", *[""] * (len(COLUMNS) + 4)])
    atomic.write_text(out_dir / TABLE, text.getvalue())
    atomic.write_text(out_dir / PAGE, text_of(result))
