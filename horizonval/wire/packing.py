"""Values as bytes and back: MessagePack, with arrays as maps of type, shape and data.

An array is ``{"dtype": "<u2", "shape": [H, W], "data": bytes}``: little-endian, row by row, in the words of numpy's
``dtype.str``, which a reader in any language can take apart. Numbers of 64 bits are kept bit by bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.errors import UserError

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
    """Return a map as bytes; the same map gives the same bytes.

    Parameters
    ----------
    message : dict
        Of text, numbers, true and false, None, bytes, lists and maps of them. Arrays by :func:`array_to_map`.
    """
    packed: bytes = _msgpack().packb(message, use_bin_type=True)
    return packed


def unpack(body: bytes) -> dict[str, Any]:
    """Return the map that was packed.

    Raises
    ------
    UserError
        Bytes that are no MessagePack, that hold more than one value, or another value than a map with names, each of
        them once.
    """
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
    """Return the array of :func:`array_to_map`, the caller's own.

    Raises
    ------
    UserError
        It is none: another type, or data of another length.
    """
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
