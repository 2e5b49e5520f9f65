"""An archive against its host: what is at an entry's place is a finding, nothing waits, nothing outside changes."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import socket
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from horizonval.core import atomic
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.jobs.engine import take_over
from horizonval.store import exr
from horizonval.store.export import export_file
from horizonval.store.folder import RunFolder, write_json
from horizonval.store.named import Garbage, archive_of, garbage, remove
from horizonval.store.store import Store
from horizonval.store.verify import verify_folder

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="FIFOs, devices and links of POSIX")
PATIENCE_S = 30.0


def in_time(call: Callable[[], object]) -> object:
    """What a call returns or raises; one that waits for ever is a failure and not a test that never ends."""
    answer: list[object] = []

    def work() -> None:
        try:
            answer.append(call())
        except Exception as error:
            answer.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    assert answer, "it waits"
    return answer[0]


def contents(root: Path) -> dict[str, bytes]:
    """Every file but the index."""
    paths = [path for path in root.rglob("*") if path.is_file() and not path.name.startswith("index.")]
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in paths}


def a_socket(path: Path) -> None:
    # Of a socket's path a hundred characters are allowed.
    with contextlib.chdir(path.parent), socket.socket(socket.AF_UNIX) as server:
        server.bind("s")
        Path("s").rename(path.name)


HOSTS: dict[str, Callable[[Path], object]] = {
    "is a FIFO": os.mkfifo,
    "is a folder": lambda path: (path / "below").mkdir(parents=True),
    "is a socket": a_socket,
    "is a link": lambda path: path.symlink_to("/dev/zero"),
    "is a link to itself": lambda path: path.symlink_to(path.name),
    "is a link to nothing": lambda path: path.symlink_to("nothing"),
    "is a link to a file": lambda path: path.symlink_to(Path(__file__)),
}


@pytest.mark.parametrize("what", HOSTS)
def test_whatever_is_at_an_entrys_place_is_found_and_made_again(tmp_path, make_frame, make_image, what):
    store = Store(tmp_path / "archive")
    frame, image = make_frame(), make_image()
    address, other = store.add_frame(frame), store.add_image(image)
    store.index.update()
    before = contents(tmp_path)
    path = store.path(address)
    path.unlink()
    HOSTS[what](path)
    # Something else is wrong as well: the walk goes on to it.
    store.path(other).write_bytes(b"ruined")
    findings = in_time(lambda: store.verify({address: "the run"}))
    assert {(f.path, f.problem) for f in findings} == {(path, "damaged"), (store.path(other), "damaged")}
    assert " ".join(what.split()[:3]) in next(f.message for f in findings if f.path == path)
    assert in_time(lambda: store.is_intact(address)) is False
    assert address not in store
    assert isinstance(in_time(lambda: store.read_frame(address)), UserError)
    listed = in_time(lambda: {entry.address: entry.kind for entry in store.index.select()})
    assert listed[address] == "missing"
    if what == "is a folder":
        refused = in_time(lambda: store.add_frame(frame))
        assert isinstance(refused, UserError)
        assert "is a folder" in refused.line()
        assert (path / "below").is_dir()
        shutil.rmtree(path)
    assert in_time(lambda: store.add_frame(frame)) == address
    store.add_image(image)
    assert store.verify() == []
    assert contents(tmp_path) == before


@pytest.mark.parametrize("make", [os.mkfifo, Path.touch, "link"])
def test_what_stands_for_a_folder_of_entries_is_found_and_replaced(tmp_path, make_frame, make):
    store, outside = Store(tmp_path / "archive"), tmp_path / "outside"
    address = store.add_frame(make_frame())
    store.index.update()
    folder = store.path(address).parent
    folder.rename(outside)
    before = contents(outside)
    folder.symlink_to(outside) if make == "link" else make(folder)
    findings = in_time(store.verify)
    assert {(f.path, f.problem) for f in findings} == {(folder, "foreign"), (store.path(address), "missing")}
    assert not store.is_intact(address)
    assert address not in store
    assert store.add_frame(make_frame()) == address
    assert not folder.is_symlink()
    assert store.verify() == []
    assert contents(outside) == before


def a_run(root: Path, make_frame) -> tuple[RunFolder, str, str]:
    """A run with an entry that a case names, and one that nothing names."""
    folder = RunFolder(root)
    folder.create()
    store = Store(folder.archive)
    named, unnamed = store.add_frame(make_frame()), store.add_frame(make_frame(7.0))
    write_json(folder.suite, {"suite": "s"})
    write_json(folder.case("a"), {"frame": named})
    return folder, named, unnamed


def test_cleaning_removes_nothing_outside(tmp_path, make_frame):
    folder, named, unnamed = a_run(tmp_path / "run", make_frame)
    elsewhere, *_ = a_run(tmp_path / "elsewhere", make_frame)
    for path in [*elsewhere.archive.iterdir()]:
        if path.is_dir():
            (path / ".left.tmp").touch()
    place = Store(folder.archive).path(unnamed).parent
    shutil.rmtree(place)
    place.symlink_to(elsewhere.archive / place.name)
    (folder.archive / "more").symlink_to(elsewhere.archive)
    before = contents(elsewhere.root)
    with folder.locked():
        rubbish = garbage(folder)
        remove(rubbish, folder)
        folder.remove_temporary_files()
    assert rubbish.files == ()
    assert contents(elsewhere.root) == before
    # A link that came between the look and the removal.
    late = Garbage((place / f"{unnamed}.exr",), 0)
    with pytest.raises(UserError, match="leads out of the archive"):
        remove(late, folder)
    assert contents(elsewhere.root) == before
    assert Store(folder.archive).is_intact(named)


def test_what_an_archive_shared_by_a_link_is_writing_stays(tmp_path, make_frame):
    shared, *_ = a_run(tmp_path / "shared", make_frame)
    (shared.archive / ".at-work.tmp").touch()
    folder = RunFolder(tmp_path / "run")
    folder.root.mkdir()
    folder.archive.symlink_to(shared.archive)
    folder.create()
    folder.remove_temporary_files()
    assert (shared.archive / ".at-work.tmp").is_file()
    assert atomic.leftovers(folder.archive) == []


def test_names_that_no_listing_may_be_broken_by(tmp_path, make_frame):
    store = Store(tmp_path / "archive")
    store.add_frame(make_frame())
    for name in (b"two\nlines", b"\x1b[2Jcleared", b"\xff\xfe"):
        Path(os.fsdecode(os.fsencode(store.root) + b"/" + name)).write_bytes(b"?")
    (store.root / "fifo").mkdir()
    os.mkfifo(store.root / "fifo" / "a\rb.exr")
    findings = in_time(store.verify)
    assert [f.problem for f in findings] == ["foreign"] * 4
    for finding in findings:
        assert finding.message.isprintable()
        finding.message.encode()


def test_a_folder_that_cannot_be_listed_is_a_finding_and_the_walk_goes_on(tmp_path, make_frame, monkeypatch):
    store = Store(tmp_path / "archive")
    first, second = (store.add_frame(make_frame(value)) for value in (1.0, 2.0))
    store.path(second).write_bytes(np.random.default_rng(1).bytes(100))
    closed, scandir = str(store.path(first).parent), os.scandir

    def refusing(path):
        if os.fspath(path) == closed:
            raise PermissionError(13, "Permission denied", closed)
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refusing)
    findings = {(f.problem, f.path) for f in store.verify()}
    assert findings == {("unreadable", Path(closed)), ("damaged", store.path(second))}


def test_an_entry_that_may_not_be_read_is_not_called_damaged_and_not_overlooked(tmp_path, make_frame, monkeypatch):
    store = Store(tmp_path / "archive")
    closed, other = (store.path(store.add_frame(make_frame(value))) for value in (1.0, 2.0))
    opening = os.open

    def refusing(path, *arguments, **options):
        if os.fspath(path) == str(closed):
            raise PermissionError(13, "Permission denied", str(closed))
        return opening(path, *arguments, **options)

    monkeypatch.setattr(os, "open", refusing)
    assert [(f.problem, f.path) for f in store.verify()] == [("unreadable", closed)]
    assert {entry.address: entry.kind for entry in store.index.select()} == {
        closed.stem: "damaged",
        other.stem: "frame",
    }
    monkeypatch.undo()
    assert {entry.kind for entry in store.index.select()} == {"frame"}


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "a/b", "..", ".", "", "a\nb", "a\0b", 5, None])
def test_names_of_records_are_names(tmp_path, name):
    folder = RunFolder(tmp_path)
    for place in (folder.case, folder.frame_pointer, folder.stability_case):
        with pytest.raises(UserError, match="is no name of a record"):
            place(name)


def test_another_archive_that_a_run_names_is_read_and_never_written(tmp_path, make_frame, make_image):
    other, *_ = a_run(tmp_path / "other", make_frame)
    address = Store(other.archive).add_image(make_image())
    before = sorted(other.root.rglob("*"))
    folder = RunFolder(tmp_path / "run")
    folder.create()
    folder.archive.rmdir()
    root = archive_of(folder, {"archive": "../other/archive"})
    store = Store(root, read_only=True)
    assert len(store.index.select()) == 3
    store.read_image(address)
    assert sorted(other.root.rglob("*")) == before
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "a.txt").touch()
    for named in ("../notes", "../notes/a.txt", 5, ["a"]):
        with pytest.raises(DamagedFileError, match="is no archive"):
            archive_of(folder, {"archive": named})


@pytest.mark.parametrize("room", ["cases", "state", "stability", "report"])
def test_a_run_writes_through_no_link(tmp_path, room):
    (tmp_path / "outside").mkdir()
    folder = RunFolder(tmp_path / "run")
    folder.root.mkdir()
    (folder.root / room).symlink_to(tmp_path / "outside")
    with pytest.raises(UserError, match=rf"{room}: is a link"):
        folder.create()


def test_results_of_others_are_taken_over_as_regular_files_and_into_the_folder(tmp_path):
    source, target, outside = tmp_path / "source", tmp_path / "target", tmp_path / "outside"
    for folder in (source / "cases" / "more", target / "cases", outside):
        folder.mkdir(parents=True)
    (outside / "secret.json").write_text("hunter2")
    (source / "cases" / "a.json").write_text("{}")
    (source / "cases" / "more" / "b.json").write_text("{}")
    (source / "cases" / "link.json").symlink_to(outside / "secret.json")
    os.mkfifo(source / "cases" / "fifo.json")
    (target / "cases" / "more").symlink_to(outside)
    in_time(lambda: take_over(source, target, ["cases"], lambda path: True))
    assert [path.name for path in sorted((target / "cases").iterdir())] == ["a.json", "more"]
    assert [path.name for path in outside.iterdir()] == ["secret.json"]


def test_bands_that_are_no_names_make_no_files(tmp_path, make_frame, monkeypatch):
    monkeypatch.setattr(exr, "_BAND", re.compile(".*"))
    exr.write_frame(tmp_path / "a.exr", make_frame({"../b": 1.0}))
    monkeypatch.undo()
    with pytest.raises(DamagedFileError, match="bands' holds"):
        export_file(tmp_path / "a.exr", tmp_path / "out", ["png"])


def mutated(value: Any, rng: np.random.Generator) -> Any:
    """A JSON value with one of its parts, at any depth, gone or replaced."""
    replacements = [None, True, -1, 1e308, 2**70, "", "\ud800", "a\n\x1b[2Jb", "../x", [], {}, [1]]
    if not isinstance(value, dict) or not value or rng.random() < 0.2:
        return replacements[rng.integers(len(replacements))]
    key = list(value)[rng.integers(len(value))]
    rest = {k: v for k, v in value.items() if k != key}
    return rest if rng.random() < 0.2 else {**rest, key: mutated(value[key], rng)}


def test_headers_that_no_writer_of_ours_writes_are_read_without_a_defect(tmp_path, make_image, monkeypatch):
    """Sealed as they should be, with other content: a listing stays one line an entry, and verifying ends."""
    rng, write = np.random.default_rng(5), exr._write_sealed

    def writing(path, channels, own, *more):
        key = ("truth", "observation")[rng.integers(2)]
        write(path, channels, {**own, key: json.dumps(mutated(json.loads(own[key]), rng))}, *more)

    monkeypatch.setattr(exr, "_write_sealed", writing)
    store, image = Store(tmp_path / "archive"), make_image()
    for number in range(60):
        store.add_image(replace(image, observation={"seed": number}))
    count = store.count()
    assert count > 40
    findings = store.verify()
    listed = store.index.select()
    assert len(listed) == count
    assert {f.path.stem for f in findings if f.problem == "damaged"} >= {
        entry.address for entry in listed if entry.kind == "damaged"
    }
    assert 0 < len(findings) < count
    for path in sorted(store.root.rglob("*.exr")):
        with contextlib.suppress(UserError):
            export_file(path, tmp_path, ["png"])


@pytest.mark.parametrize("entries", [None, [], {"a": 5}, {"../secret.json": "0" * 64}, {"/etc/passwd": "0" * 64}])
def test_a_manifest_that_names_what_is_elsewhere_is_damaged(tmp_path, entries):
    write_json(tmp_path / "manifest.json", {"schema": 1, "files": entries})
    assert [(f.problem, f.path.name) for f in verify_folder(tmp_path)] == [("damaged", "manifest.json")]
