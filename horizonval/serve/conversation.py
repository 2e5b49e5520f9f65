"""One client: a request, its answer, the next request, until it goes or says what cannot be understood."""

from __future__ import annotations

import contextlib
import hmac
import select
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import Event
from typing import Any

from horizonval.core.errors import UserError
from horizonval.serve.request import ImageRequest, identity_of, image_request, kind_of
from horizonval.wire.framing import BrokenStreamError, receive, send, send_last
from horizonval.wire.packing import pack, unpack
from horizonval.wire.problem import problem_message

MOST_REQUEST_BYTES = 64 * 1024
"""Of a request's body; the longest sensible one takes some 500."""


@dataclass(frozen=True, eq=False)
class Job:
    """A request that waits for the renderer, and its reply once it is there.

    ``wanted`` says whether anybody still waits: who has gone costs no rendering.
    """

    request: ImageRequest
    wanted: Callable[[], bool]
    done: Event = field(default_factory=Event)
    reply: list[dict[str, Any] | UserError] = field(default_factory=list)

    def finish(self, reply: dict[str, Any] | UserError) -> None:
        """Hand the reply to the one who waits."""
        self.reply.append(reply)
        self.done.set()


class Conversation:
    """Talks with one client; :meth:`run` returns when it is over.

    Parameters
    ----------
    stream : socket
    ask : callable
        Hands a job to the renderer.
    status : callable
        Returns the reply to a request for the server's status.
    token : str or None
        What every request must hold.
    time_limit_s : float
        For a message to come in or to go out, each.
    refused : callable
        Told once of every request that was refused.
    """

    def __init__(
        self,
        stream: socket.socket,
        *,
        ask: Callable[[Job], None],
        status: Callable[[], dict[str, Any]],
        token: str | None,
        time_limit_s: float,
        refused: Callable[[], None],
    ) -> None:
        self._stream, self._ask, self._status = stream, ask, status
        self._token, self._time_limit_s, self._refused = token, time_limit_s, refused
        self._known = token is None

    def run(self) -> None:
        """Answer until the client goes."""
        with contextlib.suppress(OSError), contextlib.closing(self._stream):
            while self._one_turn():
                pass

    def end(self) -> None:
        """Take no more requests; an answer that is under way still goes out."""
        with contextlib.suppress(OSError):
            self._stream.shutdown(socket.SHUT_RD)

    def _one_turn(self) -> bool:
        """Answer one request; return whether another one can follow."""
        # Strangers may not keep a place by saying nothing.
        first_s = None if self._known else self._time_limit_s
        try:
            body = receive(self._stream, MOST_REQUEST_BYTES, self._time_limit_s, first_s)
        except BrokenStreamError as e:
            self._refuse(e)
            return False
        if body is None:
            return False
        identity = None
        try:
            message = unpack(body)
            identity = identity_of(message)
            reply = self._reply(message)
        except UserError as e:
            self._refuse(e, identity)
            return True
        send(self._stream, pack(reply if identity is None else reply | {"id": identity}), self._time_limit_s)
        return True

    def _refuse(self, error: UserError, identity: int | str | None = None) -> None:
        self._refused()
        # After a broken stream nothing more can be understood.
        say = send_last if isinstance(error, BrokenStreamError) else send
        say(self._stream, pack(problem_message(error, identity)), self._time_limit_s)

    def _reply(self, message: Mapping[str, Any]) -> dict[str, Any]:
        kind = kind_of(message)
        self._check_token(message.get("token"))
        if kind == "status":
            return self._status()
        job = Job(image_request(message), self._is_there)
        self._ask(job)
        job.done.wait()
        if isinstance(job.reply[0], UserError):
            raise job.reply[0]
        return job.reply[0]

    def _check_token(self, token: object) -> None:
        if self._token is None:
            return
        given = token if isinstance(token, str) else ""
        if not hmac.compare_digest(given.encode(), self._token.encode()):
            raise UserError(
                "missing" if token is None else "not the server's",
                where="request: token",
                expected="the word in the server's --token-file",
            )
        self._known = True

    def _is_there(self) -> bool:
        """Return whether the client has not closed the connection; what it sent ahead counts as being there."""
        try:
            if not select.select([self._stream], [], [], 0)[0]:
                return True
            return bool(self._stream.recv(1, socket.MSG_PEEK))
        except (OSError, ValueError):
            return False
