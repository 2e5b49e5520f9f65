"""Messages between the image service and its clients: framing on a stream, packing of values, addresses.

A message is a header of eight bytes and one map in MessagePack::

    "HVS1"  length of the body, 4 bytes, most significant first  body

The four letters show at once that a peer speaks another protocol; the length bounds what is read before any of it is
parsed. After an incomplete or foreign message the next one cannot be found, so the stream is given up
(:class:`BrokenStreamError`).

An array is ``{"dtype": "<u2", "shape": [H, W], "data": bytes}``: little-endian, row by row, with numpy's
``dtype.str``. Numbers of 64 bits are exact.
"""

from __future__ import annotations

import ipaddress
import os
import socket
import stat
import struct
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.errors import UserError

SCHEMA = "horizonval/1"
"""Of the messages' contents; every message carries it. Another number is another meaning of the same keys."""

MAGIC = b"HVS1"
HEADER = struct.Struct(">4sI")
LONGEST_BODY = (1 << 32) - 1
"""What the header can say [bytes]."""
_CHUNK = 1 << 20
_FAREWELL_S = 0.2


class BrokenStreamError(UserError):
    """What came is no whole message, and nothing that follows on the stream can be understood."""


def receive(stream: socket.socket, most_bytes: int, time_limit_s: float, first_s: float | None = None) -> bytes | None:
    """Return the body of the next message, or None where the peer ended the stream between two messages.

    ``most_bytes``: longest body; ``time_limit_s``: from the first byte of a message to its last; ``first_s``: for the
    first byte, no limit by default. Changes the stream's time-out.

    Raises
    ------
    BrokenStreamError
        A message that is incomplete, too long, too slow or foreign.
    OSError
        The connection is lost.
    """
    stream.settimeout(first_s)
    try:
        first = stream.recv(1)
    except TimeoutError:
        raise BrokenStreamError(f"no message within {first_s:g} s", where="message") from None
    if not first:
        return None
    end = time.monotonic() + time_limit_s
    # A foreign beginning is refused at once: what else would follow may never come.
    header = bytearray(first)
    while len(header) < HEADER.size:
        _refuse_foreign(bytes(header[: len(MAGIC)]))
        header += _read(stream, HEADER.size - len(header), end, len(header), HEADER.size, whole=False)
    magic, length = HEADER.unpack(bytes(header))
    _refuse_foreign(magic)
    if length > most_bytes:
        raise BrokenStreamError(
            f"a message of {length} bytes", where="message", expected=f"at most {most_bytes}", fix="connect again"
        )
    return bytes(_read(stream, length, end, 0, length, whole=True))


def send(stream: socket.socket, body: bytes, time_limit_s: float | None) -> None:
    """Write one message; ``UserError`` if the body is too long for a header.

    ``OSError``: the connection is lost, or the peer does not read (``TimeoutError``); the stream is then unusable.
    """
    if len(body) > LONGEST_BODY:
        raise UserError(f"a message of {len(body)} bytes", where="message", expected=f"at most {LONGEST_BODY}")
    stream.settimeout(time_limit_s)
    stream.sendall(HEADER.pack(MAGIC, len(body)) + body)


def send_last(stream: socket.socket, body: bytes, time_limit_s: float) -> None:
    """Write one message after which the connection is closed; later bytes from the peer are discarded.

    Closed with bytes unread, TCP would discard what the peer has not read yet. Errors as of :func:`send`.
    """
    send(stream, body, time_limit_s)
    stream.shutdown(socket.SHUT_WR)
    end = time.monotonic() + _FAREWELL_S
    while (left := end - time.monotonic()) > 0:
        stream.settimeout(left)
        if not stream.recv(_CHUNK):
            break


def _refuse_foreign(beginning: bytes) -> None:
    if not MAGIC.startswith(beginning):
        raise BrokenStreamError(
            f"a message that begins with {beginning!r}",
            where="message",
            expected=f"{MAGIC.decode()}, four bytes of length, and a packed map",
            fix="connect again",
        )


def _read(stream: socket.socket, count: int, end: float, before: int, of: int, *, whole: bool) -> bytearray:
    """Return the next bytes: all ``count`` of them if ``whole``, else those that are there."""
    found = bytearray()
    while len(found) < count:
        left = end - time.monotonic()
        try:
            if left <= 0:
                raise TimeoutError
            stream.settimeout(left)
            part = stream.recv(min(count - len(found), _CHUNK))
        except TimeoutError:
            what = f"half a message: {before + len(found)} of {of} bytes, and no more in time"
            raise BrokenStreamError(what, where="message", fix="connect again") from None
        if not part:
            what = f"half a message: {before + len(found)} of {of} bytes, then the end"
            raise BrokenStreamError(what, where="message", fix="connect again")
        found += part
        if not whole:
            break
    return found


DTYPES = ("<u2", "<f4", "<f8")
"""Types of arrays that messages carry."""


def _msgpack() -> Any:
    try:
        import msgpack
    except ImportError:
        raise UserError(
            "the package msgpack is not installed",
            where="serve",
            fix="install the extra `serve`: pip install 'horizonval[serve]'",
        ) from None
    return msgpack


def check_installed() -> None:
    """Raise the user's error that says how to install what packing needs, where it is missing."""
    _msgpack()


def pack(message: dict[str, Any]) -> bytes:
    """Return a map of plain values as bytes; the same map gives the same bytes. Arrays by :func:`array_to_map`."""
    packed: bytes = _msgpack().packb(message, use_bin_type=True)
    return packed


def unpack(body: bytes) -> dict[str, Any]:
    """Return the packed map; ``UserError`` for anything but one MessagePack map with unique text keys."""
    msgpack = _msgpack()
    try:
        message = msgpack.unpackb(body, raw=False, strict_map_key=True, object_pairs_hook=_map)
    except UserError:
        raise
    except (ValueError, TypeError, RecursionError, msgpack.UnpackException) as e:
        what = " ".join(str(e).split()) or type(e).__name__
        raise UserError(f"no MessagePack: {what}", where="message", expected="one packed map") from None
    if not isinstance(message, dict):
        raise UserError(f"a packed {type(message).__name__}", where="message", expected="one packed map")
    return message


def _map(pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in pairs:
        if not isinstance(key, str):
            raise UserError(f"the key {key!r}", where="message", expected="keys that are text")
        if key in found:
            raise UserError(f"the key {key!r} stands twice", where="message", expected="every key once")
        found[key] = value
    return found


def array_to_map(array: NDArray[Any]) -> dict[str, Any]:
    """Return an array as a map that can be packed."""
    little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    return {"dtype": little.dtype.str, "shape": list(array.shape), "data": little.tobytes()}


def array_of_map(packed: Any, where: str) -> NDArray[Any]:
    """Return the array of :func:`array_to_map` as a copy; ``UserError`` for another type or length."""
    expected = f"an array: dtype {', '.join(DTYPES)}, shape and data"
    if not isinstance(packed, dict) or set(packed) != {"dtype", "shape", "data"} or packed["dtype"] not in DTYPES:
        raise UserError("found something else", where=where, expected=expected)
    shape, data, dtype = packed["shape"], packed["data"], np.dtype(packed["dtype"])
    sizes_are_whole = isinstance(shape, list) and all(type(side) is int and side >= 0 for side in shape)
    if not sizes_are_whole or not isinstance(data, bytes):
        raise UserError("found something else", where=where, expected=expected)
    count = 1
    for side in shape:
        count *= side
    if count * dtype.itemsize != len(data):
        raise UserError(f"{len(data)} bytes of shape {shape}", where=where, expected=f"{count * dtype.itemsize} bytes")
    return np.frombuffer(data, dtype).reshape(shape).astype(dtype.newbyteorder("="))


PARTS = ("what", "where", "expected", "fix")


def problem_message(error: UserError, identity: int | str | None = None) -> dict[str, Any]:
    """Return the reply that says a mistake, the first one of several; ``identity`` is the request's ``id``."""
    message: dict[str, Any] = {"schema": SCHEMA, "kind": "error"}
    if identity is not None:
        message["id"] = identity
    return message | {part: getattr(error, part) for part in PARTS} | {"line": error.line()}


def error_of_message(message: dict[str, Any]) -> UserError:
    """Return the mistake that a reply says."""
    what, where, expected, fix = (str(message.get(part, "")) for part in PARTS)
    return UserError(what or "the server refused", where=where, expected=expected, fix=fix)


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
        """Return the address that a text names, the default socket for the empty text.

        ``UserError`` if it names none.
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

        ``OSError``: nobody listens, or not in time. ``UserError``: a path that no socket can have, or a system without
        Unix sockets.
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
    """Return an unconnected Unix socket; ``UserError`` if the system has none, or the path is too long."""
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
    """Make the default socket's folder, if need be; ``UserError`` if another user owns it or may enter it."""
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
