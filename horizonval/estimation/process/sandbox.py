"""Estimators run in a process of their own, beside the worker: one that hangs or eats memory is ended, not the run.

The process is started once and asked again and again: an estimate costs the copy of its image through a pipe (2 ms for
512 x 512), not a start. Its standard output goes nowhere, so that an estimator may print what it likes. It ends with
its worker, however that ends.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from horizonval.core.refusal import Refusal
from horizonval.estimation.last_words import crash
from horizonval.estimation.observation import Fit, Observation
from horizonval.spec.suite import ProgramSpec

START_LIMIT_S = 300.0
"""For the start, which is not the estimator's fault on a busy machine."""
LONGEST_ANSWER = 1 << 28
HEADER = struct.Struct("<Q")


@dataclass(frozen=True)
class Limits:
    """What an estimate may use, and the programs that are estimators here.

    Attributes
    ----------
    time_s : float
        Wall-clock time of one estimate.
    memory_mb : int
        Address space beyond what the process has before its first estimate.
    programs : tuple of ProgramSpec
    folder : Path
        Relative paths of programs start here.
    """

    time_s: float = 60.0
    memory_mb: int = 4096
    programs: tuple[ProgramSpec, ...] = ()
    folder: Path = Path()


class Sandbox:
    """The process; started when it is needed, again after it was ended."""

    spent_s: float | None = None
    """Processor time of the last estimate, programs that it ran included; ``None`` if it did not end by itself."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._process: subprocess.Popen[bytes] | None = None

    def run(self, name: str, observation: Observation) -> Fit | Refusal:
        """Return what the estimator of a name makes of an observation."""
        process = self._process if self._process is not None and self._process.poll() is None else self._start()
        if process is None:
            return crash("the process of the estimators cannot be started")
        # A program's own limit comes first and says more.
        self.spent_s = None
        limit = self._limits.time_s + (5.0 if name in {p.name for p in self._limits.programs} else 0.0)
        try:
            _send(process, pickle.dumps((name, observation), protocol=pickle.HIGHEST_PROTOCOL))
            answer = _receive(process, limit)
        except TimeoutError:
            self.close()
            return crash(f"the estimator exceeded its time limit of {self._limits.time_s:g} s")
        except (OSError, EOFError):
            self.close()
            return crash("the estimator's process died (a crash, or out of memory)")
        try:
            result, spent = pickle.loads(answer)
        except Exception as e:
            return crash(f"the estimator's result cannot be read: {type(e).__name__}")
        self.spent_s = float(spent)
        return result if isinstance(result, Fit | Refusal) else crash("the estimator returned no result")

    def close(self) -> None:
        """End the process and what it started."""
        process, self._process = self._process, None
        if process is None:
            return
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):
                    pipe.close()

    def _start(self) -> subprocess.Popen[bytes] | None:
        self.close()
        # One thread for linear algebra, as in every worker: the last bit must not depend on the machine.
        one_thread = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "horizonval.estimation.process.estimator_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | one_thread,
            start_new_session=True,
        )
        try:
            _send(self._process, pickle.dumps(self._limits))
            _receive(self._process, START_LIMIT_S)
        except (OSError, EOFError, TimeoutError):
            self.close()
        return self._process


_open: dict[Limits, Sandbox] = {}


def sandbox_of(limits: Limits) -> Sandbox:
    """Return this process's sandbox with these limits."""
    if limits not in _open:
        _open[limits] = Sandbox(limits)
        atexit.register(_open[limits].close)
    return _open[limits]


def _send(process: subprocess.Popen[bytes], data: bytes) -> None:
    assert process.stdin is not None
    process.stdin.write(HEADER.pack(len(data)))
    process.stdin.write(data)
    process.stdin.flush()


def _receive(process: subprocess.Popen[bytes], limit_s: float) -> bytes:
    deadline = time.monotonic() + limit_s
    (length,) = HEADER.unpack(_read(process, HEADER.size, deadline))
    if length > LONGEST_ANSWER:
        raise EOFError
    return _read(process, length, deadline)


def _read(process: subprocess.Popen[bytes], length: int, deadline: float) -> bytes:
    assert process.stdout is not None
    found = bytearray()
    while len(found) < length:
        ready, _, _ = select.select([process.stdout], [], [], max(0.0, deadline - time.monotonic()))
        if not ready:
            raise TimeoutError
        chunk = os.read(process.stdout.fileno(), min(length - len(found), 1 << 20))
        if not chunk:
            raise EOFError
        found += chunk
    return bytes(found)
