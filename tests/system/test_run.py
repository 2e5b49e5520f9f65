"""The main job: complete, repeatable to the bit, and indestructible."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
from conftest import PROGRAM, assert_one_line, outcome_of

from horizonval.scoring.row import read_results


def test_a_run_is_complete(mini_run):
    summary = json.loads((mini_run / "summary.json").read_text())
    assert summary["suite"] == "mini"
    assert (summary["n_cases"], summary["n_rows"], summary["failed"]) == (6, 12, {})
    assert {g["estimator"] for g in summary["groups"]} == {"altitude-free", "ideal"}
    rows = read_results(mini_run / "results.parquet")
    assert [(r.case, r.estimator) for r in rows] == [
        (f"frame-{i}", e) for i in range(6) for e in ("altitude-free", "ideal")
    ]
    assert (mini_run / "report" / "index.html").is_file()
    for i in range(6):
        case = json.loads((mini_run / "cases" / f"frame-{i}.json").read_text())
        for key in ("truth_frame", "image"):
            address = case[key]
            assert (mini_run / "archive" / address[:2] / f"{address}.exr").is_file()
        assert set(case["details"]) == {"altitude-free", "ideal"}
    assert len(list((mini_run / "archive").rglob("*.exr"))) == 12
    assert set(json.loads((mini_run / "timings.json").read_text())["cases"]) == {f"frame-{i}" for i in range(6)}


def test_results_hold_no_clock(mini_run):
    for path in [mini_run / "summary.json", *sorted((mini_run / "cases").iterdir())]:
        assert "second" not in path.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 3])
def test_the_number_of_workers_and_threads_changes_nothing(program, mini_suite, mini_run, tmp_path, workers):
    # One worker uses all processors as threads, three share them.
    assert program("run", mini_suite, "--out", "out", "--workers", workers).returncode == 0
    assert outcome_of(tmp_path / "out") == outcome_of(mini_run)


def test_a_finished_run_is_not_made_again(horizonval, mini_suite, mini_run, tmp_path):
    shutil.copytree(mini_run, tmp_path / "out")
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "out" / "archive").rglob("*.exr")}
    done = horizonval("run", mini_suite, "--out", "out")
    assert done.returncode == 0
    assert "6 of 6 frames are finished already" in done.stderr
    assert before == {p: p.stat().st_mtime_ns for p in (tmp_path / "out" / "archive").rglob("*.exr")}
    assert outcome_of(tmp_path / "out") == outcome_of(mini_run)


def _killed_run(suite: Path, out: Path, after_s: float) -> None:
    """Start a run and kill it without warning."""
    process = subprocess.Popen(
        [str(PROGRAM), "run", str(suite), "--out", str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    time.sleep(after_s)
    process.kill()
    process.wait()


def _check_kills(suite: Path, reference: Path, out: Path, moments: list[float]) -> None:
    for moment in moments:
        _killed_run(suite, out, moment)
    done = subprocess.run([str(PROGRAM), "run", str(suite), "--out", str(out)], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    assert outcome_of(out) == outcome_of(reference)
    assert not [p for p in out.rglob(".*") if p.name != ".lock"], "no leftovers"
    done = subprocess.run([str(PROGRAM), "archive", "verify", str(out)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "12 entries, 0 problems\n")


@pytest.mark.slow
def test_100_kills_at_random_moments_change_nothing(mini_suite, mini_run, tmp_path):
    moments = random.Random(20260320)
    start = time.monotonic()
    subprocess.run([str(PROGRAM), "run", str(mini_suite), "--out", str(tmp_path / "dry")], check=True)
    whole = time.monotonic() - start
    for i in range(100):
        # Five kills in a row on the same folder, then a fresh one.
        _killed_run(mini_suite, tmp_path / f"out-{i // 5}", moments.uniform(0, whole))
    for i in range(20):
        _check_kills(mini_suite, mini_run, tmp_path / f"out-{i}", [])


def _stopped_halfway(suite: Path, out: Path) -> subprocess.Popen[str] | None:
    """Start a run and halt it between its first and its last frame; None if it was too quick for that."""
    process = subprocess.Popen(
        [str(PROGRAM), "run", str(suite), "--out", str(out), "--workers", "1"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        # Tests that a shell started in the background were told to ignore it, and hand that on.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not list((out / "cases").glob("*.json")):
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGSTOP)
    if len(list((out / "cases").glob("*.json"))) < 6:
        return process
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    return None


def test_ctrl_c_is_clean_and_resumable(mini_suite, mini_run, tmp_path):
    # On a loaded machine the frames may all be done before this process sees the first one.
    for attempt in range(5):
        out = tmp_path / f"out-{attempt}"
        if process := _stopped_halfway(mini_suite, out):
            break
    assert process is not None
    # The whole group, as a terminal does.
    os.killpg(process.pid, signal.SIGINT)
    os.killpg(process.pid, signal.SIGCONT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "the same command goes on" in errors
    assert not (out / "summary.json").exists()
    _check_kills(mini_suite, mini_run, out, [])


def test_another_suite_is_refused(horizonval, mini_suite, mini_run, tmp_path):
    shutil.copytree(mini_run, tmp_path / "out")
    other = tmp_path / "other.toml"
    other.write_text(mini_suite.read_text().replace('"mini"', '"other"'))
    shutil.copy(mini_suite.with_name("mini-camera.toml"), tmp_path)
    assert_one_line(horizonval("run", other, "--out", "out"), "holds a run of suite 'mini'", "choose another --out")
    other.write_text(mini_suite.read_text().replace("500.0", "501.0"))
    assert_one_line(horizonval("run", other, "--out", "out"), "other frames", "choose another --out")
    assert outcome_of(tmp_path / "out") == outcome_of(mini_run)


@pytest.mark.slow
def test_two_runs_in_one_folder_are_refused(program, mini_suite, tmp_path):
    first = subprocess.Popen(
        [str(PROGRAM), "run", str(mini_suite), "--out", "out"],
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not (tmp_path / "out" / "run.json").exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert_one_line(program("run", mini_suite, "--out", "out"), "another run is working in this folder")
    assert first.wait(timeout=120) == 0


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (('estimators = ["altitude-free", "ideal"]', 'estimators = ["idael"]'),
         ["suite.estimators", "idael", "one of ideal, "]),
        (("mini-camera.toml", "vis-cmos-512-60dg"), ["camera.file", "one of vis-cmos-512-60deg"]),
        (("500.0", "-500.0"), ["frame[1] (frame-0): platform.altitude_km", "found -500"]),
        (("platform.altitude_km = 500.0", 'platform.altitude_km = 500.0\natmosphere.profile = "tropicl"'),
         ["atmosphere.profile", "tropicl", "one of tropical"]),
        (("[suite]", "[suite"), ["not valid TOML", "line"]),
    ],
)  # fmt: skip
def test_mistakes_in_a_suite_are_told_before_anything_is_rendered(horizonval, mini_suite, tmp_path, change, parts):
    shutil.copy(mini_suite.with_name("mini-camera.toml"), tmp_path)
    suite = tmp_path / "bad.toml"
    suite.write_text(mini_suite.read_text().replace(*change))
    assert_one_line(horizonval("run", suite, "--out", "out"), str(suite), *parts)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_broken_frame_costs_only_itself(program, mini_suite, tmp_path):
    shutil.copy(mini_suite.with_name("mini-camera.toml"), tmp_path)
    # Python loads a file of this name at start, in workers too; the defect it plants is met by one frame only.
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\n"
        "class Saboteur:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'horizonval.renderer.frame':\n"
        "            import horizonval.earth.optical as optical\n"
        "            whole = optical.optical_model\n"
        "            def broken(scene, *rest, **more):\n"
        "                if scene.scene.name == 'frame-3':\n"
        "                    raise ZeroDivisionError('on purpose')\n"
        "                return whole(scene, *rest, **more)\n"
        "            optical.optical_model = broken\n"
        "sys.meta_path.insert(0, Saboteur())\n"
    )
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    done = program("run", mini_suite, "--out", "out", PYTHONPATH=paths)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "frame-3" in done.stderr
    assert "ZeroDivisionError" in done.stderr
    rows = read_results(tmp_path / "out" / "results.parquet")
    assert len(rows) == 12
    assert {(r.case, r.status) for r in rows if r.status == "bad_input"} == {("frame-3", "bad_input")}
    assert all("on purpose" in r.reason for r in rows if r.case == "frame-3")
    # Once the cause is gone, the same command makes what is missing.
    assert program("run", mini_suite, "--out", "out").returncode == 0
    assert not [r for r in read_results(tmp_path / "out" / "results.parquet") if r.status == "bad_input"]
