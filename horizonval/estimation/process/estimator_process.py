"""The process that runs estimators for a worker; see :mod:`horizonval.estimation.process.sandbox`.

Ours run in it one after the other. For one of another package, or a program, it is the keeper of processes that run it:
:mod:`horizonval.estimation.process.keeper`. What estimators print goes to standard error, which the worker reads.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import IO, Any

from horizonval.core.errors import UserError
from horizonval.core.outcome import Refusal
from horizonval.estimation import registry
from horizonval.estimation.last_words import crash
from horizonval.estimation.observation import Estimator
from horizonval.estimation.process import asked, keeper
from horizonval.estimation.process.containment import end_with_parent, hide, own_namespace, show_own_processes
from horizonval.estimation.process.frames import ANSWER, READY, receive, send
from horizonval.estimation.process.limits import Limits, limit_memory
from horizonval.spec.suite import ProgramSpec


def main(kind: str, question: int) -> None:
    """Answer until the worker closes the pipe.

    Parameters
    ----------
    kind : {"ours", "foreign"}
    question : int
        Descriptor of the file in which observations come.
    """
    requests, answers = _take_pipes()
    if kind == "foreign":
        _keep(requests, answers, question)
        return
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    limits = _prepare(receive(requests))
    limit_memory(limits.memory_mb)
    send(answers, READY)
    with contextlib.suppress(EOFError, BrokenPipeError):
        while True:
            order: dict[str, Any] = json.loads(receive(requests))
            # The worker ends an estimate in time; this is for one that outlives a killed worker inside foreign code.
            signal.setitimer(signal.ITIMER_REAL, 2 * limits.time_s + 60)
            said = asked.answer(_ours(order["name"]), question, order["length"])
            signal.setitimer(signal.ITIMER_REAL, 0)
            send(answers, ANSWER + said)


def _ours(name: str) -> Estimator:
    try:
        return registry.get(name)
    except UserError as e:
        refusal: Refusal = crash(e.line())
        return Estimator(name, name, lambda _: refusal)


def _keep(requests: IO[bytes], answers: IO[bytes], question: int) -> None:
    worker = os.getppid()
    private = own_namespace()
    first = os.fork() if private else 0
    if first:
        requests.close()
        answers.close()
        while os.getppid() == worker and os.waitpid(first, os.WNOHANG)[0] == 0:
            time.sleep(0.2)
        with contextlib.suppress(ProcessLookupError):
            os.kill(first, signal.SIGKILL)
        os._exit(0)
    if private:
        end_with_parent()
        show_own_processes()
    # Ctrl-C is for the run, which ends this process in order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limits = _prepare(receive(requests))
    hidden = private and hide(limits.hidden) if limits.hidden else False
    keeper.keep(requests, answers, question, limits, private, hidden)
    os._exit(0)


def _prepare(message: bytes) -> Limits:
    import cv2

    cv2.setNumThreads(1)
    said = json.loads(message)
    programs = tuple(ProgramSpec(**spec) for spec in said["programs"])
    hidden = tuple(Path(path) for path in said["hidden"])
    return Limits(said["time_s"], said["memory_mb"], programs, Path(said["folder"]), hidden)


def _take_pipes() -> tuple[IO[bytes], IO[bytes]]:
    """Return the pipes; in their places comes what an estimator may read and write: nothing, and standard error."""
    requests, answers = os.fdopen(os.dup(0), "rb", 0), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    os.close(nothing)
    return requests, answers


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
    sys.exit(0)
