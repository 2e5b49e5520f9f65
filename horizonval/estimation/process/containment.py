"""Keeping what an estimator of another package starts together, and ending all of it.

On Linux a foreign estimator runs in a namespace of processes of its own where the kernel permits it, which needs no
rights on most systems: it sees and signals none outside, and all of it ends with the namespace's first process,
whatever session it moved to. Folders can be hidden from it there, and the network cut (:func:`hide`). Elsewhere its
first process adopts orphans, and descendants are found by their parents.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

_NEW_MOUNTS, _NEW_USER, _NEW_PIDS, _NEW_NETWORK = 0x00020000, 0x10000000, 0x20000000, 0x40000000
_PRIVATE_TREE = 0x4000 | 0x40000
_DEATH_SIGNAL, _CHILD_SUBREAPER = 1, 36


def own_namespace() -> bool:
    """Put the children of this process, which has one thread, into a namespace of their own; whether that was granted.

    Without the right to do so a namespace of users is tried first, in which everyone has it.
    """
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.unshare(_NEW_PIDS | _NEW_MOUNTS) == 0:
            return True
        return _as_other_user(libc, _NEW_PIDS | _NEW_MOUNTS)
    except (OSError, AttributeError, TypeError):
        return False


def _as_other_user(libc: ctypes.CDLL, more: int) -> bool:
    """Move into new namespaces, one of users among them; whether that was granted."""
    user, group = os.getuid(), os.getgid()
    if libc.unshare(_NEW_USER | more) != 0:
        return False
    # The same names for user and group inside; without them files would seem nobody's.
    for name, text in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
        with contextlib.suppress(OSError), open(f"/proc/self/{name}", "w", encoding="ascii") as table:
            table.write(text)
    return True


def hide(folders: Iterable[Path]) -> bool:
    """Hide folders from this process and all that it starts, and cut the network; whether that was granted.

    To be called in a namespace of mounts of its own. An empty folder in memory is laid over each. The process then
    moves to further namespaces of users and mounts, in which what was laid there before cannot be taken away: the
    kernel locks the mounts that came from a namespace of other users (mount_namespaces(7)).
    """
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        # What lies under it stays open to who works in such a folder; and no mount may reach the namespaces outside.
        os.chdir("/")
        if libc.mount(b"none", b"/", None, _PRIVATE_TREE, None) != 0:
            return False
        for folder in folders:
            if libc.mount(b"none", os.fsencode(folder), b"tmpfs", 0, b"size=4k,mode=555") != 0:
                return False
        return _as_other_user(libc, _NEW_MOUNTS | _NEW_NETWORK)
    except (OSError, AttributeError, TypeError):
        return False


def can_hide() -> bool:
    """Whether this system hides folders from a process: tried out on an empty one, by a process that then ends."""
    if not hasattr(os, "fork"):
        return False
    with tempfile.TemporaryDirectory() as folder:
        tried = subprocess.run(
            [sys.executable, "-c", _TRY, folder], stdin=subprocess.DEVNULL, capture_output=True, check=False
        )
    return tried.returncode == 0


_TRY = """
import sys
from pathlib import Path
from horizonval.estimation.process.containment import hide, own_namespace
sys.exit(0 if own_namespace() and hide([Path(sys.argv[1])]) else 1)
"""


def show_own_processes() -> None:
    """Mount the table of this namespace's processes, where that is permitted; elsewhere that of all is seen."""
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mount(b"none", b"/", None, _PRIVATE_TREE, None) == 0:
            libc.mount(b"proc", b"/proc", b"proc", 0, None)


def end_with_parent() -> None:
    """Have this process killed when the thread that started it ends."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_DEATH_SIGNAL, signal.SIGKILL, 0, 0, 0)


def adopt_orphans() -> None:
    """Become the parent of descendants whose own parent ends."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_CHILD_SUBREAPER, 1, 0, 0, 0)


def children(process: str = "self") -> list[int]:
    """Return the children of a process, as the table of processes names them; none where there is no such table."""
    with contextlib.suppress(OSError, ValueError):
        place = Path(f"/proc/{process}")
        tasks = list((place / "task").iterdir())
        with contextlib.suppress(FileNotFoundError):
            return [int(word) for task in tasks for word in (task / "children").read_text().split()]
        parent = os.readlink(place) if process == "self" else process
        return [int(p.name) for p in Path("/proc").iterdir() if p.name.isdigit() and _parent(p) == parent]
    return []


def _parent(place: Path) -> str | None:
    try:
        return (place / "stat").read_text().rpartition(")")[2].split()[1]
    except (OSError, IndexError):
        return None


def end_strays(spared: int | None, private: bool) -> bool:
    """End all descendants of this process but one and its own; whether the spared one had to go as well.

    Parameters
    ----------
    spared : int or None
        A child.
    private : bool
        Whether this process is the first of its namespace: then all go at once.
    """
    _reap_ended(spared)
    if private:
        if len(children()) <= (spared is not None):
            return False
        with contextlib.suppress(ProcessLookupError):
            os.kill(-1, signal.SIGKILL)
        _reap()
        return spared is not None
    for _ in range(100):
        strays = [pid for pid in children() if pid != spared]
        if not strays:
            break
        for pid in _with_descendants(strays):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        for pid in strays:
            with contextlib.suppress(ChildProcessError):
                os.waitpid(pid, 0)
    return False


def _with_descendants(pids: list[int]) -> list[int]:
    known = list(pids)
    for pid in known:
        known += [child for child in children(str(pid)) if child not in known]
    return known


def _reap_ended(spared: int | None) -> None:
    """Take leave of orphans that have ended: they are no strays."""
    with contextlib.suppress(ChildProcessError):
        while True:
            ended = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
            if ended is None or ended.si_pid == spared:
                return
            os.waitpid(ended.si_pid, 0)


def _reap() -> None:
    deadline = time.monotonic() + 10.0
    with contextlib.suppress(ChildProcessError):
        while time.monotonic() < deadline:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                time.sleep(0.001)
