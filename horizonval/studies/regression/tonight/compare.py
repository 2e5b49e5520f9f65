"""A night beside its baselines: the estimate of every gate, and what has changed where."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from horizonval.core.json_types import JsonObject
from horizonval.studies.regression.baseline.baseline import Baseline, frames_of
from horizonval.studies.regression.bench import arrays_of
from horizonval.studies.regression.images import compare_images
from horizonval.studies.regression.statistics.gates import GateInputs, Measured, changed, measure, pairs_of
from horizonval.studies.regression.statistics.judge import judge
from horizonval.studies.regression.tonight.gathered import Gathered

MOST_CHANGES = 200
"""Changed scenes written into the verdict; the count is always that of all."""


def compare(
    night: Gathered, release: Baseline | None, reference: GateInputs | None
) -> tuple[list[JsonObject], list[JsonObject]]:
    comparisons: list[JsonObject] = []
    measured: list[tuple[str, Measured]] = []
    bases = [("accepted", night.accepted), ("release", release)]
    for name, base in bases:
        if base is None:
            continue
        if name == "release" and night.accepted is not None and _is_same(base, night.accepted):
            comparisons.append({"name": name, "baseline": base.label, "same_as_accepted": True, "changed": []})
            continue
        about, found = _against(night, name, base, reference if name == "accepted" else None)
        comparisons.append(about)
        measured += [(name, one) for one in found]
    gates = judge(measured, looks=night.spec.most_batches)
    return comparisons, gates


def _against(
    night: Gathered, name: str, base: Baseline, reference: GateInputs | None
) -> tuple[JsonObject, list[Measured]]:
    images = _images(night, base)
    now = GateInputs(night.replayed, images, night.fresh, night.wanted.night)
    whole = replace(now, rows=night.all_rows())
    theirs = (
        base.results
        if reference is None
        else replace(base.results, fresh=reference.fresh, fresh_night=reference.fresh_night)
    )
    found = []
    for gate in night.spec.gate:
        if gate.lane not in night.wanted.lanes:
            continue
        # The release's own detector images are not kept: what is compared with it is the whole chain.
        whole_chain = gate.lane == "rerender" or name == "release"
        mine = whole if whole_chain and (gate.lane != "replay" or "rerender" in night.wanted.lanes) else now
        found.append(measure(gate, mine, theirs))
    replay_pairs = pairs_of(night.replayed if name == "accepted" else (), base.results.rows)
    moved = changed(replay_pairs)
    other = [
        {"scene": scene, "band": band, **{key: value for key, value in image.items() if key != "table"}}
        for (scene, band), image in images.items()
        if not image["same_radiance"] or image["same_images"] < image["n_images"]
    ]
    about = {
        "name": name,
        "baseline": base.label,
        "reason": base.head["reason"],
        "environment": base.head["environment"],
        "same_as_accepted": False,
        "replayed": len(replay_pairs),
        "n_changed": len(moved),
        "changed": moved[:MOST_CHANGES],
        "rendered": len(images),
        "n_images_changed": len(other),
        "images_changed": other[:MOST_CHANGES],
        "missing_scenes": sorted(set(base.scenes) - set(night.scenes)) if "rerender" in night.wanted.lanes else [],
    }
    return about, found


def _images(night: Gathered, base: Baseline) -> dict[tuple[str, str], JsonObject]:
    frames = frames_of(base.images)
    found = {}
    for scene, record in night.scenes.items():
        before = base.scenes.get(scene)
        for band, now in record["bands"].items():
            if before is None or band not in before["bands"]:
                continue
            old = before["bands"][band]
            radiance = None
            if now["radiance_sha256"] != old["radiance_sha256"]:
                radiance = arrays_of(Path(night.arrays[scene]), scene)[f"radiance.{band}"]
            found[scene, band] = compare_images(record["table"], now, old, radiance, frames.get((scene, band)))
    return found


def _is_same(a: Baseline, b: Baseline) -> bool:
    return bool(a.head["night"] == b.head["night"] and a.head["version"] == b.head["version"]) and (
        a.results.rows == b.results.rows
    )
