"""Messages over pipes: each behind its length, with a word of what it is."""

from __future__ import annotations

import os
from typing import IO

from horizonval.estimation.process.wire import LENGTH

READY, DESCRIBED, ANSWER, ENDED = b"R", b"D", b"A", b"E"
"""A process has started; what an estimator says of itself; its answer; its process ended without one."""


def send(pipe: IO[bytes], data: bytes) -> None:
    """Write a message."""
    pipe.write(LENGTH.pack(len(data)) + data)
    pipe.flush()


def receive(pipe: IO[bytes]) -> bytes:
    """Read a message from whoever may be trusted.

    Raises
    ------
    EOFError
        The other side has closed the pipe.
    """
    (length,) = LENGTH.unpack(_exactly(pipe, LENGTH.size))
    return _exactly(pipe, length)


def _exactly(pipe: IO[bytes], length: int) -> bytes:
    data = bytearray()
    while len(data) < length:
        more = pipe.read(length - len(data))
        if not more:
            raise EOFError
        data += more
    return bytes(data)


def send_all(descriptor: int, data: bytes) -> None:
    """Write all of some bytes to a descriptor."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]
