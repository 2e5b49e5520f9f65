"""Where the image service listens: a Unix socket (``ipc://PATH``) or TCP (``tcp://HOST:PORT``)."""

from __future__ import annotations

import ipaddress
import os
import socket
import stat
import tempfile
from dataclasses import dataclass
from pathlib import Path

from horizonval.core.errors import UserError

LONGEST_PATH = 100
"""Bytes of a Unix socket's path; systems allow 103 to 107."""
DEFAULT_SOCKET = "serve.sock"
EXPECTED = "ipc://PATH or tcp://HOST:PORT"


@dataclass(frozen=True)
class Address:
    """A Unix socket's path, or host and port of TCP; one of the two is None."""

    path: Path | None = None
    host: str = ""
    port: int = 0

    @classmethod
    def parse(cls, text: str) -> Address:
        """Return the address that a text names; the empty text names the default socket.

        Raises
        ------
        UserError
            It names none.
        """
        if not text:
            return cls(default_socket())
        kind, mark, rest = text.partition("://")
        if mark and kind == "ipc" and rest:
            return cls(Path(rest))
        host, colon, port = rest.rpartition(":")
        if mark and kind == "tcp" and colon and host and port.isascii() and port.isdigit() and int(port) < 1 << 16:
            return cls(None, host.removeprefix("[").removesuffix("]"), int(port))
        raise UserError(f"found {text!r}", where="address", expected=EXPECTED)

    @property
    def is_local(self) -> bool:
        """Whether nobody outside of this machine can reach it."""
        if self.path is not None or self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    def connect(self, time_limit_s: float | None) -> socket.socket:
        """Return a connection.

        Raises
        ------
        OSError
            Nobody listens, or not in time.
        UserError
            A path that no socket can have, or a system without Unix sockets.
        """
        if self.path is None:
            stream = socket.create_connection((self.host, self.port), timeout=time_limit_s)
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return stream
        stream = unix_socket(self.path)
        try:
            stream.settimeout(time_limit_s)
            stream.connect(os.fspath(self.path))
        except BaseException:
            stream.close()
            raise
        return stream

    def __str__(self) -> str:
        if self.path is not None:
            return f"ipc://{self.path}"
        return f"tcp://[{self.host}]:{self.port}" if ":" in self.host else f"tcp://{self.host}:{self.port}"


def unix_socket(path: Path) -> socket.socket:
    """Return an unconnected Unix socket for a path.

    Raises
    ------
    UserError
        The system has none, or the path is too long for one.
    """
    if not hasattr(socket, "AF_UNIX"):
        raise UserError("this system has no Unix sockets", where=str(path), fix="use TCP on the loopback: --port")
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise UserError(
            f"{len(os.fsencode(path))} bytes long",
            where=str(path),
            expected=f"a socket's path of at most {LONGEST_PATH} bytes",
            fix="name a shorter one with --socket",
        )
    return socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)


def default_socket() -> Path:
    """Return the socket that is used where none is named: in a folder of which only this user has the key."""
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if runtime and Path(runtime).is_dir():
        return Path(runtime) / "horizonval" / DEFAULT_SOCKET
    user = os.getuid() if hasattr(os, "getuid") else "user"
    return Path(tempfile.gettempdir()) / f"horizonval-{user}" / DEFAULT_SOCKET


def make_private_folder(folder: Path) -> None:
    """Make the default socket's folder, if need be, and refuse one that others can get into.

    Raises
    ------
    UserError
        It belongs to somebody else, or others may enter it.
    """
    folder.mkdir(mode=0o700, exist_ok=True)
    about = folder.lstat()
    foreign = hasattr(os, "getuid") and about.st_uid != os.getuid()
    if foreign or not stat.S_ISDIR(about.st_mode) or about.st_mode & 0o077:
        raise UserError(
            "is open to others",
            where=str(folder),
            expected="a folder of this user alone (mode 700)",
            fix="name another socket with --socket",
        )
