"""Messages of the image service: whole or refused, in time and within bounds; values keep their bits."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from horizonval.core.errors import UserError
from horizonval.wire import (
    HEADER,
    LONGEST_PATH,
    MAGIC,
    Address,
    BrokenStreamError,
    array_of_map,
    array_to_map,
    default_socket,
    make_private_folder,
    pack,
    receive,
    send,
    unix_socket,
    unpack,
)


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


def test_a_message_in_single_bytes_is_whole_and_the_end_after_it_no_mistake(pair):
    ours, theirs = pair

    def drip() -> None:
        for byte in HEADER.pack(MAGIC, 3) + b"abc":
            theirs.sendall(bytes([byte]))
        theirs.close()

    sender = threading.Thread(target=drip)
    sender.start()
    assert receive(ours, 10, 5.0) == b"abc"
    assert receive(ours, 10, 1.0) is None
    sender.join()


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


TEXT = st.text("a\n\0\u00e9\u20ac\U0001f600")
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(1 << 63), (1 << 64) - 1) | st.floats(allow_nan=False) | TEXT
    | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4),
    max_leaves=20,
)  # fmt: skip


@settings(max_examples=30, deadline=None)
@given(st.dictionaries(TEXT, VALUES, max_size=6))
def test_a_map_comes_back(message):
    assert unpack(pack(message)) == message


@pytest.mark.parametrize("dtype", ["uint16", ">u2", "float32", "float64"])
def test_an_array_comes_back(dtype):
    array = np.arange(24).astype(dtype).reshape(4, 6)[:, ::2]
    packed = unpack(pack({"a": array_to_map(array)}))["a"]
    found = array_of_map(packed, "a")
    np.testing.assert_array_equal(found, array)
    assert found.dtype == array.dtype.newbyteorder("=")
    assert found.flags.writeable


@given(st.binary(max_size=200))
def test_any_bytes_are_a_map_or_one_line(body):
    try:
        found = unpack(body)
    except UserError as e:
        found = {"line": str(e)}
    assert isinstance(found, dict)
    assert "\n" not in str(found.get("line", ""))


NO_MAPS = [
    *(b"", b"\xc1", msgpack.packb([1, 2]), msgpack.packb({1: 2}), msgpack.packb({"a": 1}) + b"\x00"),
    *(b"\x81\xc4\x01a\x01", b"\x82\xa1a\x01\xa1a\x02"),  # a key that is no text, a key twice
    *(
        b"\x81\xa1a\xdd\xff\xff\xff\xff",
        b"\x81\xa1a\xc6\xff\xff\xff\xff",
        b"\x81\xa1a\xa2\xff\xfe",
        b"\x81\xa1a" * 5000,
    ),
]


@pytest.mark.parametrize("body", NO_MAPS)
def test_what_is_no_map_is_one_line(body):
    with pytest.raises(UserError) as raised:
        unpack(body)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "packed",
    [
        None,
        7,
        {},
        {"dtype": "<u2", "shape": [2], "data": b"123"},
        {"dtype": "<u2", "shape": [-1], "data": b""},
        {"dtype": "<u2", "shape": [True], "data": b"12"},
        {"dtype": "<u2", "shape": 1, "data": b"12"},
        {"dtype": "<u2", "shape": [1], "data": "12"},
        {"dtype": "O", "shape": [1], "data": b"12345678"},
        {"dtype": "<u2", "shape": [1 << 62, 4], "data": b""},
        {"dtype": "<u2", "shape": [1], "data": b"12", "more": 1},
    ],
)
def test_what_is_no_array_is_one_line(packed):
    with pytest.raises(UserError, match="reply: dn"):
        array_of_map(packed, "reply: dn")


@pytest.mark.parametrize("text", ["ipc:///run/x.sock", "ipc://x.sock", "tcp://127.0.0.1:5000", "tcp://[::1]:5000"])
def test_an_address_is_written_as_it_is_read(text):
    assert str(Address.parse(text)) == text


@pytest.mark.parametrize(
    "text", ["x.sock", "ipc://", "tcp://a", "tcp://:1", "tcp://a:b", "tcp://a:65536", "http://a:1"]
)
def test_what_is_no_address_is_one_line(text):
    with pytest.raises(UserError, match="expected ipc://PATH or tcp://HOST:PORT"):
        Address.parse(text)


@pytest.mark.parametrize(
    ("text", "local"),
    [
        *((text, True) for text in ("ipc://x", "tcp://127.0.0.1:1", "tcp://127.8.0.1:1", "tcp://[::1]:1")),
        ("tcp://localhost:1", True),
        *((f"tcp://{host}:1", False) for host in ("0.0.0.0", "192.168.0.2", "[::]", "example.org")),
    ],
)
def test_who_can_reach_it(text, local):
    assert Address.parse(text).is_local is local


def test_the_default_lies_in_the_runtime_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert default_socket() == tmp_path / "horizonval" / "serve.sock"
    assert Address.parse("").path == default_socket()
    monkeypatch.setenv("XDG_RUNTIME_DIR", "")
    assert default_socket().parent.name.startswith("horizonval-")


def test_a_folder_that_others_enter_is_refused(tmp_path):
    make_private_folder(tmp_path / "new")
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o700
    make_private_folder(tmp_path / "new")
    (tmp_path / "new").chmod(0o755)
    with pytest.raises(UserError, match="is open to others"):
        make_private_folder(tmp_path / "new")
    (tmp_path / "mine").mkdir(0o700)
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    with pytest.raises(UserError, match="is open to others"):
        make_private_folder(tmp_path / "link")


def test_a_path_that_is_too_long_is_one_line():
    with pytest.raises(UserError, match=f"at most {LONGEST_PATH} bytes"):
        unix_socket(Path("/" + "x" * LONGEST_PATH))
