"""Only regular files of bounded size are opened, whatever lies at a path; nothing waits, nothing of them is shown."""

from __future__ import annotations

import hashlib
import os
import re
import socket
import sys
import threading
from pathlib import Path

import pytest

from horizonval.core import files
from horizonval.core.errors import UserError

posix = pytest.mark.skipif(sys.platform == "win32", reason="FIFOs, devices and links of POSIX")
PATIENCE_S = 10.0


def _refusal(path: Path | str, **options) -> files.UnfitFileError:
    """The refusal of a path, read in a thread: opening that waits is a failure, not a test that never ends."""
    raised: list[BaseException | bytes] = []

    def read():
        try:
            raised.append(files.read_bytes(path, largest=options.pop("largest", 1000), expected="a table", **options))
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    assert raised, "it waits"
    assert isinstance(raised[0], files.UnfitFileError), raised
    assert isinstance(raised[0], UserError)
    assert "\n" not in str(raised[0])
    assert "a table" in str(raised[0])
    return raised[0]


def test_a_regular_file_is_read(tmp_path):
    path = tmp_path / "a"
    path.write_bytes("\ufeffgrün\r\n".encode())
    assert files.read_bytes(path, largest=100) == path.read_bytes()
    assert files.read_bytes(path, largest=100, first=3) == b"\xef\xbb\xbf"
    assert files.read_text(path, largest=100) == "grün\r\n"
    assert files.sha256_of(path) == hashlib.sha256(path.read_bytes()).hexdigest()
    (tmp_path / "empty").touch()
    assert files.read_bytes(tmp_path / "empty", largest=0) == b""


@posix
def test_whatever_is_no_regular_file_is_refused_by_its_kind(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "dangling").symlink_to("nothing")
    (tmp_path / "to_fifo").symlink_to("fifo")
    (tmp_path / "to_zero").symlink_to("/dev/zero")
    monkeypatch.chdir(tmp_path)  # Of a socket's path a hundred characters are allowed.
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")
        kinds = {
            "fifo": "is a FIFO",
            "to_fifo": "is a FIFO",
            "folder": "is a folder",
            "socket": "is a socket",
            "to_zero": "is a device",
            "loop": "is a link that leads nowhere",
            "dangling": "is a link to nothing",
            "nothing": "no such file",
        }
        assert {name: _refusal(tmp_path / name).what for name in kinds} == kinds
    assert isinstance(_refusal(tmp_path / "dangling"), files.MissingFileError)
    assert isinstance(_refusal(tmp_path / "fifo" / "below"), files.MissingFileError)
    assert _refusal("/dev/zero").what == "is a device"
    assert _refusal("a\0b").what == "is no path"


@posix
def test_a_link_to_a_file_is_a_file_where_links_may_be(tmp_path):
    (tmp_path / "a").write_bytes(b"1")
    (tmp_path / "link").symlink_to("a")
    assert files.read_bytes(tmp_path / "link", largest=9) == b"1"
    assert _refusal(tmp_path / "link", links=False).what == "is a link"
    assert files.kind_at(tmp_path / "link") == "a link"
    assert files.kind_at(tmp_path / "link", links=True) == "a file"
    assert files.kind_at(tmp_path / "no") == ""


@posix
def test_a_fifo_that_takes_the_place_of_a_file_after_the_look_is_found_when_open(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "file").touch()
    status = os.stat(tmp_path / "file")
    monkeypatch.setattr(files.os, "stat", lambda *args, **kwargs: status)
    assert _refusal(tmp_path / "fifo").what == "is a FIFO"


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
def test_files_of_the_system_without_a_size_are_refused_and_not_shown(monkeypatch):
    assert "of the system" in _refusal("/proc/self/environ").what


def test_size_and_encoding_are_bounded_before_anything_is_kept(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"\xffsecret")
    assert _refusal(path, largest=6).line() == f"{path}: is too large; expected a table of at most 6 B"
    assert files.read_bytes(path, largest=7)
    with pytest.raises(files.UnfitFileError, match="byte 0 is not UTF-8") as refused:
        files.read_text(path, largest=7)
    assert "secret" not in str(refused.value)


@pytest.mark.skipif(sys.platform == "win32" or os.geteuid() == 0, reason="permissions do not bind here")
def test_a_file_without_permission_is_refused(tmp_path):
    path = tmp_path / "a"
    path.touch(mode=0)
    assert _refusal(path).what.startswith("cannot be read: ")


def test_no_other_way_to_read_files_of_users_and_of_results():
    """What is read in the rooms that users' files and results pass through is opened here; libraries get a check."""
    ways = re.compile(r"\.read_text\(|\.read_bytes\(|(?<!os)\.open\(|(?<![\w.])open\(|fromfile\(|np\.load\(|loadtxt\(")
    # Data of the package, temporary files, the lock, the null device, and bytes or files that were checked.
    allowed = {
        "earth/tables.py", "report/page.py", "store/header.py", "store/folder.py", "api/info.py", "store/fits.py",
        "studies/dataset/shards.py", "cli/locating.py", "cli/serving.py", "store/exr.py", "store/picture.py",
            "formats/rays.py",
        "scoring/row.py", "studies/regression/night.py", "studies/regression/baseline.py",
        "store/quiet.py", "store/readers/arrays.py", "store/readers/raster.py",
    }  # fmt: skip
    package = Path(files.__file__).parents[1]
    rooms = ("api", "cli", "earth", "report", "scoring", "spec", "store", "studies", "suites", "tables")
    others = set()
    for path in sorted(path for room in rooms for path in (package / room).rglob("*.py")):
        own = r"\b(files|exr_header|file)\.(read_text|read_bytes|open_file)\("
        text = re.sub(own, "", path.read_text(encoding="utf-8"))
        if ways.search(text):
            others.add(path.relative_to(package).as_posix())
    assert others <= allowed


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "a value is missing at line 1, column 1"),
        ("{a}", "a name in double quotes is missing at line 1, column 2"),
        ("[1; 2]", "a comma is missing at line 1, column 3"),
        ('{"a" 1}', "a colon is missing at line 1, column 6"),
        ("1\n2", "more text after the end at line 2, column 1"),
        ('"a', "a text without its closing quote at line 1, column 1"),
        ('"a\n"', "a control character in a text at line 1, column 3"),
        ('"\\x"', "an unknown escape in a text at line 1, column 2"),
        ("[" * 100_000, "nested too deeply"),
        ("9" * 5000, "a number of thousands of digits"),
    ],
)
def test_a_mistake_in_json_is_described(text: str, what: str) -> None:
    with pytest.raises(UserError, match=f"^a.json: not JSON.*: {what}$"):
        files.parse_json(text, "a.json")
