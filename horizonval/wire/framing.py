"""Whole messages on a stream of bytes: a header of eight bytes, then the body.

::

    "HVS1"  length of the body, 4 bytes, most significant first  body

The four letters say at once that a peer speaks something else; the length bounds what is read before any of it is
looked at. After anything but a whole message nobody knows where the next one begins, so the stream is given up
(:class:`BrokenStreamError`).
"""

from __future__ import annotations

import socket
import struct
import time

from horizonval.core.errors import UserError

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

    Parameters
    ----------
    stream : socket
        Its time-out is changed.
    most_bytes : int
        Longest body that is read.
    time_limit_s : float
        From the first byte of a message to its last.
    first_s : float, optional
        How long the first byte may take; for ever without.

    Raises
    ------
    BrokenStreamError
        Half a message, one that is too long or too slow, or none of ours.
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
    """Write one message.

    Raises
    ------
    UserError
        The body is longer than a header can say.
    OSError
        The connection is lost, or the peer does not read (``TimeoutError``); the stream is then of no more use.
    """
    if len(body) > LONGEST_BODY:
        raise UserError(f"a message of {len(body)} bytes", where="message", expected=f"at most {LONGEST_BODY}")
    stream.settimeout(time_limit_s)
    stream.sendall(HEADER.pack(MAGIC, len(body)) + body)


def send_last(stream: socket.socket, body: bytes, time_limit_s: float) -> None:
    """Write one message after which the connection is closed; what the peer still says is read and forgotten.

    Closed with bytes unread, TCP would take back what the peer has not read yet. Errors as of :func:`send`.
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
