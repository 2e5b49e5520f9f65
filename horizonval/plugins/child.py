"""The program that runs estimators for a worker: ``python -m horizonval.plugins.child``.

Estimators of this package run here in sequence. Third-party code, one estimator per process, is imported once and
forked for every image: changes of the process (modules, limits, folder, handlers) end with the estimate, so no answer
depends on earlier images.

The worker writes a line of JSON for each image, with the observation in a shared open file; the answer replaces it
there, and a line of JSON says how the process ended. Output of estimators goes to standard error, which the worker
reads.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any, NoReturn

import psutil

from horizonval.core.errors import UserError
from horizonval.core.outcome import Refusal
from horizonval.estimation.answer import checked, crash, raised, traceback_of
from horizonval.estimation.observation import Estimator, Fit
from horizonval.plugins import registry
from horizonval.plugins.messages import pack_answer, read_observation
from horizonval.plugins.program import program_estimator
from horizonval.spec.suite import ProgramSpec

_NEW_MOUNTS, _NEW_USER, _NEW_NETWORK = 0x00020000, 0x10000000, 0x40000000
_PRIVATE_TREE = 0x4000 | 0x40000
_DEATH_SIGNAL, _CHILD_SUBREAPER = 1, 36


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
    if foreign and setup["hidden"] and not hide(setup["hidden"]):
        _say(answers, {"hides": False})
        return
    _prctl(_DEATH_SIGNAL, signal.SIGKILL)
    limit_memory(setup["memory_mb"])
    if foreign:
        _prctl(_CHILD_SUBREAPER, 1)
        estimator, said = _loaded(setup, exchange)
        kept = {child.pid for child in psutil.Process().children(recursive=True)}
    _say(answers, said)
    for line in requests:
        order = json.loads(line)
        status = 0
        if foreign:
            status = _forked(estimator, exchange, order["length"], (requests, answers))
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


def _forked(estimator: Estimator | None, exchange: int, length: int, pipes: Iterable[IO[bytes]]) -> int:
    """Answer in a forked process; return its exit code, negative for a signal."""
    asked = os.fork()
    if asked == 0:
        _be_asked(estimator, exchange, length, pipes)
    return os.waitstatus_to_exitcode(os.waitpid(asked, 0)[1])


def _be_asked(estimator: Estimator | None, exchange: int, length: int, pipes: Iterable[IO[bytes]]) -> NoReturn:
    with contextlib.suppress(BaseException):
        _prctl(_DEATH_SIGNAL, signal.SIGKILL)
        # Signals to the estimate's process group must not reach the importing process.
        os.setpgid(0, 0)
        for pipe in pipes:
            os.close(pipe.fileno())
        assert estimator is not None
        answer(estimator, exchange, length)
        os._exit(0)
    os._exit(1)


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


def hide(folders: Iterable[str | Path]) -> bool:
    """Hide folders from this process and its descendants, and cut the network; return whether the system permitted it.

    An empty file system in memory is mounted over each folder in user and mount namespaces, which needs no privileges.
    The process then enters further namespaces, in which those mounts are locked (mount_namespaces(7)). Nor may it
    inspect outside processes, including ``/proc/PID/root``: that takes privileges in their user namespace (ptrace(2)).

    The process must have a single thread.
    """
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        # A process still sees its working folder below a later mount.
        os.chdir("/")
        return (
            _new_namespaces(libc, _NEW_MOUNTS)
            # Mounts must not propagate to the outer namespaces.
            and libc.mount(b"none", b"/", None, _PRIVATE_TREE, None) == 0
            and all(libc.mount(b"none", os.fsencode(f), b"tmpfs", 0, b"size=4k,mode=555") == 0 for f in folders)
            and _new_namespaces(libc, _NEW_MOUNTS | _NEW_NETWORK)
        )
    except (OSError, AttributeError, TypeError):
        return False


def _new_namespaces(libc: ctypes.CDLL, kinds: int) -> bool:
    """Enter new namespaces, including a user namespace; return whether the system permitted it."""
    user, group = os.getuid(), os.getgid()
    if libc.unshare(_NEW_USER | kinds) != 0:
        return False
    # The same user and group inside; otherwise files would belong to nobody.
    for name, text in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
        with contextlib.suppress(OSError), open(f"/proc/self/{name}", "w", encoding="ascii") as table:
            table.write(text)
    return True


def _prctl(option: int, value: int) -> None:
    """Ask Linux to end this process with its parent's thread, or to adopt orphans; no effect elsewhere."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


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
