"""A message is whole or refused, in time and within bounds."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator

import pytest

from horizonval.wire import HEADER, MAGIC, BrokenStreamError, receive, send


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield ours, theirs


@pytest.mark.parametrize("body", [b"", b"x", bytes(range(256)) * 5000])
def test_what_is_sent_is_received(pair, body):
    ours, theirs = pair
    sender = threading.Thread(target=lambda: [send(theirs, body, 5.0), send(theirs, b"next", 5.0)])
    sender.start()
    assert receive(ours, 1 << 21, 5.0) == body
    assert receive(ours, 1 << 21, 5.0) == b"next"
    sender.join()


def test_a_message_in_single_bytes_is_whole(pair):
    ours, theirs = pair

    def drip() -> None:
        for byte in HEADER.pack(MAGIC, 3) + b"abc":
            theirs.sendall(bytes([byte]))

    sender = threading.Thread(target=drip)
    sender.start()
    assert receive(ours, 10, 5.0) == b"abc"
    sender.join()


def test_the_end_between_two_messages_is_no_mistake(pair):
    ours, theirs = pair
    theirs.close()
    assert receive(ours, 10, 1.0) is None


@pytest.mark.parametrize(
    ("sent", "says"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "begins with b'G"),
        (b"HVS2\0\0\0\1x", "begins with b'HVS2"),
        (b"HV", "2 of 8 bytes, then the end"),
        (HEADER.pack(MAGIC, 9) + b"four", "4 of 9 bytes, then the end"),
        (HEADER.pack(MAGIC, 11), "11 bytes; expected at most 10"),
        (HEADER.pack(MAGIC, (1 << 32) - 1), "expected at most 10"),
    ],
)
def test_anything_else_breaks_the_stream(pair, sent, says):
    ours, theirs = pair
    theirs.sendall(sent)
    theirs.shutdown(socket.SHUT_WR)
    with pytest.raises(BrokenStreamError) as raised:
        receive(ours, 10, 1.0)
    assert says in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("sent", [b"H", HEADER.pack(MAGIC, 9), HEADER.pack(MAGIC, 9) + b"four"])
def test_half_a_message_that_stays_half_is_given_up_in_time(pair, sent):
    ours, theirs = pair
    theirs.sendall(sent)
    start = time.monotonic()
    with pytest.raises(BrokenStreamError, match="no more in time"):
        receive(ours, 10, 0.2)
    assert time.monotonic() - start < 2.0


def test_a_slow_drip_does_not_stretch_the_time_limit(pair):
    ours, theirs = pair
    stop = threading.Event()

    def drip() -> None:
        theirs.sendall(HEADER.pack(MAGIC, 1000))
        while not stop.wait(0.02):
            theirs.sendall(b".")

    sender = threading.Thread(target=drip)
    sender.start()
    with pytest.raises(BrokenStreamError, match="of 1000 bytes, and no more in time"):
        receive(ours, 1000, 0.3)
    stop.set()
    sender.join()


def test_who_says_nothing_is_waited_for_as_long_as_asked(pair):
    ours, _ = pair
    with pytest.raises(BrokenStreamError, match=r"no message within 0\.1 s"):
        receive(ours, 10, 5.0, first_s=0.1)


def test_who_does_not_read_is_given_up(pair):
    _, theirs = pair
    with pytest.raises(TimeoutError):
        send(theirs, bytes(1 << 24), 0.2)
