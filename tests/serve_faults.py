"""What clients of the image service may do that they should not, and that another client notices nothing of it."""

from __future__ import annotations

import random
import socket
import time

import horizonval as hv
from horizonval.serve.server import MOST_REQUEST_BYTES
from horizonval.wire import HEADER, MAGIC, SCHEMA, Address, pack, receive, send, unpack

REQUEST = pack({"schema": SCHEMA, "kind": "image", "seed": 5})
FRAME = HEADER.pack(MAGIC, len(REQUEST)) + REQUEST
FAULTS = [
    "gone at once", "gone before its answer", "half a message", "garbage", "a garbled message", "too long",
    "many at once, never read", "reset",
]  # fmt: skip


def _fault(address: Address, kind: str, rng: random.Random) -> None:
    """Do to the server at an address what no client should."""
    with address.connect(5.0) as stream:
        if kind == "gone at once":
            return
        if kind == "gone before its answer":
            stream.sendall(FRAME)
        elif kind == "half a message":
            stream.sendall(FRAME[: rng.randrange(1, len(FRAME))])
        elif kind == "garbage":
            stream.sendall(b"X" + rng.randbytes(rng.randrange(0, 3000)))
            assert unpack(receive(stream, 1 << 20, 5.0) or b"")["kind"] == "error"
        elif kind == "a garbled message":
            body = bytearray(REQUEST)
            body[rng.randrange(len(body))] ^= 1 << rng.randrange(8)
            send(stream, bytes(body), 5.0)
            assert unpack(receive(stream, 1 << 20, 5.0) or b"")["kind"] in ("error", "image")
        elif kind == "too long":
            stream.sendall(HEADER.pack(MAGIC, MOST_REQUEST_BYTES + rng.randrange(1, 1 << 31)))
            assert unpack(receive(stream, 1 << 20, 5.0) or b"")["kind"] == "error"
        elif kind == "many at once, never read":
            stream.sendall(FRAME * rng.randrange(2, 40))
        elif kind == "reset":
            stream.sendall(FRAME[: rng.randrange(len(FRAME))])
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")


def after_faults(address: Address, faults: int, seed: int) -> None:
    """Do faults of all kinds in turn; a steady client must get each of its own images, and the others be let go."""
    rng = random.Random(seed)
    with hv.Client(str(address), timeout_s=60.0) as steady:
        for number in range(faults):
            _fault(address, FAULTS[number % len(FAULTS)], rng)
            image = steady.image(seed=number)
            assert image.seed == number
        end = time.monotonic() + 20.0
        # What counts is the status that ends the wait: the last fault's connection may be let in only after it.
        while (status := steady.status())["clients"] > 1 and time.monotonic() < end:
            time.sleep(0.05)
    assert status["clients"] == 1
    assert status["refused"] >= faults // len(FAULTS)
