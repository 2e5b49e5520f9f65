"""What a run of the rivals' suite says, by table of the suite and by method: the page's numbers and nothing else."""

from __future__ import annotations

import json
import math
import platform
import re
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from scipy import stats

import horizonval as hv

PACKAGES = ("horizonval", "bsk", "bsk-opnav", "scikit-image", "opencv-python-headless", "numpy")
TABLES = ("hard-visible", "air-visible", "clouds-visible", "hard-infrared", "air-infrared", "nothing")


def digest_of(run: hv.Run, methods: list[str], left_out: list[str]) -> dict[str, Any]:
    """Return the page's numbers: versions, and for every table and method errors, claims and processor time.

    Angles are in degrees, times in milliseconds.
    """
    relation = run.rows()
    rows = [dict(zip(relation.columns, row, strict=True)) for row in relation.fetchall()]
    seconds = json.loads((run.out / "timings.json").read_text(encoding="utf-8"))["cases"]
    for row in rows:
        row["table"] = next(table for table in TABLES if row["case"].startswith(table))
        row["place"] = _place(row["case"])
        row["processor_s"] = seconds.get(row["case"], {}).get(f"processor {row['estimator']}")
    groups = {
        table: {
            method: _group([row for row in rows if (row["table"], row["estimator"]) == (table, method)])
            for method in methods
        }
        for table in TABLES
    }
    return {"versions": _versions(), "left_out": left_out, "methods": methods, "groups": groups}


def _place(case: str) -> str:
    found = re.search(r"\d+km", case)
    return found.group() if found else case


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _group(rows: list[dict[str, Any]]) -> dict[str, Any]:
    claims = [row for row in rows if row["status"] == "valid"]
    due = [row for row in rows if row["expected"] == "valid" and not row["borderline"]]
    errors = np.array([row["nadir_error_arcsec"] for row in claims]) / 3600.0
    nees = [row["nees_nadir_total"] for row in claims if row["nees_nadir_total"] is not None]
    tilts = (
        np.array([[row["roll_error_arcsec"], row["pitch_error_arcsec"]] for row in claims], dtype=np.float64) / 3600.0
    )
    times = [row["processor_s"] for row in rows if row["processor_s"] is not None]
    return {
        "frames": len(rows),
        "due": len(due),
        "answered": sum(row["status"] == "valid" for row in due),
        "claims": len(claims),
        "false": sum(row["false_valid"] for row in claims),
        "without_sigma": sum(row["without_sigma"] for row in claims),
        "crashed": sum(row["status"] == "crashed" for row in rows),
        "median_deg": _digits(np.median(errors)) if claims else None,
        "p95_deg": _digits(np.percentile(errors, 95)) if claims else None,
        "rms_deg": _digits(math.sqrt(np.mean(errors**2))) if claims else None,
        "bias_deg": _digits(np.hypot(*np.nanmean(tilts, axis=0))) if len(claims) > 1 else None,
        "nees": _digits(np.mean(nees)) if nees else None,
        "nees_interval": [_digits(x / len(nees)) for x in stats.chi2.interval(0.95, 2 * len(nees))] if nees else None,
        "processor_ms": _digits(1e3 * np.median(times), 2) if times else None,
        "errors_deg": {
            place: [_digits(row["nadir_error_arcsec"] / 3600.0) for row in claims if row["place"] == place]
            for place in sorted({row["place"] for row in rows})
        },
    }


def _digits(value: float, digits: int = 3) -> float:
    return float(f"{value:.{digits}g}")
