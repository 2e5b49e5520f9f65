"""Shards are a partition of the items, whatever their number."""

from __future__ import annotations

import pytest

from horizonval.jobs.pool import Execution, parse_shard


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("count", [0, 1, 4, 7, 16])
def test_every_item_belongs_to_one_shard_and_shards_are_even(n: int, count: int) -> None:
    items = [f"item {k}" for k in range(count)]
    shares = [Execution(shard=parse_shard(f"{i}/{n}")).share(items) for i in range(1, n + 1)]
    assert sorted(item for share in shares for item in share) == sorted(items), "each once, none left out"
    assert max(map(len, shares)) - min(map(len, shares)) <= 1
    assert all(share == sorted(share, key=items.index) for share in shares), "in the items' order"
    assert Execution().share(items) == items


def test_the_first_shard_has_the_first_item() -> None:
    assert [Execution(shard=(i, 3)).share("abc") for i in (1, 2, 3)] == [["a"], ["b"], ["c"]]
