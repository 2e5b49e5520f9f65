"""The content-addressed store: what goes in comes out, and everything odd is found."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.store.store import Store


@pytest.fixture
def store(tmp_path) -> Store:
    return Store(tmp_path / "archive")


def test_what_goes_in_comes_out(store, make_frame, make_image):
    frame, image = make_frame(), make_image()
    first, second = store.add_frame(frame), store.add_image(image)
    assert store.read_frame(first).truth == frame.truth
    np.testing.assert_array_equal(store.read_frame(first).radiance["vis"], frame.radiance["vis"])
    np.testing.assert_array_equal(store.read_image(second).dn, image.dn)
    assert store.verify() == []
    assert first in store
    assert "0" * 64 not in store


def test_the_address_is_the_hash_of_the_file_and_adding_twice_touches_nothing(store, make_frame):
    address = store.add_frame(make_frame())
    path = store.path(address)
    assert path.relative_to(store.root) == Path(address[:2]) / f"{address}.exr"
    assert hashlib.sha256(path.read_bytes()).hexdigest() == address
    address = store.add_frame(make_frame())
    before = os.stat(store.path(address))
    assert store.add_frame(make_frame()) == address
    after = os.stat(store.path(address))
    assert (before.st_ino, before.st_mtime_ns) == (after.st_ino, after.st_mtime_ns)
    assert len(list(store.root.rglob("*.exr"))) == 1


def test_unknown_addresses_are_user_errors(store):
    with pytest.raises(UserError, match="no entry"):
        store.read_frame("0" * 64)
    with pytest.raises(UserError, match="64 hexadecimal digits"):
        store.path("../../etc/passwd")
    assert list(store.entries()) == []
    assert store.verify() == []


def test_a_failed_addition_leaves_nothing(store, make_frame):
    frame = make_frame()
    frame.radiance["vis"][0, 0] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        store.add_frame(frame)
    assert list(store.root.rglob("*")) == []


def _add_many(root: Path, make: Callable, start: int) -> None:
    store = Store(root)
    for k in range(start, start + 12):
        store.add_frame(make(float(k)))


def test_two_writers_lose_nothing(store, make_frame):
    """Overlapping ranges: some frames are added by both at the same time."""
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=_add_many, args=(store.root, make_frame, start)) for start in (0, 6)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
        assert worker.exitcode == 0
    assert store.verify() == []
    entries = list(store.entries())
    assert len(entries) == 18
    assert store.index.select() == entries


def test_an_index_built_anew_meanwhile_loses_nothing_either(store, make_frame):
    context = multiprocessing.get_context("fork")
    worker = context.Process(target=_add_many, args=(store.root, make_frame, 0))
    worker.start()
    rebuilt = 0
    while worker.is_alive():
        if store.root.is_dir():
            rebuilt = max(rebuilt, store.index.rebuild())
    worker.join(60)
    assert (worker.exitcode, rebuilt > 0) == (0, True)
    listed = store.index.select()
    assert listed == list(store.entries())
    assert len(listed) == 12
