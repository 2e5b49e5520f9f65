"""The archive of a run through the commands: listed, shown, exported, cleaned, scored again."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO
import pytest
from conftest import assert_one_line, outcome_of

from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.horizon import tangency_points
from horizonval.report.load import load_run
from horizonval.scoring.row import read_results
from horizonval.store.store import Store


@pytest.fixture
def out(mini_run, tmp_path) -> Path:
    return shutil.copytree(mini_run, tmp_path / "out")


def listed(horizonval, *arguments: object) -> list[dict]:
    done = horizonval("archive", "ls", "out", *arguments, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_filters_of_the_list(horizonval, out):
    assert len(listed(horizonval)) == 12
    assert {e["scene"] for e in listed(horizonval, "--kind", "image")} == {f"frame-{i}" for i in range(6)}
    assert len(listed(horizonval, "--scene", "frame-[12]", "--camera", "mini", "--band", "vis")) == 4
    assert len(listed(horizonval, "--seed", "0", "--since", "2026-01-01")) == 6
    done = horizonval("archive", "ls", "out", "--band", "lwir")
    assert (done.returncode, done.stdout) == (0, "")
    assert "none of 12 entries" in done.stderr
    assert_one_line(horizonval("archive", "ls", "out", "--kind", "film"), "--kind", "frame or image")
    assert_one_line(horizonval("archive", "ls", "out", "--since", "now"), "--since", "'now'")
    assert_one_line(horizonval("archive", "ls", "out/summary.json"), "is a file")
    assert_one_line(horizonval("archive", "verify", "out/cases"), "holds no archive")


def test_the_index_of_a_run_is_complete_and_can_be_built_again(horizonval, out):
    index = out / "archive" / "index.json"
    before = index.read_bytes()
    assert len(json.loads(before)["entries"]) == 12
    index.unlink()
    done = horizonval("archive", "reindex", "out")
    assert (done.returncode, done.stdout.strip().endswith("12 entries")) == (0, True)
    assert index.read_bytes() == before


def test_verify_knows_what_the_run_names(horizonval, out):
    victim = listed(horizonval)[4]["address"]
    (out / "archive" / victim[:2] / f"{victim}.exr").unlink()
    (out / "archive" / "index.json").unlink()
    done = horizonval("archive", "verify", "out", "--json")
    index, problem = sorted(json.loads(done.stdout)["problems"], key=lambda one: one["address"])
    assert index["message"] == "archive/index.json: not there, though the manifest names it"
    assert (done.returncode, problem["problem"], problem["address"]) == (1, "missing", victim)
    assert "the case 'frame-" in problem["message"]


@pytest.mark.skipif(sys.platform == "win32", reason="FIFOs and links of POSIX")
def test_a_run_among_what_its_host_put_there_is_verified_and_restored(horizonval, out, mini_suite, mini_run, tmp_path):
    archive, outside = out / "archive", tmp_path / "outside"
    first, second, third = (archive / e["address"][:2] / f"{e['address']}.exr" for e in listed(horizonval)[:9:4])
    assert len({path.parent for path in (first, second, third)}) == 3
    for path in (first, second):
        path.unlink()
    os.mkfifo(first)
    second.symlink_to("/dev/zero")
    third.parent.rename(outside)
    third.parent.symlink_to(outside)
    (archive / "index.json").write_bytes((archive / "index.json").read_bytes()[:1000])
    strange = archive / os.fsdecode(b"two\nlines\x1b[2J\xff")
    strange.touch()
    done = horizonval("archive", "verify", out)
    assert done.returncode == 1
    assert done.stdout.replace("\n", "").isprintable()
    lines = done.stdout.splitlines()
    assert sorted(line.partition(":")[0] for line in lines[:-1]) == [
        "damaged", "damaged", "foreign", "foreign", "index", "missing",
    ]  # fmt: skip
    assert lines[-1] == "9 entries, 6 problems"
    # Who lists makes the index again, says so, and leaves a folder in which that is no damage.
    assert len(listed(horizonval)) == 9
    assert "index" not in horizonval("archive", "verify", out).stdout
    strange.unlink()
    assert horizonval("run", mini_suite, "--out", out).returncode == 0
    assert outcome_of(out) == outcome_of(mini_run)
    done = horizonval("archive", "verify", out)
    assert (done.returncode, done.stdout) == (0, "12 entries, 0 problems\n")
    assert [path.name for path in outside.iterdir()] == [third.name]


def test_show(horizonval, out):
    entry = listed(horizonval, "--kind", "image")[0]
    done = horizonval("archive", "show", "out", entry["address"][:10])
    assert done.returncode == 0
    lines = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()}
    # 96 px of 5.5 um behind a 60 deg lens.
    length, unit = lines["pinholeFocalLength"]
    assert (float(length), unit) == (pytest.approx(0.264 / np.tan(np.pi / 6)), "mm")
    assert lines["expTime"] == ["0.00022", "s"]
    content = json.loads(horizonval("archive", "show", "out", entry["address"], "--json").stdout)
    assert content["channels"] == ["Y", "dn.vis", "mask.saturated"]
    assert content["truth"]["scene_id"] == entry["scene_id"]
    assert_one_line(horizonval("archive", "show", "out"), "which entry?")
    assert_one_line(horizonval("archive", "show", "out", "zz"), "no entry begins with 'zz'")
    assert_one_line(horizonval("archive", "show", "nowhere.exr"), "nowhere.exr", "no such file")


def test_export_and_estimate_what_was_exported(horizonval, out, mini_suite):
    entry = listed(horizonval, "--kind", "image", "--scene", "frame-3")[0]
    done = horizonval("archive", "export", "out", "--kind", "image", "--scene", "frame-3", "--png", "-o", "pictures")
    assert done.returncode == 0, done.stderr
    (picture,) = (out.parent / "pictures").glob("*.png")
    archived = out / "archive" / entry["address"][:2] / f"{entry['address']}.exr"
    camera = mini_suite.parent / "mini-camera.toml"
    answers = []
    for image in (archived, picture):
        arguments = ("--camera", camera, "--estimator", "altitude-free", "--json")
        answers.append(json.loads(horizonval("estimate", image, *arguments).stdout))
        assert answers[-1].pop("seconds") > 0
    assert answers[0]["n_points"] > 50
    for key in ("status", "n_points", "nadir_cam", "sigma_nadir_arcsec"):
        assert answers[0][key] == answers[1][key], key
    done = horizonval("archive", "export", archived, "--fits", "-o", "sky")
    assert done.stdout == "sky: 1 files of 1 entry\n"
    assert_one_line(horizonval("archive", "export", "out", "-o", "sky"), "which format?")
    assert_one_line(horizonval("archive", "export", "out", "--png", "-o", "out/archive/x"), "lies inside the archive")
    assert_one_line(horizonval("archive", "export", archived, "--png", "--band", "vis", "-o", "sky"), "--band")
    assert_one_line(horizonval("archive", "export", "out", "--png", "--scene", "x", "-o", "sky"), "nothing to export")
    assert_one_line(horizonval("archive", "export", "out/run.json", "--png", "-o", "sky"), "not an OpenEXR file")


def test_gc_asks_and_spares_what_is_named(horizonval, out, make_frame, monkeypatch):
    loose = Store(out / "archive").add_frame(make_frame())
    assert_one_line(horizonval("archive", "gc", "out"), "nobody is there to ask", "--yes")
    done = horizonval("archive", "gc", "out", "--dry-run")
    assert f"{loose[:2]}/{loose}.exr" in done.stdout
    for answer, count in (("n", 13), ("", 13), ("y", 12)):
        monkeypatch.setattr("sys.stdin.isatty", lambda: True)
        monkeypatch.setattr("builtins.input", lambda question, answer=answer: answer)
        done = horizonval("archive", "gc", "out")
        assert done.returncode == 0, done.stderr
        assert len(listed(horizonval)) == count
    assert "nothing to remove, 12 entries" in horizonval("archive", "gc", "out", "--yes").stdout
    assert horizonval("archive", "verify", "out").returncode == 0
    shutil.copytree(out / "archive", out.parent / "bare")
    assert_one_line(horizonval("archive", "gc", "bare", "--yes"), "no run.json")


def test_gc_does_nothing_while_a_run_or_a_shard_is_at_work(horizonval, out, make_frame):
    from horizonval.store.folder import RunFolder

    Store(out / "archive").add_frame(make_frame())
    for shard in (None, (1, 2)):
        with RunFolder(out).locked(shard):
            assert_one_line(horizonval("archive", "gc", "out", "--yes"), "another run is working")
    assert len(listed(horizonval)) == 13


@pytest.mark.usefixtures("estimators_here")
def test_scoring_again_gives_the_runs_own_results(horizonval, out):
    """From the archive alone; what is damaged is told, and made good by the same command later."""
    before = read_results(out / "results.parquet")
    shutil.move(out / "archive", out.parent / "kept")
    victim = next(row.image_address for row in before if row.case == "frame-2")
    path = out.parent / "kept" / victim[:2] / f"{victim}.exr"
    good = path.read_bytes()
    path.write_bytes(good[:-9])
    arguments = ("--estimator", "ideal", "--estimator", "altitude-free", "--workers", 2)
    done = horizonval("archive", "rescore", "kept", "-o", "again", *arguments)
    assert done.returncode == 1
    assert "frame-2: " in done.stderr.splitlines()[-1]
    again = out.parent / "again"
    rows = read_results(again / "results.parquet")
    assert rows == [row for row in before if row.case != "frame-2"]
    assert len(rows) == 10
    # What the report is made of has the images, which lie elsewhere.
    views = load_run(again).views
    assert [view.case for view in views if view.image is not None] == [f"frame-{i}" for i in (0, 1, 3, 4, 5)]
    assert all((again / view.image_path).is_file() for view in views)
    path.write_bytes(good)
    finished = {path: path.stat().st_mtime_ns for path in (again / "cases").iterdir()}
    assert len(finished) == 5
    assert horizonval("archive", "rescore", "kept", "-o", "again", *arguments).returncode == 0
    assert read_results(again / "results.parquet") == before
    assert finished == {path: path.stat().st_mtime_ns for path in finished}
    assert "12 entries, 0 problems" in horizonval("archive", "verify", "again").stdout


def test_scoring_again_says_what_it_cannot(horizonval, out):
    assert_one_line(horizonval("archive", "rescore", "out", "-o", "out"), "holds a run")
    assert_one_line(horizonval("archive", "rescore", "out", "-o", "x", "--estimator", "idel"), "unknown estimator")
    assert_one_line(horizonval("archive", "rescore", "out", "-o", "x", "--scene", "none"), "no detector image")
    Path(out, "run.json").unlink()
    assert_one_line(horizonval("archive", "rescore", "out", "-o", "x"), "which estimators?")
    assert not (out.parent / "x").exists()


def test_the_horizon_is_where_a_foreign_reader_projects_it(mini_run):
    """OpenImageIO opens every archived file; the exact horizon, projected with its attributes, is on height 0."""
    seen = 0
    for path in sorted((mini_run / "archive").rglob("*.exr")):
        buffer = OpenImageIO.ImageBuf(str(path))
        assert not buffer.has_error, buffer.geterror()
        spec = buffer.spec()
        found = {a.name: a.value for a in spec.extra_attribs}
        assert (spec.width, spec.height, found["horizonval:schema"]) == (96, 80, 5)
        if found["horizonval:kind"] != "frame":
            continue
        values = buffer.get_pixels(OpenImageIO.FLOAT)
        height = values[..., spec.channelnames.index("truth.tangent_height")]
        points = tangency_points(found["horizonval:camera_position_m"], WGS84, np.linspace(0, 2 * np.pi, 720))
        across, down, _, depth = (
            np.column_stack([points, np.ones(len(points))]) @ np.array(found["worldToNDC"]).reshape(4, 4)
        ).T
        column, row = across / depth * spec.width - 0.5, down / depth * spec.height - 0.5
        inside = (depth > 0) & (column > 1) & (column < 94) & (row > 1) & (row < 78)
        u, v = column[inside].astype(np.float32), row[inside].astype(np.float32)
        on_line = cv2.remap(height, u, v, cv2.INTER_LINEAR).ravel()
        slope = np.hypot(*np.gradient(height.astype(float)))[v.round().astype(int), u.round().astype(int)]
        np.testing.assert_array_less(np.abs(on_line) / slope, 0.25)
        seen += inside.sum()
    assert seen > 300
