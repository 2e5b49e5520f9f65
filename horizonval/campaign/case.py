"""One case: render, archive, observe, estimate, score. A pure function of the case's identity, plus timings.

What a case has already is used again: a finished case file is kept if everything it names is still in the archive and
undamaged; a frame that was rendered before the run was cut off is not rendered again.
"""

from __future__ import annotations

import hashlib
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.archive.store import Store
from horizonval.campaign.folder import RunFolder, read_json, write_json
from horizonval.campaign.identity import case_identity, code_version, frame_identity
from horizonval.campaign.observation import method_radius_m, observation_of
from horizonval.errors import UserError
from horizonval.estimators.observation import Fit, NoFit
from horizonval.frame import Frame, FrameTruth
from horizonval.outcome import Outcome
from horizonval.scoring.errors import score
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.table import COLUMNS, make_row
from horizonval.spec.load import Case

CASE_SCHEMA = 1
MAX_POINTS = 2000

Record = dict[str, Any]


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
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def run_case(case: Case, estimators: tuple[str, ...], folder: RunFolder) -> tuple[Record, dict[str, float]]:
    """Run one case, write its file, and return its record and the seconds each stage took.

    A defect anywhere is recorded in the case (``error``, rows with ``bad_input``), so that one bad frame does not cost
    the others.
    """
    watch = Stopwatch()
    try:
        record = _run(case, estimators, folder, watch)
    except UserError as e:
        record = failed_record(case, estimators, e.line())
    except Exception as e:
        frame = traceback.extract_tb(e.__traceback__)[-1]
        # The file's name only: where the package is installed must not show in a result.
        place = f"{Path(frame.filename).name}:{frame.lineno}"
        record = failed_record(case, estimators, f"{type(e).__name__} at {place}: {e}")
    write_json(folder.case(case.name), record, indent=None)
    return record, {stage: round(seconds, 4) for stage, seconds in watch.seconds.items()}


def finished_record(case: Case, estimators: tuple[str, ...], folder: RunFolder) -> Record | None:
    """Return the record of a case that needs no work, or ``None``."""
    record = read_json(folder.case(case.name))
    if record is None or record.get("identity") != case_identity(case, estimators) or record.get("error") is not None:
        return None
    store = Store(folder.archive)
    addresses = (record["truth_frame"], *record["images"].values())
    return record if all(_is_intact(store, address) for address in addresses) else None


def failed_record(case: Case, estimators: tuple[str, ...], error: str) -> Record:
    """Return the record of a case that has no result because something broke."""
    from horizonval.estimators import registry

    truth = _truth_or_none(case)
    camera = camera_name(case)
    reason = " ".join(error.split())
    rows = []
    for band in case.camera.band:
        for estimator in estimators:
            expected = Outcome.BAD_INPUT
            if truth is not None:
                expected = expected_outcome(truth, band.name, needs=registry.get(estimator).needs).outcome
            row = dict.fromkeys(COLUMNS) | {
                "case": case.name,
                "camera": camera,
                "band": band.name,
                "estimator": estimator,
                "expected": str(expected),
                "status": str(Outcome.BAD_INPUT),
                "reason": reason,
                "n_points": 0,
                "false_valid": False,
            }
            rows.append(row)
    return {
        "schema": CASE_SCHEMA,
        "case": case.name,
        "scene_id": truth.scene_id if truth else None,
        "version": code_version(),
        "identity": case_identity(case, estimators),
        "truth_frame": None,
        "image": None,
        "images": {},
        "rows": rows,
        "details": {},
        "error": reason,
    }


def camera_name(case: Case) -> str:
    """Return the camera's own name, else its file's."""
    return case.camera.camera.name or case.scene.camera.file.rsplit("/", 1)[-1].removesuffix(".toml")


def _run(case: Case, estimators: tuple[str, ...], folder: RunFolder, watch: Stopwatch) -> Record:
    from horizonval.estimators import registry
    from horizonval.sensor.observe import observe

    store = Store(folder.archive)
    frame, frame_address = _frame(case, store, folder, watch)
    images: dict[str, str] = {}
    rows: list[Mapping[str, Any]] = []
    details: dict[str, Any] = {}
    for band in case.camera.band:
        with watch.stage("observe"):
            image = observe(frame, case.camera, band=band.name)
        with watch.stage("archive"):
            images[band.name] = store.add_image(image)
        for name in estimators:
            estimator = registry.get(name)
            with watch.stage(f"estimate {name}"):
                result = registry.run_safely(estimator, observation_of(image, estimator))
            with watch.stage("score"):
                rows.append(
                    make_row(
                        case=case.name,
                        camera=camera_name(case),
                        band=band.name,
                        estimator=name,
                        truth=frame.truth,
                        expected=expected_outcome(frame.truth, band.name, needs=estimator.needs),
                        score=score(frame.truth, estimator, result, earth_radius_m=method_radius_m(frame.truth)),
                        frame_address=frame_address,
                        image_address=images[band.name],
                    )
                )
            # The report draws the first band; further bands keep their own entry beside it.
            key = name if band is case.camera.band[0] else f"{name} [{band.name}]"
            details[key] = _details(result)
    return {
        "schema": CASE_SCHEMA,
        "case": case.name,
        "scene_id": frame.truth.scene_id,
        "version": code_version(),
        "identity": case_identity(case, estimators),
        "truth_frame": frame_address,
        "image": images[case.camera.band[0].name],
        "images": images,
        "rows": rows,
        "details": details,
        "error": None,
    }


def _frame(case: Case, store: Store, folder: RunFolder, watch: Stopwatch) -> tuple[Frame, str]:
    """Return the frame and its address: from the archive if it was rendered before, else rendered and stored."""
    from horizonval.render.frame import render_frame

    pointer_path = folder.frame_pointer(case.name)
    identity = frame_identity(case)
    pointer = read_json(pointer_path)
    if pointer is not None and pointer.get("identity") == identity and _is_intact(store, str(pointer.get("frame"))):
        with watch.stage("read"):
            return store.read_frame(pointer["frame"]), pointer["frame"]
    with watch.stage("render"):
        frame = render_frame(case.scene, case.camera)
    with watch.stage("archive"):
        address = store.add_frame(frame)
        write_json(pointer_path, {"identity": identity, "frame": address})
    return frame, address


def _is_intact(store: Store, address: str) -> bool:
    """Whether an entry is there and is what was added."""
    try:
        with store.path(address).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() == address
    except (UserError, OSError):
        return False


def _details(result: Fit | NoFit) -> dict[str, Any]:
    """What the report draws over the image: limb points, evenly thinned, and the fitted limb."""
    points = np.asarray(result.points, dtype=np.float64).reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) > MAX_POINTS:
        points = points[np.linspace(0, len(points) - 1, MAX_POINTS).round().astype(int)]
    fit = None
    if isinstance(result, Fit):
        fit = {
            "nadir_cam": [float(x) for x in result.nadir_cam],
            "angular_radius_rad": None if result.angular_radius_rad is None else float(result.angular_radius_rad),
        }
    return {"points": points.round(3).tolist(), "fit": fit}


def _truth_or_none(case: Case) -> FrameTruth | None:
    from horizonval.truth import truth_of

    try:
        return truth_of(case.scene, case.camera, infrared=False)
    except Exception:  # Whatever broke the case may break its truth as well; the error is reported already.
        return None
