"""How good the weights are: the frames for test, and the scorer's own rows beside other methods.

The frames for test are of scenes that the training never saw. The scorer's rows are those of ``learning`` again with
another seed, a suite that names the plug-in among its ``estimators``, and of the infrared frames of the benchmark, most
of which are not what the network was trained on.
"""

from __future__ import annotations

import math
import platform
import re
import time
from collections.abc import Callable, Iterable
from importlib.metadata import PackageNotFoundError, version
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

import horizonval as hv
from horizonval.geometry.rotation import angle_between, tangent_basis
from horizonval.spec.files import shipped_path
from horizonval.store.index import Filter
from horizonval.store.store import Store
from horizonval.studies.bench.frames import cell_of
from horizonval.suites.rescore import rescore
from horizonval_learned.frames import Frame, frames, image_alone, index_of
from horizonval_learned.network import WEIGHTS, load

OURS, ALONE = "learned-limb", "learned-limb, image alone"
FLOOR, OTSU = "triangle-circle", "otsu-circle"
"""Two of the floor's thresholds. Otsu's follows the lens, which darkens its corners to a tenth, and not the limb."""
ON_ALL = (OURS, ALONE, FLOOR, OTSU)
SAMPLE = 100
ON_SAMPLE = ("altitude-free", "guarded-altitude-free", "limb-ellipsoid")
"""Methods that are asked about some of the frames, for the time that they take."""
BESIDE = (OURS, FLOOR, OTSU, "altitude-free", "limb-ellipsoid")
OTHER_SEED, SCENES = 7, 8
PRIOR = """
[defaults.prior]
altitude_sigma_km = 1.0
position_sigma_km = 1.0
attitude_sigma_deg = [2.0, 2.0, 2.0]
"""


def on_test(folder: Path, estimators: dict[str, hv.Estimator]) -> dict[str, Any]:
    """Return what methods make of the frames for test, by method and, of those that see all of them, by air."""
    names = index_of(folder)["scene_names"]
    answers: dict[str, list[dict[str, Any]]] = {}
    for method in (*ON_ALL, *ON_SAMPLE):
        step = 1 if method in ON_ALL else SAMPLE
        answers[method] = [
            _answer(estimators[method.partition(",")[0]], frame, method == ALONE, names[frame.scene])
            for frame in islice(frames(folder, "test"), 0, None, step)
        ]
    # The same frames for all, beside what some methods make of all of them.
    sampled = {f"{method}": rows[::SAMPLE] if method in ON_ALL else rows for method, rows in answers.items()}
    airs = sorted({row["air"] for row in answers[OURS]})
    return {
        "all": {method: summary(answers[method]) for method in ON_ALL},
        "sample": {method: summary(rows) for method, rows in sampled.items()},
        "airs": {
            air: {
                "scenes": len({row["scene"] for row in answers[OURS] if row["air"] == air}),
                **{method: summary([row for row in answers[method] if row["air"] == air]) for method in ON_ALL},
            }
            for air in airs
        },
        "errors_deg": {method: [_digits(row["error"], 4) for row in rows] for method, rows in answers.items()},
        "normalised": {m: [_digits(r["normalised"], 4) for r in answers[m] if r["claim"]] for m in (OURS, ALONE)},
    }


def _answer(method: hv.Estimator, frame: Frame, alone: bool, name: str) -> dict[str, Any]:
    """Return what a method says of a frame: its error [deg], normalised error squared over 2, processor time [ms]."""
    observation = image_alone(frame.observation) if alone else frame.observation
    began = time.process_time()
    found = method.run(observation)
    spent = time.process_time() - began
    row = {"scene": frame.scene, "air": name.partition("_")[0], "ms": 1e3 * spent, "claim": bool(found)}
    if not isinstance(found, hv.Fit):
        return {**row, "error": math.nan, "normalised": math.nan}
    basis = tangent_basis(frame.nadir_cam)
    off = basis.T @ found.nadir_cam
    covariance = basis.T @ found.total_covariance_nadir_cam @ basis
    claims = np.linalg.det(covariance) > 0.0
    normalised = float(off @ np.linalg.solve(covariance, off)) / 2.0 if claims else math.nan
    error = math.degrees(angle_between(found.nadir_cam, frame.nadir_cam))
    return {**row, "error": error, "normalised": normalised}


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the numbers of a table's row: errors in degrees, time in milliseconds."""
    errors = np.array([row["error"] for row in rows if row["claim"]])
    normalised = [row["normalised"] for row in rows if row["claim"] and math.isfinite(row["normalised"])]
    return {
        "frames": len(rows),
        "claims": len(errors),
        "rms_deg": _digits(math.sqrt(np.mean(errors**2))) if len(errors) else None,
        "median_deg": _digits(np.median(errors)) if len(errors) else None,
        "p95_deg": _digits(np.percentile(errors, 95)) if len(errors) else None,
        "largest_deg": _digits(errors.max()) if len(errors) else None,
        "normalised": _digits(np.mean(normalised)) if normalised else None,
        "ms": _digits(np.median([row["ms"] for row in rows]), 2),
    }


def in_suites(bench: Path, work: Path, report: Callable[[str], None]) -> dict[str, Any]:
    """Ask the methods in a suite and on the benchmark's frames, and return the scorer's rows by cell and by method."""
    work.mkdir(parents=True, exist_ok=True)
    suite, again, infrared = work / "learning-again.toml", work / "learning-again", work / "bench-infrared"
    report("suite learning-again")
    suite.write_text(learning_again(), encoding="utf-8")
    hv.run(suite, again, progress=False)
    report("infrared frames of the benchmark")
    rescore(Store(bench / "frames" / "archive"), infrared, BESIDE, Filter(kind="image", scene="ir-*"), workers=2)
    return {"learning-again": {"learning-again": _by_method(_rows(again))}, "bench-infrared": _by_cell(_rows(infrared))}


def _rows(folder: Path) -> list[dict[str, Any]]:
    relation = hv.open_run(folder).rows()
    return [dict(zip(relation.columns, row, strict=True)) for row in relation.fetchall()]


def _by_cell(rows: list[dict[str, Any]]) -> dict[str, Any]:
    cells = dict.fromkeys(cell_of(row["case"]) for row in rows)
    return {cell: _by_method([row for row in rows if cell_of(row["case"]) == cell]) for cell in cells}


def _by_method(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {method: _scored([row for row in rows if row["estimator"] == method]) for method in BESIDE}


def learning_again() -> str:
    """Return the suite ``learning`` with other scenes, what is known of the place, and all methods."""
    text = shipped_path("suite", "learning").read_text(encoding="utf-8")
    text = re.sub(r"(?ms)^\[dataset\].*?(?=^\[)", "", text)
    methods = ", ".join(f'"{method}"' for method in BESIDE)
    text = re.sub(r"(?m)^name = .*$", 'name = "learning-again"', text, count=1)
    text = re.sub(r"(?m)^estimators = .*$", f"estimators = [{methods}]", text)
    text = re.sub(r"(?m)^seed = .*$", f"seed = {OTHER_SEED}", text)
    text = re.sub(r"(?m)^frames = .*$", f"frames = {SCENES}", text)
    return text.replace("\n[[cases]]", f"{PRIOR}\n[[cases]]", 1)


def _scored(rows: list[dict[str, Any]]) -> dict[str, Any]:
    claims = [row for row in rows if row["status"] == "valid"]
    due = [row for row in rows if row["expected"] == "valid" and not row["borderline"]]
    errors = np.array([row["nadir_error_arcsec"] for row in claims]) / 3600.0
    normalised = [row["nees_nadir_total"] / 2.0 for row in claims if row["nees_nadir_total"] is not None]
    ratio = [row["error_over_bound"] for row in claims if row.get("error_over_bound") is not None]
    return {
        "frames": len(rows),
        "due": len(due),
        "answered": sum(row["status"] == "valid" for row in due),
        "claims": len(claims),
        "false": sum(row["false_valid"] for row in claims),
        "crashed": sum(row["status"] == "crashed" for row in rows),
        "rms_deg": _digits(math.sqrt(np.mean(errors**2))) if claims else None,
        "normalised": _digits(np.mean(normalised)) if normalised else None,
        "over_bound": _digits(np.median(ratio)) if ratio else None,
    }


def digest_of(
    folder: Path, bench: Path, estimators: Iterable[hv.Estimator], work: Path, report: Callable[[str], None]
) -> dict[str, Any]:
    """Return the numbers of the page."""
    network, index = load(), index_of(folder)
    report("frames for test")
    return {
        "versions": _versions(),
        "dataset": {"sha256": index["sha256"], "frames": index["frames"], "test": index["splits"]["test"]["frames"]},
        "test_scenes": index["splits"]["test"]["scenes"],
        "made": network.made,
        "bytes": WEIGHTS.stat().st_size,
        "unlike": _digits(network.unlike),
        "models": {
            name: [_digits(x) for x in model.numbers()]
            for name, model in (("placed", network.placed), ("free", network.free))
        },
        "test": on_test(folder, {one.name: one for one in estimators}),
        "suites": in_suites(bench, work, report),
    }


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in ("horizonval", "horizonval-learned", "numpy", "scipy", "opencv-python-headless"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _digits(value: float, digits: int = 3) -> float:
    return float(f"{value:.{digits}g}")
