"""The index: what the headers say, whoever writes it, however it was lost."""

from __future__ import annotations

import os
import sqlite3
import sys
from dataclasses import replace

import numpy as np
import pytest

from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store.entry import StoreEntry
from horizonval.store.folder import RunFolder
from horizonval.store.index import NAME, Filter, Index
from horizonval.store.manifest import amend_index, verify_folder, write_manifest
from horizonval.store.store import Store


@pytest.fixture
def store(tmp_path, make_frame, make_image) -> Store:
    """Three frames and two images of two scenes, an hour apart."""
    store = Store(tmp_path / "archive")
    for k, hour in enumerate((10, 11, 12)):
        scene = {"scene": {"name": f"orbit-{k}"}, "camera": {"head": "left" if k else None}}
        store.add_frame(make_frame({"a": 1.0, "ab": 2.0}, scene=scene, epoch_utc=f"2026-03-20T{hour}:30:00+00:00"))
    for hour in (10, 11):
        store.add_image(make_image(scene={"scene": {"name": "glare"}}, epoch_utc=f"2026-03-20T{hour}:30:00+00:00"))
    return store


def rows(store: Store) -> list[StoreEntry]:
    known = store.index.known()
    assert known is not None
    return list(known.values())


def test_every_addition_is_recorded_as_its_header_says(store):
    assert rows(store) == list(store.entries())
    assert len(rows(store)) == 5
    image = next(entry for entry in rows(store) if entry.kind == "image")
    assert (image.seed, image.width, image.height, image.camera) == ("3", 40, 30, "small")


def test_the_index_built_again_equals_the_lost_one(store):
    before = rows(store)
    store.index.path.unlink()
    assert store.index.known() is None
    assert store.index.rebuild() == 5
    assert rows(store) == before
    # Also in the file itself, as any SQLite program shows it.
    with sqlite3.connect(store.root / NAME) as connection:
        assert connection.execute("SELECT count(*), min(address) FROM entries").fetchone() == (5, before[0].address)
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_an_archive_without_index_gets_one_when_it_is_asked(store):
    before = rows(store)
    store.index.path.unlink()
    assert Index(store.root).select() == before
    assert rows(store) == before


def test_what_was_copied_into_the_folder_is_caught_up_with(store, tmp_path, make_frame):
    other = Store(tmp_path / "other")
    address = other.add_frame(make_frame(77.0))
    store.path(address).parent.mkdir(exist_ok=True)
    other.path(address).rename(store.path(address))
    assert len(rows(store)) == 5
    assert [e.address for e in store.index.select()] == [e.address for e in store.entries()]
    assert len(rows(store)) == 6


def test_a_file_that_is_gone_is_listed_as_missing_until_the_index_is_built_again(store):
    victim = rows(store)[2]
    store.path(victim.address).unlink()
    found = {e.address: e.kind for e in store.index.select()}
    assert found[victim.address] == "missing"
    assert list(found.values()).count("missing") == 1
    assert store.index.rebuild() == 4
    assert victim.address not in {e.address for e in store.index.select()}


@pytest.mark.parametrize(
    ("wanted", "count"),
    [
        (Filter(), 5),
        (Filter(kind="frame"), 3),
        (Filter(scene="orbit-*"), 3),
        (Filter(scene="orbit-1"), 1),
        (Filter(scene="orbit"), 0),
        (Filter(camera="sm?ll"), 5),
        (Filter(head="left"), 2),
        (Filter(band="a"), 3),
        (Filter(band="b"), 0),
        (Filter(band="vis", seed="3"), 2),
        (Filter(since="2026-03-20T11:00"), 3),
        (Filter(since="2026-03-20T12:00:00+01:00", until="2026-03-20T11:30"), 2),
        (Filter(until="2026-03-20"), 0),
        (Filter(scene="' OR 1=1 --"), 0),
    ],
)
def test_filters(store, wanted, count):
    assert len(store.index.select(wanted)) == count


def test_a_time_that_is_none_is_refused(store):
    with pytest.raises(UserError, match="--since: found 'yesterday'; expected a date"):
        store.index.select(Filter(since="yesterday"))


def test_a_damaged_index_costs_nothing_and_is_told(store, make_frame, caplog):
    before = rows(store)
    good = store.index.path.read_bytes()
    store.index.path.write_bytes(b"\0" * len(good))
    address = store.add_frame(make_frame(5.0))
    assert store.read_frame(address).radiance["vis"][0, 0] == 5.0
    with pytest.raises(DamagedFileError, match=r"index is damaged .*reindex"):
        store.index.known()
    assert [(f.problem, f.path.name) for f in store.verify()] == [("index", NAME)]
    assert len(store.index.select()) == 6
    (line,) = caplog.messages
    assert "made again from the headers of 6 entries" in line
    assert [e for e in rows(store) if e.address != address] == before
    assert store.verify() == []
    assert len(store.index.select()) == 6
    assert len(caplog.messages) == 1


def test_a_row_that_lies_is_told(store):
    for entry in rows(store):
        if entry.kind == "image":
            store.index.record(replace(entry, scene="other"))
    (finding,) = store.verify()
    assert finding.problem == "index"
    assert "2 rows are not what the headers say" in finding.message


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE entries SET scene = 'other' WHERE kind = 'image'",
        "DELETE FROM entries WHERE kind = 'image'",
        "UPDATE total SET count = 4",
        "DELETE FROM total",
        "CREATE TRIGGER t AFTER INSERT ON entries BEGIN DELETE FROM entries; END",
        "DROP TABLE entries; CREATE VIEW entries AS "
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i FROM n",
    ],
)
def test_what_others_did_to_the_index_is_told_and_undone(store, change, caplog):
    before = rows(store)
    with sqlite3.connect(store.index.path) as connection:
        connection.executescript(change)
    assert [(f.problem, f.path.name) for f in store.verify()] == [("index", NAME)]
    assert store.index.select() == before
    assert len(caplog.messages) == 1
    assert store.verify() == []


@pytest.mark.skipif(sys.platform == "win32", reason="FIFOs and links of POSIX")
@pytest.mark.parametrize("name", [NAME, f"{NAME}-journal", f"{NAME}-wal"])
@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("../outside"), lambda path: path.mkdir()])
def test_an_index_that_is_no_regular_file_is_neither_waited_for_nor_followed(store, tmp_path, name, make):
    before = rows(store)
    (tmp_path / "outside").write_bytes(b"mine")
    path = store.root / name
    path.unlink(missing_ok=True)
    make(path)
    assert store.index.select() == before
    assert (tmp_path / "outside").read_bytes() == b"mine"
    assert path.is_dir() or store.verify() == []


def test_no_damage_of_the_index_gives_a_wrong_list(tmp_path, make_image, caplog):
    """Truncated 85 times and with a block of zeros 300 times: the list is right, or the damage is said as well."""
    store = Store(tmp_path / "archive")
    image = make_image()
    for number in range(20):
        store.add_image(replace(image, observation={"seed": number}))
    gone = store.path(rows(store)[5].address)
    gone.unlink()
    whole = store.index.select()
    there = [entry for entry in whole if entry.kind != "missing"]
    good = store.index.path.read_bytes()
    assert len(good) > 3 * 4096
    rng = np.random.default_rng(14)
    damages = [good[:size] for size in rng.integers(0, len(good), 85)]
    for start, size in zip(rng.integers(0, len(good), 300), rng.integers(1, 4096, 300), strict=True):
        block = good[start : start + size]
        damages.append(good[:start] + bytes(len(block)) + good[start + len(block) :])
    said = 0
    for data in damages:
        caplog.clear()
        store.index.path.write_bytes(data)
        listed = store.index.select()
        # Without any index nobody knows of a file that is gone; an empty file is none.
        assert listed == (there if caplog.messages or not data else whole)
        said += len(caplog.messages)
    assert store.index.select() == listed
    assert said > 200


def test_an_index_of_another_version_is_made_anew(store):
    before = rows(store)
    with sqlite3.connect(store.index.path) as connection:
        connection.execute("ALTER TABLE entries ADD COLUMN mood TEXT")
        connection.execute("PRAGMA user_version = 99")
    assert store.index.select() == before


def test_where_no_index_can_be_made_the_headers_are_read(store, monkeypatch):
    before = rows(store)
    store.index.path.unlink()
    store.index.path.mkdir()  # Nothing can be opened here.
    assert store.index.select(Filter(kind="frame")) == [e for e in before if e.kind == "frame"]


def test_a_folder_without_entries_is_left_as_it_is(tmp_path):
    assert Index(tmp_path).select() == []
    assert Index(tmp_path / "none").select() == []
    assert list(tmp_path.iterdir()) == []


def test_rows_of_removed_files_go_from_a_damaged_index_too(store, caplog):
    victim = rows(store)[0].address
    store.path(victim).unlink()
    store.index.path.write_bytes(b"\0" * 10_000)
    store.index.forget([victim])
    assert len(caplog.messages) == 1
    assert victim not in {entry.address for entry in store.index.select()}
    assert len(rows(store)) == 4


def test_the_manifest_of_a_finished_run_follows_its_index_and_nothing_else(tmp_path, make_frame):
    folder = RunFolder(tmp_path)
    folder.create()
    store = Store(folder.archive)
    store.add_frame(make_frame())
    write_manifest(tmp_path, [store.index.path])
    whole = store.index.path.read_bytes()
    # A bit that no row has: SQLite does not miss it, and listing must not bless it.
    store.index.path.write_bytes(whole[:96] + bytes([whole[96] ^ 1]) + whole[97:])
    other = Index(folder.archive)
    assert len(other.select()) == 1
    amend_index(other)
    assert [f.problem for f in verify_folder(tmp_path) if f.path == store.index.path] == ["damaged"]
    store.index.path.unlink()
    assert len(other.select()) == 1
    amend_index(other)
    assert [f for f in verify_folder(tmp_path) if f.path == store.index.path] == []
