"""One process of estimators, seen from the worker: ours in one, every other in its own.

The worker trusts nothing that comes from there: lengths are bounded, the answer is held against its form
(:mod:`horizonval.estimation.answer`), and whatever is wrong is a crash of the estimator that was asked.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from typing import IO, Any, Literal

from horizonval.core.outcome import Refusal
from horizonval.estimation.last_words import LONGEST_OUTPUT, crash, one_line
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.process.frames import ANSWER, DESCRIBED, READY, send_all
from horizonval.estimation.process.limits import Limits
from horizonval.estimation.process.wire import LENGTH, LONGEST_ANSWER, pack_observation, unpack_answer

START_LIMIT_S = 300.0
"""For the start, which is not the estimator's fault on a busy machine."""
IMPORT_LIMIT_S = 60.0
"""At least, for the import of a plug-in's package."""
_END_S = 5.0


@dataclass(frozen=True)
class Description:
    """What an estimator says of itself."""

    title: str
    estimates: Literal["geocentric", "geodetic"]
    needs: Literal["image", "pose", "heads"]


class Cell:
    """A process; started when it is needed, again after it was ended.

    Parameters
    ----------
    limits : Limits
    name : str or None
        The one estimator that it runs, of another package or a program; ``None`` for ours.
    """

    def __init__(self, limits: Limits, name: str | None) -> None:
        self._limits, self._name = limits, name
        self._process: subprocess.Popen[bytes] | None = None
        self._private = False
        self._printed = b""
        self._said: Description | Refusal | None = None
        self._question = _file_without_name()

    @property
    def is_open(self) -> bool:
        """Whether there is a process."""
        return self._process is not None

    def describe(self) -> Description | Refusal:
        """Return what the estimator says of itself, asked for once; a crash if it cannot be imported."""
        if self._said is None:
            self._said = self._described()
        return self._said

    def ask(self, name: str, observation: Observation, limit_s: float) -> tuple[Fit | Refusal, float | None]:
        """Return what an estimator makes of an observation, and the processor time if it ended by itself."""
        if self._name is not None and isinstance(said := self.describe(), Refusal):
            return said, None
        length = self._write(observation)
        order = {"do": "run", "name": name, "length": length}
        try:
            try:
                kind, message = self._exchange(order, limit_s)
            except (BrokenPipeError, EOFError):
                if self._name is not None:
                    raise
                # What ended our process may have had nothing to do with this estimate; what has does it again.
                self.close()
                kind, message = self._exchange(order, limit_s)
        except TimeoutError:
            self.close()
            return self._crash(f"the estimator exceeded its time limit of {self._limits.time_s:g} s"), None
        except (OSError, EOFError, ValueError) as e:
            return self._crash(f"the estimator's {self._end(e)}"), None
        if kind != ANSWER:
            return self._crash(f"the estimator's process {message.decode('utf-8', 'replace')}"), None
        try:
            result, spent = unpack_answer(message)
        except ValueError as e:
            return self._crash(f"the estimator's answer cannot be used: {e}"), None
        if isinstance(result, Refusal) and result.output:
            result = crash_with(result, self._printed)
        return result, spent

    def close(self) -> None:
        """End the process and what it started."""
        process, self._process = self._process, None
        if process is None:
            return
        stdin, stdout, stderr = _pipes(process)
        self._printed = (self._printed + _lying_in(stderr.fileno()))[-4 * LONGEST_OUTPUT :]
        with contextlib.suppress(OSError):
            stdin.close()
        if self._name is not None and not self._private:
            # A keeper without a namespace finds its descendants itself, when it is told to end.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_END_S)
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        stdout.close()
        stderr.close()

    def _described(self) -> Description | Refusal:
        try:
            limit = max(self._limits.time_s, IMPORT_LIMIT_S)
            kind, message = self._exchange({"do": "describe"}, limit)
        except TimeoutError:
            self.close()
            return self._crash(f"the estimator cannot be loaded: its import took more than {limit:g} s")
        except (OSError, EOFError, ValueError) as e:
            return self._crash(f"the estimator cannot be loaded: its {self._end(e)}")
        if kind not in (ANSWER, DESCRIBED):
            return self._crash(f"the estimator cannot be loaded: its process {message.decode('utf-8', 'replace')}")
        try:
            if kind == DESCRIBED:
                return _description(json.loads(message))
            result, _ = unpack_answer(message)
        except (ValueError, RecursionError) as e:
            return self._crash(f"the estimator cannot be loaded: it says {e}")
        return crash_with(result, self._printed) if isinstance(result, Refusal) else self._crash("cannot be loaded")

    def _exchange(self, order: dict[str, Any], limit_s: float) -> tuple[bytes, bytes]:
        process = self._process
        if process is None or process.poll() is not None:
            process = self._start()
            if self._name is not None and order["do"] != "describe":
                # A keeper imports first; what it then says was heard before.
                self._send(process, {"do": "describe"})
                self._receive(process, max(self._limits.time_s, IMPORT_LIMIT_S))
        stderr = _pipes(process)[2]
        _lying_in(stderr.fileno())
        self._printed = b""
        self._send(process, order)
        message = self._receive(process, limit_s)
        self._printed = (self._printed + _lying_in(stderr.fileno()))[-4 * LONGEST_OUTPUT :]
        return message[:1], message[1:]

    def _start(self) -> subprocess.Popen[bytes]:
        self.close()
        # One thread for linear algebra, as in every worker: the last bit must not depend on the machine.
        one_thread = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
        kind = "ours" if self._name is None else "foreign"
        process = self._process = subprocess.Popen(
            [sys.executable, "-m", "horizonval.estimation.process.estimator_process", kind, str(self._question)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=os.environ | one_thread,
            start_new_session=True,
            pass_fds=[self._question],
        )
        os.set_blocking(_pipes(process)[2].fileno(), False)
        programs = [spec.model_dump(mode="json") for spec in self._limits.programs if spec.name == self._name]
        self._send(
            process,
            {
                "time_s": self._limits.time_s,
                "memory_mb": self._limits.memory_mb,
                "programs": programs,
                "folder": str(self._limits.folder),
                "hidden": [str(path) for path in self._limits.hidden],
            },
        )
        if self._name is not None:
            self._send(process, {"name": self._name})
        ready = self._receive(process, START_LIMIT_S)
        if ready[:1] != READY:
            raise EOFError
        if self._name is not None:
            granted = json.loads(ready[1:])
            self._private = granted["private"] is True
            if self._limits.hidden and granted["hidden"] is not True:
                raise EOFError("this system hides no folder from it")
        return process

    def _write(self, observation: Observation) -> int:
        place = 0
        for part in pack_observation(observation):
            view = memoryview(part)
            while view:
                count = os.pwrite(self._question, view, place)
                view, place = view[count:], place + count
        return place

    def _send(self, process: subprocess.Popen[bytes], order: dict[str, Any]) -> None:
        data = json.dumps(order).encode()
        send_all(_pipes(process)[0].fileno(), LENGTH.pack(len(data)) + data)

    def _receive(self, process: subprocess.Popen[bytes], limit_s: float) -> bytes:
        deadline = time.monotonic() + limit_s
        (length,) = LENGTH.unpack(self._read(process, LENGTH.size, deadline))
        if length > LONGEST_ANSWER:
            raise EOFError
        return self._read(process, length, deadline)

    def _read(self, process: subprocess.Popen[bytes], length: int, deadline: float) -> bytes:
        _, stdout, stderr = _pipes(process)
        data = bytearray()
        pipes = [stdout, stderr]
        while len(data) < length:
            left_s = deadline - time.monotonic()
            ready, _, _ = select.select(pipes, [], [], max(0.0, left_s))
            if not ready or left_s < 0.0:
                raise TimeoutError
            if stderr in ready:
                printed = _once(stderr.fileno())
                self._printed = (self._printed + (printed or b""))[-4 * LONGEST_OUTPUT :]
                if printed is None:
                    pipes = [stdout]
            if stdout in ready:
                chunk = os.read(stdout.fileno(), min(length - len(data), 1 << 20))
                if not chunk:
                    raise EOFError
                data += chunk
        return bytes(data)

    def _end(self, error: Exception) -> str:
        """End the process after an error; return how it ended, as the end of a sentence."""
        process = self._process
        if process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(1.0)
        code = None if process is None else process.returncode
        self.close()
        if code is not None and code < 0:
            name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
            return f"process died, by {name} (a crash, or out of memory)"
        return "process died (a crash, or out of memory)" if code is not None else f"process is lost ({error})"

    def _crash(self, reason: str) -> Refusal:
        return crash(reason, self._printed)


def _pipes(process: subprocess.Popen[bytes]) -> tuple[IO[bytes], IO[bytes], IO[bytes]]:
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    return process.stdin, process.stdout, process.stderr


def crash_with(refusal: Refusal, printed: bytes) -> Refusal:
    """Return a crash with what was printed before its traceback."""
    return crash(
        refusal.reason, printed.rstrip() + b"\n" + refusal.output.encode() if printed.strip() else refusal.output
    )


def _description(said: object) -> Description:
    if not isinstance(said, dict) or not isinstance(said.get("title"), str):
        raise ValueError("no title that is text")
    for key, words in (("estimates", ("geocentric", "geodetic")), ("needs", ("image", "pose", "heads"))):
        if said.get(key) not in words:
            raise ValueError(f"{key} that is none of {', '.join(words)}")
    return Description(one_line(said["title"]), said["estimates"], said["needs"])


def _file_without_name() -> int:
    if hasattr(os, "memfd_create"):
        return os.memfd_create("observation")
    descriptor, path = tempfile.mkstemp(prefix="horizonval-")
    os.unlink(path)
    return descriptor


def _once(descriptor: int) -> bytes | None:
    try:
        return os.read(descriptor, 1 << 16) or None
    except BlockingIOError:
        return b""


def _lying_in(descriptor: int) -> bytes:
    """Return the end of what lies in a pipe, but for what comes faster than it is read."""
    data = b""
    for _ in range(64):
        more = _once(descriptor)
        if not more:
            break
        data = (data + more)[-4 * LONGEST_OUTPUT :]
    return data
