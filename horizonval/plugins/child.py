"""The program that runs estimators for a worker: ``python -m horizonval.plugins.child``.

Estimators of this package run here in sequence. Third-party code, one estimator per process, is imported once and
forked for every image: changes of the process (modules, limits, folder, handlers) end with the estimate, so no answer
depends on earlier images.

**Contained** third-party code is also separated from the machine (:mod:`horizonval.plugins.namespaces`): hidden folders
are empty, all file systems are read-only except a private temporary folder, there is no network, and other processes
are out of reach. It is imported again for each image, so that no state outlives one.

The worker writes a line of JSON for each image, with the observation in a shared open file; the answer replaces it
there, and a line of JSON says how the process ended. Output of estimators goes to standard error, which the worker
reads.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import IO, Any

import psutil

from horizonval.core.errors import UserError
from horizonval.core.outcome import Refusal
from horizonval.estimation.observation import Estimator, Fit
from horizonval.plugins import registry
from horizonval.plugins.answer import checked, crash, raised, traceback_of
from horizonval.plugins.messages import pack_answer, read_observation
from horizonval.plugins.namespaces import adopt_orphans, apart, contain, end_with_parent, forked
from horizonval.plugins.program import program_estimator
from horizonval.spec.suite import ProgramSpec

_LONGEST_DESCRIPTION = 1 << 14


def main(exchange: int) -> None:
    """Answer until the worker closes the pipe; ``exchange`` is the descriptor of the shared file."""
    import cv2

    cv2.setNumThreads(1)
    requests, answers = _take_pipes()
    setup = json.loads(requests.readline())
    estimator: Estimator | None = None
    kept: set[int] = set()
    said: dict[str, Any] = {}
    foreign = setup["name"] is not None
    contained = foreign and bool(setup["hidden"])
    if contained and not contain(setup["hidden"]):
        _say(answers, {"hides": False})
        return
    end_with_parent()
    limit_memory(setup["memory_mb"])
    if contained:
        said = _described_apart(setup, exchange, os.environ["TMPDIR"])
    elif foreign:
        adopt_orphans()
        estimator, said = _loaded(setup, exchange)
        kept = {child.pid for child in psutil.Process().children(recursive=True)}
    _say(answers, said)
    for line in requests:
        order = json.loads(line)
        status = 0
        if contained:
            job = partial(_import_and_answer, setup, exchange, order["length"])
            status = apart(job, exchange, os.environ["TMPDIR"])
        elif foreign:
            status = forked(partial(_be_asked, estimator, exchange, order["length"], (requests, answers)))
            _end_strays(kept)
        else:
            answer(_ours(order["name"]), exchange, order["length"])
        _say(answers, {"status": status})


def answer(estimator: Estimator, exchange: int, length: int) -> None:
    """Replace an observation by the estimator's answer; any failure becomes an answer."""
    observation = read_observation(exchange, length)
    # An estimator that ends its process leaves no answer.
    os.ftruncate(exchange, 0)
    start = _processor_s()
    try:
        result: Fit | Refusal = registry.run_safely(estimator, observation)
        message = pack_answer(checked(result), _processor_s() - start)
    except BaseException as e:
        # Also SystemExit, and whatever foreign code has made of the names above.
        message = pack_answer(crash(f"the estimator raised {raised(e)}", traceback_of(e, 2)), _processor_s() - start)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(BaseException):
            stream.flush()
    os.pwrite(exchange, message, 0)


def _ours(name: str) -> Estimator:
    try:
        return registry.get(name)
    except UserError as e:
        refusal: Refusal = crash(e.line())
        return Estimator(name, name, lambda _: refusal)


def _loaded(setup: dict[str, Any], exchange: int) -> tuple[Estimator | None, dict[str, Any]]:
    """Import an estimator; return it with its description, or None after writing its crash."""
    try:
        if setup["program"] is not None:
            estimator = program_estimator(ProgramSpec(**setup["program"]), Path(setup["folder"]))
        else:
            estimator = registry.load(setup["name"])
        said = {"title": str(estimator.title)[:1000]} | {
            key: getattr(estimator, key) for key in ("estimates", "needs", "claim")
        }
        json.dumps(said)
        return estimator, said
    except BaseException as e:
        refusal = crash(f"the estimator cannot be loaded: {raised(e)}", traceback_of(e, 2))
        os.ftruncate(exchange, 0)
        os.pwrite(exchange, pack_answer(refusal, 0.0), 0)
        return None, {"failed": True}


def _be_asked(estimator: Estimator | None, exchange: int, length: int, pipes: Iterable[IO[bytes]]) -> None:
    # Signals to the estimate's process group must not reach the process that imported it.
    os.setpgid(0, 0)
    for pipe in pipes:
        os.close(pipe.fileno())
    assert estimator is not None
    answer(estimator, exchange, length)


def _import_and_answer(setup: dict[str, Any], exchange: int, length: int) -> None:
    estimator, _ = _loaded(setup, exchange)
    if estimator is not None:
        # Otherwise the crash of the import is the answer.
        answer(estimator, exchange, length)


def _describe(setup: dict[str, Any], exchange: int) -> None:
    estimator, said = _loaded(setup, exchange)
    if estimator is not None:
        os.ftruncate(exchange, 0)
        os.pwrite(exchange, json.dumps(said).encode(), 0)


def _described_apart(setup: dict[str, Any], exchange: int, scratch: str) -> dict[str, Any]:
    """Return the description of contained code, which is imported in another process for it."""
    os.ftruncate(exchange, 0)
    status = apart(partial(_describe, setup, exchange), exchange, scratch)
    written = os.pread(exchange, _LONGEST_DESCRIPTION, 0)
    if status != 0 or not written:
        reason = f"the estimator cannot be loaded: its process ended with {status}"
        os.ftruncate(exchange, 0)
        os.pwrite(exchange, pack_answer(crash(reason), 0.0), 0)
        return {"failed": True}
    try:
        found = json.loads(written)
    except (ValueError, RecursionError):
        # A crash, in the form of answers.
        return {"failed": True}
    return found if isinstance(found, dict) else {}


def _end_strays(kept: set[int]) -> None:
    """End processes left by an estimate, except those that its package started at import."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        # The usual case: nothing runs.
        return
    end_descendants(psutil.Process(), kept)
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def end_descendants(process: psutil.Process, kept: Iterable[int] = ()) -> None:
    """Kill all descendants of a process but some, until none is left that could start another."""
    for _ in range(100):
        alive = []
        with contextlib.suppress(psutil.Error):
            alive = [one for one in process.children(recursive=True) if one.pid not in kept]
        found = False
        for one in alive:
            with contextlib.suppress(psutil.Error):
                if one.status() != psutil.STATUS_ZOMBIE:
                    one.kill()
                    found = True
        if not found:
            return
        time.sleep(0.002)


def limit_memory(memory_mb: int) -> None:
    """Limit the address space of this process and its children to ``memory_mb`` beyond its present size."""
    try:
        import resource

        with open("/proc/self/statm") as file:
            used = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        most = used + memory_mb * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, OSError, ValueError):
        # Without Linux's limits memory is the user's responsibility.
        return


def _processor_s() -> float:
    """Return the processor time of this process and its finished children."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def _take_pipes() -> tuple[IO[bytes], IO[bytes]]:
    """Return the pipes; estimators get an empty standard input, and standard error as output."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    os.close(nothing)
    return requests, answers


def _say(answers: IO[bytes], said: dict[str, Any]) -> None:
    answers.write(json.dumps(said).encode() + b"\n")
    answers.flush()


if __name__ == "__main__":
    main(int(sys.argv[1]))
