"""The program that runs estimators for a worker: ``python -m horizonval.plugins.child``.

Estimators of this package run here in sequence. Third-party code, one estimator per process, is imported once and
forked for every image: changes of the process (modules, limits, folder, handlers) end with the estimate, so no answer
depends on earlier images.

**Contained** third-party code is also kept from its surroundings (:func:`contain`): hidden folders are empty, every
file system is read-only but for a private temporary folder, there is no network, and other processes cannot be
signalled. It is imported anew for each image, so that not even memory shared at the import outlives one.

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
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import IO, Any

import psutil

from horizonval.core.errors import UserError
from horizonval.core.outcome import Refusal
from horizonval.estimation.answer import checked, crash, raised, traceback_of
from horizonval.estimation.observation import Estimator, Fit
from horizonval.plugins import registry
from horizonval.plugins.messages import pack_answer, read_observation
from horizonval.plugins.program import program_estimator
from horizonval.spec.suite import ProgramSpec

_NEW_MOUNTS, _NEW_IPC, _NEW_USER, _NEW_PROCESSES, _NEW_NETWORK = 0x20000, 0x8000000, 0x10000000, 0x20000000, 0x40000000
_PRIVATE_TREE, _BIND = 0x4000 | 0x40000, 0x1000
_DEATH_SIGNAL, _CHILD_SUBREAPER, _NO_NEW_PRIVILEGES, _DROP_CAPABILITY = 1, 36, 38, 24
_MOUNT_SETATTR, _READ_ONLY, _HERE, _RECURSIVE = 442, 1, -100, 0x8000
"""Numbers of Linux's unshare(2), mount(2), prctl(2) and mount_setattr(2); the last call is of Linux 5.12 (2021)."""
_SHARED_MEMORY = "/dev/shm"
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
    _prctl(_DEATH_SIGNAL, signal.SIGKILL)
    limit_memory(setup["memory_mb"])
    scratch = os.environ["TMPDIR"] if contained else None
    if foreign:
        _prctl(_CHILD_SUBREAPER, 1)
        if scratch is not None:
            said = _described_apart(setup, exchange, scratch)
        else:
            estimator, said = _loaded(setup, exchange)
        kept = {child.pid for child in psutil.Process().children(recursive=True)}
    _say(answers, said)
    for line in requests:
        order = json.loads(line)
        status = 0
        if foreign:
            load = partial(_loaded, setup, exchange) if contained else None
            job = partial(_be_asked, estimator, load, exchange, order["length"], (requests, answers))
            status = _forked(job) if scratch is None else _forked(partial(_apart, job, scratch))
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


def _forked(job: Callable[[], None]) -> int:
    """Do a job in a forked process; return its exit code, negative for a signal."""
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            _prctl(_DEATH_SIGNAL, signal.SIGKILL)
            job()
            os._exit(0)
        os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _be_asked(
    estimator: Estimator | None,
    load: Callable[[], tuple[Estimator | None, Any]] | None,
    exchange: int,
    length: int,
    pipes: Iterable[IO[bytes]],
) -> None:
    # Signals to the estimate's process group must not reach the importing process.
    os.setpgid(0, 0)
    for pipe in pipes:
        os.close(pipe.fileno())
    if load is not None:
        estimator, _ = load()
        if estimator is None:
            # The crash of the import is the answer.
            return
    assert estimator is not None
    answer(estimator, exchange, length)


def _described_apart(setup: dict[str, Any], exchange: int, scratch: str) -> dict[str, Any]:
    """Return the description of contained code, which is imported in another process for it."""
    ours, theirs = os.pipe()

    def describe() -> None:
        os.close(ours)
        os.write(theirs, json.dumps(_loaded(setup, exchange)[1]).encode()[:_LONGEST_DESCRIPTION])

    status = _forked(partial(_apart, describe, scratch))
    os.close(theirs)
    with os.fdopen(ours, "rb") as pipe:
        said = pipe.read(_LONGEST_DESCRIPTION)
    if not said:
        os.ftruncate(exchange, 0)
        os.pwrite(
            exchange, pack_answer(crash(f"the estimator cannot be loaded: its process ended with {status}"), 0.0), 0
        )
        return {"failed": True}
    found = json.loads(said)
    return found if isinstance(found, dict) else {}


def _apart(job: Callable[[], None], scratch: str) -> None:
    """Do a job in namespaces that end with it, without privileges and with an empty ``scratch``."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_NEW_MOUNTS | _NEW_PROCESSES) != 0:
        raise OSError(ctypes.get_errno(), "no namespace of mounts and processes")
    for folder in (scratch, _SHARED_MEMORY):
        if os.path.isdir(folder) and libc.mount(b"none", os.fsencode(folder), b"tmpfs", 0, b"size=1g,mode=700") != 0:
            raise OSError(ctypes.get_errno(), "no temporary folder")
    tempfile.tempdir = scratch

    def without_privileges() -> None:
        _prctl(_NO_NEW_PRIVILEGES, 1)
        for capability in range(64):
            _prctl(_DROP_CAPABILITY, capability)
        # Version 3 of the header, this process; no capability in any of the three sets.
        if libc.capset(struct.pack("<Ii", 0x20080522, 0), bytes(24)) != 0:
            raise OSError(ctypes.get_errno(), "privileges cannot be given up")
        job()

    status = _forked(without_privileges)
    if status != 0:
        os._exit(status if status > 0 else 128 - status)


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


def contain(hidden: Iterable[str | Path]) -> bool:
    """Hide files and folders from this process and its descendants, make all file systems read-only, cut the network.

    Returns whether the system permitted it. In user and mount namespaces, which need no privileges, an empty file
    system in memory is mounted over each hidden folder, and the null device over each file. The process then enters
    further namespaces, in which those mounts are locked (mount_namespaces(7)). Nor may it inspect outside processes,
    including ``/proc/PID/root``: that takes privileges in their user namespace (ptrace(2)). ``/proc`` is read-only from
    the second namespaces on, since their users are written there.

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
            and all(_covered(libc, os.fsencode(path)) for path in hidden)
            and _read_only(libc, b"/", True)
            and _read_only(libc, b"/proc", False)
            and _new_namespaces(libc, _NEW_MOUNTS | _NEW_NETWORK | _NEW_IPC)
            and _read_only(libc, b"/proc", True)
        )
    except (OSError, AttributeError, TypeError):
        return False


def _covered(libc: ctypes.CDLL, path: bytes) -> bool:
    if os.path.isdir(path):
        return bool(libc.mount(b"none", path, b"tmpfs", 0, b"size=4k,mode=555") == 0)
    return bool(libc.mount(b"/dev/null", path, None, _BIND, None) == 0)


def _read_only(libc: ctypes.CDLL, path: bytes, wanted: bool) -> bool:
    """Make the mounts from a path on read-only, or the one at it writable."""
    change = struct.pack("<4Q", _READ_ONLY if wanted else 0, 0 if wanted else _READ_ONLY, 0, 0)
    return bool(libc.syscall(_MOUNT_SETATTR, _HERE, path, _RECURSIVE if wanted else 0, change, len(change)) == 0)


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
