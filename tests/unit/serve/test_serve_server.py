"""Clients do not disturb one another, nor the server: whatever one does, the next is answered.

The renderer is replaced by a function that answers at once with the request's seed; what is asked for is one of ours.
"""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from serve_faults import REQUEST, after_faults

import horizonval as hv
from horizonval.serve.protocol import ImageRequest
from horizonval.serve.server import MOST_CLIENTS, Server
from horizonval.serve.service import check_reach, listening, read_token
from horizonval.wire import SCHEMA, Address, array_to_map, pack, receive, send, unpack

TIME_LIMIT_S = 1.0


def answered(request: ImageRequest) -> dict[str, Any]:
    dn = np.full((30, 40), request.seed % 65536, np.uint16)
    reply = {"schema": SCHEMA, "kind": "image", "dn": array_to_map(dn), "band": "vis", "head": None}
    return {**reply, "seed": request.seed, "full_scale": 1023, "scene_id": "x"}


class Running:
    """A server in a thread of its own."""

    def __init__(self, address: Address, answer: Callable[[ImageRequest], dict[str, Any]], **keywords: Any) -> None:
        self.server = Server(answer, {"scene": "none"}, **{"time_limit_s": TIME_LIMIT_S, **keywords})
        self._context = listening(address)
        listener, self.address = self._context.__enter__()
        self.thread = threading.Thread(target=self.server.run, args=(listener,))
        self.thread.start()

    def stop(self) -> None:
        self.server.stop()
        self.thread.join(10.0)
        self._context.__exit__(None, None, None)
        assert not self.thread.is_alive()

    def client(self, **keywords: Any) -> hv.Client:
        return hv.Client(str(self.address), timeout_s=20.0, **keywords)

    def raw(self) -> socket.socket:
        return self.address.connect(5.0)


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Callable[..., Running]]:
    made: list[Running] = []

    def start(answer: Callable[[ImageRequest], dict[str, Any]] = answered, **keywords: Any) -> Running:
        address = keywords.pop("address", Address(tmp_path / "s.sock"))
        made.append(Running(address, answer, **keywords))
        return made[-1]

    yield start
    for running in made:
        if running.thread.is_alive():
            running.stop()


@pytest.mark.parametrize("faults", [16, pytest.param(200, marks=pytest.mark.slow)])
@pytest.mark.parametrize("keywords", [{}, {"address": Address(None, "127.0.0.1", 0)}], ids=["unix", "tcp"])
def test_faults_of_one_client_are_nothing_to_another(run, keywords, faults):
    after_faults(run(**keywords).address, faults, 1)


def test_a_refusal_says_what_where_and_what_to_do_and_the_client_goes_on(run):
    with run().client() as client:
        with pytest.raises(hv.UserError, match=r"request: roll_deg: found 400\.0; expected a number from -360 to 360"):
            client.image(roll_deg=400.0)
        assert client.image(seed=3).dn[0, 0] == 3


def test_an_id_comes_back_and_an_error_reply_has_its_parts(run):
    running = run()
    with running.raw() as stream:
        for message in ({"seed": 1}, {"seed": -1}, {"kind": "status"}):
            send(stream, pack({"schema": SCHEMA, "kind": "image", "id": "step 4", **message}), 5.0)
            assert unpack(receive(stream, 1 << 20, 5.0) or b"")["id"] == "step 4"
    with running.raw() as stream:
        send(stream, pack({"schema": "horizonval/9", "kind": "image"}), 5.0)
        reply = unpack(receive(stream, 1 << 20, 5.0) or b"")
    assert set(reply) == {"schema", "kind", "what", "where", "expected", "fix", "line"}
    assert (reply["kind"], reply["where"]) == ("error", "request: schema")


def test_a_defect_is_a_line_and_the_next_request_is_answered(run):
    def broken(request: ImageRequest) -> dict[str, Any]:
        if request.seed == 1:
            raise ZeroDivisionError("of something")
        return answered(request)

    with run(broken).client() as client:
        with pytest.raises(hv.UserError, match=r"server: ZeroDivisionError at .*: of something"):
            client.image(seed=1)
        assert client.image(seed=2).dn[0, 0] == 2


def test_who_has_gone_costs_no_rendering(run):
    begun, go, seen = threading.Event(), threading.Event(), []

    def slow(request: ImageRequest) -> dict[str, Any]:
        seen.append(request.seed)
        begun.set()
        assert go.wait(10.0)
        return answered(request)

    running = run(slow)
    patient = running.client()
    thread = threading.Thread(target=patient.image, kwargs={"seed": 1})
    thread.start()
    assert begun.wait(10.0)
    with running.raw() as stream:
        send(stream, pack({"schema": SCHEMA, "kind": "image", "seed": 2}), 5.0)
        time.sleep(0.2)
    go.set()
    thread.join(10.0)
    assert patient.image(seed=3).seed == 3
    assert seen == [1, 3]
    patient.close()


def test_who_does_not_read_holds_up_nobody_and_is_given_up(run):
    def large(request: ImageRequest) -> dict[str, Any]:
        return {**answered(request), "dn": array_to_map(np.zeros((1500, 1500), np.uint16))}

    running = run(large, time_limit_s=0.5)
    with running.raw() as lazy, running.client() as busy:
        send(lazy, REQUEST, 5.0)
        for seed in range(3):
            assert busy.image(seed=seed).seed == seed
        time.sleep(1.0)
        assert busy.status()["clients"] == 1


def test_clients_at_once_get_each_their_own(run):
    running = run()

    def ask(first: int, found: list[bool]) -> None:
        with running.client() as client:
            found += [client.image(seed=first + k).dn[0, 0] == first + k for k in range(50)]

    found: list[list[bool]] = [[] for _ in range(4)]
    threads = [threading.Thread(target=ask, args=(1000 * i, found[i])) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30.0)
    assert found == [[True] * 50] * 4


def test_one_client_too_many_is_told_so(run):
    running = run()
    clients = [running.client() for _ in range(MOST_CLIENTS)]
    for client in clients:
        client.status()
    with running.client() as late, pytest.raises(hv.UserError, match=f"{MOST_CLIENTS} clients are here already"):
        late.status()
    for client in clients:
        client.close()


def test_a_token_is_asked_of_every_request(run):
    running = run(token="correct-horse-battery", address=Address(None, "127.0.0.1", 0), time_limit_s=0.4)
    with running.client(token="correct-horse-battery") as friend:
        assert friend.image(seed=4).seed == 4
        time.sleep(0.8)
        assert friend.status()["served"] == 1
    with running.client() as stranger, pytest.raises(hv.UserError, match="request: token: missing"):
        stranger.image()
    with running.client(token="correct-horse-batteri") as stranger, pytest.raises(hv.UserError, match="not the server"):
        stranger.status()
    with running.raw() as silent:
        assert b"no message within 0.4 s" in (receive(silent, 1 << 20, 5.0) or b"")


def test_strangers_keep_nobody_out_and_are_dropped_after_one_wrong_token(run):
    running = run(token="correct-horse-battery", address=Address(None, "127.0.0.1", 0))
    silent = [running.raw() for _ in range(MOST_CLIENTS + 4)]
    with running.client(token="correct-horse-battery") as friend:
        for stranger in silent[:2]:
            # Those that have waited longest have made room.
            stranger.settimeout(5)
            with contextlib.suppress(ConnectionError):
                while stranger.recv(4096):
                    pass
        late = time.monotonic() + 10.0
        while friend.status()["clients"] > MOST_CLIENTS + 1:
            assert time.monotonic() < late
        # A new one: the silent ones are dropped after ten seconds, which a busy machine may have taken until here.
        silent.append(running.raw())
        send(silent[-1], pack({"schema": SCHEMA, "kind": "status", "token": "wrong"}), 5.0)
        assert b"not the server" in (receive(silent[-1], 1 << 20, 5.0) or b"")
        assert receive(silent[-1], 1 << 20, 5.0) is None
        assert friend.image(seed=4).seed == 4
    for stranger in silent:
        stranger.close()


def test_a_defect_is_an_answer_and_the_conversation_goes_on(run, monkeypatch):
    running = run()
    with running.client() as client:
        with monkeypatch.context() as broken:
            broken.setattr("horizonval.serve.server.image_request", lambda message: 1 / 0)
            with pytest.raises(hv.UserError, match="report this line as a defect"):
                client.image()
        assert client.image(seed=4).seed == 4


def test_a_lock_of_somebody_else_on_the_folder_does_not_stop_a_server(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr("horizonval.serve.service.LONGEST_LOCK_S", 0.2)
    handle = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with listening(Address(tmp_path / "s.sock")):
        assert (tmp_path / "s.sock").is_socket()
    os.close(handle)


def test_it_stops_after_as_many_images_as_it_was_told(run):
    running = run(most_images=3)
    with running.client() as client:
        assert [client.image(seed=seed).seed for seed in range(3)] == [0, 1, 2]
        running.thread.join(10.0)
        assert not running.thread.is_alive()
        with pytest.raises(hv.UserError, match="ipc://"):
            client.image()
    assert running.server.served == 3


def test_an_answer_under_way_goes_out_when_it_stops(run):
    begun = threading.Event()

    def slow(request: ImageRequest) -> dict[str, Any]:
        begun.set()
        time.sleep(0.5)
        return answered(request)

    running = run(slow)
    found: list[int] = []
    with running.client() as client:
        thread = threading.Thread(target=lambda: found.append(client.image(seed=9).seed))
        thread.start()
        assert begun.wait(10.0)
        running.stop()
        thread.join(10.0)
    assert found == [9]


def test_its_threads_end_with_their_clients(run):
    before = threading.active_count()
    running = run()
    for _ in range(30):
        with running.client() as client:
            client.status()
    running.stop()
    assert threading.active_count() <= before


def test_a_socket_is_this_users_alone_and_goes_with_its_server(tmp_path):
    address = Address(tmp_path / "s.sock")
    with listening(address):
        assert stat.S_IMODE((tmp_path / "s.sock").stat().st_mode) == 0o600
        with pytest.raises(hv.UserError, match="somebody listens there already"), listening(address):
            pass
        address.connect(1.0).close()
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_no_socket_is_left_alone(tmp_path):
    (tmp_path / "s.sock").write_text("mine")
    with pytest.raises(hv.UserError, match="is no socket"), listening(Address(tmp_path / "s.sock")):
        pass
    assert (tmp_path / "s.sock").read_text() == "mine"
    with pytest.raises(hv.UserError, match="no such folder"), listening(Address(tmp_path / "none" / "s.sock")):
        pass


def test_a_port_that_is_taken_is_refused():
    with listening(Address(None, "127.0.0.1", 0)) as (_, address):
        assert address.port > 0
        with pytest.raises(hv.UserError, match="somebody listens there already"), listening(address):
            pass


def test_other_machines_need_a_token():
    check_reach(Address(None, "127.0.0.1", 1), None)
    check_reach(Address(None, "0.0.0.0", 1), "correct-horse-battery")
    with pytest.raises(hv.UserError, match="add --token-file"):
        check_reach(Address(None, "0.0.0.0", 1), None)


def test_a_token_is_read_from_a_file_of_this_user_alone(tmp_path):
    path = tmp_path / "token"
    with pytest.raises(hv.UserError, match="No such file"):
        read_token(path)
    path.write_text("correct-horse-battery\n")
    path.chmod(0o644)
    with pytest.raises(hv.UserError, match="chmod 600"):
        read_token(path)
    path.chmod(0o600)
    assert read_token(path) == "correct-horse-battery"
    for text in (b"", b"short", b"two words of some length", b"x" * 300, b"\xff" * 20, b"line\n" * 9):
        path.write_bytes(text)
        with pytest.raises(hv.UserError, match="holds no token"):
            read_token(path)
