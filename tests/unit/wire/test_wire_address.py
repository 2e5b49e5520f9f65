"""Addresses are what they say, and the default one is this user's alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from horizonval.core.errors import UserError
from horizonval.wire import LONGEST_PATH, Address, default_socket, make_private_folder, unix_socket


@pytest.mark.parametrize("text", ["ipc:///run/x.sock", "ipc://x.sock", "tcp://127.0.0.1:5000", "tcp://[::1]:5000"])
def test_an_address_is_written_as_it_is_read(text):
    assert str(Address.parse(text)) == text


@pytest.mark.parametrize(
    "text", ["x.sock", "ipc://", "tcp://a", "tcp://:1", "tcp://a:b", "tcp://a:65536", "http://a:1"]
)
def test_what_is_no_address_is_one_line(text):
    with pytest.raises(UserError, match="expected ipc://PATH or tcp://HOST:PORT"):
        Address.parse(text)


@pytest.mark.parametrize(
    ("text", "local"),
    [
        ("ipc://x", True),
        ("tcp://127.0.0.1:1", True),
        ("tcp://127.8.0.1:1", True),
        ("tcp://[::1]:1", True),
        ("tcp://localhost:1", True),
        ("tcp://0.0.0.0:1", False),
        ("tcp://192.168.0.2:1", False),
        ("tcp://[::]:1", False),
        ("tcp://example.org:1", False),
    ],
)
def test_who_can_reach_it(text, local):
    assert Address.parse(text).is_local is local


def test_the_default_lies_in_the_runtime_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert default_socket() == tmp_path / "horizonval" / "serve.sock"
    assert Address.parse("").path == default_socket()
    monkeypatch.setenv("XDG_RUNTIME_DIR", "")
    assert default_socket().parent.name.startswith("horizonval-")


def test_a_folder_that_others_enter_is_refused(tmp_path):
    make_private_folder(tmp_path / "new")
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o700
    make_private_folder(tmp_path / "new")
    (tmp_path / "new").chmod(0o755)
    with pytest.raises(UserError, match="is open to others"):
        make_private_folder(tmp_path / "new")
    (tmp_path / "mine").mkdir(0o700)
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    with pytest.raises(UserError, match="is open to others"):
        make_private_folder(tmp_path / "link")


def test_a_path_that_is_too_long_is_one_line():
    with pytest.raises(UserError, match=f"at most {LONGEST_PATH} bytes"):
        unix_socket(Path("/" + "x" * LONGEST_PATH))
