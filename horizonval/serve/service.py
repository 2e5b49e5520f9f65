"""A scene served at an address until a signal comes: the socket, who may reach it, and the end."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError
from horizonval.serve.local import ImageSource
from horizonval.serve.server import Server
from horizonval.wire import Address, check_installed, make_private_folder, unix_socket

WAITING = 16
"""Clients that may knock while others are let in."""
LONGEST_LOCK_S = 2.0
"""Longest wait for other servers that check the sockets of the folder, which takes milliseconds."""
LEAST_TOKEN, MOST_TOKEN = 16, 256


@contextlib.contextmanager
def listening(address: Address) -> Iterator[tuple[socket.socket, Address]]:
    """Listen at an address, and leave nothing there at the end.

    Yield the socket and the address with the port chosen for 0.

    Raises
    ------
    UserError
        The address is in use or cannot be used.
    """
    stream = _tcp(address) if address.path is None else _unix(address.path)
    made = None if address.path is None else os.lstat(address.path)
    if address.path is None:
        address = Address(None, address.host, stream.getsockname()[1])
    try:
        yield stream, address
    finally:
        stream.close()
        if address.path is not None and made is not None:
            with contextlib.suppress(OSError):
                # Whoever took the name since then keeps it.
                there = os.lstat(address.path)
                if (there.st_dev, there.st_ino) == (made.st_dev, made.st_ino):
                    os.unlink(address.path)


def _tcp(address: Address) -> socket.socket:
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    stream = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":
            # There it lets a port be taken that a dead connection still holds, never one that somebody listens at.
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        stream.bind((address.host, address.port))
        stream.listen(WAITING)
    except OSError as e:
        stream.close()
        if e.errno == errno.EADDRINUSE:
            fix = "name another one with --port, or 0 for any that is free"
            raise UserError("somebody listens there already", where=str(address), fix=fix) from None
        raise UserError(str(e.strerror or e), where=str(address), fix="name another address") from None
    return stream


def _unix(path: Path) -> socket.socket:
    from horizonval.wire import default_socket

    stream = unix_socket(path)
    try:
        if path == default_socket():
            make_private_folder(path.parent)
        with _alone_in(path.parent):
            _remove_stale(path)
            before = os.umask(0o177)
            try:
                stream.bind(os.fspath(path))
            finally:
                os.umask(before)
            stream.listen(WAITING)
    except OSError as e:
        stream.close()
        what = "no such folder" if isinstance(e, FileNotFoundError) else str(e.strerror or e)
        raise UserError(what, where=str(path.parent), fix="name another socket with --socket") from None
    except BaseException:
        stream.close()
        raise
    return stream


@contextlib.contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Keep other servers from checking the sockets of a folder meanwhile; no file is needed for it.

    Anybody who can read the folder can lock it, so a server waits only :data:`LONGEST_LOCK_S`.
    """
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        end = time.monotonic() + LONGEST_LOCK_S
        while time.monotonic() < end:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(0.05)
        yield
    finally:
        os.close(handle)


def _remove_stale(path: Path) -> None:
    """Remove a socket that a server left when it was killed; refuse one at which somebody listens, and other files."""
    try:
        about = path.lstat()
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(about.st_mode):
        raise UserError("is there already, and is no socket", where=str(path), fix="name another one with --socket")
    with contextlib.closing(unix_socket(path)) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(os.fspath(path))
        except ConnectionRefusedError:
            path.unlink()
            return
        except OSError:
            # Somebody listens who has no time, or whom we may not ask.
            pass
    raise UserError("somebody listens there already", where=str(path), fix="name another one with --socket")


def read_token(path: Path) -> str:
    """Return the token in a file; ``UserError`` for no file, one that others can read, or too short a token."""
    try:
        about = path.stat()
        text = path.read_bytes()[: MOST_TOKEN + 2].decode("ascii").strip()
    except OSError as e:
        raise UserError(str(e.strerror or e), where=str(path), expected="a file that holds a token") from None
    except UnicodeDecodeError:
        text = ""
    if os.name == "posix" and about.st_mode & 0o077:
        raise UserError("can be read by others", where=str(path), fix=f"chmod 600 {path}")
    if not LEAST_TOKEN <= len(text) <= MOST_TOKEN or not text.isprintable() or " " in text:
        expected = f"one word of {LEAST_TOKEN} to {MOST_TOKEN} letters and digits"
        raise UserError("holds no token", where=str(path), expected=expected)
    return text


def check_reach(address: Address, token: str | None) -> None:
    """Raise ``UserError`` for an address that other machines can reach without a token."""
    if token is None and not address.is_local:
        raise UserError(
            "can be reached from other machines",
            where=str(address),
            expected="a Unix socket or the loopback, or a token that clients must know",
            fix="add --token-file FILE",
        )


def serve(
    scene: str | Path,
    address: Address,
    *,
    token_file: Path | None = None,
    most_images: int | None = None,
    time_limit_s: float = 30.0,
    ready: Callable[[Address, dict[str, Any]], None],
) -> int:
    """Serve images of a scene; return how many were made, after SIGINT, SIGTERM or the last one allowed.

    Parameters
    ----------
    scene : str or Path
        A scene file or the name of a shipped one.
    address : Address
        Unix socket or TCP; port 0 is any that is free.
    token_file : Path, optional
        Holds a word that every request must have; required where other machines can reach the address.
    most_images : int, optional
        Stop after so many.
    time_limit_s : float
        For a message to come in or to go out, each.
    ready : callable
        Called with the address and the description of the service once the first image can be requested.

    Raises
    ------
    UserError
        A scene that cannot be rendered or observed, an address that is in use or reaches too far, a missing package.
    """
    check_installed()
    token = None if token_file is None else read_token(token_file)
    check_reach(address, token)
    source = ImageSource(scene)
    with _signals() as signals, listening(address) as (listener, reached):
        # A scene that cannot be served is refused now, and its tables are there for the first client.
        source.first_image()
        signals.check()
        server = Server(source.answer, source.about(), token=token, time_limit_s=time_limit_s, most_images=most_images)
        signals.stop = server.stop
        ready(reached, source.about())
        server.run(listener)
        signals.stop = None
    return server.served


class _Signals:
    """SIGINT and SIGTERM: one that comes before the server runs ends its start, a later one stops it in good order."""

    def __init__(self) -> None:
        self.stop: Callable[[], None] | None = None
        """What the next signal calls; without it a signal raises KeyboardInterrupt."""
        self._came = False

    def handle(self, _kind: int, _frame: object) -> None:
        if self.stop is not None:
            stop, self.stop = self.stop, None
            stop()
            return
        self._came = True
        raise KeyboardInterrupt

    def check(self) -> None:
        """Raise again, later, what a signal has raised while compiled code called back, which swallows exceptions."""
        if self._came:
            raise KeyboardInterrupt


@contextlib.contextmanager
def _signals() -> Iterator[_Signals]:
    signals = _Signals()
    if threading.current_thread() is not threading.main_thread():
        yield signals
        return
    before = {kind: signal.signal(kind, signals.handle) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield signals
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)
