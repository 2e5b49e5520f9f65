"""The record of a case: its rows, where frame and images lie, what the report draws; or why there is none of that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from horizonval.core.code import code_version
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Fit
from horizonval.frame import FrameTruth
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.row import Row
from horizonval.spec.load import Case
from horizonval.suites.plan import CasePlan

CASE_SCHEMA = 1
MAX_POINTS = 2000

Record = dict[str, Any]


def record_of(
    name: str,
    truth: FrameTruth,
    rows: Sequence[Row],
    details: Mapping[str, Any],
    addresses: Mapping[str, str],
) -> Record:
    """Return the record of a case with results.

    ``addresses`` are those of the images by band, the frame's under ``""``; empty where nothing was kept.
    """
    images = {band: address for band, address in addresses.items() if band}
    placed = [
        replace(row, frame_address=addresses.get(""), image_address=images.get(row.band)).to_dict() for row in rows
    ]
    return {
        "schema": CASE_SCHEMA,
        "case": name,
        "scene_id": truth.scene_id,
        "version": code_version(),
        "truth_frame": addresses.get(""),
        "image": next(iter(images.values()), None),
        "images": images,
        "rows": placed,
        "details": dict(details),
        "error": None,
    }


def failed_record(name: str, case: Case, estimators: Sequence[str], plan: CasePlan, error: str) -> Record:
    """Return the record of a case that has no result because something broke."""
    truth = _truth_or_none(case)
    reason = " ".join(error.split())
    rows = []
    for band in case.camera.band:
        for estimator in estimators:
            expected = Outcome.BAD_INPUT
            if truth is not None:
                expected = expected_outcome(truth, band.name, needs=plan.estimator(estimator).needs).outcome
            row = Row(
                case=name,
                camera=camera_name(case),
                band=band.name,
                estimator=estimator,
                expected=str(expected),
                status=str(Outcome.BAD_INPUT),
                reason=reason,
            )
            rows.append(row.to_dict())
    return {
        "schema": CASE_SCHEMA,
        "case": name,
        "scene_id": truth.scene_id if truth else None,
        "version": code_version(),
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


def details_of(result: Fit | Refusal) -> dict[str, Any]:
    """Return what the report draws over the image: limb points, evenly thinned, and the fitted limb; of a crash
    what was printed last."""
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
    details = {"points": points.round(3).tolist(), "fit": fit}
    return details | {"output": result.output} if isinstance(result, Refusal) and result.output else details


def _truth_or_none(case: Case) -> FrameTruth | None:
    from horizonval.truth.frame_truth import truth_of

    try:
        return truth_of(case.scene, case.camera, infrared=False)
    except Exception:  # Whatever broke the case may break its truth as well; the error is reported already.
        return None
