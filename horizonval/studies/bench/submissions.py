"""Render the frames of the benchmark, run submissions on them, and score all of them, in one folder.

``frames`` is a run of the suite, ``entries/NAME`` holds the answers of a submission, ``scores.json`` and ``README.md``
the sheets and the ranking. A submission runs in a separate process and sees image, camera and prior only.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from horizonval.core import atomic
from horizonval.core.digests import content_digest
from horizonval.core.errors import UserError, command_line
from horizonval.core.progress import Progress
from horizonval.jobs.pool import Execution
from horizonval.plugins import supervisor
from horizonval.plugins.supervisor import Limits
from horizonval.scoring.row import Row
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.store.index import Filter
from horizonval.store.store import Store
from horizonval.studies.bench.frames import CELLS, Group, bench_suite, cell_of, commitment
from horizonval.studies.bench.sheet import Answer, cells_png, ranking, sheet_of
from horizonval.suites.rescore import rescore
from horizonval.suites.run import run_suite

TITLES: dict[Group, str] = {"frames": "Methods of one image", "heads": "Methods of several heads at once"}
TIMES = "timings.json"
"""Wall-clock seconds of every image and submission, measured by the caller; they differ between runs."""


def make_frames(
    out: Path, seed: int | None, frames_per_cell: int, workers: int | None, progress: Progress
) -> dict[str, Any]:
    """Render the frames of a suite, or resume; return the content of ``bench.json``.

    Raises ``UserError``: frames that failed, or as :func:`horizonval.suites.run.run_suite`.
    """
    made: dict[str, dict[str, Any]] = {}
    for group in CELLS:
        suite = bench_suite(seed, frames_per_cell, group)
        done = run_suite(suite, out / group, progress=progress, execution=Execution(workers))
        if done.failed:
            name, why = next(iter(done.failed.items()))
            raise UserError(f"{len(done.failed)} frames failed, the first {name}: {why}", where=str(out / group))
        images = Store(out / group / "archive").index.select(Filter(kind="image"))
        made[group] = {
            # Bands are separate images; the heads of a scene are estimated together.
            "questions": len({image.scene for image in images}) if group == "heads" else len(images),
            "images": len(images),
            "images_sha256": content_digest(sorted(image.address for image in images)),
        }
    # No seed of a sealed suite: readers of a competition's folder must not reproduce its frames.
    head = {
        "bench": 1,
        "sealed": seed is not None,
        "commitment": commitment(suite.seed),
        "frames_per_cell": frames_per_cell,
        **made,
    }
    write_json(out / "bench.json", head)
    return head


def run_submissions(
    out: Path, names: Sequence[str], limits: Limits, workers: int, progress: Progress, *, contained: bool = True
) -> dict[str, dict[str, str]]:
    """Run submissions on every frame, or resume; return the failed frames of each, with reasons.

    ``contained``: plug-ins and programs see neither the folder nor the network. Raises ``UserError``: no frames, an
    unknown estimator, or one that receives the pose.
    """
    _head(out)
    limits = replace(limits, hidden=(out.resolve(),) if contained else ())
    for name in names:
        # Estimators that receive the pose answer every frame, so they cannot be ranked.
        if supervisor.get(name, limits).needs == "pose":
            raise UserError(
                f"{name} is told the pose", where="bench run", expected="a method of one image, or of several heads"
            )
    failed = {}
    for name in names:
        group = "heads" if supervisor.get(name, limits).needs == "heads" else "frames"
        store = Store(out / group / "archive")
        done = rescore(store, out / "entries" / name, (name,), None, workers, limits, progress)
        failed[name] = done.failed
        seconds = read_json(out / TIMES) or {}
        now = {image: stages[f"estimate {name}"] for image, stages in done.seconds.items()}
        write_json(out / TIMES, {**seconds, name: {**seconds.get(name, {}), **now}})
    return failed


def score_submissions(out: Path) -> dict[str, Any]:
    """Score all answers; write the page and ``scores.json``, and return the content of the latter.

    Raises ``UserError``: no frames, no answers, or an unfinished entry.
    """
    head = _head(out)
    methods = {path.name: _answers(path) for path in sorted((out / "entries").glob("*"))}
    if not methods:
        raise UserError("no answers to score", where=str(out), fix="run a submission first")
    groups: dict[str, dict[str, list[Answer]]] = {group: {} for group in CELLS}
    for name, (group, answers) in methods.items():
        if len(answers) != head[group]["questions"]:
            what = f"has {len(answers)} of {head[group]['questions']} answers"
            raise UserError(what, where=str(out / "entries" / name), fix="run the submission again")
        groups[group][name] = answers
    scores = {
        "frames": head,
        "rankings": {group: ranking(entered) for group, entered in groups.items() if entered},
        "sheets": {name: sheet_of(answers) for name, (_, answers) in methods.items()},
        "median_s": {name: statistics.median(times.values()) for name, times in _times(out).items() if times},
    }
    write_json(out / "scores.json", scores)
    atomic.write_text(out / "README.md", page(scores))
    for name, ranked in scores["rankings"].items():
        atomic.write_bytes(out / f"{name}.png", cells_png(ranked, scores["sheets"]))
    return scores


def page(scores: dict[str, Any]) -> str:
    """Return the ranking as Markdown."""
    head = scores["frames"]
    kind = f"sealed, commitment `{head['commitment']}`" if head["sealed"] else "public"
    lines = [
        "# Ranking of horizon sensing",
        "",
        f"Frames: {kind}; {head['frames_per_cell']} of each cell.",
        "",
        "Score: 100 is the bound on every frame that is due, 0 is silence, a false claim costs a frame.",
        "Methods of one rank cannot be told apart on these frames.",
        "",
        "Time is that of the clock for the median image, on the machine of this page; it is not scored.",
    ]
    for group, ranked in scores["rankings"].items():
        lines += ["", *_table(TITLES[group], head[group], ranked, scores), ""]
        lines += [f"![Scores of methods by cells]({group}.png)"]
    return "\n".join(lines) + "\n"


def _table(title: str, about: Mapping[str, Any], ranked: Sequence[dict[str, Any]], scores: dict[str, Any]) -> list[str]:
    lines = [
        f"## {title}",
        "",
        f"{about['images']} images, digest `{about['images_sha256']}`.",
        "",
        "| rank | method | score | answered, of due | false, of claims | median / bound | 95 % [deg] | NEES | ms |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in ranked:
        f = scores["sheets"][row["method"]]["all"]
        p95 = None if f["p95_error_arcsec"] is None else f["p95_error_arcsec"] / 3600.0
        lines.append(
            f"| {row['rank']}{' =' if row['tied'] else ''} | `{row['method']}` | {row['score']:.1f} "
            f"| {f['answered']} of {f['due']} | {f['false']} of {f['claims']} "
            f"| {_number(f['median_over_bound'])} | {_number(p95)} | {_number(f['mean_nees'])} "
            f"| {_number(_milliseconds(scores['median_s'].get(row['method'])))} |"
        )
    return lines


def _times(out: Path) -> dict[str, dict[str, float]]:
    return dict(read_json(out / TIMES) or {})


def _milliseconds(seconds: float | None) -> float | None:
    return None if seconds is None else 1e3 * seconds


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _head(out: Path) -> dict[str, Any]:
    head = read_json(out / "bench.json")
    if head is None:
        raise UserError("no frames of a benchmark", where=str(out), fix=command_line("bench", "make", "--out", out))
    return dict(head)


def _answers(entry: Path) -> tuple[Group, list[Answer]]:
    """Return the answers of a submission, and their group of frames."""
    folder = RunFolder(entry)
    head = read_json(folder.suite) or {}
    group: Group = "heads" if "heads/" in str(head.get("archive", "")) else "frames"
    rows = []
    for path in sorted(folder.cases.glob("*.json")):
        record = read_json(path) or {}
        rows += [Row.from_dict(row) for row in record.get("rows", ())]
    return group, [
        Answer(
            cell=cell_of(row.case),
            frame=f"{row.case}/{row.band}",
            due=row.is_due,
            claimed=row.is_claim,
            error_arcsec=row.nadir_error_arcsec,
            sigma_arcsec=row.sigma_total_arcsec,
            bound_arcsec=row.bound_arcsec,
            nees=row.nees_nadir_total,
        )
        for row in rows
    ]
