"""The server of the viewer: a folder's pages and nothing outside, every frame of a run with its exact numbers."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import signal
import socket
import threading
import time
from urllib.parse import urlsplit

import pytest
from synthetic import synthetic_cases, write_run

from horizonval.core.errors import UserError
from horizonval.report import view_server, viewer
from horizonval.report.view_server import file_below, viewable
from horizonval.store.folder import read_json
from horizonval.store.store import Store


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    made = write_run(tmp_path_factory.mktemp("view") / "run", synthetic_cases()[:2])
    (made / "report").mkdir()
    (made / "report" / "index.html").write_text(
        '<!doctype html>\n<html lang="en"><meta content="default-src \'none\'; img-src data:">page</html>'
    )
    (made / ".hidden").write_text("no")
    (made.parent / "secret.txt").write_text("no")
    (made / "report" / "out.txt").symlink_to(made.parent / "secret.txt")
    return made


@pytest.fixture(scope="module")
def port(out):
    server = view_server._server(viewable(out), 0)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    SECRETS[server.server_address[1]] = server.secret
    yield server.server_address[1]
    server.shutdown()
    thread.join(10)
    server.server_close()


SECRETS = {}


def ask(port, address, method="GET", cookie=True, **headers):
    link = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    known = {"Cookie": f"other=1; horizonval-{port}={SECRETS[port]}"} if cookie else {}
    link.request(method, address, headers=known | headers)
    answer = link.getresponse()
    body = answer.read()
    link.close()
    return answer, body


def test_it_listens_on_the_loopback_alone_and_leads_to_the_page(out, port):
    answer, _ = ask(port, "/")
    assert (answer.status, answer.headers["Location"]) == (302, f"/report/index.html?token={SECRETS[port]}")
    answer, body = ask(port, "/report/index.html")
    assert answer.status == 200
    assert b'<html lang="en" data-served>' in body
    assert b"default-src 'none'; connect-src 'self';" in body
    assert view_server.HOST == "127.0.0.1"


@pytest.mark.parametrize(
    "address",
    [
        "/../secret.txt",
        "/report/../../secret.txt",
        "/%2e%2e/secret.txt",
        "/..%2fsecret.txt",
        "//etc/passwd",
        "/report/out.txt",
        "/.hidden",
        "/report/..\\..\\secret.txt",
        "/report",
        "/none.html",
        "/a%00b",
    ],
)
def test_nothing_outside_the_folder_is_served(out, port, address):
    assert ask(port, address)[0].status == 404
    assert file_below(out, address) is None


def test_another_site_that_points_its_name_here_gets_nothing(port):
    assert ask(port, "/report/index.html", Host="example.org")[0].status == 403
    assert ask(port, "/report/index.html", Host=f"localhost:{port}")[0].status == 200


def test_every_frame_comes_with_the_numbers_of_the_archive(out, port):
    frames = json.loads(ask(port, view_server.FRAMES)[1])
    assert [frame["name"] for frame in frames] == ["day-arc", "day-tilted"]
    for frame in frames:
        query = f"{view_server.FRAME}?case={frame['name']}&band={frame['band']}"
        found = json.loads(ask(port, query)[1])
        record = read_json(out / "cases" / f"{frame['name']}.json")
        image = Store(out / "archive", read_only=True).read_image(record["image"])
        assert found["numbers"] == viewer.packed(image.dn)
        assert (found["height"], found["width"]) == image.dn.shape
        assert found["truth"].startswith("M")
        assert found["full"] == image.full_scale
        assert found["rows"] == frame["rows"]
        assert (found["light"], found["sun_deg"]) == (frame["light"], frame["sun_deg"]) == ("day", frame["sun_deg"])


def test_only_who_knows_the_secret_gets_an_answer(out, port):
    for address in (
        "/",
        "/run.json",
        "/report/index.html",
        "/run.json?token=",
        "/run.json?token=a",
        view_server.FRAMES,
    ):
        answer, body = ask(port, address, cookie=False)
        assert answer.status == 403
        assert answer.headers.get("Set-Cookie") is None
        assert SECRETS[port].encode() not in body
    assert ask(port, f"/run.json?token={SECRETS[port]}", cookie=False)[0].status == 200
    answer, _ = ask(port, f"/report/index.html?token={SECRETS[port]}", cookie=False)
    cookie = answer.headers["Set-Cookie"]
    assert cookie.endswith("; Path=/; HttpOnly; SameSite=Strict")
    assert ask(port, "/run.json", cookie=False, Cookie=cookie.split(";")[0])[0].status == 200


def test_a_large_file_costs_no_memory_and_head_has_its_size(out, port):
    path = out / "big.bin"
    with path.open("wb") as file:
        file.truncate(4 * 10**9)
    try:
        answer, body = ask(port, "/big.bin", "HEAD")
    finally:
        path.unlink()
    assert (answer.status, answer.headers["Content-Length"], body) == (200, str(4 * 10**9), b"")
    answer, body = ask(port, "/report/index.html", "HEAD")
    assert (int(answer.headers["Content-Length"]), body) == (len(ask(port, "/report/index.html")[1]), b"")


def test_connections_and_their_time_are_bounded(port, monkeypatch):
    monkeypatch.setattr(view_server, "LONGEST_HEAD_S", 0.5)
    silent = [socket.create_connection(("127.0.0.1", port)) for _ in range(view_server.MOST_CONNECTIONS + 3)]
    start = time.monotonic()
    for one in silent:
        one.settimeout(10)
        with contextlib.suppress(ConnectionError):
            assert one.recv(1) == b""
        one.close()
    assert time.monotonic() - start < 5
    assert ask(port, "/run.json")[0].status == 200


@pytest.mark.parametrize("query", ["?case=none", "?case=../run", "?case=day-arc&band=blue", ""])
def test_a_frame_that_is_not_there_is_told_in_a_line(port, query):
    answer, body = ask(port, view_server.FRAME + query)
    assert answer.status == 404
    assert "\n" not in json.loads(body)["problem"]


def test_a_folder_that_is_none_of_ours_and_a_port_that_is_taken(out, port, tmp_path):
    with pytest.raises(UserError, match="no such folder"):
        viewable(tmp_path / "none")
    with pytest.raises(UserError, match="holds no results"):
        viewable(tmp_path)
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(UserError, match="no report yet"):
        viewable(tmp_path)
    with pytest.raises(UserError, match="somebody listens"):
        view_server._server(viewable(out), port)


def test_it_ends_when_interrupted(out):
    told = []

    def ready(address):
        told.append(urlsplit(address))
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()

    view_server.view(viewable(out), 0, ready)
    # The port is free again.
    server = view_server._server(viewable(out), told[0].port)
    server.server_close()
