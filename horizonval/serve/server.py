"""The server: lets clients in, renders what they ask for one after another, and ends cleanly."""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

from horizonval.core.errors import UserError, one_line
from horizonval.serve.conversation import Conversation, Job
from horizonval.serve.request import ImageRequest
from horizonval.wire import SCHEMA
from horizonval.wire.framing import send_last
from horizonval.wire.packing import pack
from horizonval.wire.problem import problem_message

MOST_CLIENTS = 16
LAST_WORDS_S = 5.0
"""How long answers that are under way may take to go out when the server ends."""
_WAKE_S = 0.5
"""Some systems let no signal through to a thread that waits for ever."""


class Server:
    """Serves images until it is stopped.

    Parameters
    ----------
    answer : callable
        Returns the reply to a request for an image; called by the thread of :meth:`run` alone.
    about : dict
        What a status reply says of the service.
    token : str, optional
        What every request must hold.
    time_limit_s : float
        For a message to come in or to go out, each.
    most_images : int, optional
        Stop after so many images.
    """

    def __init__(
        self,
        answer: Callable[[ImageRequest], dict[str, Any]],
        about: dict[str, Any],
        *,
        token: str | None = None,
        time_limit_s: float = 30.0,
        most_images: int | None = None,
    ) -> None:
        self._answer, self._about = answer, about
        self._token, self._time_limit_s, self._most_images = token, time_limit_s, most_images
        # A signal may come while the renderer takes a job from it; this kind of queue stands that.
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._clients: dict[Conversation, threading.Thread] = {}
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

    def status(self) -> dict[str, Any]:
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

    def _do(self, job: Job | None) -> None:
        if job is None:
            return
        if self._stopping.is_set():
            job.finish(UserError("the server is stopping", where="server"))
            return
        if not job.wanted():
            job.finish(UserError("the client has gone", where="server"))
            return
        try:
            reply: dict[str, Any] | UserError = self._answer(job.request)
        except UserError as e:
            reply = e
        except Exception as e:
            # A defect, or no memory for this image: the other clients are not to suffer for it.
            reply = UserError(one_line(e), where="server", expected="an image", fix="report this line as a defect")
        if not isinstance(reply, UserError):
            self._served += 1
        last = self._most_images is not None and self._served >= self._most_images
        if last:
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
        conversation = Conversation(
            stream,
            ask=self._ask,
            status=self.status,
            token=self._token,
            time_limit_s=self._time_limit_s,
            refused=self._count_refused,
        )
        with self._lock:
            full = len(self._clients) >= MOST_CLIENTS
            if not full:
                thread = threading.Thread(target=self._talk, args=(conversation,), daemon=True)
                self._clients[conversation] = thread
        if full:
            self._count_refused()
            error = UserError(f"{MOST_CLIENTS} clients are here already", where="server", fix="try again later")
            with contextlib.suppress(OSError), contextlib.closing(stream):
                send_last(stream, pack(problem_message(error)), _WAKE_S)
            return
        thread.start()

    def _talk(self, conversation: Conversation) -> None:
        try:
            conversation.run()
        finally:
            with self._lock:
                self._clients.pop(conversation, None)

    def _ask(self, job: Job) -> None:
        self._jobs.put(job)
        if self._stopping.is_set():
            # Whoever empties the queue may have been there before this job.
            self._empty()

    def _count_refused(self) -> None:
        with self._lock:
            self._refused += 1

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
