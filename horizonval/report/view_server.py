"""A local server that shows a report in a browser and reads frames from the archive on request.

The pages are the files in the folder. With the server the viewer lists all frames of a run, including those that a long
run's page omits, and requests numbers that the page does not hold.

Other users of the machine can connect to the loopback address. As with notebooks, the printed address has a secret. The
first answer sets it as a cookie; requests without it are refused.
"""

from __future__ import annotations

import contextlib
import errno
import hmac
import json
import mimetypes
import os
import secrets
import shutil
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BufferedReader
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, unquote, urlsplit

from horizonval.core.errors import UserError, command_line
from horizonval.core.files import MissingFileError, UnfitFileError, kind_at, open_file
from horizonval.report.viewer import RunFrames

HOST = "127.0.0.1"
FRAMES, FRAME = "/.view/frames", "/.view/frame"
"""Addresses of the viewer's requests; files of the folder never begin with a dot."""
SECRET = "token"
"""Key of the secret in the printed address."""
MOST_CONNECTIONS = 32
LONGEST_HEAD_S, LONGEST_ANSWER_S = 10.0, 600.0
"""Total time of a request until the secret is known, and of an answer."""
_PIECE = 1 << 20
_MARK = (b'<html lang="en">', b'<html lang="en" data-served>')
_POLICY = (b"default-src 'none';", b"default-src 'none'; connect-src 'self';")


@dataclass(frozen=True)
class Viewable:
    """A folder with a page: relative path ``page``; ``frames`` of a run."""

    root: Path
    page: str
    frames: RunFrames | None


def viewable(out: Path) -> Viewable:
    """Return the pages in the folder of a run, campaign, study or night; ``UserError`` if there is none."""
    expected = "the folder of a run, campaign, study or night"
    if not out.is_dir():
        kind = kind_at(out, links=True)
        raise UserError(f"is {kind}" if kind else "no such folder", where=str(out), expected=expected)
    if (out / "run.json").is_file():
        page = "report/index.html"
        if not (out / page).is_file():
            raise UserError("has no report yet", where=str(out), fix=f"make it with {command_line('report', out)}")
        return Viewable(out.resolve(), page, RunFrames(out))
    if (out / "night.json").is_file() or (out / "verdict.json").is_file():
        if not (out / "index.html").is_file():
            raise UserError("has no page yet", where=str(out), fix="run the night again")
        return Viewable(out.resolve(), "index.html", None)
    raise UserError("holds no results", where=str(out), expected=expected)


def view(what: Viewable, port: int, ready: Callable[[str], None]) -> None:
    """Serve until an interruption or a SIGTERM; ``ready`` receives the address. ``UserError`` if the port is taken."""
    with _server(what, port) as server, _ended_by_signals(), contextlib.suppress(KeyboardInterrupt):
        ready(f"http://{HOST}:{server.server_address[1]}/{quote(what.page)}?{SECRET}={server.secret}")
        server.serve_forever(poll_interval=0.2)


def _server(what: Viewable, port: int) -> _Server:
    try:
        server = _Server((HOST, port), _Handler)
    except OSError as e:
        if e.errno == errno.EADDRINUSE:
            fix = "name another one with --port, or leave it out for any that is free"
            raise UserError("somebody listens there already", where=f"{HOST}:{port}", fix=fix) from None
        raise UserError(str(e.strerror or e), where=f"{HOST}:{port}", fix="name another --port") from None
    server.what = what
    return server


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    before = {kind: signal.signal(kind, signal.default_int_handler) for kind in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for kind, handler in before.items():
            signal.signal(kind, handler)


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    what: Viewable

    def __init__(self, *arguments: Any) -> None:
        self.secret = secrets.token_urlsafe(24)
        self._places = threading.BoundedSemaphore(MOST_CONNECTIONS)
        super().__init__(*arguments)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own; one connection too many is closed."""
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and end the connection when its time is over."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Stay silent: a browser may disconnect in the middle of an answer."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    server_version, sys_version = "horizonval", ""
    timeout = 60.0
    _end: threading.Timer | None = None

    def log_message(self, format: str, *args: Any) -> None:
        """Keep the terminal free for the user."""

    def setup(self) -> None:
        super().setup()
        self._allow(LONGEST_HEAD_S)

    def finish(self) -> None:
        if self._end is not None:
            self._end.cancel()
        super().finish()

    def _allow(self, seconds: float) -> None:
        """End the connection after a time, whatever is under way; an earlier end no longer holds."""
        if self._end is not None:
            self._end.cancel()
        self._end = threading.Timer(seconds, _shut, (self.connection,))
        self._end.daemon = True
        self._end.start()

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        # Refuse other host names: protection against DNS rebinding.
        port = self.server.server_address[1]
        if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
            return self._send(HTTPStatus.FORBIDDEN, b"ask for 127.0.0.1\n", "text/plain")
        address = urlsplit(self.path)
        query = parse_qs(address.query, keep_blank_values=True)
        if not self._is_known(query):
            return self._send(HTTPStatus.FORBIDDEN, b"open the address that `horizonval view` printed\n", "text/plain")
        self._allow(LONGEST_ANSWER_S)
        if address.path == "/":
            self.send_response(HTTPStatus.FOUND)
            self.send_header("Location", f"/{quote(self.server.what.page)}?{SECRET}={self.server.secret}")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return None
        if address.path in (FRAMES, FRAME):
            return self._send_json(address.path, query)
        path = file_below(self.server.what.root, address.path)
        try:
            if path is None:
                raise MissingFileError("no such file")
            with open_file(path, links=False) as file:
                self._send_file(file, path.name)
        except UnfitFileError:
            return self._send(HTTPStatus.NOT_FOUND, b"no such file\n", "text/plain")
        return None

    def _is_known(self, query: dict[str, list[str]]) -> bool:
        """Whether a request has the secret, in its address or as the cookie that the first answer set."""
        try:
            morsel = SimpleCookie(self.headers.get("Cookie", "")).get(self._cookie)
        except CookieError:
            morsel = None
        given = query.get(SECRET, ["" if morsel is None else morsel.value])[0]
        return hmac.compare_digest(given.encode(), self.server.secret.encode())

    @property
    def _cookie(self) -> str:
        # Cookies do not tell ports apart.
        return f"horizonval-{self.server.server_address[1]}"

    def _send_file(self, file: BufferedReader, name: str) -> None:
        """Send a file in pieces; of a page's first piece the policy and the mark are replaced."""
        kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
        size, first = os.fstat(file.fileno()).st_size, b""
        if kind == "text/html":
            kind += "; charset=utf-8"
            if self.server.what.frames is not None:
                whole = file.read(_PIECE)
                first = whole.replace(*_POLICY, 1).replace(*_MARK, 1)
                size += len(first) - len(whole)
        self._head(HTTPStatus.OK, size, kind)
        if self.command != "HEAD":
            self.wfile.write(first)
            shutil.copyfileobj(file, self.wfile, _PIECE)

    def _send_json(self, path: str, query: dict[str, list[str]]) -> None:
        frames, status = self.server.what.frames, HTTPStatus.OK
        answer: object
        try:
            if frames is None:
                raise UserError("holds no run", where=str(self.server.what.root))
            if path == FRAMES:
                answer = frames.listed()
            else:
                answer = frames.frame(query.get("case", [""])[0], query.get("band", [""])[0])
        except UserError as error:
            status, answer = HTTPStatus.NOT_FOUND, {"problem": error.line()}
        body = json.dumps(answer, allow_nan=False).encode()
        self._send(status, body, "application/json")

    def _send(self, status: HTTPStatus, body: bytes, kind: str) -> None:
        self._head(status, len(body), kind)
        if self.command != "HEAD":
            self.wfile.write(body)

    def _head(self, status: HTTPStatus, size: int, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(size))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        if status is HTTPStatus.OK:
            self.send_header("Set-Cookie", f"{self._cookie}={self.server.secret}; Path=/; HttpOnly; SameSite=Strict")
        self.end_headers()


def _shut(connection: socket.socket) -> None:
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


def file_below(root: Path, address: str) -> Path | None:
    """Return the file of an address below a folder; None for leading dots or links that leave it."""
    parts = unquote(address).split("/")[1:]
    if any(not part or part.startswith(".") or "\\" in part or "\0" in part for part in parts):
        return None
    try:
        path = root.joinpath(*parts).resolve()
        inside = path.is_relative_to(root.resolve()) and path.is_file()
    except OSError:
        return None
    return path if inside else None
