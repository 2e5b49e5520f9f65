"""A local server that shows a report in a browser and reads frames from the archive on request.

The pages are the files in the folder. With the server the viewer lists all frames of a run, including those that a long
run's page omits, and requests numbers that the page does not hold.
"""

from __future__ import annotations

import contextlib
import errno
import json
import mimetypes
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, unquote, urlsplit

from horizonval.core.errors import UserError, command_line
from horizonval.core.files import MissingFileError, UnfitFileError, kind_at, open_file
from horizonval.report.viewer import RunFrames

HOST = "127.0.0.1"
FRAMES, FRAME = "/.view/frames", "/.view/frame"
"""Addresses of the viewer's requests; files of the folder never begin with a dot."""
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
        ready(f"http://{HOST}:{server.server_address[1]}/{quote(what.page)}")
        server.serve_forever(poll_interval=0.2)


def _server(what: Viewable, port: int) -> ThreadingHTTPServer:
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

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Stay silent: a browser may disconnect in the middle of an answer."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    server_version, sys_version = "horizonval", ""
    timeout = 60.0

    def log_message(self, format: str, *args: Any) -> None:
        """Keep the terminal free for the user."""

    def do_GET(self) -> None:
        # Refuse other host names: protection against DNS rebinding.
        port = self.server.server_address[1]
        if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
            return self._send(HTTPStatus.FORBIDDEN, b"ask for 127.0.0.1\n", "text/plain")
        address = urlsplit(self.path)
        if address.path == "/":
            self.send_response(HTTPStatus.FOUND)
            self.send_header("Location", f"/{quote(self.server.what.page)}")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return None
        if address.path in (FRAMES, FRAME):
            return self._send_json(address.path, parse_qs(address.query, keep_blank_values=True))
        path = file_below(self.server.what.root, address.path)
        try:
            if path is None:
                raise MissingFileError("no such file")
            with open_file(path, links=False) as file:
                body = file.read()
        except UnfitFileError:
            return self._send(HTTPStatus.NOT_FOUND, b"no such file\n", "text/plain")
        kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
        if kind == "text/html":
            kind += "; charset=utf-8"
            if self.server.what.frames is not None:
                body = body.replace(*_POLICY, 1).replace(*_MARK, 1)
        return self._send(HTTPStatus.OK, body, kind)

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
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(body)


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
