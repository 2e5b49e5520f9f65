"""Containment of third-party code on Linux: nothing to find, nothing to leave behind, nobody to call.

:func:`contain` prepares a process of ours once. Folders are hidden below empty file systems in memory, also where
another mount shows them; all file systems are read-only; of the devices five harmless ones are left; there is no
network. This takes user and mount namespaces, which need no privileges. The process then enters further namespaces, in
which those mounts are locked (mount_namespaces(7)).

:func:`apart` does one job of third-party code in namespaces that end with it: mounts, processes, shared memory and
message queues. Its first process is ours and waits, so that the code cannot outlive the worker (pid_namespaces(7)). The
code itself has no privileges, empty private folders for temporary files, no descriptors but its own, and a filter of
system calls that keeps it from keyrings and from sockets of other families than the namespaces cut.

Not contained: the time of day, processor caches, and how long others' work takes.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import select
import signal
import struct
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NoReturn

_NEW_MOUNTS, _NEW_IPC, _NEW_USER, _NEW_PROCESSES, _NEW_NETWORK = 0x20000, 0x8000000, 0x10000000, 0x20000000, 0x40000000
_PRIVATE_TREE, _BIND, _PROC_FLAGS = 0x4000 | 0x40000, 0x1000, 1 | 2 | 4 | 8
_DEATH_SIGNAL, _NO_NEW_PRIVILEGES, _DROP_CAPABILITY, _SECCOMP = 1, 38, 24, 22
_MOUNT_SETATTR, _READ_ONLY, _NO_DEVICES, _HERE, _RECURSIVE = 442, 1, 4, -100, 0x8000
"""Numbers of Linux's unshare(2), mount(2), prctl(2) and mount_setattr(2); the last call is of Linux 5.12 (2021)."""
DEVICES = ("null", "zero", "full", "random", "urandom")
_SHARED_MEMORY = "/dev/shm"
_SIGNALLED = 128
"""Added to the number of a signal in exit codes that tell of one."""

_CALLS = {
    # machine: architecture of the filter, socket, and the calls that are refused: keys, keyrings and io_uring
    "x86_64": (0xC000003E, 41, (248, 249, 250, 425, 426, 427)),
    "aarch64": (0xC00000B7, 198, (217, 218, 219, 425, 426, 427)),
}
_FAMILIES = (1, 2, 10, 16)
"""Sockets of Unix, IPv4, IPv6 and netlink, which end at a network namespace."""
_REFUSED, _ALLOWED = 0x00050001, 0x7FFF0000


def contain(hidden: Iterable[str | Path]) -> bool:
    """Hide files and folders from this process and its descendants; return whether the system permitted it.

    All file systems become read-only, but for what :func:`apart` adds, and the network is cut. ``/proc`` is read-only
    from the second namespaces on, since their users are written there. The process must have a single thread.
    """
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        if platform.machine() not in _CALLS:
            return False
        covered = [alias for path in hidden for alias in aliases(str(path), _mounts())]
        # A process still sees its working folder below a later mount.
        os.chdir("/")
        return (
            _new_namespaces(libc, _NEW_MOUNTS)
            # Mounts must not propagate to the outer namespaces.
            and libc.mount(b"none", b"/", None, _PRIVATE_TREE, None) == 0
            and all(_cover(libc, path) for path in covered)
            and _few_devices(libc)
            and _set(libc, "/", add=_READ_ONLY | _NO_DEVICES)
            and all(_set(libc, f"/dev/{name}", remove=_NO_DEVICES) for name in DEVICES)
            and _set(libc, "/proc", remove=_READ_ONLY)
            and _new_namespaces(libc, _NEW_MOUNTS | _NEW_NETWORK | _NEW_IPC)
            and _set(libc, "/proc", add=_READ_ONLY)
        )
    except (OSError, AttributeError, TypeError, ValueError):
        return False


Mount = tuple[str, str, str]
"""Device, folder of its file system that is mounted, and where."""


def _mounts() -> list[Mount]:
    found = []
    for line in Path("/proc/self/mountinfo").read_text(encoding="utf-8", errors="surrogateescape").splitlines():
        _, _, device, root, place, *_ = (word.encode().decode("unicode_escape") for word in line.split(" "))
        found.append((device, root, place))
    return found


def aliases(path: str, mounts: Sequence[Mount]) -> list[str]:
    """Return the places at which a file or folder is seen, the path among them, as other mounts show it too."""
    device, root, place = max(
        (one for one in mounts if _below(path, one[2]) is not None), key=lambda one: (len(one[2]), mounts.index(one))
    )
    inside = os.path.normpath(os.path.join(root, _below(path, place) or "."))
    found = {path: None}
    for other, other_root, other_place in mounts:
        if other != device:
            continue
        if (rest := _below(inside, other_root)) is not None:
            found[os.path.normpath(os.path.join(other_place, rest or "."))] = None
        elif _below(other_root, inside) is not None:
            found[other_place] = None
    # Outer folders first: what lies inside one that is covered already needs no cover.
    return sorted((one for one in found if os.path.exists(one)), key=len)


def _below(path: str, folder: str) -> str | None:
    """Return the rest of a path below a folder, "" for itself; None if it is not below it."""
    if path == folder or folder == "/":
        return path.lstrip("/") if folder == "/" else ""
    return path[len(folder) + 1 :] if path.startswith(folder + "/") else None


def _cover(libc: ctypes.CDLL, path: str) -> bool:
    if not os.path.exists(path):
        return True
    if os.path.isdir(path):
        return bool(libc.mount(b"none", os.fsencode(path), b"tmpfs", 0, b"size=4k,mode=555") == 0)
    return bool(libc.mount(b"/dev/null", os.fsencode(path), None, _BIND, None) == 0)


def _few_devices(libc: ctypes.CDLL) -> bool:
    """Cover ``/dev``, and bind the harmless devices there; disks and consoles could be read and written as root."""
    kept = {name: os.open(f"/dev/{name}", os.O_PATH) for name in DEVICES}
    try:
        if libc.mount(b"none", b"/dev", b"tmpfs", 0, b"size=64k,mode=755") != 0:
            return False
        for name, descriptor in kept.items():
            Path(f"/dev/{name}").touch()
            if libc.mount(f"/proc/self/fd/{descriptor}".encode(), f"/dev/{name}".encode(), None, _BIND, None) != 0:
                return False
    finally:
        for descriptor in kept.values():
            os.close(descriptor)
    os.mkdir(_SHARED_MEMORY)
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        os.symlink(f"/proc/self/fd/{number}", f"/dev/{name}")
    os.symlink("/proc/self/fd", "/dev/fd")
    return True


def _set(libc: ctypes.CDLL, path: str, *, add: int = 0, remove: int = 0) -> bool:
    """Change attributes: add them to all mounts from a path on, or remove them from the one at it."""
    change = struct.pack("<4Q", add, remove, 0, 0)
    flags = _RECURSIVE if add else 0
    return bool(libc.syscall(_MOUNT_SETATTR, _HERE, os.fsencode(path), flags, change, len(change)) == 0)


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


def apart(job: Callable[[int], None], scratch: str, memory_mb: int, longest: int) -> tuple[int, bytes]:
    """Do a job of third-party code in a contained process; return its exit code and its result.

    ``job`` receives the descriptor of the file for its result, of which one byte more than ``longest`` is read at most.
    The code is negative for a signal. ``scratch``: folder for temporary files, of at most ``memory_mb``.
    """
    result = os.memfd_create("horizonval-result")
    try:
        status = forked(lambda: _in_namespaces(job, result, scratch, memory_mb))
        return (_SIGNALLED - status if status > _SIGNALLED else status), os.pread(result, longest + 1, 0)
    finally:
        os.close(result)


def forked(job: Callable[[], None]) -> int:
    """Do a job in a process that ends with this one; return its exit code, negative for a signal."""
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            die_with_parent()
            job()
            os._exit(0)
        os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def die_with_parent() -> None:
    """Ask Linux to end this process with its parent; no effect elsewhere."""
    prctl(_DEATH_SIGNAL, signal.SIGKILL)


def prctl(option: int, value: int) -> None:
    """Set an attribute of this process; no effect where the system has none such."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _in_namespaces(job: Callable[[int], None], result: int, scratch: str, memory_mb: int) -> NoReturn:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_NEW_MOUNTS | _NEW_PROCESSES | _NEW_IPC) != 0:
        raise OSError(ctypes.get_errno(), "no namespaces of mounts and processes")
    for folder in (scratch, _SHARED_MEMORY):
        if libc.mount(b"none", os.fsencode(folder), b"tmpfs", 0, f"size={memory_mb}m,mode=700".encode()) != 0:
            raise OSError(ctypes.get_errno(), "no temporary folder")
    # The first process of the namespace is the next one; the code must not be it.
    _exit_as(forked(lambda: _first_process(libc, job, result, scratch)))


def _first_process(libc: ctypes.CDLL, job: Callable[[int], None], result: int, scratch: str) -> NoReturn:
    # Where the system masks parts of /proc, that of the outer namespace stays.
    libc.mount(b"proc", b"/proc", b"proc", _PROC_FLAGS, None)
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            die_with_parent()
            os.setpgid(0, 0)
            for number, descriptor in ((0, os.open("/dev/null", os.O_RDWR)), (1, theirs), (2, theirs)):
                os.dup2(descriptor, number)
            tempfile.tempdir = scratch
            _give_up_privileges(libc)
            job(result)
            os._exit(0)
        os._exit(1)
    os.close(theirs)
    os.close(result)
    _exit_as(_relayed(ours, child))


def _relayed(output: int, child: int) -> int:
    """Copy a process's output to ours until it ends; return its exit code. Its output is a pipe for it alone."""
    open_, status = True, None
    while status is None:
        if open_ and select.select([output], [], [], 0.05)[0]:
            data = os.read(output, 1 << 16)
            open_ = bool(data)
            os.write(2, data)
        done, how = os.waitpid(-1, os.WNOHANG if open_ else 0)
        status = os.waitstatus_to_exitcode(how) if done == child else None
    while open_ and select.select([output], [], [], 0.0)[0] and (data := os.read(output, 1 << 16)):
        os.write(2, data)
    return status


def _exit_as(status: int) -> NoReturn:
    os._exit(_SIGNALLED - status if status < 0 else status)


def _give_up_privileges(libc: ctypes.CDLL) -> None:
    prctl(_NO_NEW_PRIVILEGES, 1)
    for capability in range(64):
        prctl(_DROP_CAPABILITY, capability)
    # Version 3 of the header, this process; no capability in any of the three sets.
    if libc.capset(struct.pack("<Ii", 0x20080522, 0), bytes(24)) != 0:
        raise OSError(ctypes.get_errno(), "privileges cannot be given up")
    program = _filter()
    held = ctypes.create_string_buffer(program, len(program))
    pointer = struct.pack(
        "HxxxxxxP" if ctypes.sizeof(ctypes.c_void_p) == 8 else "HxxP", len(program) // 8, ctypes.addressof(held)
    )
    if libc.prctl(_SECCOMP, 2, pointer, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "system calls cannot be filtered")


def _filter() -> bytes:
    """Return the filter of system calls, a program of seccomp(2) for this machine."""
    architecture, socket, refused = _CALLS[platform.machine()]
    load, equal, at_least, leave = 0x20, 0x15, 0x35, 0x06
    # Each test is followed by what is done if it holds; it skips one instruction if not.
    steps = [(load, 0, 0, 4), (equal, 1, 0, architecture), (leave, 0, 0, _REFUSED), (load, 0, 0, 0)]
    # Numbers from 2^30 on are those of the x32 interface, under which other numbers mean the same calls.
    steps += [(at_least, 0, 1, 0x40000000), (leave, 0, 0, _REFUSED)]
    for number in refused:
        steps += [(equal, 0, 1, number), (leave, 0, 0, _REFUSED)]
    steps += [(equal, 1, 0, socket), (leave, 0, 0, _ALLOWED), (load, 0, 0, 16)]
    for family in _FAMILIES:
        steps += [(equal, 0, 1, family), (leave, 0, 0, _ALLOWED)]
    steps.append((leave, 0, 0, _REFUSED))
    return b"".join(struct.pack("<HBBI", *step) for step in steps)
