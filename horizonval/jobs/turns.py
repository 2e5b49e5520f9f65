"""Whose turn it is: which item each of several workers takes next, so that what items share is found in memory.

Items of a group go to one worker, one after another, groups in the order of their first items. A worker that would be
idle takes over the later half of the longest group that another one is at; a last item stays where it is, for what it
shares is there already. No result depends on any of it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable
from typing import Generic, TypeVar

I = TypeVar("I")  # noqa: E741


class Turns(Generic[I]):
    """Items that wait for workers.

    Parameters
    ----------
    items : iterable
    group : callable, optional
        Returns what the items of a group have in common; by default every item is alone.
    """

    def __init__(self, items: Iterable[I], group: Callable[[I], Hashable] | None = None) -> None:
        groups: dict[Hashable, deque[I]] = {}
        for number, item in enumerate(items):
            groups.setdefault(number if group is None else group(item), deque()).append(item)
        self._groups = deque(groups.values())
        self._begun: dict[int, deque[I]] = {}

    def __len__(self) -> int:
        """Return how many items wait."""
        return sum(map(len, (*self._groups, *self._begun.values())))

    def take(self, worker: int) -> I | None:
        """Return a worker's next item; None if it has nothing to do."""
        if not self._begun.get(worker):
            self._begun[worker] = self._groups.popleft() if self._groups else self._half_of_the_longest()
        turns = self._begun[worker]
        return turns.popleft() if turns else None

    def put_back(self, worker: int, item: I) -> None:
        """Let an item wait that a worker took and did not begin."""
        self._begun[worker].appendleft(item)

    def release(self) -> None:
        """Let the groups that were begun go to whoever comes next: their workers are gone."""
        self._groups.extendleft(turns for _, turns in sorted(self._begun.items(), reverse=True) if turns)
        self._begun = {}

    def _half_of_the_longest(self) -> deque[I]:
        longest = max(self._begun.values(), key=len, default=deque())
        half: deque[I] = deque()
        for _ in range(len(longest) // 2):
            half.appendleft(longest.pop())
        return half
