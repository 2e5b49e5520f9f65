"""Estimators in supervised processes: hanging, excessive memory and crashes are outcomes and do not end the run.

Methods of this package share one process. Every third-party estimator and every program has a separate process
(:mod:`horizonval.plugins.child`). All end with the worker.

**Time.** An estimate has a limit of *processor time*, including its child processes, so that the outcome does not
depend on the machine's load. For sleeping processes the wall clock decides: :data:`CLOCK_FACTOR` times the limit, or
:data:`LEAST_CLOCK_S` if longer. The same limit applies to methods, plug-ins and programs.

**Memory.** The address space of each process is limited relative to its size before the first estimate.

The worker trusts no output of a process: lengths are bounded, the form of answers is validated
(:mod:`horizonval.plugins.answer`), and any defect counts as a crash of the estimator.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

import psutil

from horizonval.core.outcome import Refusal
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.plugins import registry
from horizonval.plugins.answer import LONGEST_OUTPUT, crash, one_line
from horizonval.plugins.child import end_descendants
from horizonval.plugins.messages import read_answer, write_observation
from horizonval.spec.suite import ProgramSpec

IMPORT_LIMIT_S = 60.0
"""Minimum processor time for starting a process and importing a plug-in."""
CLOCK_FACTOR, LEAST_CLOCK_S = 10.0, 60.0
"""Ratio of the wall-clock limit to that of processor time, and its minimum [s]."""
_POLL_S = (0.05, 1.0)
"""Shortest and longest interval between measurements of the processor time, which take some milliseconds."""
_LONGEST_LINE = 1 << 16
_ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""Single-threaded linear algebra keeps the last bit independent of the machine; hiding folders needs it too."""
_MOST_PROCESSES = 16
"""Maximum number of third-party processes, each of some 50 MB; the least recently used ends first."""


@dataclass(frozen=True)
class Limits:
    """Limits of an estimate, and the programs that are estimators here.

    ``time_s``: processor time of one estimate, including child processes. ``memory_mb``: address space beyond the size
    before the first estimate. ``folder``: base of the programs' paths. ``hidden``: files and folders that third-party
    estimators and programs must not read; they then are contained (:func:`horizonval.plugins.namespaces`), and do
    not run if the system does not permit it.
    """

    time_s: float = 60.0
    memory_mb: int = 4096
    programs: tuple[ProgramSpec, ...] = ()
    folder: Path = Path()
    hidden: tuple[Path, ...] = ()


def get(name: str, limits: Limits | None = None) -> Estimator:
    """Return an estimator by name: those of this package directly, others as a proxy of their process.

    An estimator that cannot be imported crashes on every image. Raises ``UserError``: no such estimator.
    """
    limits = limits or Limits()
    run = partial(_run, name, limits)
    for program in limits.programs:
        if program.name == name:
            return Estimator(name, program.command, run, estimates=program.estimates)
    if not registry.is_foreign(name):
        return registry.get(name)
    said = supervisor_of(limits).describe(name)
    return Estimator(name, name, run) if isinstance(said, Refusal) else Estimator(name, run=run, **said)


def _run(name: str, limits: Limits, observation: Observation) -> Fit | Refusal:
    return supervisor_of(limits).run(name, observation)


def can_hide() -> bool:
    """Whether this system can hide folders from a process, tested with an empty one."""
    with tempfile.TemporaryDirectory() as folder:
        code = (
            "import os, sys; from horizonval.plugins.namespaces import apart, contain; "
            "sys.exit(not contain(sys.argv[1:]) or apart(int, os.memfd_create('exchange'), sys.argv[1]))"
        )
        tried = subprocess.run([sys.executable, "-c", code, folder], capture_output=True, env=os.environ | _ONE_THREAD)
    return tried.returncode == 0


class Supervisor:
    """The processes of one set of limits, started on demand."""

    spent_s: float | None = None
    """Processor time of the last estimate, including child processes; None if it was ended."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._processes: dict[str | None, _Process] = {}

    def run(self, name: str, observation: Observation) -> Fit | Refusal:
        """Return the answer of an estimator to an observation."""
        result, self.spent_s = self._process(name).ask(name, observation, self._limits.time_s)
        return result

    def describe(self, name: str) -> dict[str, Any] | Refusal:
        """Return the description of a third-party estimator; a crash if it cannot be imported."""
        return self._process(name).describe()

    def close(self) -> None:
        """End the processes and their descendants."""
        for process in self._processes.values():
            process.close()

    def _process(self, name: str) -> _Process:
        foreign = registry.is_foreign(name) or any(program.name == name for program in self._limits.programs)
        key = name if foreign else None
        process = self._processes.pop(key, None) or _Process(self._limits, key)
        self._processes[key] = process
        others = [other for key, other in self._processes.items() if key is not None and other.is_open]
        for other in others[:-_MOST_PROCESSES]:
            other.close()
        return process


_open: dict[Limits, Supervisor] = {}


def supervisor_of(limits: Limits) -> Supervisor:
    """Return this process's supervisor with these limits."""
    if limits not in _open:
        _open[limits] = Supervisor(limits)
        atexit.register(_open[limits].close)
    return _open[limits]


class _Process:
    """A process of estimators, started on demand; ``name``: third-party estimator or program, None for ours."""

    def __init__(self, limits: Limits, name: str | None) -> None:
        self._limits, self._name = limits, name
        self._process: subprocess.Popen[bytes] | None = None
        self._scratch: tempfile.TemporaryDirectory[str] | None = None
        self._printed = b""
        self._said: dict[str, Any] | Refusal | None = None
        self._exchange = _file_without_name()
        self._import_s = 0.0
        """Processor time of an import that every estimate repeats, which its limit does not count."""

    @property
    def is_open(self) -> bool:
        return self._process is not None

    def describe(self) -> dict[str, Any] | Refusal:
        """Return the cached description of the estimator; a crash if it cannot be imported."""
        if self._said is None:
            self._said = self._described()
        return self._said

    def ask(self, name: str, observation: Observation, limit_s: float) -> tuple[Fit | Refusal, float | None]:
        """Return the answer to an observation, and its processor time unless the process was ended."""
        if self._name is not None and isinstance(said := self.describe(), Refusal):
            return said, None
        try:
            try:
                status = self._asked(name, observation, limit_s)
            except (BrokenPipeError, EOFError):
                if self._name is not None:
                    raise
                # The process may have died for another reason; a defect of this estimate will recur.
                self.close()
                status = self._asked(name, observation, limit_s)
        except TimeoutError as e:
            self.close()
            return crash(f"the estimator exceeded its time limit of {e}", self._printed), None
        except (OSError, EOFError, ValueError) as e:
            return crash(f"the estimator's process {self._end(e)}", self._printed), None
        except BaseException:
            # Interrupted: a late answer must not count for the next observation.
            self.close()
            raise
        if status != 0:
            return crash(f"the estimator's process {_how(status)}", self._printed), None
        try:
            result, spent = read_answer(self._exchange)
        except ValueError as e:
            return crash(f"the estimator's answer cannot be used: {e}", self._printed), None
        return self._with_printed(result) if isinstance(result, Refusal) else result, spent

    def close(self) -> None:
        """End the process and its descendants."""
        process, self._process = self._process, None
        if process is None:
            return
        stdin, stdout, stderr = _pipes(process)
        self._drain(stderr)
        if process.poll() is None:
            with contextlib.suppress(psutil.Error):
                root = psutil.Process(process.pid)
                # A stopped process still adopts orphans but starts nothing.
                root.suspend()
                end_descendants(root)
        _end_session(process.pid)
        process.wait()
        for pipe in (stdin, stdout, stderr):
            with contextlib.suppress(OSError):
                pipe.close()
        if self._scratch is not None:
            self._scratch.cleanup()
            self._scratch = None

    def _described(self) -> dict[str, Any] | Refusal:
        try:
            said = self._start()
            if "failed" not in said:
                return _description(said)
            result, _ = read_answer(self._exchange)
            self.close()
            return self._with_printed(result) if isinstance(result, Refusal) else crash("it cannot be loaded")
        except TimeoutError as e:
            self.close()
            return crash(f"the estimator cannot be loaded: its import took more than {e}", self._printed)
        except (ValueError, RecursionError) as e:
            self.close()
            return crash(f"the estimator cannot be loaded: it says {e}", self._printed)
        except (OSError, EOFError) as e:
            return crash(f"the estimator cannot be loaded: its process {self._end(e)}", self._printed)

    def _asked(self, name: str, observation: Observation, limit_s: float) -> int:
        """Send an observation; return the exit code of the answering process, negative for a signal."""
        if self._process is None or self._process.poll() is not None:
            self._start()
        assert self._process is not None
        self._drain(_pipes(self._process)[2])
        self._printed = b""
        if self._name is not None:
            # Whatever it says that it needs, third-party code never receives the truth.
            observation = replace(observation, oracle=None)
        length = write_observation(self._exchange, observation)
        self._send({"name": name, "length": length})
        status = self._receive(limit_s, self._import_s).get("status")
        if not isinstance(status, int):
            raise ValueError("sent no status")
        return status

    def _start(self) -> dict[str, Any]:
        """Start the process; return the description of its estimator after the import."""
        self.close()
        self._printed = b""
        self._scratch = tempfile.TemporaryDirectory(prefix="horizonval-", ignore_cleanup_errors=True)
        # Contained code finds its usual caches read-only.
        caches = dict.fromkeys(("XDG_CACHE_HOME", "NUMBA_CACHE_DIR"), self._scratch.name) if self._limits.hidden else {}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "horizonval.plugins.child", str(self._exchange)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # Temporary files of an ended estimate are deleted with the process.
            env=os.environ | _ONE_THREAD | {"TMPDIR": self._scratch.name} | caches,
            start_new_session=True,
            pass_fds=[self._exchange],
        )
        os.set_blocking(_pipes(self._process)[2].fileno(), False)
        programs = [program for program in self._limits.programs if program.name == self._name]
        self._send(
            {
                "name": self._name,
                "memory_mb": self._limits.memory_mb,
                "program": programs[0].model_dump(mode="json") if programs else None,
                "folder": str(self._limits.folder),
                "hidden": [str(path) for path in self._limits.hidden],
            }
        )
        said = self._receive(max(self._limits.time_s, IMPORT_LIMIT_S))
        if said.get("hides") is False:
            raise EOFError("this system hides no folder from it")
        if self._limits.hidden and self._name is not None:
            self._import_s = processor_s(psutil.Process(self._process.pid))
        return said

    def _send(self, order: dict[str, Any]) -> None:
        assert self._process is not None
        stdin = _pipes(self._process)[0]
        stdin.write(json.dumps(order).encode() + b"\n")
        stdin.flush()

    def _receive(self, limit_s: float, import_s: float = 0.0) -> dict[str, Any]:
        """Return the next line of the process; ``import_s`` of its processor time do not count.

        Raises ``TimeoutError``: processor time or wall clock exceeded, with the limit. Raises ``EOFError``: the process
        has ended. Raises ``ValueError``: the line is not a JSON object.
        """
        assert self._process is not None
        _, stdout, stderr = _pipes(self._process)
        root = psutil.Process(self._process.pid)
        # A scan for descendants takes milliseconds; before an estimate there are at most helpers from the import.
        before_s, clock_s = _own_s(root), max(CLOCK_FACTOR * (limit_s + import_s), LEAST_CLOCK_S)
        now = time.monotonic()
        end, poll_at = now + clock_s, now + _poll_s(limit_s)
        line, pipes = bytearray(), [stdout, stderr]
        while not line.endswith(b"\n"):
            ready, _, _ = select.select(pipes, [], [], max(0.0, min(poll_at, end) - now))
            if stderr in ready and not self._drain(stderr):
                pipes = [stdout]
            if stdout in ready:
                chunk = os.read(stdout.fileno(), _LONGEST_LINE)
                line += chunk
                if not chunk or len(line) > _LONGEST_LINE:
                    raise EOFError
            now = time.monotonic()
            if now >= poll_at:
                left_s = limit_s + import_s - (processor_s(root) - before_s)
                if left_s <= 0.0:
                    raise TimeoutError(f"{limit_s:g} s of processor time")
                poll_at = now + _poll_s(left_s)
            if now >= end:
                raise TimeoutError(f"{limit_s:g} s: it did not use them within {clock_s:g} s by the clock")
        self._drain(stderr)
        said = json.loads(line)
        if not isinstance(said, dict):
            raise ValueError("sent no JSON object")
        return said

    def _drain(self, stderr: IO[bytes]) -> bool:
        """Keep the end of the output, unless it comes faster than it is read; return whether more may follow."""
        for _ in range(64):
            try:
                data = os.read(stderr.fileno(), 1 << 16)
            except BlockingIOError:
                return True
            if not data:
                return False
            self._printed = (self._printed + data)[-4 * LONGEST_OUTPUT :]
        return True

    def _end(self, error: Exception) -> str:
        """End the process after an error; return how it ended, as the end of a sentence."""
        process = self._process
        if process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(1.0)
        code = None if process is None else process.returncode
        self.close()
        return f"is lost ({error})" if code is None else _how(code)

    def _with_printed(self, refusal: Refusal) -> Refusal:
        """Prepend the printed output to the traceback of a crash."""
        if not refusal.output or not self._printed.strip():
            return refusal
        return crash(refusal.reason, self._printed.rstrip() + b"\n" + refusal.output.encode())


def processor_s(process: psutil.Process) -> float:
    """Return the processor time [s] of a process and its descendants (of finished ones on Linux only)."""
    with contextlib.suppress(psutil.Error):
        return sum(map(_own_s, (process, *process.children(recursive=True))))
    return 0.0


def _own_s(process: psutil.Process) -> float:
    with contextlib.suppress(psutil.Error):
        times = process.cpu_times()
        return float(times.user + times.system + times.children_user + times.children_system)
    return 0.0


def _end_session(session: int) -> None:
    """Kill the remaining processes of a session, whatever their parent."""
    for pid in psutil.pids():
        with contextlib.suppress(OSError):
            if os.getsid(pid) == session:
                os.kill(pid, signal.SIGKILL)


def _poll_s(left_s: float) -> float:
    """Return the time to the next measurement: no longer than all cores need for the remaining processor time."""
    return min(max(left_s / (os.cpu_count() or 1), _POLL_S[0]), _POLL_S[1])


def _how(code: int) -> str:
    """Return how a process ended, from its exit code, as the end of a sentence."""
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
        return f"was ended by {name} (a crash, or out of memory)"
    return f"ended with status {code} and without an answer"


def _pipes(process: subprocess.Popen[bytes]) -> tuple[IO[bytes], IO[bytes], IO[bytes]]:
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    return process.stdin, process.stdout, process.stderr


def _description(said: dict[str, Any]) -> dict[str, Any]:
    if not isinstance(said.get("title"), str):
        raise ValueError("no title that is text")
    known = {
        "estimates": ("geocentric", "geodetic"),
        # Third-party code never receives the pose.
        "needs": ("image", "heads"),
        "claim": ("cone", "likelihood"),
    }
    for key, words in known.items():
        if said.get(key) not in words:
            raise ValueError(f"{key} that is none of {', '.join(words)}")
    return {"title": one_line(said["title"])} | {key: said[key] for key in known}


def _file_without_name() -> int:
    if hasattr(os, "memfd_create"):
        return os.memfd_create("horizonval")
    descriptor, path = tempfile.mkstemp(prefix="horizonval-")
    os.unlink(path)
    return descriptor
