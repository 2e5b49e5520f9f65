"""Render the frames of the benchmark, run submissions on them, and score all of them, in one folder.

``frames`` is a run of the suite, ``entries/NAME`` holds the answers of a submission, ``scores.json`` and ``README.md``
the sheets and the ranking. A submission runs in a separate process and sees image, camera and prior only.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import statistics
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from horizonval.core import atomic, files
from horizonval.core.digests import content_digest
from horizonval.core.errors import UserError, command_line, excerpt
from horizonval.core.progress import Progress
from horizonval.jobs.pool import Execution
from horizonval.plugins import registry, supervisor
from horizonval.plugins.supervisor import Limits
from horizonval.scoring.row import Row
from horizonval.spec.suite import ProgramSpec
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.store.index import Filter
from horizonval.store.store import Store
from horizonval.studies.bench.frames import (
    CELLS,
    SHORTEST_PASSPHRASE,
    Group,
    bench_suite,
    cell_of,
    commitment,
    sealed_seed,
)
from horizonval.studies.bench.sheet import Answer, cells_png, ranking, sheet_of
from horizonval.suites.rescore import rescore
from horizonval.suites.run import run_suite

TITLES: dict[Group, str] = {"frames": "Methods of one image", "heads": "Methods of several heads at once"}
TIMES = "timings.json"
"""Wall-clock seconds of every image and submission, measured by the caller; they differ between runs."""
PASSPHRASE = "passphrase.json"
"""Where `bench make` found the passphrase of sealed frames, never the passphrase itself."""
LONGEST_PASSPHRASE = 4096
"""Maximum size of its file, bytes."""
MOST_CANDIDATES = 300
"""Maximum number of texts that are tried as a passphrase: 15 s."""


def make_frames(
    out: Path,
    seed: int | None,
    frames_per_cell: int,
    workers: int | None,
    progress: Progress,
    passphrase_file: Path | None = None,
) -> dict[str, Any]:
    """Render the frames of a suite, or resume; return the content of ``bench.json``.

    ``passphrase_file``: where the seed's passphrase was read. Raises ``UserError``: frames that failed, or as
    :func:`horizonval.suites.run.run_suite`.
    """
    made: dict[str, dict[str, Any]] = {}
    RunFolder(out).refuse_files_of_others(("bench.json", PASSPHRASE))
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
    if passphrase_file is not None:
        write_json(out / PASSPHRASE, {"file": str(passphrase_file.resolve())})
    return head


def run_submissions(
    out: Path, names: Sequence[str], limits: Limits, workers: int, progress: Progress, *, contained: bool = True
) -> dict[str, dict[str, str]]:
    """Run submissions on every frame, or resume; return the failed frames of each, with reasons.

    ``contained``: plug-ins and programs see neither the folder nor the network, and write nowhere. Raises
    ``UserError``: no frames, an unknown estimator, one that receives the pose, two of one name, or a passphrase of the
    frames that submissions could read.
    """
    head = _head(out)
    programs = [program.name for program in limits.programs]
    if taken := [name for name in programs if name in registry.names() or names.count(name) > 1]:
        raise UserError(
            f"the name {taken[0]!r} is another method's", where="bench run: --program", fix="choose another name"
        )
    for program in limits.programs:
        _ensure_it_starts(program, limits.folder)
    if contained:
        refuse_readable_passphrase(out, head, limits.folder)
    limits = replace(limits, hidden=hidden_of(out) if contained else ())
    for name in names:
        # Estimators that receive the pose answer every frame, so they cannot be ranked.
        if supervisor.get(name, limits).needs == "pose":
            raise UserError(
                f"{name} receives the pose", where="bench run", expected="a method of one image, or of several heads"
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


def _ensure_it_starts(program: ProgramSpec, folder: Path) -> None:
    try:
        first = shlex.split(program.command)[0]
    except (ValueError, IndexError):
        raise UserError("the command cannot be read", where=f"--program {program.name}", expected="a command") from None
    if shutil.which(folder / first if "/" in first else first) is None:
        raise UserError(
            f'"{excerpt(first)}" is no program that can be started',
            where=f"--program {program.name}",
            expected="NAME=COMMAND, the command's first word a program on the path or in a folder",
        )


def hidden_of(out: Path) -> tuple[Path, ...]:
    """Return what hides a benchmark: its folder, and whatever links in it lead to.

    Raises ``UserError``: a link to a folder that programs need.
    """
    found: dict[Path, None] = {}
    folders = [out.resolve()]
    while folders:
        folder = folders.pop()
        if folder in found:
            continue
        if any(needed.is_relative_to(folder) for needed in (Path(sys.prefix).resolve(), Path(__file__).resolve())):
            raise UserError(f"leads to {folder}, which cannot be hidden", where=str(out), expected="links to frames")
        found[folder] = None
        for place, names, files_ in os.walk(folder):
            folders += [path.resolve() for name in (*names, *files_) if (path := Path(place, name)).is_symlink()]
    return tuple(path for path in found if path.exists())


def refuse_readable_passphrase(out: Path, head: Mapping[str, Any], folder: Path) -> None:
    """Raise ``UserError`` if the passphrase of sealed frames is found where submissions could read it.

    Searched are lines and quoted words of short files where `bench make` found it, in the calling ``folder``, next to
    the benchmark, in the folders inside these two, and in the home folder. Each costs some 50 ms, so only the first
    :data:`MOST_CANDIDATES` are tried; the search does not cover other places.
    """
    if not head["sealed"]:
        return
    made_from = (read_json(out / PASSPHRASE) or {}).get("file")
    places = [Path(made_from)] if made_from else []
    for place in dict.fromkeys((folder.resolve(), out.resolve().parent, Path.home())):
        inside = _listed(place)
        places += inside
        places += [path for one in inside if one.is_dir() and place != Path.home() for path in _listed(one)]
    tried: set[str] = set()
    for path in dict.fromkeys(places):
        try:
            text = files.read_text(path, largest=LONGEST_PASSPHRASE, expected="a passphrase")
        except UserError:
            continue
        for words in (text, *text.splitlines(), *re.findall(r"[\"'](.*?)[\"']", text)):
            if words in tried or len(tried) >= MOST_CANDIDATES or len(words.strip()) < SHORTEST_PASSPHRASE:
                continue
            tried.add(words)
            if commitment(sealed_seed(words)) == head["commitment"]:
                raise UserError(
                    "holds the passphrase of these frames, and submissions could read it",
                    where=str(path),
                    fix="take it off this machine before `bench run`",
                )


def _listed(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


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
        "Score: 100 is the bound on every frame that is due, 0 is no answer, a false claim costs a frame.",
        "Methods of one rank cannot be distinguished on these frames.",
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
