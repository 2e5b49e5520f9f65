"""The keeper of one foreign estimator: it asks a fresh process for every image, and ends what is left behind.

Three processes, of which only the first, the keeper, runs none of the estimator's code:

- the *keeper* speaks with the worker; it is the first of a namespace of processes where that is permitted;
- the *warm* one has imported the package, once, and forks for every image;
- the *asked* one answers for one image and ends. What it changed of itself (modules, limits, folder, handlers) ends
  with it, so that no answer hangs on the images before.

The asked one writes its answer to a pipe, the warm one says how it ended; the keeper believes neither and hands on
bytes of bounded length.
"""

from __future__ import annotations

import contextlib
import fcntl
import gc
import json
import os
import select
import signal
import struct
from typing import IO, Any, NoReturn

from horizonval.estimation.observation import Estimator
from horizonval.estimation.process import asked
from horizonval.estimation.process.containment import adopt_orphans, end_strays, end_with_parent
from horizonval.estimation.process.external import external
from horizonval.estimation.process.frames import ANSWER, DESCRIBED, ENDED, READY, receive, send, send_all
from horizonval.estimation.process.limits import Limits, limit_memory
from horizonval.estimation.process.wire import LENGTH, LONGEST_ANSWER

_STATUS = struct.Struct("<i")


def keep(requests: IO[bytes], answers: IO[bytes], question: int, limits: Limits, private: bool, hidden: bool) -> None:
    """Answer until the worker closes the pipe.

    Parameters
    ----------
    requests, answers : file
        From and to the worker.
    question : int
        Descriptor of the file in which observations come.
    limits : Limits
    hidden : bool
        Whether the folders of the limits are hidden from this process.
    private : bool
        Whether this process is the first of a namespace.
    """
    if not private:
        adopt_orphans()
    name = json.loads(receive(requests))["name"]
    warm: _Warm | None = None
    send(answers, READY + json.dumps({"private": private, "hidden": hidden}).encode())
    try:
        while True:
            order = receive(requests)
            if warm is None:
                warm = _Warm(name, question, limits, (requests.fileno(), answers.fileno()))
                said = warm.wait(requests)
                if said[:1] != DESCRIBED or json.loads(order)["do"] == "describe":
                    send(answers, said)
                    warm = _after(warm, private)
                    continue
            warm.ask(order)
            said = warm.wait(requests)
            warm = _after(warm, private)
            send(answers, said)
    except (EOFError, BrokenPipeError):
        end_strays(None, private)


def _after(warm: _Warm, private: bool) -> _Warm | None:
    """End what an answer has left behind; return the warm process if it still stands."""
    gone = warm.has_ended()
    if end_strays(None if gone else warm.pid, private) or gone:
        warm.close()
        return None
    return warm


class _Warm:
    """The warm process, seen from the keeper."""

    def __init__(self, name: str, question: int, limits: Limits, keepers: tuple[int, int]) -> None:
        orders, self._orders = os.pipe()
        self._answers, answers = os.pipe()
        self._statuses, statuses = os.pipe()
        # What all processes have in common is not looked through again in each of them.
        gc.collect()
        gc.freeze()
        self.pid = os.fork()
        if self.pid == 0:
            for end in (self._orders, self._answers, self._statuses, *keepers):
                os.close(end)
            _be_warm(name, limits, question, os.fdopen(orders, "rb"), answers, statuses)
        for end in (orders, answers, statuses):
            os.close(end)
        for end in (self._answers, self._statuses):
            fcntl.fcntl(end, fcntl.F_SETFL, fcntl.fcntl(end, fcntl.F_GETFL) | os.O_NONBLOCK)
        self._ended: int | None = None

    def ask(self, order: bytes) -> None:
        """Hand an order on."""
        while _drained(self._answers):
            pass
        with contextlib.suppress(BrokenPipeError):
            send_all(self._orders, LENGTH.pack(len(order)) + order)

    def wait(self, requests: IO[bytes]) -> bytes:
        """Return what is to be told to the worker, once the process that was asked has ended.

        Raises
        ------
        EOFError
            The worker is gone.
        """
        found, status, worker = bytearray(), bytearray(), requests.fileno()
        open_ends = {self._answers: found, self._statuses: status}
        while len(status) < _STATUS.size:
            gone = self.has_ended()
            # Short, as the end of the warm process itself is seen only by asking.
            ready, _, _ = select.select([worker, *open_ends], [], [], 0.0 if gone else 0.05)
            if worker in ready:
                raise EOFError
            more = 0
            for end in (end for end in ready if end in open_ends):
                data = _drained(end)
                more += len(data or b"")
                open_ends[end] += data or b""
                if data is None:
                    del open_ends[end]
            if len(found) > LONGEST_ANSWER:
                return ENDED + b"gave too long an answer"
            if gone and not more and len(status) < _STATUS.size:
                return ENDED + _how(self._ended or 0)
        while data := _drained(self._answers):
            found += data
        (code,) = _STATUS.unpack(status[: _STATUS.size])
        if code != 0:
            return ENDED + _how(code)
        whole = len(found) > LENGTH.size and LENGTH.unpack(found[: LENGTH.size])[0] == len(found) - LENGTH.size
        if not whole:
            return ENDED + (b"wrote what is no answer" if found else b"ended without an answer")
        return bytes(found[LENGTH.size :])

    def has_ended(self) -> bool:
        """Whether the warm process is gone."""
        if self._ended is None:
            with contextlib.suppress(ChildProcessError):
                pid, status = os.waitpid(self.pid, os.WNOHANG)
                self._ended = status if pid else None
        return self._ended is not None

    def close(self) -> None:
        """Give the pipes back."""
        for end in (self._orders, self._answers, self._statuses):
            os.close(end)


def _drained(descriptor: int) -> bytes | None:
    """Return what lies in a pipe; ``None`` at its end."""
    try:
        return os.read(descriptor, 1 << 20) or None
    except BlockingIOError:
        return b""


def _how(status: int) -> bytes:
    """Return how a process ended, from its wait status, as the end of a sentence."""
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        name = signal.Signals(number).name if number in set(signal.Signals) else str(number)
        return f"was ended by {name} (a crash, or out of memory)".encode()
    return f"ended with status {os.waitstatus_to_exitcode(status)} and without an answer".encode()


def _be_warm(name: str, limits: Limits, question: int, orders: IO[bytes], answers: int, statuses: int) -> NoReturn:
    """Import the estimator and fork for every image, until the keeper closes the pipe."""
    with contextlib.suppress(BaseException):
        end_with_parent()
        # Signals to a group of processes reach none of ours.
        os.setsid()
        limit_memory(limits.memory_mb)
        estimator, said = _loaded(name, limits)
        send_all(answers, LENGTH.pack(len(said)) + said)
        send_all(statuses, _STATUS.pack(0))
        while True:
            order: dict[str, Any] = json.loads(receive(orders))
            asked_pid = os.fork()
            if asked_pid == 0:
                _be_asked(estimator, question, int(order["length"]), answers, statuses)
            _, status = os.waitpid(asked_pid, 0)
            send_all(statuses, _STATUS.pack(status))
    os._exit(0)


def _loaded(name: str, limits: Limits) -> tuple[Estimator | None, bytes]:
    for program in limits.programs:
        if program.name == name:
            estimator = external(program, limits.folder, limits.time_s)
            return estimator, DESCRIBED + asked.described(estimator)
    return asked.loaded(name)


def _be_asked(estimator: Estimator | None, question: int, length: int, answers: int, statuses: int) -> NoReturn:
    with contextlib.suppress(BaseException):
        end_with_parent()
        os.close(statuses)
        os.setpgid(0, 0)
        assert estimator is not None
        said = ANSWER + asked.answer(estimator, question, length)
        send_all(answers, LENGTH.pack(len(said)) + said)
        os._exit(0)
    os._exit(1)
