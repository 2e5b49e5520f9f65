"""Information bound of every design on the frames of its study, without running an estimator.

For a design with the bounds ``b`` of its frames, rms errors in two directions, an efficient unbiased method is within
``e`` in the share::

    within = mean over all frames of (1 - exp(-e^2 / b^2)),      0 where the image does not determine the nadir

The error is Rayleigh distributed if both directions are equally uncertain; for an arc the share is a few per cent
smaller at ``e`` about ``b``. A design that misses the requirement here misses it with any method. Each head of a camera
counts separately.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import atomic
from horizonval.core.code import code_digest
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Outcome
from horizonval.core.progress import Progress, Silent
from horizonval.jobs.engine import Record, Recorded, do
from horizonval.jobs.pool import Execution
from horizonval.jobs.progress import Stopwatch
from horizonval.renderer.frame import render_in_turn
from horizonval.renderer.frame_cost import shared_view
from horizonval.scoring.bound import bound_of
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.information import information_of
from horizonval.spec.load import Case
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.store.verify import amend_manifest
from horizonval.studies.trade.conclude import RESULT
from horizonval.studies.trade.design import Study
from horizonval.studies.trade.run import study_in
from horizonval.suites.identity import frame_identity

FILE = "study-information.json"


class InformationWork(Recorded[Case]):
    """Bounds of the cases of a study, each a record in the folder ``information``."""

    def __init__(self, folder: Path) -> None:
        self.folder: Path | None = folder
        self.records = folder

    def name(self, item: Case) -> str:
        return item.name

    def group(self, item: Case) -> str:
        """Return the key of cases that share view tables."""
        return shared_view(item.scene, item.camera)

    def path(self, item: Case) -> Path:
        return self.records / f"{item.name}.json"

    def identity(self, item: Case) -> str:
        """Return the digest of the frame's identity and of the code."""
        return hashlib.sha256(f"{frame_identity(item)} {code_digest()}".encode()).hexdigest()

    def record(self, item: Case, watch: Stopwatch) -> Record:
        """Render a case and return the bounds of its bands, and the expected outcome."""
        with watch.stage("render"):
            frame = render_in_turn(item.scene, item.camera)
        bands = {}
        for name in (band.name for band in item.camera.band):
            with watch.stage("bound"):
                bound = bound_of(information_of(frame, item.camera, name), frame.truth, name)
            bands[name] = {
                "noise_arcsec": bound.noise_arcsec,
                "bound_arcsec": bound.known_arcsec,
                "altitude_m": bound.altitude_m,
                "expected": str(expected_outcome(frame.truth, name, bound=bound).outcome),
            }
        return {"case": item.name, "bands": bands}


def run_information(
    path_or_name: str | Path,
    out_dir: Path,
    *,
    execution: Execution | None = None,
    progress: Progress | None = None,
    frames: int | None = None,
) -> JsonObject:
    """Compute the information bounds of a study's frames, or resume; write ``study-information.json`` and return it.

    ``out_dir`` may be the study's folder; its trial is then part of the result. ``frames`` replaces the number of
    conditions. Raises ``UserError``: a mistake in the study, found before rendering; no back-end.

    Returns
    -------
    dict
        ``study``, ``limit`` (the requirement with the error), ``conditions``, ``failed`` by frame, and ``designs``:
        ``name``, ``settings``, ``camera``, ``n``,
        ``due`` (frames to be answered), ``noise_arcsec`` and ``bound_arcsec`` (``{median, rms, p95, n}`` over the
        frames that determine the nadir), ``within`` and ``within_by_noise`` (shares of all frames), and ``trial``: by
        estimator ``{rms_deg, within, n}`` of a finished study in the folder.
    """
    study = study_in(path_or_name, frames)
    folder = RunFolder(out_dir)
    folder.refuse_files_of_others(("information", FILE, RESULT))
    atomic.make_folder(out_dir)
    with folder.locked():
        work = InformationWork(out_dir / "information")
        done = do(work, study.suite.cases, execution or Execution(), progress or Silent(), unit="frames")
    found = {name: one.result["bands"] for name, one in done.items() if one.result is not None}
    trial = read_json(out_dir / RESULT) or {"designs": []}
    result = {
        "schema": 1,
        "study": study.head.model_dump(mode="json"),
        "limit": study.limit.model_dump(mode="json"),
        "conditions": len(study.conditions),
        "failed": {name: one.error for name, one in done.items() if one.error is not None},
        "designs": _designs(study, found, trial["designs"]),
    }
    write_json(out_dir / FILE, result)
    amend_manifest(out_dir, [out_dir / FILE])
    return result


def _designs(study: Study, found: Mapping[str, Mapping[str, Any]], trial: Sequence[JsonObject]) -> list[JsonObject]:
    limit_arcsec = 3600.0 * study.limit_deg
    by_entry: dict[str, list[Mapping[str, Any]]] = {}
    for name, bands in found.items():
        by_entry.setdefault(study.frames[name][0], []).extend(bands.values())
    tried: dict[str, JsonObject] = {}
    for one in trial:
        values = {"rms_deg": one["rms_deg"]["value"], "within": one["within"]["rate"], "n": one["n"]}
        tried.setdefault(one["frames"], {})[one["estimator"]] = values
    designs: dict[str, JsonObject] = {}
    for design in study.designs:
        records = by_entry.get(design.frames, [])
        designs.setdefault(
            design.frames,
            {
                "name": design.frames,
                "settings": {key: value for key, value in design.settings.items() if key != "estimator"},
                "camera": design.camera,
                "pixels": design.width * design.height * design.heads,
                "n": len(records),
                "due": sum(record["expected"] == Outcome.VALID for record in records),
                "noise_arcsec": _spread(records, "noise_arcsec"),
                "bound_arcsec": _spread(records, "bound_arcsec"),
                "within": _within(records, "bound_arcsec", limit_arcsec),
                "within_by_noise": _within(records, "noise_arcsec", limit_arcsec),
                "trial": tried.get(design.frames, {}),
            },
        )
    return list(designs.values())


def _spread(records: Sequence[Mapping[str, Any]], key: str) -> JsonObject:
    values = np.array([record[key] for record in records if record[key] is not None])
    if not len(values):
        return {"median": None, "rms": None, "p95": None, "n": 0}
    return {
        "median": float(np.median(values)),
        "rms": float(np.sqrt(np.mean(values**2))),
        "p95": float(np.percentile(values, 95)),
        "n": len(values),
    }


def _within(records: Sequence[Mapping[str, Any]], key: str, limit_arcsec: float) -> float | None:
    known = [float(record[key]) for record in records if record[key] is not None]
    total = math.fsum(1.0 - math.exp(-((limit_arcsec / bound) ** 2)) for bound in known)
    return total / len(records) if records else None
