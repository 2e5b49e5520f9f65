"""Values come back as they were, bit by bit; bytes that are none are one line."""

from __future__ import annotations

import math
import sys

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from horizonval.core.errors import UserError
from horizonval.wire import array_of_map, array_to_map, pack, unpack

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(1 << 63), (1 << 64) - 1) | st.floats(allow_nan=False) | st.text()
    | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)  # fmt: skip


@given(st.dictionaries(st.text(), VALUES, max_size=6))
def test_a_map_comes_back(message):
    assert unpack(pack(message)) == message


def test_numbers_keep_their_bits():
    number = math.nextafter(0.1, 1.0)
    assert unpack(pack({"x": number, "n": (1 << 63) - 1})) == {"x": number, "n": (1 << 63) - 1}


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


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (b"", "no MessagePack"),
        (b"\xc1", "no MessagePack"),
        (msgpack.packb([1, 2]), "a packed list"),
        (msgpack.packb({1: 2}), "no MessagePack"),
        (b"\x81\xc4\x01a\x01", "keys that are text"),
        (msgpack.packb({"a": 1}) + b"\x00", "no MessagePack"),
        (b"\x82\xa1a\x01\xa1a\x02", "'a' stands twice"),
        (b"\x81\xa1a\xdd\xff\xff\xff\xff", "no MessagePack"),
        (b"\x81\xa1a\xc6\xff\xff\xff\xff", "no MessagePack"),
        (b"\x81\xa1a\xa2\xff\xfe", "no MessagePack"),
        (b"\x81\xa1a" * 5000, "no MessagePack"),
    ],
)
def test_what_is_no_map_is_one_line(body, says):
    with pytest.raises(UserError) as raised:
        unpack(body)
    assert says in str(raised.value)
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


def test_without_the_package_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "msgpack", None)
    with pytest.raises(UserError, match=r"pip install 'horizonval\[serve\]'"):
        pack({})
