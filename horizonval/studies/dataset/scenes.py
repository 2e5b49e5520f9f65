"""Frames of a data set: the scenes of a suite, the attitudes of each, and its split.

The list of seeds holds the texts of the suite and of the user's cameras, the root seed, and the numbers of frames and
shards. The same list and version make the same bytes. Every data set is made from its list, also the first time, so
that something missing from the list is noticed at once.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np

import horizonval
from horizonval.core import atomic, files
from horizonval.core.code import code_digest
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.geometry.camera import camera_from_spec
from horizonval.geometry.pose import turned
from horizonval.renderer.frame_cost import shared_view
from horizonval.spec.expand import seed_of, variants
from horizonval.spec.files import find, shipped_names, shipped_path
from horizonval.spec.load import MAX_FILE_BYTES, Case, Suite
from horizonval.spec.scene import SceneSpec
from horizonval.spec.suite import CasesSpec, DatasetSpec, SobolSpec
from horizonval.store.folder import read_json, write_json
from horizonval.suites.identity import suite_identity
from horizonval.suites.suite import load_suite

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")


@dataclass(frozen=True)
class LearningScene:
    """A scene of a data set, its position ``number`` among the scenes, and its split."""

    number: int
    case: Case
    frames: int
    split: Split


@dataclass(frozen=True)
class FramesOfScene:
    """Frames ``first`` to before ``last`` of a scene; the frame ``first`` is ``number`` of the data set."""

    scene: LearningScene
    first: int
    last: int
    number: int


def scenes_of(suite: Suite, spec: DatasetSpec, frames: int, seed: int) -> list[LearningScene]:
    """Return the scenes of a data set with all frames divided among them.

    Scenes with the same position, instant and air, with other heads or attitudes, are in one split. Raises
    ``UserError``: images of different sizes or numbers of bands.
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
    for case in cases:
        if not camera_from_spec(case.camera.camera).classic:
            raise UserError(
                "a data set states a lens by four intrinsics and five coefficients, which cannot state this one",
                where=f"{suite.source}: {case.name}: camera",
                expected="a pinhole or fisheye without rational, thin prism and skew terms",
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
    """Return the frames of every shard by name: those of a split in the scenes' order, ``size`` at a time."""
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
    """Return a scene once for every frame, each with its attitude.

    Raises ``UserError``: a key that is not of attitude or mounting, or an invalid range.
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
    """Sample the attitudes of the first scene, so that a mistake in their ranges is found before rendering."""
    for scene in scenes:
        turned_scenes(scene, spec, seed, where)
        return


def _turned(scene: SceneSpec, drawn: JsonObject, where: str) -> SceneSpec:
    place = f"{where}: dataset.attitudes"
    attitude, mounting = drawn.pop("attitude", {}), drawn.pop("camera", {})
    others = [*drawn, *(f"camera.{key}" for key in mounting if not key.startswith("mount_"))]
    if others:
        raise UserError(f"unknown key {others[0]!r}", where=place, expected="keys of attitude, or camera.mount_*")
    return turned(scene, attitude | mounting, place)


def _split(place: int, parts: Sequence[int], seed: int) -> Split:
    """Return the split of a scene: each block of scenes has every split's parts in random order, so any prefix is
    balanced.
    """
    block, inside = divmod(place, sum(parts))
    names = [name for name, count in zip(SPLITS, parts, strict=True) for _ in range(count)]
    random = np.random.default_rng(np.random.SeedSequence(seed_of("split", seed, block)))
    return names[int(random.permutation(len(names))[inside])]


def _text(shape: tuple[int, int, int]) -> str:
    bands, height, width = shape
    return f"{width} x {height} pixels in {bands} band{'s' if bands > 1 else ''}"


LIST_SCHEMA = 1
LIST_NAME = "seeds.json"
FORMATS = ("webdataset", "hdf5", "zarr")
CODE = ("horizonval.studies",)
"""Package that makes the bytes of a data set, in addition to those that make rows."""
MOST_FRAMES = 10_000_000


@dataclass(frozen=True)
class SeedList:
    """A list of seeds.

    ``suite``: name of the suite's file without suffix; ``suite_sha256``: digest of its scenes. ``seed``: root seed.
    ``scenes``: number of scenes for a suite that draws shares of a number. ``dataset``: the table ``[dataset]`` with
    its defaults. ``texts``: the suite and all cameras that are not shipped, by path. ``version``, ``code``: of this
    package when the list was made.
    """

    suite: str
    suite_sha256: str
    seed: int
    frames: int
    shard_size: int
    scenes: int | None
    format: str
    dataset: dict[str, Any]
    texts: dict[str, str]
    version: str = horizonval.__version__
    code: str = field(default_factory=lambda: code_digest(*CODE))
    schema: int = LIST_SCHEMA

    @property
    def spec(self) -> DatasetSpec:
        """The table ``[dataset]``."""
        return DatasetSpec.model_validate(self.dataset)

    @property
    def is_of_this_code(self) -> bool:
        """Whether the running code made the list."""
        return self.code == code_digest(*CODE)

    def write(self, path: Path) -> None:
        """Write the list as JSON, sealed."""
        write_json(path, asdict(self), bound=False)


def list_of(
    suite: str | Path, frames: int | None, seed: int | None, shard_size: int, format_name: str
) -> tuple[SeedList, Suite]:
    """Return the list of a new data set, and its suite (a file or shipped name).

    ``frames`` and ``seed`` replace the suite's numbers; ``shard_size`` is in frames. Raises ``UserError``: a mistake in
    the suite, or numbers that do not match it.
    """
    if format_name not in FORMATS:
        raise UserError(f"found {format_name!r}", where="--format", expected=" or ".join(FORMATS))
    for name, value in (("--frames", frames), ("--shard-size", shard_size)):
        if value is not None and not 1 <= value <= MOST_FRAMES:
            raise UserError(f"found {value}", where=name, expected=f"a number from 1 to {MOST_FRAMES}")
    loaded = load_suite(suite, seed=seed)
    spec = loaded.dataset or DatasetSpec(frames_per_scene=1)
    wanted = frames or spec.frames_per_scene * (loaded.frames or len(loaded.cases))
    scenes = None
    if loaded.frames is not None:
        scenes = -(-wanted // spec.frames_per_scene)
        loaded = load_suite(suite, scenes, seed)
    elif loaded.dataset is None and wanted > len(loaded.cases):
        raise UserError(
            f"found {wanted}",
            where="--frames",
            expected=f"at most {len(loaded.cases)}, one of each scene",
            fix="or say in a table [dataset] of the suite how the camera turns",
        )
    path = find("suite", suite)
    texts = {
        f"{path.stem}.toml": files.read_text(path, largest=MAX_FILE_BYTES, expected="a suite"),
        **_cameras(loaded, path),
    }
    made = SeedList(
        suite=path.stem,
        suite_sha256=suite_identity(loaded),
        seed=loaded.seed,
        frames=wanted,
        shard_size=shard_size,
        scenes=scenes,
        format=format_name,
        # Sorted as in the file: the order of ranges assigns them to coordinates.
        dataset=json.loads(json.dumps(spec.model_dump(mode="json"), sort_keys=True)),
        texts=texts,
    )
    return made, loaded


def read_list(path: Path) -> SeedList:
    """Read a list. Raises ``UserError``: missing, damaged, or of another version of this package."""
    data = read_json(path, bound=False, fix="take it from the data set again")
    if data is None:
        raise UserError("no such file", where=str(path), expected=f"a list of seeds ({LIST_NAME})")
    names = {one.name for one in fields(SeedList)}
    if not isinstance(data, dict) or set(data) != names or data["schema"] != LIST_SCHEMA:
        raise UserError("is no list of seeds", where=str(path), expected=f"the {LIST_NAME} of a data set")
    if data["version"] != horizonval.__version__:
        raise UserError(
            f"was made by version {data['version']}, this is {horizonval.__version__}",
            where=str(path),
            fix=f"pip install 'horizonval=={data['version']}'",
        )
    return SeedList(**data)


def suite_from(seeds: SeedList, folder: Path) -> Suite:
    """Write a list's texts below a folder and return their suite.

    Raises ``UserError``: the list lacks a file of the suite, or the suite draws other scenes than recorded.
    """
    for name, text in seeds.texts.items():
        inside = PurePosixPath(name)
        if inside.is_absolute() or ".." in inside.parts or not inside.parts:
            raise UserError(f"holds the path {name!r}", where=LIST_NAME, expected="paths beside the suite")
        path = folder / inside
        atomic.make_folder(path.parent)
        atomic.write_text(path, text)
    suite = load_suite(folder / f"{seeds.suite}.toml", seeds.scenes, seeds.seed)
    if suite_identity(suite) != seeds.suite_sha256:
        raise UserError(
            f"the suite {seeds.suite!r} draws other scenes than when the list was made",
            where=LIST_NAME,
            expected="the version that made it, and no files but the list's own",
        )
    return suite


def _cameras(suite: Suite, path: Path) -> dict[str, str]:
    """Return the texts of cameras that are not shipped, by path relative to the suite's folder."""
    texts = {}
    for name in sorted({case.scene.camera.file for case in suite.cases}):
        place = find("camera", name, beside=path.parent)
        if place.stem in shipped_names("camera") and place == shipped_path("camera", place.stem):
            continue
        inside = PurePosixPath(name)
        if inside.is_absolute() or ".." in inside.parts:
            raise UserError(
                f"the camera {name!r} is not beside the suite",
                where=str(path),
                expected="a shipped camera, or a file beside the suite, which a list of seeds can hold",
            )
        texts[name] = files.read_text(place, largest=MAX_FILE_BYTES, expected="a camera")
    return texts
