"""Shards as work for the engine: each is a file, whole or not at all, and a record that says its digest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import atomic, files
from horizonval.core.digests import content_digest
from horizonval.jobs.engine import Done, Record, Recorded
from horizonval.jobs.progress import Stopwatch
from horizonval.renderer.scene.shared_view import shared_view
from horizonval.sensor.observe import observe
from horizonval.spec.suite import DatasetSpec
from horizonval.studies.dataset.columns import content_of, row_of
from horizonval.studies.dataset.scenes import FramesOfScene, turned_scenes
from horizonval.studies.dataset.shard_files import SUFFIXES, write_shard


@dataclass(frozen=True)
class Shard:
    """Frames that go into one file."""

    name: str
    parts: tuple[FramesOfScene, ...]

    @property
    def frames(self) -> int:
        """Their number."""
        return sum(part.last - part.first for part in self.parts)


@dataclass(frozen=True)
class Drawing:
    """What the frames of all shards are drawn from.

    Attributes
    ----------
    digest : str
        Of the list of seeds and of the code: what every shard depends on beside its name.
    seed : int
    spec : DatasetSpec
    format : str
    source : str
        The suite's file, for errors.
    """

    digest: str
    seed: int
    spec: DatasetSpec
    format: str
    source: str


class ShardWork(Recorded[Shard]):
    """Shards of a data set, into its folder; records lie in ``state``."""

    def __init__(self, drawing: Drawing, root: Path) -> None:
        self._drawing, self._root = drawing, root
        self.folder: Path | None = root

    def name(self, item: Shard) -> str:
        """Return the shard's name."""
        return item.name

    def group(self, item: Shard) -> str:
        """Return whose tables of light the first frames of a shard share: those of the shard before, perhaps."""
        case = item.parts[0].scene.case
        return shared_view(case.scene, case.camera)

    def path(self, item: Shard) -> Path:
        """Return the file of a shard's record."""
        return self._root / "state" / f"{item.name}.json"

    def identity(self, item: Shard) -> str:
        """Return the digest of everything that a shard depends on."""
        return content_digest(self._drawing.digest, item.name)

    def file(self, item: Shard) -> Path:
        """Return the shard itself."""
        return self._root / f"{item.name}{SUFFIXES[self._drawing.format]}"

    def finished(self, item: Shard) -> Record | None:
        """Return the record of a shard whose file is there and undamaged."""
        record, path = super().finished(item), self.file(item)
        if record is None or files.kind_at(path) != "a file" or files.sha256_of(path) != record["sha256"]:
            return None
        return record

    def parts(self, item: Shard, done: Done[Record] | None) -> Mapping[str, str | None]:
        """Count frames."""
        error = None if done is None else done.error
        return {f"{item.name}/{i}": error for i in range(item.frames)}

    def record(self, item: Shard, watch: Stopwatch) -> Record:
        """Render, observe and write the frames of a shard; return what its record says."""
        # Only a process that renders loads the renderer.
        from horizonval.renderer.scene.frame import render_in_turn

        drawing, images, rows = self._drawing, [], []
        for part in item.parts:
            camera = part.scene.case.camera
            scenes = turned_scenes(part.scene, drawing.spec, drawing.seed, drawing.source)
            for i in range(part.first, part.last):
                with watch.stage("render"):
                    frame = render_in_turn(scenes[i], camera, maps=False)
                with watch.stage("observe"):
                    seen = [observe(frame, camera, band.name, seed=i) for band in camera.band]
                images.append(np.stack([image.dn for image in seen]))
                rows.append(row_of(frame.truth, seen[0].full_scale, part.scene.number, part.number + i - part.first))
        path = self.file(item)
        with watch.stage("write"), atomic.replacing(path) as temporary:
            write_shard(temporary, content_of(images, rows), drawing.format)
        return {
            "file": path.name,
            "frames": item.frames,
            "bytes": path.stat().st_size,
            "sha256": files.sha256_of(path),
            "scenes": [part.scene.case.name for part in item.parts],
        }

    def lost(self, item: Shard, why: str) -> Done[Any]:
        """Return why there is no shard."""
        return Done(None, why)
