"""Messages between a worker and the processes of estimators, through a shared open file.

The worker is trusted: an observation is pickled, followed by its arrays. An estimator's process is not: an answer is
the length of its head, the head as JSON, and the arrays that the head declares, all float64 in C order. Sizes are
bounded before allocation, and :func:`horizonval.plugins.answer.checked` validates the whole.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import pickle
import struct
from typing import Any

import numpy as np

from horizonval.core.outcome import Refusal
from horizonval.estimation.observation import Fit, Observation
from horizonval.plugins.answer import MOST_POINTS, checked

LENGTH = struct.Struct("<Q")
LONGEST_HEAD = 1 << 16
LONGEST_ANSWER = LONGEST_HEAD + 8 * (6 * MOST_POINTS + 64)
"""Maximum size of head, points, residuals and steps, bytes."""
_ALIGNED = 64
_FIT_ARRAYS = ("nadir_cam", "covariance_nadir_cam", "systematic_nadir_cam", "points", "residuals_rad", "steps")
_FIT_NUMBERS = ("roll_rad", "pitch_rad", "angular_radius_rad", "altitude_m", "sigma_altitude_m")


def write_observation(exchange: int, observation: Observation) -> int:
    """Write an observation to the file; return its length in bytes."""
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(_contiguous(observation), protocol=5, buffer_callback=buffers.append)
    parts = [memoryview(head), *(buffer.raw() for buffer in buffers)]
    table = struct.pack(f"<{1 + len(parts)}Q", len(parts), *(part.nbytes for part in parts))
    place = 0
    for part in (memoryview(table), *parts):
        view = part
        while view:
            count = os.pwrite(exchange, view, place)
            view, place = view[count:], place + count
        place += -place % _ALIGNED
    os.ftruncate(exchange, place)
    return place


def read_observation(exchange: int, length: int) -> Observation:
    """Return the observation in the file; its arrays are aligned to 64 bytes, equal in every process."""
    memory = np.empty(length + _ALIGNED, dtype=np.uint8)
    data = memory[-memory.ctypes.data % _ALIGNED :][:length]
    data[:] = np.frombuffer(os.pread(exchange, length, 0), dtype=np.uint8)
    (count,) = LENGTH.unpack(data[: LENGTH.size].tobytes())
    lengths = np.frombuffer(data[LENGTH.size : LENGTH.size * (1 + count)].tobytes(), dtype="<u8")
    place, parts = LENGTH.size * (1 + count), []
    for nbytes in map(int, lengths):
        place += -place % _ALIGNED
        parts.append(data[place : place + nbytes])
        place += nbytes
    observation: Observation = pickle.loads(parts[0].tobytes(), buffers=[part.data for part in parts[1:]])
    return observation


def _contiguous(observation: Observation) -> Observation:
    heads = {name: _contiguous(head) for name, head in observation.heads.items()}
    return dataclasses.replace(observation, image=np.ascontiguousarray(observation.image), heads=heads)


def pack_answer(result: Fit | Refusal, spent_s: float) -> bytes:
    """Return the message of an answer that :func:`horizonval.plugins.answer.checked` returned."""
    about: dict[str, Any] = {"spent_s": spent_s}
    if isinstance(result, Fit):
        about |= {name: getattr(result, name) for name in _FIT_NUMBERS} | {"estimates": result.estimates}
        arrays = {name: array for name in _FIT_ARRAYS if (array := getattr(result, name)) is not None}
    else:
        about |= {"status": str(result.status), "reason": result.reason, "output": result.output}
        arrays = {"points": result.points}
    about["shapes"] = {name: list(array.shape) for name, array in arrays.items()}
    head = json.dumps(about).encode()
    return b"".join(
        [LENGTH.pack(len(head)), head, *(array.astype("<f8", copy=False).tobytes() for array in arrays.values())]
    )


def read_answer(exchange: int) -> tuple[Fit | Refusal, float]:
    """Return the answer in the file and its processor time; as :func:`unpack_answer`."""
    length = os.fstat(exchange).st_size
    if length > LONGEST_ANSWER:
        raise ValueError(f"it is longer than {LONGEST_ANSWER} bytes")
    return unpack_answer(os.pread(exchange, length, 0))


def unpack_answer(message: bytes) -> tuple[Fit | Refusal, float]:
    """Return an answer and its processor time. Raises ``ValueError``: an invalid form, in one line."""
    about, rest = _head(message)
    shapes = about.get("shapes")
    if not isinstance(shapes, dict) or not set(shapes) <= set(_FIT_ARRAYS):
        raise ValueError("it has arrays that no answer has")
    arrays: dict[str, Any] = {}
    place = 0
    for name, shape in shapes.items():
        if not isinstance(shape, list) or len(shape) > 2 or not all(type(n) is int and 0 <= n <= 2**21 for n in shape):
            raise ValueError(f"the shape of {name} is none")
        end = place + 8 * math.prod(shape)
        if end > len(rest):
            raise ValueError(f"it ends within {name}")
        arrays[name] = np.frombuffer(rest[place:end], dtype="<f8").reshape(shape).copy()
        place = end
    if place != len(rest):
        raise ValueError("there is more behind it")
    spent = about.get("spent_s")
    if isinstance(spent, bool) or not isinstance(spent, int | float) or not 0.0 <= spent < 1e9:
        raise ValueError("its processor time is none")
    points = arrays.get("points", np.empty((0, 2)))
    if "status" in about:
        # The following check verifies that it is text.
        return checked(Refusal(about["status"], about.get("reason"), points, about.get("output"))), float(spent)  # type: ignore[arg-type]
    wanted = {field.name for field in dataclasses.fields(Fit)}
    numbers = {name: value for name, value in about.items() if name in wanted}
    try:
        return checked(Fit(**(numbers | arrays))), float(spent)
    except (TypeError, OverflowError) as e:
        raise ValueError(f"it is neither Fit nor Refusal: {e}") from e


def _head(message: bytes) -> tuple[dict[str, Any], bytes]:
    if len(message) < LENGTH.size:
        raise ValueError("it is too short")
    (length,) = LENGTH.unpack(message[: LENGTH.size])
    if length > min(LONGEST_HEAD, len(message) - LENGTH.size):
        raise ValueError("its head is of the wrong length")
    try:
        about = json.loads(message[LENGTH.size : LENGTH.size + length])
    except (ValueError, RecursionError) as e:
        raise ValueError(f"its head is no JSON ({type(e).__name__})") from e
    if not isinstance(about, dict):
        raise ValueError("its head is no JSON object")
    return about, message[LENGTH.size + length :]
