r"""A design study by information alone: the bound of every design on the frames of its study, no estimator run.

For a design with the bounds ``b`` of its frames, root mean squares of an error in two directions, an unbiased method
that reaches them is within ``e`` in the share::

    within = mean over all frames of (1 - exp(-e^2 / b^2)),      0 where the image does not determine the nadir

(the error is Rayleigh distributed where both directions are known alike; where one is known worse, as of an arc, a few
per cent less for ``e`` about ``b``). It is the best that the design can do, with what its scenes say is known; a design
that misses the requirement here misses it with any method, and one that meets it waits for the method that does.

The bound changes little from frame to frame: a dozen conditions tell what hundreds of trials do. Of a camera with
several heads each image counts by itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Outcome
from horizonval.core.progress import Progress, Silent
from horizonval.jobs.engine import do
from horizonval.jobs.pool import Execution
from horizonval.spec.load import Case
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.store.verify import amend_manifest
from horizonval.studies.information.work import InformationWork
from horizonval.studies.trade.conclude import RESULT
from horizonval.studies.trade.design import Study
from horizonval.studies.trade.run import study_in

FILE = "study-information.json"
FOLDER = "information"
SCHEMA = 1


def run_information(
    path_or_name: str | Path,
    out_dir: Path,
    *,
    execution: Execution | None = None,
    progress: Progress | None = None,
    frames: int | None = None,
) -> JsonObject:
    """Work out what the frames of a study allow, or finish what an earlier call left; only new frames are made.

    Parameters
    ----------
    path_or_name : str or Path
        A study file, or the name of a shipped study.
    out_dir : Path
        May be the folder of the study itself: its trial then stands beside the bounds.
    execution : Execution, optional
    progress : Progress, optional
    frames : int, optional
        Conditions in place of the file's number.

    Returns
    -------
    dict
        Also written to ``study-information.json``: ``study``, ``conditions``, ``failed`` by frame, and ``designs``:
        ``name``, ``settings``, ``camera``, ``n``, ``due`` (frames that a method should answer), ``noise_arcsec`` and
        ``bound_arcsec`` (``{median, rms, p95, n}`` over the frames that determine the nadir), ``within`` and
        ``within_by_noise`` (shares of all frames), and ``trial``: by estimator
        ``{rms_deg, within, n}`` of a finished study in the folder.

    Raises
    ------
    UserError
        A mistake in the study, told before anything is rendered; nothing on this machine can render.
    """
    study = study_in(path_or_name, out_dir, frames)
    cases = _cases(study)
    folder = RunFolder(out_dir)
    out_dir.mkdir(parents=True, exist_ok=True)
    with folder.locked():
        work = InformationWork(out_dir / FOLDER)
        done = do(work, list(cases.values()), execution or Execution(), progress or Silent(), unit="frames")
    found = {name: one.result for name, one in done.items() if one.result is not None}
    result = {
        "schema": SCHEMA,
        "study": study.spec.study.model_dump(mode="json"),
        "conditions": len(study.conditions),
        "failed": {name: one.error for name, one in done.items() if one.error is not None},
        "designs": _designs(study, cases, found, read_json(out_dir / RESULT) if (out_dir / RESULT).exists() else None),
    }
    write_json(out_dir / FILE, result)
    amend_manifest(out_dir, [out_dir / FILE])
    return result


def _cases(study: Study) -> dict[tuple[str, str, str | None], Case]:
    """Return one case for every entry, condition and head: batches of estimators look at the same frames."""
    cases: dict[tuple[str, str, str | None], Case] = {}
    for case in study.suite.cases:
        cases.setdefault((*study.frames[case.name], case.scene.camera.head), case)
    return cases


def _designs(
    study: Study,
    cases: Mapping[tuple[str, str, str | None], Case],
    found: Mapping[str, Mapping[str, Any]],
    trial: JsonObject | None,
) -> list[JsonObject]:
    limit_arcsec = 3600.0 * study.spec.study.requirement.error_deg
    by_entry: dict[str, list[Mapping[str, Any]]] = {}
    for (entry, _, _), case in cases.items():
        if case.name in found:
            by_entry.setdefault(entry, []).extend(found[case.name]["bands"].values())
    tried: dict[str, JsonObject] = {}
    for one in [] if trial is None else trial["designs"]:
        tried.setdefault(one["frames"], {})[one["estimator"]] = {
            "rms_deg": one["rms_deg"]["value"],
            "within": one["within"]["rate"],
            "n": one["n"],
        }
    designs: dict[str, JsonObject] = {}
    for design in study.designs:
        records = by_entry.get(design.frames, [])
        due = [record for record in records if record["expected"] == Outcome.VALID]
        designs.setdefault(
            design.frames,
            {
                "name": design.frames,
                "settings": {key: value for key, value in design.settings.items() if key != "estimator"},
                "camera": design.camera,
                "pixels": design.width * design.height * design.heads,
                "n": len(records),
                "due": len(due),
                "noise_arcsec": _spread(records, "noise_arcsec"),
                "bound_arcsec": _spread(records, "bound_arcsec"),
                "within": _within(records, "bound_arcsec", limit_arcsec, len(records)),
                "within_by_noise": _within(records, "noise_arcsec", limit_arcsec, len(records)),
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


def _within(records: Sequence[Mapping[str, Any]], key: str, limit_arcsec: float, n: int) -> float | None:
    if n == 0:
        return None
    known = [float(record[key]) for record in records if record[key] is not None]
    return math.fsum(1.0 - math.exp(-((limit_arcsec / bound) ** 2)) for bound in known) / n


def information_lines(result: JsonObject) -> list[str]:
    """Return a table of the designs, a line each, as printed."""
    limit = result["study"]["requirement"]["error_deg"]
    head = ("design", "frames", "due", "by noise [deg]", "bound [deg]", f"within {limit:g} deg", "trial")
    rows: list[tuple[str, ...]] = [head]
    for d in result["designs"]:
        trial = ", ".join(
            f"{name} {_degrees(one['rms_deg'])} rms, {_share(one['within'])}" for name, one in d["trial"].items()
        )
        noise, bound = (d[key]["median"] for key in ("noise_arcsec", "bound_arcsec"))
        degrees = tuple(_degrees(None if value is None else value / 3600.0) for value in (noise, bound))
        rows.append((d["name"], str(d["n"]), str(d["due"]), *degrees, _share(d["within"]), trial))
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _degrees(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.1f} %"
