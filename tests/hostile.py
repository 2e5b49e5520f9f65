"""A hundred plug-ins that do what no estimator should, each in a few lines, installed as packages would be."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass
from pathlib import Path

_MODULE = """
import atexit, builtins, ctypes, gc, json, os, resource, signal, subprocess, sys, threading, time, warnings
import numpy as np
import horizonval as hv
from dataclasses import dataclass
{before}

def fit(**changes):
    across = 1e-6 * np.diag([1.0, 1.0, 0.0])
    fields = dict(nadir_cam=np.array([0.0, 0.0, 1.0]), covariance_nadir_cam=across, roll_rad=0.0, pitch_rad=0.0)
    return hv.Fit(**(fields | changes))

def refuse(reason="as always", **changes):
    return hv.Refusal(**(dict(status=hv.Outcome.NO_LIMB, reason=reason) | changes))

def run(observation):
{body}
    return refuse()

ESTIMATOR = hv.Estimator("hostile", "Hostile", run)
{after}
"""


@dataclass(frozen=True)
class Hostile:
    """What a plug-in does when it is asked, before its function is made, and at the end of its import.

    ``crashes``: whether it can have no other outcome; others may answer, as long as it is they alone who are harmed.
    """

    body: str = "pass"
    before: str = ""
    after: str = ""
    crashes: bool = True


def _raises(what: str, before: str = "") -> Hostile:
    return Hostile(f"raise {what}", before)


def _returns(what: str, before: str = "", crashes: bool = True) -> Hostile:
    return Hostile(f"return {what}", before, crashes=crashes)


def _meddles(body: str, before: str = "", crashes: bool = False) -> Hostile:
    return Hostile(body, before, crashes=crashes)


_MUTE = "class Mute(Exception):\n    def __str__(self):\n        os._exit(0)"
_SLEEPER = "[sys.executable, '-c', 'import os, time; os.setsid(); time.sleep(600)']"

HOSTILE: dict[str, Hostile] = {
    # Exceptions of every kind.
    "raise-value": _raises("ValueError('no')"),
    "raise-exit-0": _raises("SystemExit(0)"),
    "raise-exit-1": _raises("SystemExit(1)"),
    "raise-interrupt": _raises("KeyboardInterrupt"),
    "raise-generator-exit": _raises("GeneratorExit"),
    "raise-stop": _raises("StopIteration"),
    "raise-memory": _raises("MemoryError"),
    "raise-surrogate": _raises("ValueError('\\ud800 <script>')"),
    "raise-long": _raises("ValueError('long ' * 2_000_000)"),
    "raise-mute": _raises("Mute", _MUTE),
    "raise-group": _raises("ExceptionGroup('two', [ValueError(), TypeError()])"),
    "raise-deep": Hostile("return run(observation)"),
    "raise-own-base": _raises("Own", "class Own(BaseException):\n    pass"),
    # Ends of the process.
    "exit-0": Hostile("os._exit(0)"),
    "exit-1": Hostile("os._exit(1)"),
    "exit-255": Hostile("os._exit(255)"),
    "exit-thread": Hostile("threading.Thread(target=os._exit, args=(0,)).start(); time.sleep(5)"),
    "abort": Hostile("os.abort()"),
    "segfault": Hostile("ctypes.string_at(0)"),
    "segfault-stack": Hostile("sys.setrecursionlimit(10**9); f = lambda n: f(n + 1); f(0)"),
    "kill-itself": Hostile("os.kill(os.getpid(), signal.SIGKILL)"),
    "stop-itself": Hostile("os.kill(os.getpid(), signal.SIGSTOP)"),
    "become-true": Hostile("os.execv('/bin/true', ['true'])"),
    "become-false": Hostile("os.execv('/bin/false', ['false'])"),
    # Imports.
    "import-exit": Hostile(before="os._exit(0)"),
    "import-exit-1": Hostile(before="os._exit(1)"),
    "import-raise": Hostile(before="raise ImportError('no')"),
    "import-system-exit": Hostile(before="raise SystemExit(0)"),
    "import-syntax": Hostile(before="this is no python"),
    "import-forever": Hostile(before="while True:\n    time.sleep(1)"),
    "import-missing": Hostile(before="import no_such_module_anywhere"),
    "import-prints": Hostile(before="print('x' * 3_000_000)", crashes=False),
    "import-child": Hostile(before=f"subprocess.Popen({_SLEEPER})", crashes=False),
    "import-thread": Hostile(before="threading.Thread(target=time.sleep, args=(600,)).start()", crashes=False),
    "no-estimator": Hostile(after="ESTIMATOR = 5"),
    "no-needs": Hostile(after="ESTIMATOR = hv.Estimator('h', 'H', run, needs='the truth')"),
    "no-title": Hostile(after="ESTIMATOR = hv.Estimator('h', {'a': np.zeros(5)}, run, estimates=['x'])"),
    # Answers that are none.
    "return-none": _returns("None"),
    "return-dict": _returns("{'nadir': 1}"),
    "return-number": _returns("5"),
    "return-class": _returns("hv.Fit"),
    "reason-number": _returns("refuse(5)"),
    "reason-surrogate": _returns("refuse('half \\udcff of a pair')", crashes=False),
    "reason-controls": _returns("refuse('\\x1b[2J\\x00\\n\\r <b>\\u202e')", crashes=False),
    "reason-long": _returns("refuse('long ' * 5_000_000)", crashes=False),
    "status-valid": _returns("refuse(status=hv.Outcome.VALID)"),
    "status-own": _returns("refuse(status='fine')"),
    "status-evil": _returns("refuse(status=Evil())", "class Evil:\n    def __eq__(self, other):\n        os._exit(0)"),
    "points-flat": _returns("fit(points=np.zeros(3))"),
    "points-three": _returns("fit(points=np.zeros((5, 3)))"),
    "points-text": _returns("fit(points=np.array([['a', 'b']]))"),
    "points-objects": _returns("fit(points=np.array([[None, {}]], dtype=object))"),
    "points-nan": _returns("fit(points=np.full((4, 2), np.nan))"),
    "points-far": _returns("fit(points=np.full((4, 2), 1e300))"),
    "points-many": _returns("fit(points=np.zeros((3_000_000, 2)))"),
    "points-deep": _returns("refuse(points=[[[[[[1]]]]]])"),
    "residuals-many": _returns("fit(residuals_rad=np.zeros(9_000_000))"),
    "steps-flat": _returns("fit(steps=np.zeros(7))"),
    "nadir-nan": _returns("fit(nadir_cam=np.full(3, np.nan))"),
    "nadir-two": _returns("fit(nadir_cam=np.array([0.0, 1.0]))"),
    "nadir-zero": _returns("fit(nadir_cam=np.zeros(3))"),
    "nadir-text": _returns("fit(nadir_cam='down')"),
    "nadir-huge": _returns("fit(nadir_cam=np.full(3, 1e308))"),
    "covariance-nan": _returns("fit(covariance_nadir_cam=np.full((3, 3), np.nan))"),
    "covariance-small": _returns("fit(covariance_nadir_cam=np.zeros((2, 2)))"),
    "covariance-complex": _returns("fit(covariance_nadir_cam=1j * np.eye(3))"),
    "covariance-negative": _returns("fit(covariance_nadir_cam=-np.eye(3))", crashes=False),
    "covariance-tiny": _returns("fit(covariance_nadir_cam=1e-300 * np.eye(3))", crashes=False),
    "roll-none": _returns("fit(roll_rad=None)"),
    "roll-text": _returns("fit(roll_rad='left')"),
    "roll-infinite": _returns("fit(roll_rad=float('inf'))"),
    "altitude-huge": _returns("fit(altitude_m=1e300)"),
    "altitude-array": _returns("fit(altitude_m=np.zeros(3))"),
    "altitude-integer": _returns("fit(altitude_m=10**400)"),
    "array-raises": _returns(
        "fit(points=A())", "class A:\n    def __array__(self, *a, **k):\n        raise SystemExit(0)"
    ),
    "array-hangs": _returns("fit(points=A())", "class A:\n    def __array__(self, *a, **k):\n        time.sleep(600)"),
    "class-lies": _returns(
        "A()", "class A:\n    __class__ = hv.Fit\n    def __getattr__(self, name):\n        return A()"
    ),
    "reduce": _returns("A()", "class A:\n    def __reduce__(self):\n        return os._exit, (0,)"),
    "fit-properties": _returns(
        "A(np.zeros(3), np.eye(3), 0.0, 0.0)",
        "class A(hv.Fit):\n    def __getattribute__(self, name):\n        raise KeyboardInterrupt",
    ),
    # Words and descriptors.
    "print-much": _meddles("for _ in range(3000): print('x' * 1000)"),
    "print-errors": _meddles("sys.stderr.write('y' * 3_000_000)"),
    "print-no-text": _meddles("os.write(2, bytes(range(256)) * 100); raise ValueError", crashes=True),
    "write-everywhere": _meddles(
        "for fd in range(1, 64):\n    try: os.write(fd, b'\\x05' + bytes(7) + b'Alies')\n    except OSError: pass"
    ),
    "close-all": Hostile("os.closerange(0, 256)"),
    "truncate-question": _meddles("for fd in range(3, 64):\n    try: os.ftruncate(fd, 0)\n    except OSError: pass"),
    # What is left changed.
    "change-folder": _meddles("os.chdir('/'); os.umask(0o777); os.environ.clear()"),
    "patch-numpy": _meddles(
        "np.linalg.norm = np.cross = lambda *a, **k: 7.0; np.float64 = float; return fit()", crashes=False
    ),
    "patch-limits": _meddles(
        "import horizonval.scoring.limits as l; l.NADIR_ERROR_LIMIT_RAD = l.SIGMA_LIMIT = 1e9; return fit()",
        "import horizonval.scoring.limits as l; l.NADIR_ERROR_LIMIT_RAD = l.SIGMA_TEST_FLOOR_RAD = 1e9",
    ),
    "patch-json": _meddles("json.dumps = lambda *a, **k: '[' * 100_000; return fit()"),
    "patch-ours": Hostile(
        "from horizonval.plugins import answer\n"
        "from horizonval.plugins import child, registry\n"
        "child.checked = answer.checked = lambda result: result\n"
        "registry.run_safely = lambda *a: None\n"
        "return fit(points=np.zeros(3))"
    ),
    "patch-builtins": _meddles("builtins.open = builtins.len = builtins.isinstance = None"),
    "poison-modules": _meddles("sys.modules.clear(); sys.path.clear()"),
    "raise-on-warnings": _meddles("warnings.simplefilter('error'); np.seterr(all='raise')"),
    "lower-limits": _meddles(
        "[resource.setrlimit(k, (0, 0)) for k in (resource.RLIMIT_NOFILE, resource.RLIMIT_FSIZE, resource.RLIMIT_CPU)]"
    ),
    "lower-memory": _meddles("resource.setrlimit(resource.RLIMIT_AS, (1, 1))"),
    "deaf": _meddles("[signal.signal(n, signal.SIG_IGN) for n in range(1, 30) if n not in (9, 19)]; signal.alarm(1)"),
    "trace": _meddles("sys.settrace(lambda *a: os._exit(0)); sys.setswitchinterval(100)"),
    "at-exit": _meddles("atexit.register(time.sleep, 600); gc.disable()"),
    "thread-stays": _meddles("threading.Thread(target=time.sleep, args=(600,)).start()"),
    # Time and memory.
    "loop": Hostile("while True: pass"),
    "sleep": Hostile("time.sleep(600)"),
    "deadlock": Hostile("lock = threading.Lock(); lock.acquire(); lock.acquire()"),
    "eat": Hostile("kept = []\nwhile True: kept.append(bytearray(2**26))"),
    "eat-at-once": Hostile("np.ones(10**12)"),
    # Processes.
    "child-stays": _meddles(f"subprocess.Popen({_SLEEPER})"),
    "child-deaf": _meddles(
        "pid = os.fork()\nif pid == 0:\n    os.setsid()\n    if os.fork() == 0:\n"
        "        [signal.signal(n, signal.SIG_IGN) for n in (1, 2, 15)]\n"
        "        ctypes.CDLL(None).prctl(1, 0)\n        time.sleep(600)\n    os._exit(0)"
    ),
    "many-children": _meddles("for _ in range(40):\n    if os.fork() == 0:\n        os.setsid(); time.sleep(600)"),
    "child-answers-too": _meddles("os.fork(); return fit()"),
    "kill-parent": Hostile("os.kill(os.getppid(), signal.SIGKILL); time.sleep(5)"),
    "stop-parent": Hostile("os.kill(os.getppid(), signal.SIGSTOP); os._exit(0)"),
    "kill-group": _meddles("os.kill(0, signal.SIGKILL)", crashes=True),
}

STEADY = "steady"
"""A plug-in that does nothing wrong, to be harmed by the others."""
_STEADY = "return fit(altitude_m=float(np.linalg.norm(observation.image)), points=np.ones((3, 2)))"


def install(folder: Path, names: list[str] | tuple[str, ...]) -> None:
    """Lay plug-ins out in a folder as installed packages: modules, and what tells their entry points."""
    for name, plugin in {**{name: HOSTILE[name] for name in names}, STEADY: Hostile(_STEADY)}.items():
        module = "hostile_" + name.replace("-", "_")
        body = textwrap.indent(plugin.body, "    ")
        (folder / f"{module}.py").write_text(_MODULE.format(before=plugin.before, body=body, after=plugin.after))
        info = folder / f"{module}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[horizonval.estimators]\n{name} = {module}:ESTIMATOR\n")
