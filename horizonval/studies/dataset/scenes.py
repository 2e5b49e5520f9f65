"""Which frames a data set has: the scenes of a suite, how the camera turns in each, and who learns from which."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.renderer.scene.shared_view import shared_view
from horizonval.spec.expand import seed_of, variants
from horizonval.spec.load import Case, Suite, validate
from horizonval.spec.pose import Attitude, CameraUse
from horizonval.spec.scene import SceneSpec
from horizonval.spec.suite import CasesSpec, DatasetSpec, SobolSpec

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")
MOUNTING = ("camera.mount_yaw_deg", "camera.mount_pitch_deg", "camera.mount_roll_deg")


@dataclass(frozen=True)
class LearningScene:
    """A scene with its frames.

    Attributes
    ----------
    number : int
        Place among the scenes of the data set.
    case : Case
    frames : int
    split : {"train", "validation", "test"}
    """

    number: int
    case: Case
    frames: int
    split: Split


@dataclass(frozen=True)
class FramesOfScene:
    """Some frames of a scene, from ``first`` to before ``last``; the frame ``first`` is ``number`` of the data set."""

    scene: LearningScene
    first: int
    last: int
    number: int


def scenes_of(suite: Suite, spec: DatasetSpec, frames: int, seed: int) -> list[LearningScene]:
    """Return the scenes of a data set, all frames divided among them.

    Scenes that share place, instant and air, seen by other heads or at other attitudes, are of one split.

    Raises
    ------
    UserError
        Images of several sizes or numbers of bands, which no array holds.
    """
    cases = suite.cases[:frames]
    shapes = {(len(case.camera.band), case.camera.camera.height, case.camera.camera.width): case for case in cases}
    if len(shapes) > 1:
        (a, first), (b, second) = list(shapes.items())[:2]
        raise UserError(
            f"{first.name} has {_text(a)}, {second.name} {_text(b)}",
            where=suite.source,
            expected="images of one size and number of bands",
        )
    groups: dict[str, Split] = {}
    keys = [shared_view(case.scene, case.camera) for case in cases]
    for place, key in enumerate(dict.fromkeys(keys)):
        groups[key] = _split(place, spec.split, seed)
    share, more = divmod(frames, len(cases))
    return [
        LearningScene(i, case, share + (i < more), groups[key])
        for i, (case, key) in enumerate(zip(cases, keys, strict=True))
    ]


def shards_of(scenes: Sequence[LearningScene], size: int) -> dict[str, list[FramesOfScene]]:
    """Return the frames of every shard by its name: those of a split in the scenes' order, ``size`` at a time."""
    shards: dict[str, list[FramesOfScene]] = {}
    number = 0
    counts = dict.fromkeys(SPLITS, 0)
    for scene in sorted(scenes, key=lambda one: (SPLITS.index(one.split), one.number)):
        first = 0
        while first < scene.frames:
            shard, full = divmod(counts[scene.split], size)
            last = min(scene.frames, first + size - full)
            part = FramesOfScene(scene, first, last, number)
            shards.setdefault(f"{scene.split}-{shard:06d}", []).append(part)
            counts[scene.split] += last - first
            number += last - first
            first = last
    return shards


def turned_scenes(scene: LearningScene, spec: DatasetSpec, seed: int, where: str) -> list[SceneSpec]:
    """Return a scene once for every frame, each with an attitude of its own.

    Raises
    ------
    UserError
        A key that is none of the attitude or the mounting, or a range that is none.
    """
    of_scene = scene.case.scene
    if not spec.attitudes:
        return [of_scene] * scene.frames
    table = CasesSpec(
        name=of_scene.scene.name,
        sobol=SobolSpec(n=scene.frames, ranges=spec.attitudes, seed=seed_of("attitudes", scene.case.name) >> 66),
    )
    drawn = variants(table, seed, f"{where}: dataset.attitudes")
    return [_turned(of_scene, variant.scene, where) for variant in drawn]


def refuse_wrong_attitudes(scenes: Iterable[LearningScene], spec: DatasetSpec, seed: int, where: str) -> None:
    """Draw the attitudes of the first scene, so that a mistake in their ranges is told before anything is rendered."""
    for scene in scenes:
        turned_scenes(scene, spec, seed, where)
        return


def _turned(scene: SceneSpec, drawn: JsonObject, where: str) -> SceneSpec:
    attitude, camera = drawn.pop("attitude", {}), drawn.pop("camera", {})
    others = [*drawn, *(f"camera.{key}" for key in camera if f"camera.{key}" not in MOUNTING)]
    if others:
        raise UserError(
            f"unknown key {others[0]!r}",
            where=f"{where}: dataset.attitudes",
            expected=f"keys of attitude, or {', '.join(MOUNTING)}",
        )
    place = f"{where}: dataset.attitudes"
    return scene.model_copy(
        update={
            "attitude": validate(Attitude, {**scene.attitude.model_dump(exclude_unset=True), **attitude}, place),
            "camera": validate(CameraUse, {**scene.camera.model_dump(exclude_unset=True), **camera}, place),
        }
    )


def _split(place: int, parts: Sequence[int], seed: int) -> Split:
    """Return the split of the scene at a place: of every block of scenes each split has its parts, in a drawn order.

    So every prefix of the scenes, and every table of a suite, is divided nearly as asked.
    """
    block, inside = divmod(place, sum(parts))
    names = [name for name, count in zip(SPLITS, parts, strict=True) for _ in range(count)]
    random = np.random.default_rng(np.random.SeedSequence(seed_of("split", seed, block)))
    return names[int(random.permutation(len(names))[inside])]


def _text(shape: tuple[int, int, int]) -> str:
    bands, height, width = shape
    return f"{width} x {height} pixels in {bands} band{'s' if bands > 1 else ''}"
