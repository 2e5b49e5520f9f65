"""The index: what the headers say, whoever writes it, however it was lost."""

from __future__ import annotations

import sqlite3

import pytest

from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store.entry import StoreEntry
from horizonval.store.index import NAME, Filter, Index
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


def test_a_damaged_index_costs_nothing_and_is_told(store, make_frame):
    before = rows(store)
    good = store.index.path.read_bytes()
    store.index.path.write_bytes(b"\0" * len(good))
    address = store.add_frame(make_frame(5.0))
    assert store.read_frame(address).radiance["vis"][0, 0] == 5.0
    with pytest.raises(DamagedFileError, match=r"index is damaged .*reindex"):
        store.index.select()
    assert [(f.problem, f.path.name) for f in store.verify()] == [("index", NAME)]
    assert store.index.rebuild() == 6
    assert [e for e in rows(store) if e.address != address] == before
    assert store.verify() == []


def test_a_row_that_lies_is_told(store):
    with sqlite3.connect(store.index.path) as connection:
        connection.execute("UPDATE entries SET scene = 'other' WHERE kind = 'image'")
    (finding,) = store.verify()
    assert finding.problem == "index"
    assert "2 rows are not what the headers say" in finding.message


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
