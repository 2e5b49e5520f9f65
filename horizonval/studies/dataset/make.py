"""Make a data set or resume: the list of seeds, its shards, and an index."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from horizonval.core import atomic
from horizonval.core.code import code_digest
from horizonval.core.digests import content_digest
from horizonval.core.errors import UserError
from horizonval.core.progress import Progress
from horizonval.jobs.engine import do
from horizonval.jobs.pool import Execution
from horizonval.spec.load import Suite
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.studies.dataset.scenes import (
    CODE,
    LIST_NAME,
    SPLITS,
    LearningScene,
    SeedList,
    refuse_wrong_attitudes,
    scenes_of,
    shards_of,
    suite_from,
)
from horizonval.studies.dataset.shards import COLUMNS, Drawing, Shard, ShardWork, refuse_missing_library
from horizonval.suites.mistakes import refuse_mistakes
from horizonval.suites.plan import plan_of
from horizonval.suites.worker_memory import within_memory

INDEX_NAME = "dataset.json"


def make_dataset(seeds: SeedList, out: Path, execution: Execution, progress: Progress) -> dict[str, Any]:
    """Make a data set from its list, or resume; return the content of ``dataset.json``.

    The folder gets ``seeds.json``, the shards, ``dataset.json`` with their digests, ``state`` with a record of every
    shard, and ``suite`` with the texts of the list. With ``execution.shard`` no index is written. Raises ``UserError``:
    a mistake in the suite, another data set in the folder, a missing library, or failed frames.
    """
    refuse_missing_library(seeds.format)
    shards = [path.name for split in SPLITS for path in out.glob(f"{split}-*")]
    RunFolder(out).refuse_files_of_others((LIST_NAME, INDEX_NAME, "state", "suite", *shards))
    for folder in (out, out / "state", out / "suite"):
        atomic.make_folder(folder)
    with RunFolder(out).locked(execution.shard):
        _claim(seeds, out)
        suite = suite_from(seeds, out / "suite")
        refuse_mistakes(suite, plan_of(suite))
        scenes = scenes_of(suite, seeds.spec, seeds.frames, seeds.seed)
        refuse_wrong_attitudes(scenes, seeds.spec, seeds.seed, suite.source)
        if execution.shard is None:
            for path in (*atomic.leftovers(out, below=False), *atomic.leftovers(out / "state")):
                path.unlink(missing_ok=True)
        items = [Shard(name, tuple(parts)) for name, parts in shards_of(scenes, seeds.shard_size).items()]
        work = ShardWork(_drawing(seeds, suite), out)
        done = do(work, items, within_memory(execution, suite), progress)
        for name, one in done.items():
            if one.error is not None:
                raise UserError(f"{name}: {one.error}", where=str(out), fix="mend it, and run again")
        records = {name: one.result for name, one in done.items() if one.result is not None}
        if execution.shard is not None:
            return {"shards": list(records.values()), "frames": sum(record["frames"] for record in records.values())}
        index = _index(seeds, scenes, records)
        write_json(out / INDEX_NAME, index)
        return index


def _claim(seeds: SeedList, out: Path) -> None:
    """Record the data set of this folder; refuse a folder of another one."""
    path = out / LIST_NAME
    before = read_json(path, bound=False, fix="choose another --out, or delete this folder")
    if before is not None and {**before, "code": ""} != {**asdict(seeds), "code": ""}:
        raise UserError(
            f"holds another data set, of suite {before.get('suite')!r}",
            where=str(out),
            expected="a new folder, or the same suite, frames, seed, shards and format",
            fix="choose another --out, or delete this folder",
        )
    if before is None:
        seeds.write(path)


def _drawing(seeds: SeedList, suite: Suite) -> Drawing:
    # The running code counts, not that of the list.
    # Keys of a list from a file have another order than those of a new list.
    listed = json.dumps({**asdict(seeds), "code": ""}, sort_keys=True)
    digest = content_digest(listed, code_digest(*CODE))
    return Drawing(digest, seeds.seed, seeds.spec, seeds.format, suite.source)


def _index(seeds: SeedList, scenes: list[LearningScene], records: dict[str, Any]) -> dict[str, Any]:
    camera = scenes[0].case.camera
    shards: dict[str, list[dict[str, Any]]] = {split: [] for split in SPLITS}
    for name, record in records.items():
        shards[name.rpartition("-")[0]].append(
            {key: record[key] for key in ("file", "frames", "bytes", "sha256", "scenes")}
        )
    digests = [shard["sha256"] for split in SPLITS for shard in shards[split]]
    return {
        "dataset": 1,
        "format": seeds.format,
        "frames": seeds.frames,
        "bytes": sum(shard["bytes"] for split in SPLITS for shard in shards[split]),
        "sha256": content_digest(digests),
        "version": seeds.version,
        "image": {
            "bands": [band.name for band in camera.band],
            "height": camera.camera.height,
            "width": camera.camera.width,
            "dtype": "uint16",
            "projection": camera.camera.projection,
        },
        "columns": COLUMNS,
        "splits": {
            split: {
                "frames": sum(shard["frames"] for shard in shards[split]),
                "scenes": sum(scene.split == split for scene in scenes),
                "shards": shards[split],
            }
            for split in SPLITS
        },
        "scene_names": [scene.case.name for scene in scenes],
    }
