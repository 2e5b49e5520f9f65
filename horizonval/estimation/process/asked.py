"""One question to one estimator, in the process that runs it: whatever happens becomes bytes of an answer."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time

import numpy as np

from horizonval.core.outcome import Refusal
from horizonval.estimation import registry
from horizonval.estimation.answer import checked
from horizonval.estimation.last_words import crash, raised, traceback_of
from horizonval.estimation.observation import Estimator, Fit
from horizonval.estimation.process.frames import ANSWER, DESCRIBED
from horizonval.estimation.process.wire import pack_answer, unpack_observation


def answer(estimator: Estimator, question: int, length: int) -> bytes:
    """Return the message of an estimator's answer.

    Parameters
    ----------
    estimator : Estimator
    question : int
        Descriptor of the file that the observation lies in.
    length : int
        Of that, in bytes.
    """
    start = _processor_s()
    try:
        result: Fit | Refusal = registry.run_safely(estimator, unpack_observation(_read(question, length)))
        message = pack_answer(checked(result), _processor_s() - start)
    except BaseException as e:
        # Also what ends a program, and whatever the names above have become in a process that runs foreign code.
        message = pack_answer(crash(f"the estimator raised {raised(e)}", traceback_of(e, 2)), _processor_s() - start)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(BaseException):
            stream.flush()
    return message


def loaded(name: str) -> tuple[Estimator | None, bytes]:
    """Import the package of an estimator; return it, and the message of what it says of itself, or of the crash."""
    try:
        estimator = registry.load(name)
        return estimator, DESCRIBED + described(estimator)
    except BaseException as e:
        return None, ANSWER + pack_answer(
            crash(f"the estimator cannot be loaded: {raised(e)}", traceback_of(e, 2)), 0.0
        )


def described(estimator: Estimator) -> bytes:
    """Return what an estimator says of itself."""
    said = {"title": str(estimator.title)[:1000], "estimates": estimator.estimates, "needs": estimator.needs}
    return json.dumps(said).encode()


def _read(question: int, length: int) -> np.ndarray:
    memory = np.empty(length + 64, dtype=np.uint8)
    # Arrays lie alike in every process.
    start = -memory.ctypes.data % 64
    data = memory[start : start + length]
    place = 0
    while place < length:
        count = os.preadv(question, [data[place:].data], place)
        if count == 0:
            raise EOFError("the observation is not whole")
        place += count
    return data


def _processor_s() -> float:
    """Return the processor time of this process and of the programs that it ran."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system
