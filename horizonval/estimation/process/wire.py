"""What passes between a worker and its estimators: JSON for small things, raw arrays behind it, nothing that is run.

A message is the length of its head, the head as JSON, and the arrays that the head declares, each float64 (an image in
its own type of number) in C order from a multiple of 64 bytes on. What comes from an estimator is trusted in nothing:
sizes are bounded before anything is allocated, and the whole is held against the form of an answer.
"""

from __future__ import annotations

import dataclasses
import json
import math
import struct
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.outcome import Refusal
from horizonval.estimation.answer import MOST_POINTS, checked
from horizonval.estimation.calibration import Calibration
from horizonval.estimation.lens import Lens
from horizonval.estimation.observation import Fit, Observation, OraclePose
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel

LENGTH = struct.Struct("<Q")
LONGEST_HEAD = 1 << 16
LONGEST_ANSWER = LONGEST_HEAD + 8 * (6 * MOST_POINTS + 64)
"""Bytes: head, points, residuals and steps at their most."""
_ALIGNED = 64
_FIT_ARRAYS = ("nadir_cam", "covariance_nadir_cam", "systematic_nadir_cam", "points", "residuals_rad", "steps")
_FIT_NUMBERS = ("roll_rad", "pitch_rad", "angular_radius_rad", "altitude_m", "sigma_altitude_m")


def pack_observation(observation: Observation) -> list[bytes | memoryview]:
    """Return the parts of a message with an observation, to be written one behind the other."""
    arrays: list[NDArray[Any]] = []
    places: dict[int, int] = {}
    tree = _observation_tree(observation, arrays, places)
    head = json.dumps({"tree": tree, "arrays": [[a.dtype.str, a.shape] for a in arrays]}).encode()
    parts: list[bytes | memoryview] = [LENGTH.pack(len(head)), head]
    place = LENGTH.size + len(head)
    for array in arrays:
        gap = -place % _ALIGNED
        parts += [bytes(gap), array.reshape(-1).view(np.uint8).data]
        place += gap + array.nbytes
    return parts


def unpack_observation(data: NDArray[np.uint8]) -> Observation:
    """Return the observation of a message, its arrays in the message's own memory."""
    (length,) = LENGTH.unpack(data[: LENGTH.size].tobytes())
    place = LENGTH.size + length
    head = json.loads(data[LENGTH.size : place].tobytes())
    arrays = []
    for kind, shape in head["arrays"]:
        place += -place % _ALIGNED
        end = place + np.dtype(kind).itemsize * math.prod(shape)
        arrays.append(data[place:end].view(kind).reshape(shape))
        place = end
    return _observation(head["tree"], arrays)


def _observation_tree(observation: Observation, arrays: list[NDArray[Any]], places: dict[int, int]) -> dict[str, Any]:
    def put(array: NDArray[Any] | None) -> int | None:
        if array is None:
            return None
        # The first head's image is the observation's own too.
        if id(array) not in places:
            places[id(array)] = len(arrays)
            plain = np.asarray(array)
            arrays.append(np.ascontiguousarray(plain if plain.dtype.kind in "fiub" else plain.astype(np.float64)))
        return places[id(array)]

    def number(value: float | None) -> float | None:
        return None if value is None else float(value)

    def plain(value: Any) -> Any:
        # Few numbers: JSON keeps every bit of them.
        return value.isoformat() if isinstance(value, datetime) else np.asarray(value).tolist()

    oracle, calibration, lens = observation.oracle, observation.calibration, observation.lens
    camera = {key: list(v) if isinstance(v, tuple) else v for key, v in vars(observation.camera).items()}
    return {
        "image": put(observation.image),
        "camera": {key: v.item() if isinstance(v, np.generic) else v for key, v in camera.items()},
        "q_cam_from_body": put(observation.q_cam_from_body),
        "sun_cam": put(observation.sun_cam),
        "full_scale": number(observation.full_scale),
        "prior": {name: plain(value) for name, value in vars(observation.prior).items() if value is not None},
        "band_kind": observation.band_kind,
        "band_width_um": number(observation.band_width_um),
        "radiance_per_dn": number(observation.radiance_per_dn),
        "lens": None if lens is None else {name: plain(value) for name, value in vars(lens).items()},
        "band_um": None if observation.band_um is None else [float(limit) for limit in observation.band_um],
        "calibration": None if calibration is None else vars(calibration),
        "oracle": None if oracle is None else [put(oracle.r_itrs), put(oracle.q_cam_from_itrs), float(oracle.radius_m)],
        "heads": {name: _observation_tree(head, arrays, places) for name, head in observation.heads.items()},
    }


def _observation(tree: dict[str, Any], arrays: list[NDArray[Any]]) -> Observation:
    camera = tree["camera"]
    oracle, calibration = tree["oracle"], tree["calibration"]
    return Observation(
        image=arrays[tree["image"]],
        camera=CameraModel(**(camera | {"distortion": tuple(camera["distortion"])})),
        q_cam_from_body=arrays[tree["q_cam_from_body"]],
        full_scale=tree["full_scale"],
        prior=_prior(tree["prior"]),
        band_kind=tree["band_kind"],
        band_width_um=tree["band_width_um"],
        radiance_per_dn=tree["radiance_per_dn"],
        lens=None if tree["lens"] is None else _lens(tree["lens"]),
        band_um=None if tree["band_um"] is None else (tree["band_um"][0], tree["band_um"][1]),
        sun_cam=None if tree["sun_cam"] is None else arrays[tree["sun_cam"]],
        calibration=None if calibration is None else _calibration(calibration),
        oracle=None if oracle is None else OraclePose(arrays[oracle[0]], arrays[oracle[1]], oracle[2]),
        heads={name: _observation(head, arrays) for name, head in tree["heads"].items()},
    )


def _lens(tree: dict[str, Any]) -> Lens:
    return Lens(np.array(tree["angles_rad"]), np.array(tree["ratios"]), tree["diffraction_px"])


def _calibration(tree: dict[str, Any]) -> Calibration:
    return Calibration(**(tree | {"mounting_sigma_rad": tuple(tree["mounting_sigma_rad"])}))


def _prior(tree: dict[str, Any]) -> Prior:
    values: dict[str, Any] = dict(tree)
    for name in ("r_itrs", "q_cam_from_itrs", "attitude_sigma_rad"):
        if name in tree:
            values[name] = np.array(tree[name])
    if "epoch_utc" in tree:
        values["epoch_utc"] = datetime.fromisoformat(tree["epoch_utc"])
    return Prior(**values)


def pack_answer(result: Fit | Refusal, spent_s: float) -> bytes:
    """Return the message of an answer that :func:`horizonval.estimation.answer.checked` returned."""
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


def unpack_answer(message: bytes) -> tuple[Fit | Refusal, float]:
    """Return an answer and the processor time that it took.

    Raises
    ------
    ValueError
        It has not the form of an answer; in one line, why.
    """
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
        # The type says text, the check that follows holds it to that.
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
