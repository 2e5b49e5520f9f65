"""The process that runs estimators for a worker; see :mod:`horizonval.estimation.process.sandbox`.

It reads pickled pairs of a name and an observation and writes pickled results, each behind its length. Nothing but its
worker can speak to it.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import sys
import threading
import time
from typing import IO

from horizonval.core.errors import UserError
from horizonval.core.refusal import Refusal
from horizonval.estimation import registry
from horizonval.estimation.last_words import crash
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.estimation.process.external import external
from horizonval.estimation.process.sandbox import HEADER, Limits


def main() -> None:
    """Answer until the worker closes the pipe."""
    requests, answers = _take_pipes()
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    limits: Limits = pickle.loads(_receive(requests))
    _prepare(limits)
    programs = {spec.name: external(spec, limits.folder, limits.time_s) for spec in limits.programs}
    _send(answers, b"ready")
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            name, observation = pickle.loads(_receive(requests))
            # The worker ends an estimate in time; this is for one that outlives a killed worker inside foreign code.
            signal.setitimer(signal.ITIMER_REAL, 2 * limits.time_s + 60)
            start = _processor_s()
            result = _run(name, observation, programs)
            spent = _processor_s() - start
            signal.setitimer(signal.ITIMER_REAL, 0)
            _send(answers, _pickled(result, spent))


def _run(name: str, observation: Observation, programs: dict[str, Estimator]) -> Fit | Refusal:
    try:
        estimator = programs[name] if name in programs else registry.get(name)
    except UserError as e:
        return crash(e.line())
    return registry.run_safely(estimator, observation)


def _processor_s() -> float:
    """Return the processor time of this process and of the programs that it ran."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def _pickled(result: Fit | Refusal, spent_s: float) -> bytes:
    try:
        return pickle.dumps((result, spent_s), protocol=pickle.HIGHEST_PROTOCOL)
    except Exception as e:
        reason = f"the estimator's result cannot be handed on: {type(e).__name__}: {e}"
        return pickle.dumps((crash(reason), spent_s))


def _prepare(limits: Limits) -> None:
    import cv2

    cv2.setNumThreads(1)
    try:
        import resource

        with open("/proc/self/statm") as file:
            used = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        most = used + limits.memory_mb * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    except (ImportError, OSError, ValueError):
        # Without Linux's limits memory is the user's care, as for every other program.
        return


def _take_pipes() -> tuple[IO[bytes], IO[bytes]]:
    """Return the pipes, and put nothing in their places: what an estimator prints must not be taken for an answer."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    return requests, answers


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def _receive(pipe: IO[bytes]) -> bytes:
    header = pipe.read(HEADER.size)
    if len(header) < HEADER.size:
        raise EOFError
    (length,) = HEADER.unpack(header)
    return pipe.read(length)


def _send(pipe: IO[bytes], data: bytes) -> None:
    pipe.write(HEADER.pack(len(data)) + data)
    pipe.flush()


if __name__ == "__main__":
    main()
    sys.exit(0)
