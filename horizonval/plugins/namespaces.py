"""Linux namespaces that contain third-party code: it reads no hidden file, writes nowhere, and leaves nothing behind.

:func:`contain` hides and write-protects files for this process and its descendants. :func:`apart` then does one job in
namespaces and folders that end with it. Neither needs privileges, because both begin with a user namespace; a mount of
an outer user namespace cannot be undone in an inner one (mount_namespaces(7)).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import signal
import struct
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from horizonval.plugins.messages import LONGEST_ANSWER

_NEW_MOUNTS, _NEW_IPC, _NEW_USER, _NEW_PROCESSES, _NEW_NETWORK = 0x20000, 0x8000000, 0x10000000, 0x20000000, 0x40000000
_PRIVATE_TREE, _BIND, _PROC_FLAGS = 0x4000 | 0x40000, 0x1000, 1 | 2 | 4 | 8
_DEATH_SIGNAL, _DUMPABLE, _SECCOMP, _DROP_CAPABILITY, _CHILD_SUBREAPER, _NO_NEW_PRIVILEGES = 1, 4, 22, 24, 36, 38
_MOUNT_SETATTR, _READ_ONLY, _NO_DEVICES, _HERE, _RECURSIVE = 442, 1, 4, -100, 0x8000
"""Numbers of Linux's unshare(2), mount(2), prctl(2) and mount_setattr(2); the last call is of Linux 5.12 (2021)."""
_MACHINES = {"x86_64": (0xC000003E, 248, 41), "aarch64": (0xC00000B7, 217, 198)}
"""AUDIT_ARCH of a machine, and its numbers of add_key(2), followed by those of request_key(2) and keyctl(2), and of
socket(2)."""
_IO_URING_SETUP, _AF_VSOCK = 425, 40
_DEVICES = ("null", "zero", "full", "random", "urandom")
_SHARED_MEMORY = "/dev/shm"

Mount = tuple[str, Path, Path]
"""Device, path of the root inside the device, mount point."""


def contain(hidden: Iterable[str | Path]) -> bool:
    """Hide files and folders from this process and its descendants, and make all file systems read-only.

    Returns whether the system permits it. An empty file system is mounted over each hidden folder, and the null device
    over each hidden file, at every mount point that shows them. Only five devices without content are left.

    The process must have a single thread.
    """
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        paths = _everywhere(hidden)
        # A process still sees its working folder below a later mount.
        os.chdir("/")
        return (
            os.uname().machine in _MACHINES
            and _new_namespaces(libc, _NEW_MOUNTS)
            # Mounts must not propagate to the outer namespaces.
            and libc.mount(b"none", b"/", None, _PRIVATE_TREE, None) == 0
            and all(_covered(libc, path) for path in paths)
            and _few_devices(libc)
            and _changed(libc, "/", _READ_ONLY | _NO_DEVICES, 0)
            and all(_changed(libc, device, 0, _NO_DEVICES) for device in _devices())
            # The users of later namespaces are written there.
            and _changed(libc, "/proc", 0, _READ_ONLY)
        )
    except (OSError, AttributeError, TypeError, ValueError):
        return False


def apart(job: Callable[[], object], exchange: int, scratch: str) -> int:
    """Do a job in namespaces that end with it; return its exit code, negative for a signal.

    Of open files it has a copy of the exchange, under the same number, and an output of its own. It has no network, no
    privileges, no keyrings, and empty private folders: ``scratch`` and the one of shared memory.
    """
    status = forked(lambda: _relayed(job, exchange, scratch))
    return 128 - status if 128 < status <= 128 + max(signal.Signals) else status


def forked(job: Callable[[], object]) -> int:
    """Do a job in a forked process that ends with this one; return its exit code, negative for a signal."""
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            end_with_parent()
            job()
            os._exit(0)
        os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def end_with_parent() -> None:
    """Ask Linux to kill this process when its parent's thread ends; no effect elsewhere."""
    _prctl(_DEATH_SIGNAL, signal.SIGKILL)


def adopt_orphans() -> None:
    """Ask Linux to make this process the parent of orphaned descendants; no effect elsewhere."""
    _prctl(_CHILD_SUBREAPER, 1)


def _relayed(job: Callable[[], object], exchange: int, scratch: str) -> None:
    """Enter new namespaces, start their first process, and copy its output and its answer out of them."""
    libc = ctypes.CDLL(None, use_errno=True)
    private = os.memfd_create("horizonval")
    _copy(exchange, private, os.fstat(exchange).st_size)
    ours, theirs = os.pipe()
    kinds = _NEW_MOUNTS | _NEW_PROCESSES | _NEW_NETWORK | _NEW_IPC
    _demand(_new_namespaces(libc, kinds) and _changed(libc, "/proc", _READ_ONLY, 0), "namespaces")
    for folder in (scratch, _SHARED_MEMORY):
        _demand(libc.mount(b"none", os.fsencode(folder), b"tmpfs", 0, b"size=1g,mode=700") == 0, "a private folder")
    first = os.fork()
    if first == 0:
        with contextlib.suppress(BaseException):
            os.dup2(private, exchange)
            os.dup2(os.open(os.devnull, os.O_RDWR), 0)
            os.dup2(theirs, 1)
            os.dup2(theirs, 2)
            os.closerange(3, exchange)
            os.closerange(exchange + 1, 1 << 16)
            _first_process(libc, job, scratch)
        os._exit(1)
    os.close(theirs)
    while data := os.read(ours, 1 << 16):
        os.write(2, data)
    status = os.waitstatus_to_exitcode(os.waitpid(first, 0)[1])
    _copy(private, exchange, min(os.fstat(private).st_size, LONGEST_ANSWER + 1))
    os._exit(_as_shells_do(status))


def _first_process(libc: ctypes.CDLL, job: Callable[[], object], scratch: str) -> None:
    """Be process 1 of the namespaces, which the job can neither signal nor inspect; the others end with it."""
    end_with_parent()
    _prctl(_DUMPABLE, 0)
    # Where parts of the outer /proc are covered, as in containers, Linux refuses a new one.
    libc.mount(b"proc", b"/proc", b"proc", _PROC_FLAGS, None)
    third_party = os.fork()
    if third_party == 0:
        with contextlib.suppress(BaseException):
            _prctl(_DUMPABLE, 1)
            os.setpgid(0, 0)
            tempfile.tempdir = scratch
            _give_up_privileges(libc)
            job()
            os._exit(0)
        os._exit(1)
    while (ended := os.wait())[0] != third_party:
        pass
    os._exit(_as_shells_do(os.waitstatus_to_exitcode(ended[1])))


def _as_shells_do(status: int) -> int:
    return status if status >= 0 else 128 - status


def _give_up_privileges(libc: ctypes.CDLL) -> None:
    """Drop all capabilities, and deny the system calls of keyrings, of io_uring and of sockets to a hypervisor."""
    _prctl(_NO_NEW_PRIVILEGES, 1)
    for capability in range(64):
        _prctl(_DROP_CAPABILITY, capability)
    # Version 3 of the header, this process; no capability in any of the three sets.
    _demand(libc.capset(struct.pack("<Ii", 0x20080522, 0), bytes(24)) == 0, "fewer privileges")
    machine, add_key, socket = _MACHINES[os.uname().machine]
    load, equal, at_least, done = 0x20, 0x15, 0x35, 0x06
    # Code, instructions skipped if true and if false, operand; see seccomp(2). x32 numbers begin at 2^30.
    program = [
        (load, 0, 0, 4),
        (equal, 0, 8, machine),
        (load, 0, 0, 0),
        (at_least, 6, 0, 1 << 30),
        (equal, 5, 0, _IO_URING_SETUP),
        (equal, 2, 0, socket),
        (at_least, 0, 4, add_key),
        (at_least, 3, 2, add_key + 3),
        (load, 0, 0, 16),
        (equal, 0, 1, _AF_VSOCK),
        (done, 0, 0, 0x00050001),
        (done, 0, 0, 0x7FFF0000),
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("<HBBI", *line) for line in program))
    about = struct.pack("@HP", len(program), ctypes.addressof(code))
    _demand(libc.prctl(_SECCOMP, 2, about, 0, 0) == 0, "a filter of system calls")


def _demand(granted: bool, what: str) -> None:
    if not granted:
        raise OSError(ctypes.get_errno(), f"the system does not grant {what}")


def _copy(source: int, target: int, size: int) -> None:
    os.ftruncate(target, 0)
    os.lseek(target, 0, os.SEEK_SET)
    position = 0
    while position < size and (count := os.sendfile(target, source, position, size - position)):
        position += count


def _everywhere(hidden: Iterable[str | Path]) -> list[Path]:
    """Return paths, and those that lead to the same files through other mount points."""
    mounts = [*_mounts()]
    found = {Path(os.path.realpath(path)): None for path in hidden}
    for path in [*found]:
        device, root, point = _mount_of(path, mounts)
        inside = [(device, root / path.relative_to(point))]
        inside += [(device, root) for device, root, point in mounts if point.is_relative_to(path)]
        for mount in mounts:
            for device, place in inside:
                if device != mount[0] or not (place.is_relative_to(mount[1]) or mount[1].is_relative_to(place)):
                    continue
                other = mount[2] / (place.relative_to(mount[1]) if place.is_relative_to(mount[1]) else "")
                # Another mount may cover it.
                if _mount_of(other, mounts) == mount:
                    found[other] = None
    return [*found]


def _mounts() -> Iterator[Mount]:
    """Yield all mounts, later ones last (proc_pid_mountinfo(5), which writes some characters as octal numbers)."""
    with open("/proc/self/mountinfo", "rb") as file:
        for line in file:
            words = [re.sub(rb"\\(\d{3})", lambda m: bytes([int(m[1], 8)]), word) for word in line.split(b" ")[:5]]
            yield words[2].decode(), Path(os.fsdecode(words[3])), Path(os.fsdecode(words[4]))


def _mount_of(path: Path, mounts: list[Mount]) -> Mount:
    return max(
        (len(mount[2].parts), number, mount) for number, mount in enumerate(mounts) if path.is_relative_to(mount[2])
    )[2]


def _covered(libc: ctypes.CDLL, path: Path) -> bool:
    if not os.path.lexists(path):
        # A folder that has been covered held it.
        return True
    if path.is_dir():
        return bool(libc.mount(b"none", os.fsencode(path), b"tmpfs", 0, b"size=4k,mode=555") == 0)
    return bool(libc.mount(b"/dev/null", os.fsencode(path), None, _BIND, None) == 0)


def _few_devices(libc: ctypes.CDLL) -> bool:
    """Replace ``/dev`` by a folder with the devices that have no content, the standard streams and shared memory."""
    kept = {device: os.open(device, os.O_PATH) for device in _devices()}
    if libc.mount(b"none", b"/dev", b"tmpfs", 0, b"size=64k,mode=755") != 0:
        return False
    os.mkdir(_SHARED_MEMORY)
    for name, target in (("fd", ""), ("stdin", "/0"), ("stdout", "/1"), ("stderr", "/2")):
        os.symlink(f"/proc/self/fd{target}", f"/dev/{name}")
    for device, descriptor in kept.items():
        open(device, "x").close()
        if libc.mount(b"/proc/self/fd/%d" % descriptor, os.fsencode(device), None, _BIND, None) != 0:
            return False
        os.close(descriptor)
    return True


def _devices() -> list[str]:
    return [device for name in _DEVICES if os.path.exists(device := f"/dev/{name}")]


def _changed(libc: ctypes.CDLL, path: str, added: int, removed: int) -> bool:
    """Add attributes to the mounts from a path on, or remove some of the mount at it."""
    change = struct.pack("<4Q", added, removed, 0, 0)
    flags = _RECURSIVE if path == "/" else 0
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


def _prctl(option: int, value: int) -> None:
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)
