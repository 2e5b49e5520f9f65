"""Accept a night as the baseline: never automatic, always with a reason and a table of the changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import atomic, files
from horizonval.core.errors import DamagedFileError, UserError, excerpt
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Outcome
from horizonval.spec.suite import RegressionSpec
from horizonval.store.folder import read_json
from horizonval.studies.regression.baseline import (
    Baseline,
    FrozenFrame,
    FrozenImage,
    Pack,
    accepting,
    baseline_at,
    copy_as_release,
    finish_acceptance,
    pack_path,
    read_pack,
    release_path,
    write_baseline,
)
from horizonval.studies.regression.gates import GateInputs, group_of, judge_rows
from horizonval.studies.regression.night import LANES, PUBLISHED, WORK, read_night
from horizonval.studies.regression.partners import Group, cameras_of, pairs_of
from horizonval.studies.regression.row import ReplicateRow, summary_of
from horizonval.studies.regression.statistics import Verdict
from horizonval.studies.regression.units import arrays_of
from horizonval.studies.regression.words import by_subject, figure, subject, subject_sentence

SHORTEST_REASON = 10
NEARLY_ALL = 0.9
"""Share of false claims or crashes from which a method can hardly get worse."""
MOST_REASONS = 50


def accept(run: Path, baseline: Path, reason: str, *, release: bool = False, yes: bool = False) -> list[Path]:
    """Make the results of a night the accepted baseline, and with ``release`` the last release's; return the written
    files.

    ``run``: folder of the night. ``baseline``: JSON file, with images and table of differences in the same folder.
    ``reason``: stored with the baseline. ``yes``: accept methods that claim falsely or crash in nearly every image.
    Raises ``UserError``: no proper reason; missing lanes or failed units; such a method.
    """
    if len(reason.split()) < 2 or len(reason.strip()) < SHORTEST_REASON:
        raise UserError(f"found {reason!r}", where="--reason", expected="a sentence that a reviewer can judge")
    night = read_night(run)
    missing_lanes = [lane for lane in LANES if lane not in ("replay", PUBLISHED) and lane not in night["lanes"]]
    if missing_lanes:
        raise UserError(f"lane {missing_lanes[0]} was left out", where=str(run), fix="run the night with all lanes")
    if night["failed"]:
        name, error = next(iter(night["failed"].items()))
        raise UserError(f"{len(night['failed'])} units failed; {name}: {error}", where=str(run))
    finish_acceptance(baseline)
    before = baseline_at(baseline, night["suite"])
    of_release = None if before is None else baseline_at(release_path(baseline), night["suite"])
    results = GateInputs(rows=night["rows"], fresh=night["fresh"], fresh_night=night["night"])
    scenes = {
        name: {"table": record["table"], "camera": record["camera"], "bands": record["bands"]}
        for name, record in night["scenes"].items()
    }
    useless = useless_methods(results.rows, cameras_of(scenes, night["together"]))
    if useless and not yes:
        raise UserError(
            "; ".join(useless),
            where=str(run),
            expected="a baseline with which a method can get worse",
            fix="--yes accepts it all the same",
        )
    past = [] if before is None else [_line(before.head), *before.head["past"]][:MOST_REASONS]
    spec = RegressionSpec(replicates=night["replicates"], gate=night["gates"])
    head = {
        "suite": night["suite"],
        "night": night["night"],
        "version": night["environment"]["version"],
        "environment": night["environment"],
        "accepted_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "reason": " ".join(reason.split()),
        "replicates": night["replicates"],
        "gates": night["gates"],
        "covers": [
            *useless,
            *covered(spec, before, results),
            *covered(spec, of_release, results, "release"),
            *_covered_images(run),
        ],
        "past": past,
    }
    pack = _pack(run, night)
    with accepting(baseline) as folder:
        staged = folder / baseline.name
        write_baseline(staged, head, results, scenes, pack, night["together"])
        read_pack(pack_path(staged))
        atomic.write_text(staged.with_suffix(".md"), difference_table(before, results, scenes, head))
        written = [baseline, pack_path(baseline), baseline.with_suffix(".md")]
        if release:
            made = copy_as_release(staged)
            written += [baseline.with_name(path.name) for path in (made, pack_path(made))]
    return written


def useless_methods(rows: Sequence[ReplicateRow], cameras: Mapping[str, str]) -> list[str]:
    """Return sentences about methods, by table, camera and band, that claim falsely or crash in nearly every image."""
    groups: dict[Group, list[ReplicateRow]] = {}
    for row in rows:
        groups.setdefault(group_of(row, cameras), []).append(row)
    found = []
    for group, own in sorted(groups.items()):
        for what, bad in (
            ("claims falsely", sum(row.false_valid for row in own)),
            ("crashes", sum(row.status == Outcome.CRASHED for row in own)),
        ):
            if bad >= NEARLY_ALL * len(own):
                found.append(f"{subject(group._asdict())} {what} in {bad} of {len(own)} images")
    return found


def covered(spec: RegressionSpec, before: Baseline | None, now: GateInputs, against: str = "accepted") -> list[str]:
    """Return sentences about the changes beyond their margins that an acceptance covers."""
    if before is None:
        return []
    cameras = cameras_of(before.scenes, before.together)
    known = {row.key for row in now.rows}
    gone: dict[str, int] = {}
    for row in before.results.rows if against == "accepted" else ():
        if row.key not in known:
            name = subject(group_of(row, cameras)._asdict())
            gone[name] = gone.get(name, 0) + 1
    gates = judge_rows(spec, "replay", pairs_of(now.rows, before.results.rows), cameras, against)
    found = [
        f"{verdict}: {subject_sentence(first, deciding, lane=False)}"
        for first, verdict, deciding in by_subject(gates)
        if verdict in (Verdict.FAIL, Verdict.IMPROVED)
    ]
    return [f"no longer compared: {name}, {count} answers" for name, count in gone.items()] + found


def _covered_images(run: Path) -> list[str]:
    """Return the sentences of a night's verdict about images that changed beyond their margins."""
    gates = [gate for gate in (read_json(run / "verdict.json") or {"gates": []})["gates"] if not gate["estimator"]]
    return [
        f"{verdict}: {subject_sentence(first, deciding, lane=False)}"
        for first, verdict, deciding in by_subject(gates)
        if verdict == Verdict.FAIL
    ]


def difference_table(
    before: Baseline | None, now: GateInputs, scenes: Mapping[str, Any], head: Mapping[str, Any]
) -> str:
    """Return the changes by a new baseline as Markdown."""
    lines = [
        f"# Accepted baseline of suite {head['suite']}",
        "",
        f"Night {head['night']}, version {head['version']}, accepted {head['accepted_utc']}.",
        "",
        f"Reason: {head['reason']}",
        "",
        "What the acceptance covers, beyond the margins:"
        if head["covers"]
        else "Nothing that was compared changed beyond its margin.",
        "",
        *(f"- {one}" for one in head["covers"]),
        *([""] if head["covers"] else []),
    ]
    if before is None:
        lines += ["There was no baseline before.", ""]
    else:
        same, total = _same_images(before, scenes)
        lines += [
            f"Before it: night {before.head['night']}, version {before.head['version']}. "
            f"{same} of {total} detector images are the same, bit by bit.",
            "",
        ]
    lines += [
        "Before and after, on the same scenes and noise seeds; availability among the images that clearly should give "
        "an attitude, errors where both claim one.",
        "",
        "| estimator | scenes | images | available [%] | false claims [%] | median nadir error [arcsec] "
        "| 95 % below [arcsec] | median error over bound | changed outcomes |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    old_rows: Sequence[ReplicateRow] = () if before is None else before.results.rows
    for estimator in sorted({row.estimator for row in now.rows}):
        for table in sorted({row.table for row in now.rows}):
            mine = _those(now.rows, estimator, table)
            theirs = _those(old_rows, estimator, table)
            if mine or theirs:
                lines.append(_table_row(estimator, table, mine, theirs))
    if before is not None:
        lines += ["", *_removed(before, scenes)]
    if head["past"]:
        lines += ["", "## Earlier baselines", ""]
        lines += [
            f"- {one['accepted_utc']}, night {one['night']}, {one['version']}: {one['reason']}" for one in head["past"]
        ]
    return "\n".join(lines).rstrip() + "\n"


def _those(rows: Sequence[ReplicateRow], estimator: str, table: str) -> list[ReplicateRow]:
    return [row for row in rows if row.estimator == estimator and row.table == table]


def _table_row(estimator: str, table: str, now: list[ReplicateRow], base: list[ReplicateRow]) -> str:
    pairs = pairs_of(now, base)
    changes = sum(a.status != b.status for a, b in pairs)
    common = [
        (a.nadir_error_arcsec, b.nadir_error_arcsec)
        for a, b in pairs
        if a.nadir_error_arcsec is not None and b.nadir_error_arcsec is not None
    ]
    after = [a for a, _ in common] if base else [r.nadir_error_arcsec for r in now if r.nadir_error_arcsec is not None]
    earlier = [b for _, b in common]

    def both(old: float | None, new: float | None) -> str:
        return " → ".join(figure(value) for value in ([old] if base else []) + [new])

    def shown(name: str) -> str:
        old, new = (summary_of(rows).get(name, (None,))[0] for rows in (base, now))
        return both(old, new)

    def percentile(share: float) -> str:
        old, new = (float(np.percentile(values, share)) if values else None for values in (earlier, after))
        return both(old, new)

    cells = [estimator, table, len(now), shown("availability"), shown("false claims"), percentile(50), percentile(95)]
    cells += [shown("median error over bound"), f"{changes} of {len(pairs)}" if base else "–"]
    return f"| {' | '.join(map(str, cells))} |"


def _same_images(before: Baseline, scenes: Mapping[str, Any]) -> tuple[int, int]:
    same = total = 0
    for scene, record in scenes.items():
        for band, about in record["bands"].items():
            old = before.scenes.get(scene, {}).get("bands", {}).get(band, {}).get("images", [])
            total += len(about["images"])
            same += sum(a == b for a, b in zip(about["images"], old, strict=False))
    return same, total


def _removed(before: Baseline, scenes: Mapping[str, Any]) -> list[str]:
    gone, new = sorted(set(before.scenes) - set(scenes)), sorted(set(scenes) - set(before.scenes))
    lines = []
    if gone:
        lines.append(f"Scenes that are no longer there: {', '.join(gone)}.")
    if new:
        lines.append(f"New scenes: {', '.join(new)}.")
    return lines


def _line(head: Mapping[str, Any]) -> JsonObject:
    return {key: head[key] for key in ("night", "version", "accepted_utc", "reason")}


def _pack(run: Path, night: Mapping[str, Any]) -> Pack:
    """Return the frozen images and frames of a night, from the files of its units."""
    images, frames, truths = [], [], {}
    for scene, record in sorted(night["scenes"].items()):
        name = night["arrays"][scene]
        if not files.is_name(name):
            raise DamagedFileError(f"names {excerpt(str(name))!r}", where=str(run), expected="a file of the night")
        path = run / WORK / name
        if not path.is_file():
            raise UserError("no such file", where=str(path), fix="run the night again; its working files are gone")
        arrays = arrays_of(path, scene)
        truths[scene] = record["truth"]
        for band, about in record["bands"].items():
            radiance = arrays[f"radiance.{band}"].astype(np.float64)
            frames.append(FrozenFrame(scene, band, about["radiance_sha256"], radiance, arrays["regions"]))
            of_images = zip(about["images"], about["radiance_per_dn"], strict=True)
            for replicate, (sha, radiance_per_dn) in enumerate(of_images):
                dn = arrays[f"dn.{band}.{replicate}"]
                image = FrozenImage(scene, band, replicate, about["full_scale"], dn, radiance_per_dn)
                if image.sha256 != sha:
                    raise DamagedFileError(f"the image {scene} {band} {replicate} has changed", where=str(path))
                images.append(image)
    return Pack(tuple(images), tuple(frames), truths)
