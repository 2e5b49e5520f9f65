"""The index: what the headers say, whoever writes it, however it was lost."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest

from horizonval.core.errors import DamagedFileError, UserError
from horizonval.store.entry import StoreEntry
from horizonval.store.folder import write_json
from horizonval.store.index import NAME, Filter, Index
from horizonval.store.store import Store


@pytest.fixture
def store(tmp_path, make_frame, make_image) -> Store:
    """Three frames and two images of two scenes, an hour apart, and their index."""
    store = Store(tmp_path / "archive")
    for k, hour in enumerate((10, 11, 12)):
        scene = {"scene": {"name": f"orbit-{k}"}, "camera": {"head": "left" if k else None}}
        store.add_frame(make_frame({"a": 1.0, "ab": 2.0}, scene=scene, epoch_utc=f"2026-03-20T{hour}:30:00+00:00"))
    for hour in (10, 11):
        store.add_image(make_image(scene={"scene": {"name": "glare"}}, epoch_utc=f"2026-03-20T{hour}:30:00+00:00"))
    assert store.index.known() is None
    store.index.update()
    return store


def rows(store: Store) -> list[StoreEntry]:
    known = store.index.known()
    assert known is not None
    return list(known.values())


def test_the_index_says_what_the_headers_say_and_can_be_built_again(store):
    before = rows(store)
    assert before == list(store.entries()) == store.index.select()
    assert len(before) == 5
    image = next(entry for entry in before if entry.kind == "image")
    assert (image.seed, image.width, image.height, image.camera) == ("3", 40, 30, "small")
    whole = store.index.path.read_bytes()
    store.index.path.unlink()
    assert store.index.rebuild() == 5
    assert store.index.path.read_bytes() == whole
    store.index.path.unlink()
    assert Index(store.root, read_only=True).select() == before
    assert not store.index.path.exists()


def test_what_came_is_caught_up_with_and_what_is_gone_is_missing_until_the_index_is_built_again(store, make_frame):
    address = store.add_frame(make_frame(77.0))
    victim = rows(store)[2].address
    store.path(victim).unlink()
    found = {entry.address: entry.kind for entry in store.index.select()}
    assert (len(found), found[address], found[victim]) == (6, "frame", "missing")
    assert list(found.values()).count("missing") == 1
    assert [(f.problem, f.address) for f in store.verify()] == [("missing", victim)]
    assert store.index.rebuild() == 5
    assert victim not in {entry.address for entry in store.index.select()}
    store.index.forget(one for one in [address])
    assert address not in {row.address for row in rows(store)}


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
    ],
)
def test_filters(store, wanted, count):
    assert len(store.index.select(wanted)) == count


def test_no_damage_of_the_index_gives_a_wrong_list(store, caplog):
    """Truncated, with a block of zeros, with a bit flipped: it is said, and the index is made again."""
    gone = store.path(rows(store)[3].address)
    gone.unlink()
    there = list(store.entries())
    good = store.index.path.read_bytes()
    rng = np.random.default_rng(14)
    damages = [good[:size] for size in rng.integers(0, len(good), 20)]
    for start, size, bit in zip(*(rng.integers(0, most, 20) for most in (len(good), 512, 8)), strict=True):
        damages.append(good[:start] + bytes(1 + size) + good[start + 1 + size :])
        damages.append(good[:start] + bytes([good[start] ^ 1 << bit]) + good[start + 1 :])
    for data in damages:
        caplog.clear()
        store.index.path.write_bytes(data)
        with pytest.raises(DamagedFileError, match="reindex"):
            store.index.known()
        assert {(f.problem, f.path.name) for f in store.verify()} == {("index", NAME)}
        assert store.index.select() == there, "nobody knows any more of the file that is gone"
        (line,) = caplog.messages
        assert "made again from the headers of 4 entries" in line
        assert store.verify() == []


ROW = {"address": "a", "kind": "frame", "size_bytes": 1, "bands": ["vis"]}


@pytest.mark.parametrize(
    "entries",
    [
        *(None, [{"address": "a"}], [{"mood": 1}], [5]),
        *(
            [{**ROW, **one}]
            for one in ({"address": {}}, {"camera": None}, {"bands": [[]]}, {"kind": "x"}, {"width": "1"})
        ),
    ],
)
def test_an_index_of_another_version_is_made_anew(store, entries):
    before = rows(store)
    write_json(store.index.path, {"entries": entries})
    assert store.index.select() == before == rows(store)


@pytest.mark.skipif(sys.platform == "win32", reason="FIFOs and links of POSIX")
@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("../outside"), lambda path: path.mkdir()])
def test_an_index_that_is_no_regular_file_is_neither_waited_for_nor_followed(store, tmp_path, make):
    before = rows(store)
    (tmp_path / "outside").write_bytes(b"mine")
    store.index.path.unlink()
    make(store.index.path)
    assert store.index.select() == before
    assert (tmp_path / "outside").read_bytes() == b"mine"
    assert store.verify() == []


def test_where_no_index_can_be_made_the_headers_are_read(store):
    before = rows(store)
    store.index.path.unlink()
    (store.index.path / "below").mkdir(parents=True)
    assert store.index.select(Filter(kind="frame")) == [e for e in before if e.kind == "frame"]
    with pytest.raises(UserError, match="cannot be written"):
        store.index.rebuild()


def test_a_folder_without_entries_is_left_as_it_is(tmp_path):
    assert Index(tmp_path).select() == []
    assert Index(tmp_path / "none").select() == []
    assert list(tmp_path.iterdir()) == []
