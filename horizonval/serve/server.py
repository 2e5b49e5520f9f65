"""The server: admits clients, renders their requests one after another, and ends cleanly."""

from __future__ import annotations

import contextlib
import hmac
import queue
import select
import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from horizonval.core.errors import UserError, one_line
from horizonval.serve.protocol import ImageRequest, identity_of, image_request, kind_of
from horizonval.wire import SCHEMA, BrokenStreamError, pack, problem_message, receive, send, send_last, unpack

MOST_REQUEST_BYTES = 64 * 1024
"""Longest body of a request; a usual one takes some 500."""
MOST_CLIENTS = 16
"""Maximum number of clients, and of connections that have not sent the token yet."""
STRANGER_S = 10.0
"""Longest total time of a connection's first message, which must have the token."""
LAST_WORDS_S = 5.0
"""How long answers that are under way may take to go out when the server ends."""
_WAKE_S = 0.5
"""Some systems let no signal through to a thread that waits for ever."""

Reply = dict[str, Any]


@dataclass(frozen=True, eq=False)
class _Job:
    """A request that waits for the renderer, and its reply once it is there."""

    request: ImageRequest
    wanted: Callable[[], bool]
    """Whether anybody still waits: a client that has gone costs no rendering."""
    done: threading.Event = field(default_factory=threading.Event)
    reply: list[Reply | UserError] = field(default_factory=list)

    def finish(self, reply: Reply | UserError) -> None:
        self.reply.append(reply)
        self.done.set()


class Server:
    """Serves images until it is stopped.

    ``answer`` returns the reply to a request for an image and is called by the thread of :meth:`run` alone; ``about``:
    part of a status reply; ``token``: required in every request; ``time_limit_s``: for a message to come in or to go
    out, each; ``most_images``: stop after so many.
    """

    def __init__(
        self,
        answer: Callable[[ImageRequest], Reply],
        about: dict[str, Any],
        *,
        token: str | None = None,
        time_limit_s: float = 30.0,
        most_images: int | None = None,
    ) -> None:
        self._answer, self._about = answer, about
        self.token, self.time_limit_s, self._most_images = token, time_limit_s, most_images
        # A signal may come while the renderer takes a job from it; this kind of queue stands that.
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._clients: dict[_Conversation, threading.Thread] = {}
        self._served = self._refused = 0
        self._since = time.monotonic()

    @property
    def served(self) -> int:
        """Images that were made."""
        return self._served

    def stop(self) -> None:
        """End :meth:`run` after the image under way; from any thread or signal."""
        self._stopping.set()
        self._jobs.put(None)

    def run(self, listener: socket.socket) -> None:
        """Serve the clients of a listening socket until :meth:`stop`; renders in the calling thread."""
        door = threading.Thread(target=self._let_in, args=(listener,), daemon=True)
        door.start()
        try:
            while not self._stopping.is_set():
                with contextlib.suppress(queue.Empty):
                    self._do(self._jobs.get(timeout=_WAKE_S))
        finally:
            self._stopping.set()
            self._dismiss()
            # A thread that waits at the door is woken by the shutdown on Linux, and by its time-out elsewhere.
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            door.join(LAST_WORDS_S)

    def status(self) -> Reply:
        """Return the reply to a request for the status."""
        with self._lock:
            return {
                "schema": SCHEMA,
                "kind": "status",
                **self._about,
                "served": self._served,
                "refused": self._refused,
                "clients": len(self._clients),
                "seconds": time.monotonic() - self._since,
            }

    def image(self, request: ImageRequest, wanted: Callable[[], bool]) -> Reply:
        """Return the reply to a request for an image when its turn has come; called by the clients' threads.

        ``UserError``: the image cannot be made, the server is stopping, or nobody wants the image any more.
        """
        job = _Job(request, wanted)
        self._jobs.put(job)
        if self._stopping.is_set():
            # Whoever empties the queue may have been there before this job.
            self._empty()
        job.done.wait()
        if isinstance(job.reply[0], UserError):
            raise job.reply[0]
        return job.reply[0]

    def count_refused(self) -> None:
        """Note that a request was refused."""
        with self._lock:
            self._refused += 1

    def _do(self, job: _Job | None) -> None:
        if job is None:
            return
        if self._stopping.is_set():
            job.finish(UserError("the server is stopping", where="server"))
            return
        if not job.wanted():
            job.finish(UserError("the client has gone", where="server"))
            return
        try:
            reply: Reply | UserError = self._answer(job.request)
        except UserError as e:
            reply = e
        except Exception as e:
            # A defect, or no memory for this image: the other clients are not to suffer for it.
            reply = UserError(one_line(e), where="server", expected="an image", fix="report this line as a defect")
        if not isinstance(reply, UserError):
            self._served += 1
        if self._most_images is not None and self._served >= self._most_images:
            self._stopping.set()
        job.finish(reply)

    def _let_in(self, listener: socket.socket) -> None:
        listener.settimeout(_WAKE_S)
        while not self._stopping.is_set():
            try:
                stream, _ = listener.accept()
            except TimeoutError:
                continue
            except OSError:
                # Too many open files, say: a moment later there may be room.
                self._stopping.wait(_WAKE_S)
                continue
            self._welcome(stream)

    def _welcome(self, stream: socket.socket) -> None:
        if stream.family != getattr(socket, "AF_UNIX", None):
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        conversation = _Conversation(stream, self)
        thread = threading.Thread(target=self._talk, args=(conversation,), daemon=True)
        with self._lock:
            known = [one.is_known for one in self._clients]
            full = sum(known) >= MOST_CLIENTS
            if not full and known.count(False) >= MOST_CLIENTS:
                # The stranger that has waited longest makes room.
                next(one for one in self._clients if not one.is_known).drop()
            if not full:
                self._clients[conversation] = thread
        if not full:
            thread.start()
            return
        self.count_refused()
        error = UserError(f"{MOST_CLIENTS} clients are here already", where="server", fix="try again later")
        with contextlib.suppress(OSError), contextlib.closing(stream):
            send_last(stream, pack(problem_message(error)), _WAKE_S)

    def admit(self, conversation: _Conversation) -> None:
        """Count a stranger that sent the token as a client; ``UserError`` if there are too many."""
        with self._lock:
            if sum(one.is_known for one in self._clients) >= MOST_CLIENTS:
                raise UserError(f"{MOST_CLIENTS} clients are here already", where="server", fix="try again later")
            conversation.is_known = True

    def _talk(self, conversation: _Conversation) -> None:
        try:
            conversation.run()
        finally:
            with self._lock:
                self._clients.pop(conversation, None)

    def _empty(self) -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                self._do(self._jobs.get_nowait())

    def _dismiss(self) -> None:
        """Let answers that are under way go out, and end all conversations."""
        self._empty()
        with self._lock:
            clients = dict(self._clients)
        for conversation in clients:
            conversation.end()
        end = time.monotonic() + LAST_WORDS_S
        for thread in clients.values():
            if thread.is_alive():
                thread.join(max(0.0, end - time.monotonic()))


class _Conversation:
    """One client: a request, its answer, the next request, until it goes or sends what is no message."""

    def __init__(self, stream: socket.socket, server: Server) -> None:
        self._stream, self._server = stream, server
        self.is_known = server.token is None
        """Whether its place counts: it sent the token, or none is required."""

    def run(self) -> None:
        """Answer until the client goes."""
        with contextlib.suppress(OSError), contextlib.closing(self._stream):
            while self._one_turn():
                pass

    def end(self) -> None:
        """Take no more requests; an answer that is under way still goes out."""
        with contextlib.suppress(OSError):
            self._stream.shutdown(socket.SHUT_RD)

    def drop(self) -> None:
        """End the conversation at once."""
        with contextlib.suppress(OSError):
            self._stream.shutdown(socket.SHUT_RDWR)

    def _one_turn(self) -> bool:
        """Answer one request; return whether another one can follow."""
        limit_s = self._server.time_limit_s
        try:
            # Strangers may not keep a place by saying nothing.
            total_s = None if self.is_known else min(limit_s, STRANGER_S)
            body = receive(self._stream, MOST_REQUEST_BYTES, limit_s, total_s)
        except BrokenStreamError as e:
            self._refuse(e, send_last)
            return False
        if body is None:
            return False
        identity = None
        try:
            message = unpack(body)
            identity = identity_of(message)
            reply = self._reply(message)
        except UserError as e:
            self._refuse(e, send if self.is_known else send_last, identity)
            return self.is_known
        except OSError:
            raise
        except Exception as e:
            # A defect: every request has an answer.
            defect = UserError(one_line(e), where="server", fix="report this line as a defect")
            self._refuse(defect, send if self.is_known else send_last, identity)
            return self.is_known
        send(self._stream, pack(reply if identity is None else reply | {"id": identity}), limit_s)
        return True

    def _refuse(self, error: UserError, say: Callable[..., None], identity: int | str | None = None) -> None:
        self._server.count_refused()
        say(self._stream, pack(problem_message(error, identity)), self._server.time_limit_s)

    def _reply(self, message: Mapping[str, Any]) -> Reply:
        kind = kind_of(message)
        self._check_token(message.get("token"))
        if kind == "status":
            return self._server.status()
        return self._server.image(image_request(message), self._is_there)

    def _check_token(self, token: object) -> None:
        if self._server.token is None:
            return
        given = token if isinstance(token, str) else ""
        if not hmac.compare_digest(given.encode(), self._server.token.encode()):
            raise UserError(
                "missing" if token is None else "not the server's",
                where="request: token",
                expected="the word in the server's --token-file",
            )
        if not self.is_known:
            self._server.admit(self)

    def _is_there(self) -> bool:
        """Return whether the client has not closed the connection; what it sent ahead counts as being there."""
        try:
            if not select.select([self._stream], [], [], 0)[0]:
                return True
            return bool(self._stream.recv(1, socket.MSG_PEEK))
        except (OSError, ValueError):
            return False
