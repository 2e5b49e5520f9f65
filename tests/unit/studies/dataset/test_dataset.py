"""A data set is made again from its list alone, by any number of workers, and goes on after whatever stopped it."""

from __future__ import annotations

import io
import json
import shutil
import signal
import subprocess
import sys
import tarfile
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval import cli
from horizonval.core.errors import UserError
from horizonval.spec.files import shipped_path
from horizonval.studies.dataset.scenes import list_of, read_list, scenes_of, shards_of, turned_scenes
from horizonval.studies.dataset.shards import COLUMNS, ShardContent, write_shard

TINY = """
[suite]
name = "tiny"
seed = 3
frames = 4
estimators = ["altitude-free"]
[dataset]
frames_per_scene = 5
attitudes = { "attitude.roll_deg" = [-3.0, 3.0], "attitude.pitch_deg" = [-3.0, 3.0] }
split = [2, 1, 1]
[defaults]
camera = { file = "own.toml", mount_roll_deg = 60.0, camera = { width = 32, height = 24 } }
platform = { epoch_utc = 2026-03-20T12:00:00Z, altitude_km = 500.0 }
render = { subsamples = 1, nodes = 32 }
[[cases]]
name = "places"
sobol = { share = 1.0, ranges = { "platform.latitude_deg" = [-60.0, 60.0] } }
"""
SHAPE = (1, 24, 32)


def run(*words: object) -> int:
    return cli.run_command_line([str(word) for word in words])


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suite")
    camera = shipped_path("camera", "ir-bolometer-160-57deg")
    (folder / "own.toml").write_text(camera.read_text(encoding="utf-8"))
    (folder / "tiny.toml").write_text(TINY)
    return folder / "tiny.toml"


@pytest.fixture(scope="module")
def made(suite, tmp_path_factory):
    out = tmp_path_factory.mktemp("made") / "set"
    assert run("dataset", suite, "--frames", 20, "--shard-size", 7, "--out", out, "--workers", 2) == 0
    return out


def index_of(folder: Path) -> dict:
    return json.loads((folder / "dataset.json").read_text())


def frames_in(folder: Path, split: str) -> list[tuple[np.ndarray, dict]]:
    """Every frame of a split, read by nothing of ours."""
    found = []
    for shard in index_of(folder)["splits"][split]["shards"]:
        with tarfile.open(folder / shard["file"]) as tar:
            files = {member.name: tar.extractfile(member).read() for member in tar}
        for name in sorted(name for name in files if name.endswith(".image.npy")):
            truth = json.loads(files[name.replace(".image.npy", ".truth.json")])
            found.append((np.load(io.BytesIO(files[name])), truth))
    return found


def test_scenes_are_never_shared_between_splits(made):
    index = index_of(made)
    assert [index["splits"][s]["frames"] for s in ("train", "validation", "test")] == [10, 5, 5]
    assert [shard["frames"] for shard in index["splits"]["train"]["shards"]] == [7, 3]
    splits = ("train", "validation", "test")
    seen = {split: {truth["scene"] for _, truth in frames_in(made, split)} for split in splits}
    assert sorted(number for numbers in seen.values() for number in numbers) == [0, 1, 2, 3]
    numbers = [truth["frame"] for split in seen for _, truth in frames_in(made, split)]
    assert numbers == list(range(20))


def test_the_truth_is_that_of_the_image(made):
    """The nadir from the position and attitude by another library; and the limb lies where the truth says."""
    pitches = set()
    for image, truth in frames_in(made, "train"):
        assert image.shape == SHAPE
        assert image.dtype == np.uint16
        assert set(truth) == set(COLUMNS)
        down = -np.array(truth["r_itrs"]) / np.linalg.norm(truth["r_itrs"])
        assert np.allclose(Rotation.from_quat(truth["q_cam_from_itrs"]).apply(down), truth["nadir_cam"], atol=1e-12)
        fx, fy, cx, cy, *distortion = truth["camera"]
        assert not any(distortion)
        rows, columns = np.indices(SHAPE[1:])
        rays = np.stack([(columns - cx) / fx, (rows - cy) / fy, np.ones(SHAPE[1:])], axis=-1)
        cosine = rays @ truth["nadir_cam"] / np.linalg.norm(rays, axis=-1)
        beyond = np.degrees(np.arccos(cosine) - truth["angular_radius_rad"])
        # The air ends 100 km above the ground, 2.2 deg from 500 km; a blurred pixel is 2 deg wide.
        assert image[0][beyond < -4.0].min() > 3.0 * image[0][beyond > 6.0].max()
        pitches.add(
            round(float(np.degrees(np.arcsin(-Rotation.from_quat(truth["q_body_from_lvlh"]).apply([0, 0, 1])[0]))), 3)
        )
    assert len(pitches) == 10
    assert max(map(abs, pitches)) <= 3.0


def test_the_list_alone_makes_what_is_missing_to_the_bit(made, tmp_path):
    """Of four shards one is gone, one damaged, one was being written; one worker makes them, nothing else."""
    listed, again = tmp_path / "renamed.json", tmp_path / "again"
    listed.write_bytes((made / "seeds.json").read_bytes())
    assert listed.stat().st_size < 6000
    files = sorted(path.name for path in made.glob("*.tar"))
    assert len(files) == 4
    shutil.copytree(made / "state", again / "state")
    for name in files[1:]:
        shutil.copy(made / name, again / name)
    (again / files[1]).write_bytes((made / files[1]).read_bytes()[:-1] + b"x")
    (again / "state" / files[2].replace(".tar", ".json")).unlink()
    (again / ".test.0123456789abcdef.tmp").write_bytes(b"half")
    kept = (again / files[3]).stat().st_mtime_ns
    assert run("dataset", "--from", listed, "--out", again, "--workers", 1) == 0
    assert {name: (again / name).read_bytes() for name in files} == {name: (made / name).read_bytes() for name in files}
    assert (again / files[3]).stat().st_mtime_ns == kept
    assert not list(again.glob(".*.tmp"))
    assert index_of(again) == index_of(made)


@pytest.mark.slow
def test_killed_and_on_a_cluster_the_bytes_are_the_same(suite, made, tmp_path):
    out = tmp_path / "killed"
    words = ["dataset", suite, "--frames", 20, "--shard-size", 7, "--out", out]
    command = [sys.executable, "-c", "from horizonval.cli import main; main()", *map(str, words), "--workers", "1"]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    while not list(out.glob("*.tar")):
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (out / "dataset.json").exists()
    assert run(*words, "--dask", "local:2") == 0
    assert index_of(out) == index_of(made)


def test_shipped_suite_divides_ten_thousand_frames_by_place():
    seeds, suite = list_of("learning", 10_000, None, 1000, "webdataset")
    scenes = scenes_of(suite, seeds.spec, seeds.frames, seeds.seed)
    assert [scene.frames for scene in scenes] == [100] * 100
    assert [sum(scene.split == split for scene in scenes) for split in ("train", "validation", "test")] == [80, 10, 10]
    shards = shards_of(scenes, 1000)
    assert [sum(part.last - part.first for part in parts) for parts in shards.values()] == [1000] * 10
    turned = [turned_scenes(scene, seeds.spec, seeds.seed, "") for scene in scenes[:2]]
    rolls = {scene.attitude.roll_deg for some in turned for scene in some}
    assert len(rolls) == 200
    assert -6.0 <= min(rolls) < -5.5 < 5.5 < max(rolls) <= 6.0


@pytest.fixture(scope="module")
def content():
    random = np.random.default_rng(1)
    shapes = {"nadir_cam": (3,), "q_cam_from_itrs": (4,), "camera": (9,)}
    columns = {name: random.standard_normal((3, *shapes.get(name, ()))) for name in COLUMNS}
    columns["frame"] = np.array([7, 8, 9])
    return ShardContent(random.integers(0, 2**14, (3, *SHAPE)).astype(np.uint16), columns)


@pytest.mark.parametrize("kind", ["webdataset", "hdf5", "zarr"])
def test_shards_are_read_by_the_libraries_of_their_kind(kind, content, tmp_path):
    path = tmp_path / "shard"
    library = pytest.importorskip({"hdf5": "h5py"}.get(kind, kind), reason=f"reads shards of {kind}")
    write_shard(path, content, kind)
    first = path.read_bytes()
    time.sleep(1.1 if kind == "zarr" else 0.0)
    write_shard(path, content, kind)
    assert path.read_bytes() == first
    if kind == "webdataset":
        rows = list(library.WebDataset(str(path), shardshuffle=False).decode())
        assert [row["__key__"] for row in rows] == ["00000007", "00000008", "00000009"]
        found = {"image": np.stack([row["image.npy"] for row in rows])}
        found |= {name: np.array([row["truth.json"][name] for row in rows]) for name in COLUMNS}
    elif kind == "hdf5":
        with library.File(path) as file:
            found = {name: file[name][...] for name in file}
    else:
        group = library.open_group(library.storage.ZipStore(path, mode="r"), mode="r")
        found = {name: array[...] for name, array in group.arrays()}
    assert set(found) == {"image", *COLUMNS}
    assert np.array_equal(found["image"], content.images)
    for name, values in content.columns.items():
        assert np.array_equal(found[name], values), name


RANGE = '"attitude.roll_deg" = [-3.0, 3.0]'


@pytest.mark.parametrize(
    ("change", "options", "told"),
    [
        (None, ["--format", "parquet"], "--format: found 'parquet'"),
        (None, ["--seed", "4", "--from", "x.json"], "--from: used with SUITE"),
        ((RANGE, '"platform.altitude_km" = [400.0, 500.0]'), [], "unknown key 'platform'"),
        (("split = [2, 1, 1]", "split = [0, 0, 0]"), [], "must add up to 1 to 1000"),
    ],
)
def test_mistakes_are_one_line(change, options, told, suite, tmp_path, capsys):
    path = tmp_path / "tiny.toml"
    path.write_text(TINY.replace(*change) if change else TINY)
    (tmp_path / "own.toml").write_bytes((suite.parent / "own.toml").read_bytes())
    assert run("dataset", path, "--frames", 20, "--out", tmp_path / "out", *options) == 2
    said = capsys.readouterr().err.strip()
    assert told in said
    assert "\n" not in said


def test_a_folder_and_a_list_are_of_one_data_set(made, suite, tmp_path, capsys):
    assert run("dataset", suite, "--frames", 10, "--out", made) == 2
    assert "holds another data set" in capsys.readouterr().err
    data = json.loads((made / "seeds.json").read_text())
    for name, text in {
        "none.json": None,
        "other.json": "{}",
        "changed.json": json.dumps({**data, "seed": 4}),
    }.items():
        path = tmp_path / name
        if text is not None:
            path.write_text(text)
        with pytest.raises(UserError, match=r"no such file|no list of seeds|not what was written|damaged|altered"):
            read_list(path)
