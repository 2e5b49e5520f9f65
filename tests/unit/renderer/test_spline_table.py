"""Tables over rays, cubic up to the ends of both axes and made where rays look; the store that drops old ones."""

from __future__ import annotations

import math
from threading import Thread

import numpy as np
import pytest
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.renderer.backend import activate

activate()
import mitsuba as mi  # noqa: E402

from horizonval.renderer.table_store import TableStore  # noqa: E402
from horizonval.renderer.tables import NodeGrid, SplineTable, StationTable  # noqa: E402

GRID = NodeGrid(9, 7)
ROWS = np.array([0.0, 0.3, 1.0, 2.5, 6.9, 7.2, 8.0, 11.0, -1.0])


def _places(azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
    row, angle = np.meshgrid(ROWS, azimuth)
    return row.ravel(), angle.ravel()


def test_parabolas_along_rows_come_out_exactly_at_the_ends_too() -> None:
    def values(row: NDArray[np.int64], column: NDArray[np.int64]) -> FloatArray:
        return np.stack([1.0 + 0.5 * row + 0.25 * row**2, 2.0 + 0.0 * column, 3.0 * row], axis=1)

    table = SplineTable(GRID, 3)
    row, angle = _places(np.array([0.0, 1.0, -2.0, math.pi, -math.pi]))
    table.cover(mi.Float64(row), mi.Float64(angle), values)
    looked = [np.array(v) for v in table.look(mi.Float64(row), mi.Float64(angle))]
    x = np.clip(row, 0.0, 8.0)
    for found, expected in zip(looked, (1.0 + 0.5 * x + 0.25 * x**2, 2.0 + 0.0 * x, 3.0 * x), strict=True):
        assert found == pytest.approx(expected, rel=1e-14, abs=1e-14)


def test_both_sides_of_the_meridian_are_one() -> None:
    """Third order in the step: 1e-2 of cos(azimuth) with seven nodes over half a circle, flat at both ends."""
    table = SplineTable(GRID, 1)
    angle = np.linspace(-math.pi, math.pi, 101)
    row = mi.Float64(np.full(101, 4.2))
    table.cover(row, mi.Float64(angle), lambda _, column: 2.0 + np.cos(GRID.node_azimuths()[column])[:, None])
    found = np.array(table.look(row, mi.Float64(angle))[0])
    assert found == pytest.approx(found[::-1], rel=1e-15)
    assert found == pytest.approx(2.0 + np.cos(angle), abs=1e-2)
    nodes = np.array(table.look(mi.Float64(np.full(7, 4.0)), mi.Float64(GRID.node_azimuths()))[0])
    assert nodes == pytest.approx(2.0 + np.cos(GRID.node_azimuths()), rel=1e-14)


def test_nodes_are_made_once_and_where_rays_look() -> None:
    asked: list[tuple[int, int]] = []

    def values(row: NDArray[np.int64], column: NDArray[np.int64]) -> FloatArray:
        assert len(row) % 64 == 0
        asked.extend(zip(row.tolist(), column.tolist(), strict=True))
        return (10.0 * row + column)[:, None]

    table = SplineTable(GRID, 1)
    first = mi.Float64([4.5]), mi.Float64([1.5])
    table.cover(*first, values)
    assert set(asked) == {(i, j) for i in (3, 4, 5, 6) for j in (1, 2, 3, 4)}
    before, size = table.look(*first)[0][0], table.nbytes
    asked.clear()
    table.cover(mi.Float64([4.7, 0.0]), mi.Float64([-1.5, 0.1]), values)
    assert set(asked) == {(i, j) for i in (0, 1, 2, 3) for j in (0, 1, 2)} - {(3, 1), (3, 2)}
    assert table.nbytes == size + 8 * (12 - 2)
    assert table.look(*first)[0][0] == before
    asked.clear()
    table.cover(mi.Float64([4.6]), mi.Float64([1.4]), values)
    assert not asked


def test_values_do_not_depend_on_the_order_of_what_was_looked_at() -> None:
    rng = np.random.default_rng(np.random.SeedSequence(3))
    field = rng.uniform(1.0, 2.0, (9, 7))
    rays = [(mi.Float64(rng.uniform(0, 8, 5)), mi.Float64(rng.uniform(-3, 3, 5))) for _ in range(6)]
    found = []
    for order in (rays, rays[::-1]):
        table = SplineTable(GRID, 1)
        for ray in order:
            table.cover(*ray, lambda row, column: field[row, column][:, None])
        found.append([np.array(table.look(*ray)[0]).tobytes() for ray in rays])
    assert found[0] == found[1]


def test_stations_along_a_ray_up_to_the_first_and_the_last() -> None:
    stations = np.arange(10.0)

    def values(row: NDArray[np.int64], column: NDArray[np.int64]) -> FloatArray:
        p, q = np.add.outer(1.0 * row, stations**2), np.add.outer(0.0 * column, 5.0 - stations)
        return np.stack([p, q], axis=-1)

    table = StationTable(GRID, len(stations))
    along = np.array([-0.1, 0.0, 0.05, 0.3, 0.5, 0.95, 1.0, 1.5])
    row, angle = mi.Float64(np.full(8, 3.25)), mi.Float64(np.linspace(-3.0, 3.0, 8))
    table.cover(row, angle, values)
    p, q = table.look(row, angle, mi.Float64(along))
    place = 9.0 * np.clip(along, 0.0, 1.0)
    assert np.array(p) == pytest.approx(3.25 + place**2, rel=1e-13)
    assert np.array(q) == pytest.approx(5.0 - place, rel=1e-13)


def _get(store: TableStore, key: str, nbytes: int = 40) -> bytearray:
    return store.get_or_make(key, lambda: bytearray(nbytes), len)


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
    grown.extend(bytes(41))
    assert _get(store, "b") is grown
    assert "a" not in store
    assert store.nbytes == 81


def test_a_failure_leaves_nothing_behind_and_making_may_ask_for_another() -> None:
    store = TableStore(100)

    def fail() -> bytearray:
        raise ValueError("no table")

    with pytest.raises(ValueError, match="no table"):
        store.get_or_make("a", fail, len)
    assert "a" not in store
    assert store.get_or_make("a", lambda: _get(store, "b") + b"1", len) == bytes(40) + b"1"
    assert len(store) == 2
    store.clear()
    assert store.nbytes == 0


def test_threads_share_one_table() -> None:
    store = TableStore(100)
    made: list[bytearray] = []

    def make() -> bytearray:
        made.append(bytearray(40))
        return made[-1]

    threads = [Thread(target=store.get_or_make, args=("a", make, len)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1
