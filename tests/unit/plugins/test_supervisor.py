"""Estimators that hang, eat memory, die or print: each is an outcome, and the next estimate is as if nothing was."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import sys
import threading
import time

import numpy as np
import psutil
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Fit, Observation
from horizonval.geometry.camera import CameraModel
from horizonval.plugins import registry, supervisor
from horizonval.plugins.supervisor import Limits, Supervisor
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

def loop(observation):
    while True:
        pass

def hand_on(observation):
    """Have other processes use the time, one after the other."""
    while True:
        subprocess.run([sys.executable, "-S", "-c", "for _ in range(2 * 10**6): pass"])

def work(observation):
    while time.process_time() < 0.4:
        pass
    return Refusal(Outcome.DARK, "done")

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
LOOP, HAND_ON, WORK = make("loop", loop), make("hand-on", hand_on), make("work", work)
LEAVE, CHATTER, WRONG = make("leave", leave), make("chatter", chatter), make("wrong", wrong)
'''
NAMES = (
    "hang", "eat", "die", "leave", "chatter", "wrong", "helped-hang", "helped-die", "helped-answer",
    "loop", "hand-on", "work",
)  # fmt: skip
OBSERVATION = Observation(np.full((48, 64), 100.0), CameraModel(64, 48, 55.0, 55.0, 31.5, 23.5), full_scale=1023.0)


@pytest.fixture(scope="module")
def processes(tmp_path_factory: pytest.TempPathFactory):
    """A supervisor of a package of bad estimators and of bad programs; one for all tests, which is the point."""
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
        "burner": "while True: pass",
        "sleeper": "import os, time; os.close(1); time.sleep(600)",
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
    found = Supervisor(Limits(time_s=2.0, memory_mb=256, programs=specs, folder=place))
    yield found
    found.close()
    patch.undo()
    registry._points.cache_clear()
    assert "bad_estimators" not in sys.modules


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch):
    """Return what shortens the limit by the clock."""

    def hurry() -> None:
        monkeypatch.setattr(supervisor, "CLOCK_FACTOR", 1.5)
        monkeypatch.setattr(supervisor, "LEAST_CLOCK_S", 0.0)

    return hurry


@pytest.mark.parametrize(
    ("name", "status", "reason"),
    [
        ("hang", Outcome.CRASHED, "2 s: it did not use them within 3 s by the clock"),
        ("loop", Outcome.CRASHED, "exceeded its time limit of 2 s of processor time"),
        ("hand-on", Outcome.CRASHED, "of processor time"),
        ("burner", Outcome.CRASHED, "of processor time"),
        ("eat", Outcome.CRASHED, "MemoryError"),
        ("die", Outcome.CRASHED, "ended with status 3"),
        ("leave", Outcome.CRASHED, "SystemExit"),
        ("chatter", Outcome.DARK, "said enough"),
        ("wrong", Outcome.CRASHED, "it is of type dict"),
        ("garbage", Outcome.CRASHED, "printed no JSON object but b'no json"),
        ("endless", Outcome.CRASHED, "more than a megabyte"),
        ("sleeper", Outcome.CRASHED, "by the clock"),
        ("failing", Outcome.CRASHED, "ended with status 1"),
        ("unheard-of", Outcome.CRASHED, "unknown estimator"),
    ],
)
def test_misbehaviour_is_an_outcome(processes, hurried, name, status, reason):
    if "by the clock" in reason:
        hurried()
    result = processes.run(name, OBSERVATION)
    assert isinstance(result, Refusal)
    assert result.status is status
    assert reason in result.reason


@pytest.mark.parametrize("name", ["helped-hang", "helped-die", "helped-answer"])
def test_nothing_that_an_estimator_started_survives_it(processes, hurried, name, tmp_path, monkeypatch):
    """Whether it is ended, dies, or answers and is closed: the lock that its helper holds is free again."""
    lock = tmp_path / "lock"
    monkeypatch.setenv("TEST_LOCK", str(lock))
    processes.close()
    hurried()
    monkeypatch.setattr(supervisor, "IMPORT_LIMIT_S", 300.0)
    assert isinstance(processes.run(name, OBSERVATION), Refusal)
    processes.close()
    assert lock.with_name("lock.held").exists()
    deadline = time.monotonic() + 10.0
    with lock.open("w") as file:
        while time.monotonic() < deadline:
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            time.sleep(0.02)
    pytest.fail("the helper still runs")


def test_an_estimate_that_hardly_gets_the_processor_is_not_ended(processes, monkeypatch):
    """It needs a fifth of its limit of processor time, and gets a tenth of a core: by the clock twice the limit."""
    assert processes.run("work", OBSERVATION).status is Outcome.DARK
    process, done = processes._process("work")._process, threading.Event()

    def starve() -> None:
        root = psutil.Process(process.pid)
        while not done.is_set():
            for stopped in root.children(recursive=True):
                with contextlib.suppress(psutil.Error):
                    stopped.suspend()
                    time.sleep(0.09)
                    stopped.resume()
            time.sleep(0.01)

    thread = threading.Thread(target=starve)
    thread.start()
    start = time.monotonic()
    result = processes.run("work", OBSERVATION)
    elapsed_s = time.monotonic() - start
    done.set()
    thread.join()
    assert (result.status, result.reason) == (Outcome.DARK, "done")
    assert elapsed_s > 2.0


def test_our_process_is_asked_again_when_something_else_ended_it(processes):
    """Stopped, so that it ends during the estimate for certain."""
    first = processes.run("altitude-free", OBSERVATION)
    process = processes._process("altitude-free")._process
    os.kill(process.pid, signal.SIGSTOP)
    threading.Timer(0.3, process.kill).start()
    again = processes.run("altitude-free", OBSERVATION)
    assert (again.status, repr(again)) == (first.status, repr(first))
    assert again.status is not Outcome.CRASHED


def test_what_was_printed_last_is_kept(processes):
    """Of a program both its outputs, without the name of the folder that its files lay in for a moment."""
    assert processes.run("failing", OBSERVATION).output == "no .../image.png\nhalf"
    assert "MemoryError" in processes.run("eat", OBSERVATION).output
    assert processes.run("chatter", OBSERVATION).output == ""


def test_a_program_is_an_estimator(processes):
    result = processes.run("honest", OBSERVATION)
    assert isinstance(result, Fit)
    assert result.nadir_cam == pytest.approx([0, 0.6, 0.8])
    assert result.roll_rad == pytest.approx(np.arctan2(0.6, 0.8))
    # 360 arcsec rms over two directions: the trace of the covariance is 0.1 deg squared.
    assert np.trace(result.covariance_nadir_cam) == pytest.approx(np.radians(0.1) ** 2)
