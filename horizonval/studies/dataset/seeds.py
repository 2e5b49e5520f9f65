"""The list of seeds: all that a data set is made of, in a few kilobytes.

It holds the suite's text and those of the user's own cameras, the root seed, how many frames there are and how they are
cut into shards. Everything else follows: the same list and version make the same bytes. A data set is always made from
its list, also the first time, so that what the list cannot hold is noticed at once and not by whoever has it alone.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path, PurePosixPath
from typing import Any

import horizonval
from horizonval.core import atomic, files
from horizonval.core.code import code_digest
from horizonval.core.errors import UserError
from horizonval.spec.files import find, shipped_names, shipped_path
from horizonval.spec.load import MAX_FILE_BYTES, Suite
from horizonval.spec.suite import DatasetSpec
from horizonval.store.folder import read_json, write_json
from horizonval.suites.identity import suite_identity
from horizonval.suites.suite import load_suite

LIST_SCHEMA = 1
LIST_NAME = "seeds.json"
FORMATS = ("webdataset", "hdf5", "zarr")
CODE = ("horizonval.studies",)
"""The room that makes the bytes of a data set, in addition to those that make rows."""
MOST_FRAMES = 10_000_000


@dataclass(frozen=True)
class SeedList:
    """A list of seeds.

    Attributes
    ----------
    suite : str
        Name of the suite's file, without its ending.
    suite_sha256 : str
        Of the scenes that the suite draws.
    seed : int
        The root of all that is drawn.
    frames, shard_size : int
    scenes : int or None
        Number that a suite is asked for which draws shares of a number.
    format : {"webdataset", "hdf5", "zarr"}
    dataset : dict
        The suite's table ``[dataset]`` with its defaults: frames of a scene, ranges of attitudes, split.
    texts : dict
        The suite's text and those of cameras that are not shipped, by their paths.
    version, code : str
        Of this package when the list was made.
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
        """Whether the list was made by the code that runs."""
        return self.code == code_digest(*CODE)

    def write(self, path: Path) -> None:
        """Write the list as JSON, sealed."""
        write_json(path, asdict(self), bound=False)


def list_of(
    suite: str | Path, frames: int | None, seed: int | None, shard_size: int, format_name: str
) -> tuple[SeedList, Suite]:
    """Return the list of a new data set, and its suite.

    Parameters
    ----------
    suite : str or Path
        A suite file, or a shipped name.
    frames : int, optional
        As many as the suite's scenes make by default.
    seed : int, optional
        In place of the suite's.
    shard_size : int
        Frames of a shard.
    format_name : str

    Raises
    ------
    UserError
        A mistake in the suite, or numbers that do not go with it.
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
        # Sorted, as it comes back from the file: the order of ranges decides which is drawn from which coordinate.
        dataset=json.loads(json.dumps(spec.model_dump(mode="json"), sort_keys=True)),
        texts=texts,
    )
    return made, loaded


def read_list(path: Path) -> SeedList:
    """Read a list.

    Raises
    ------
    UserError
        There is none, it is damaged, or one of another version of this package.
    """
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
    """Write a list's texts below a folder and return the suite that they make.

    Raises
    ------
    UserError
        The suite needs a file that the list does not hold, or draws other scenes than it did.
    """
    for name, text in seeds.texts.items():
        inside = PurePosixPath(name)
        if inside.is_absolute() or ".." in inside.parts or not inside.parts:
            raise UserError(f"holds the path {name!r}", where=LIST_NAME, expected="paths beside the suite")
        path = folder / inside
        path.parent.mkdir(parents=True, exist_ok=True)
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
    """Return the texts of cameras that are the user's own, by their paths from the suite's folder."""
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
