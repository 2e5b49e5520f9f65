"""What passes between a worker and an estimator's process: observations and answers to the bit, damage never."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Calibration, Fit, Lens, Observation, OraclePose
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel
from horizonval.plugins.answer import checked
from horizonval.plugins.messages import (
    LENGTH,
    LONGEST_ANSWER,
    pack_answer,
    read_observation,
    unpack_answer,
    write_observation,
)

RNG = np.random.default_rng(1)
FIT = Fit(
    nadir_cam=np.array([0.1, 0.2, np.sqrt(0.95)]),
    covariance_nadir_cam=RNG.normal(size=(3, 3)),
    roll_rad=0.1 + 0.2,
    pitch_rad=-1e-17,
    angular_radius_rad=1.1,
    altitude_m=5e5 / 3,
    points=RNG.normal(size=(7, 2)),
    residuals_rad=np.array([np.nan, 1.0]),
    steps=RNG.normal(size=(2, 4)),
    systematic_nadir_cam=RNG.normal(size=(3, 3)),
    estimates="geodetic",
)
REFUSAL = Refusal(Outcome.DARK, "night over 5\N{DEGREE SIGN}", RNG.normal(size=(3, 2)))


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return type(a) is type(b) and a == b


@pytest.mark.parametrize("result", [FIT, replace(FIT, systematic_nadir_cam=None, altitude_m=None), REFUSAL])
def test_an_answer_comes_through_to_the_bit(result: Fit | Refusal) -> None:
    back, spent = unpack_answer(pack_answer(checked(result), 0.25))
    assert spent == 0.25
    assert type(back) is type(result)
    assert all(_same(value, vars(back)[name]) for name, value in vars(result).items())


PRIOR = Prior(
    shape="sphere",
    radius_m=6.4e6 / 3,
    altitude_m=5e5 / 3,
    altitude_sigma_m=1e3,
    r_itrs=np.array([1.0, -2.0, 3.0]) * 2e6 / 3,
    position_sigma_m=1.0 / 3,
    q_cam_from_itrs=np.array([0.1, 0.2, 0.3, 0.9]) / math.sqrt(0.95),
    attitude_sigma_rad=np.array([1.0, 2.0, 3.0]) / 7,
    epoch_utc=datetime(2026, 3, 20, 12, 0, 0, 123456, tzinfo=UTC),
    limb_height_m=-1e3 / 7,
    limb_height_sigma_m=3e3 / 7,
    climate="tropical",
    sun_sigma_rad=0.01 / 3,
    limb_relief_m=0.1 / 3,
    accept_rad=0.1 / 3,
)


@pytest.fixture
def exchange(tmp_path: Path) -> Iterator[int]:
    with (tmp_path / "exchange").open("w+b") as file:
        yield file.fileno()


def test_an_observation_comes_through_to_the_bit(exchange: int) -> None:
    camera = CameraModel(6, 5, 55.5, 54.5, 2.5, 2.0, (0.1, 0.2, 0.3, 0.4, 0.5), "fisheye", np.float64(1.1))
    oracle = OraclePose(np.arange(3.0), np.arange(4.0), 6.4e6)
    head = Observation(RNG.normal(size=(6, 5)).T, camera, full_scale=1023.0, oracle=oracle, prior=PRIOR)
    head = replace(head, calibration=Calibration(0.01 / 3, 0.1, 0.2, (0.1, 0.2, 0.3 / 7), 1.0, 2.0))
    head = replace(head, lens=Lens(np.array([0.1, 0.7]), np.array([0.9, 1.2]) / 3, 0.5))
    whole = replace(head, heads={"a": head, "b": replace(head, image=np.arange(30, dtype=np.uint16).reshape(5, 6))})
    back = read_observation(exchange, write_observation(exchange, whole))
    assert list(back.heads) == ["a", "b"]
    for one, other in ((whole, back), (whole.heads["b"], back.heads["b"])):
        assert _same(np.ascontiguousarray(one.image), other.image)
        assert other.image.ctypes.data % 64 == 0
        assert (one.camera, one.calibration, one.full_scale) == (other.camera, other.calibration, other.full_scale)
        for part in ("oracle", "prior", "lens"):
            values = vars(getattr(other, part))
            assert all(_same(value, values[name]) for name, value in vars(getattr(one, part)).items()), part


def _message(about: object, behind: bytes = b"") -> bytes:
    head = json.dumps(about).encode()
    return LENGTH.pack(len(head)) + head + behind


ABOUT = {"spent_s": 0.0, "status": "dark", "reason": "night", "shapes": {"points": [1, 2]}}


@pytest.mark.parametrize(
    "message",
    [
        b"",
        b"\xff" * 8,
        LENGTH.pack(2**63) + b"{}",
        _message([]),
        _message({}),
        _message(ABOUT),
        _message(ABOUT, bytes(17)),
        _message(ABOUT | {"shapes": {"points": [2**40, 2**40]}}, bytes(16)),
        _message(ABOUT | {"shapes": {"points": [-1, -2]}}, bytes(16)),
        _message(ABOUT | {"shapes": {"points": [True, 2]}}, bytes(16)),
        _message(ABOUT | {"shapes": {"secrets": [1, 2]}}, bytes(16)),
        _message(ABOUT | {"shapes": [1, 2]}, bytes(16)),
        _message(ABOUT | {"spent_s": float("nan")}, bytes(16)),
        _message(ABOUT | {"spent_s": "long"}, bytes(16)),
        _message(ABOUT | {"status": ["dark"]}, bytes(16)),
        _message(ABOUT | {"reason": {}}, bytes(16)),
        _message({"spent_s": 0.0, "shapes": {"nadir_cam": [3]}, "roll_rad": 0.0}, bytes(24)),
        LENGTH.pack(60_000) + b"[" * 60_000,
        LENGTH.pack(30_000) + b"{" + b'"a":' + b"9" * 29_994 + b"}",
        b"\x80\x04\x95" + b"cos\n_exit\n(I0\ntR." * 10,
    ],
)
def test_bytes_that_are_no_answer_are_told(message: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011
        unpack_answer(message)


def test_flipped_bits_give_an_answer_in_its_form_or_none() -> None:
    """Whatever comes over the pipe, what goes on is a fit or a refusal of plain numbers."""
    whole = pack_answer(checked(FIT), 0.1)
    for _ in range(2000):
        message = bytearray(whole)
        message[RNG.integers(len(message))] ^= 1 << RNG.integers(8)
        try:
            result, _ = unpack_answer(bytes(message))
        except ValueError:
            continue
        checked(result)
    assert len(whole) < LONGEST_ANSWER
