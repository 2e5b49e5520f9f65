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
from horizonval.store.folder import read_json
from horizonval.studies.regression.baseline import (
    Baseline,
    FrozenFrame,
    FrozenImage,
    Pack,
    copy_as_release,
    pack_path,
    read_baseline,
    write_baseline,
)
from horizonval.studies.regression.gates import GateInputs, figure, pairs_of
from horizonval.studies.regression.night import LANES, NIGHT_SCHEMA, PUBLISHED, WORK
from horizonval.studies.regression.row import ReplicateRow, summary_of
from horizonval.studies.regression.units import arrays_of

SHORTEST_REASON = 10
MOST_REASONS = 50


def accept(run: Path, baseline: Path, reason: str, *, release: bool = False) -> list[Path]:
    """Make the results of a night the accepted baseline, and with ``release`` the last release's; return the written
    files.

    ``run``: folder of the night. ``baseline``: JSON file, with images and table of differences in the same folder.
    ``reason``: stored with the baseline. Raises ``UserError``: no proper reason; missing lanes or failed units.
    """
    if len(reason.split()) < 2 or len(reason.strip()) < SHORTEST_REASON:
        raise UserError(f"found {reason!r}", where="--reason", expected="a sentence that a reviewer can judge")
    night = read_json(run / "night.json")
    if night is None or night.get("schema") != NIGHT_SCHEMA:
        raise UserError("no night.json of this version", where=str(run), expected="the folder of `horizonval regress`")
    missing = [lane for lane in LANES if lane not in ("replay", PUBLISHED) and lane not in night["lanes"]]
    if missing:
        raise UserError(f"lane {missing[0]} was left out", where=str(run), fix="run the night with all lanes")
    if night["failed"]:
        name, error = next(iter(night["failed"].items()))
        raise UserError(f"{len(night['failed'])} units failed; {name}: {error}", where=str(run))
    before = read_baseline(baseline, night["suite"]) if baseline.is_file() else None
    rows, fresh = ([ReplicateRow.from_dict(row) for row in night[key]] for key in ("rows", "fresh"))
    results = GateInputs(rows=rows, fresh=fresh, fresh_night=night["night"])
    now = datetime.now(UTC).isoformat(timespec="seconds")
    past = [] if before is None else [_line(before.head), *before.head["past"]][:MOST_REASONS]
    head = {
        "suite": night["suite"],
        "night": night["night"],
        "version": night["environment"]["version"],
        "environment": night["environment"],
        "accepted_utc": now,
        "reason": " ".join(reason.split()),
        "replicates": night["replicates"],
        "gates": night["gates"],
        "past": past,
    }
    scenes = {
        name: {"table": record["table"], "camera": record["camera"], "bands": record["bands"]}
        for name, record in night["scenes"].items()
    }
    pack = _pack(run, night)
    table = difference_table(before, results, scenes, head)
    write_baseline(baseline, head, results, scenes, pack, night["together"])
    page = baseline.with_suffix(".md")
    atomic.write_text(page, table)
    written = [baseline, pack_path(baseline), page]
    if release:
        made = copy_as_release(baseline)
        written += [made, pack_path(made)]
    return written


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
