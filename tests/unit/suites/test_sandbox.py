"""Estimators that hang, eat memory, die or print: each is an outcome, and the next estimate is as if nothing was."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation import registry
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.process.external import camera_file, result_of
from horizonval.estimation.process.sandbox import Limits, Sandbox
from horizonval.geometry.camera import CameraModel
from horizonval.spec.load import load_camera
from horizonval.spec.suite import ProgramSpec

BAD = '''
import ctypes, os, subprocess, sys, time
from horizonval.estimation.observation import Estimator
from horizonval.core.outcome import Outcome
from horizonval.core.outcome import Refusal

def make(name, run):
    return Estimator(name, name, run)

def hang(observation):
    while True:
        time.sleep(1)

def eat(observation):
    kept = []
    while True:
        kept.append(bytearray(2**26))

def die(observation):
    os._exit(3)

def leave(observation):
    raise SystemExit

def chatter(observation):
    for _ in range(1000):
        print("garbage " * 100, flush=True)
    os.write(1, b"x" * 100_000)
    return Refusal(Outcome.DARK, "said enough")

def wrong(observation):
    return {"nadir": 1}

def helped(before):
    """Start a process that holds a lock for ten minutes, and then do something else."""
    def run(observation):
        lock = os.environ["TEST_LOCK"]
        subprocess.Popen([sys.executable, "-c", HELPER, lock])
        while not os.path.exists(lock + ".held"):
            time.sleep(0.01)
        return before(observation)
    return run

HELPER = """
import fcntl, sys, time
lock = open(sys.argv[1], "w")
fcntl.flock(lock, fcntl.LOCK_EX)
open(sys.argv[1] + ".held", "w").close()
time.sleep(600)
"""
HELPED_HANG, HELPED_DIE = make("helped-hang", helped(hang)), make("helped-die", helped(die))
HELPED_ANSWER = make("helped-answer", helped(lambda observation: Refusal(Outcome.DARK, "done")))
HANG, EAT, DIE = make("hang", hang), make("eat", eat), make("die", die)
LEAVE, CHATTER, WRONG = make("leave", leave), make("chatter", chatter), make("wrong", wrong)
'''
NAMES = ("hang", "eat", "die", "leave", "chatter", "wrong", "helped-hang", "helped-die", "helped-answer")
OBSERVATION = Observation(np.full((48, 64), 100.0), CameraModel(64, 48, 55.0, 55.0, 31.5, 23.5), full_scale=1023.0)


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory):
    """A sandbox with a package of bad estimators and with bad programs; one for all tests, which is the point."""
    place = tmp_path_factory.mktemp("plugins")
    (place / "bad_estimators.py").write_text(BAD)
    info = place / "bad_estimators-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: bad-estimators\nVersion: 1.0\n")
    lines = "".join(f"{name} = bad_estimators:{name.upper().replace('-', '_')}\n" for name in NAMES)
    (info / "entry_points.txt").write_text(f"[horizonval.estimators]\n{lines}")
    programs = {
        "garbage": "import sys; sys.stdout.write('no json ' * 10)",
        "endless": "import sys\nwhile True: sys.stdout.write('x' * 65536)",
        "sleeper": "import time; time.sleep(60)",
        "failing": "import sys; print('half'); sys.exit('no ' + sys.argv[1])",
        "honest": "import json,sys\n"
        "assert open(sys.argv[1],'rb').read(4)[1:] == b'PNG'\nassert b'fx = 55.0' in open(sys.argv[2],'rb').read()\n"
        "print(json.dumps({'status':'valid','nadir_cam':[0,0.6,0.8],'sigma_nadir_arcsec':360}))",
    }
    for name, text in programs.items():
        (place / f"{name}.py").write_text(text)
    specs = tuple(ProgramSpec(name=name, command=f"{sys.executable} {name}.py") for name in programs)
    patch = pytest.MonkeyPatch()
    patch.setenv("PYTHONPATH", str(place), prepend=":")
    patch.syspath_prepend(place)
    registry._points.cache_clear()
    found = Sandbox(Limits(time_s=3.0, memory_mb=512, programs=specs, folder=place))
    yield found
    found.close()
    patch.undo()
    registry._points.cache_clear()
    assert "bad_estimators" not in sys.modules


@pytest.mark.parametrize(
    ("name", "status", "reason"),
    [
        ("hang", Outcome.CRASHED, "exceeded its time limit of 3 s"),
        ("eat", Outcome.CRASHED, "MemoryError"),
        ("die", Outcome.CRASHED, "ended with status 3"),
        ("leave", Outcome.CRASHED, "SystemExit"),
        ("chatter", Outcome.DARK, "said enough"),
        ("wrong", Outcome.CRASHED, "it is of type dict"),
        ("garbage", Outcome.CRASHED, "printed no JSON object but b'no json"),
        ("endless", Outcome.CRASHED, "more than a megabyte"),
        ("sleeper", Outcome.CRASHED, "the program exceeded its time limit"),
        ("failing", Outcome.CRASHED, "ended with status 1"),
        ("unheard-of", Outcome.CRASHED, "unknown estimator"),
    ],
)
def test_misbehaviour_is_an_outcome(sandbox, name, status, reason):
    result = sandbox.run(name, OBSERVATION)
    assert isinstance(result, Refusal)
    assert result.status is status
    assert reason in result.reason


@pytest.mark.parametrize("name", ["helped-hang", "helped-die", "helped-answer"])
def test_nothing_that_an_estimator_started_survives_it(sandbox, name, tmp_path, monkeypatch):
    """Whether it is ended, dies, or answers and is closed: the lock that its helper holds is free again."""
    lock = tmp_path / "lock"
    monkeypatch.setenv("TEST_LOCK", str(lock))
    sandbox.close()
    assert isinstance(sandbox.run(name, OBSERVATION), Refusal)
    sandbox.close()
    assert lock.with_name("lock.held").exists()
    deadline = time.monotonic() + 10.0
    with lock.open("w") as file:
        while time.monotonic() < deadline:
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            time.sleep(0.02)
    pytest.fail("the helper still runs")


def test_our_process_is_asked_again_when_something_else_ended_it(sandbox):
    """Stopped, so that it ends during the estimate for certain."""
    first = sandbox.run("altitude-free", OBSERVATION)
    process = sandbox._cell("altitude-free")._process
    os.kill(process.pid, signal.SIGSTOP)
    threading.Timer(0.3, process.kill).start()
    again = sandbox.run("altitude-free", OBSERVATION)
    assert (again.status, repr(again)) == (first.status, repr(first))
    assert again.status is not Outcome.CRASHED


def test_what_was_printed_last_is_kept(sandbox):
    """Of a program both its outputs, without the name of the folder that its files lay in for a moment."""
    assert sandbox.run("failing", OBSERVATION).output == "no .../image.png\nhalf"
    assert "MemoryError" in sandbox.run("eat", OBSERVATION).output
    assert sandbox.run("chatter", OBSERVATION).output == ""


def test_a_program_is_an_estimator(sandbox):
    result = sandbox.run("honest", OBSERVATION)
    assert isinstance(result, Fit)
    assert result.nadir_cam == pytest.approx([0, 0.6, 0.8])
    assert result.roll_rad == pytest.approx(np.arctan2(0.6, 0.8))
    # 360 arcsec rms over two directions: the trace of the covariance is 0.1 deg squared.
    assert np.trace(result.covariance_nadir_cam) == pytest.approx(np.radians(0.1) ** 2)


def test_the_camera_file_reads_back(tmp_path: Path):
    (tmp_path / "c.toml").write_text(camera_file(OBSERVATION))
    camera = load_camera(tmp_path / "c.toml").camera
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (64, 48, 55.0, 55.0, 31.5, 23.5)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (b"[1]", "printed a list"),
        (b'{"status": "fine"}', "'fine' is none of valid"),
        (b'{"status": "valid"}', "cannot be used"),
        (b'{"status": "valid", "nadir_cam": [0, 0, 0]}', "no direction"),
        (b'{"status": "valid", "nadir_cam": [0, 0, NaN]}', "no direction"),
        (b'{"status": "valid", "nadir_cam": [0, 0, 1], "altitude_km": "high"}', "cannot be used"),
        (b"[" * 100_000, "no JSON object"),
    ],
)
def test_wrong_answers_are_refused(answer, reason):
    result = result_of(answer, OBSERVATION)
    assert isinstance(result, Refusal)
    assert reason in result.reason


def test_a_refusal_keeps_its_reason():
    assert result_of(b'{"status": "dark", "reason": "night"}', OBSERVATION) == Refusal(
        Outcome.DARK, "night", pytest.approx(np.empty((0, 2)))
    )
