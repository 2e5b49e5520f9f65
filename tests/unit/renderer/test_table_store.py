"""The store of tables, which drops those that were used longest ago."""

from __future__ import annotations

from dataclasses import dataclass
from threading import Thread

import pytest

from horizonval.renderer.table_store import TableStore


@dataclass(eq=False)
class Some:
    """A table of some bytes."""

    nbytes: int


def _get(store: TableStore, key: str, nbytes: int = 40) -> Some:
    return store.get_or_make(key, lambda: Some(nbytes))


def test_a_table_is_made_once_and_what_was_used_longest_ago_goes_first() -> None:
    store = TableStore(100)
    for key in ("a", "b", "a", "c"):
        assert _get(store, key) is _get(store, key)
    assert _get(store, "c") is not _get(store, "a")
    assert ["a" in store, "b" in store, "c" in store] == [True, False, True]
    assert store.nbytes == 80
    large = _get(store, "d", 500)
    assert _get(store, "d") is large
    _get(store, "e")
    assert ("d" in store, len(store)) == (False, 1)


def test_a_table_that_grew_pushes_others_out_when_the_next_is_asked_for() -> None:
    store = TableStore(100)
    _get(store, "a")
    grown = _get(store, "b")
    grown.nbytes += 41
    assert _get(store, "b") is grown
    assert "a" not in store
    assert store.nbytes == 81


def test_a_failure_leaves_nothing_behind_and_making_may_ask_for_another() -> None:
    store = TableStore(100)

    def fail() -> Some:
        raise ValueError("no table")

    with pytest.raises(ValueError, match="no table"):
        store.get_or_make("a", fail)
    assert "a" not in store
    assert store.get_or_make("a", lambda: Some(_get(store, "b").nbytes + 1)).nbytes == 41
    assert len(store) == 2
    store.clear()
    assert store.nbytes == 0


def test_threads_share_one_table() -> None:
    store = TableStore(100)
    made: list[Some] = []

    def make() -> Some:
        made.append(Some(40))
        return made[-1]

    threads = [Thread(target=store.get_or_make, args=("a", make)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1
