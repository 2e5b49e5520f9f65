"""How long the rest of some work will take, from what its items were expected to cost and what the finished ones took.

Items differ: a mean over the first ones says little of the others. So the expected costs, where there are some, are
scaled by the ratio of measured to expected time. What is spent once for all (a process compiles its kernels, a table
is made for many frames) is counted apart, or it would be taken for the pace of all.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

PRIOR_ITEMS = 0.1
"""How many items the expected cost counts for, before there are measured ones."""
FEWEST_UNKNOWN = 3
"""Items that must be finished before there is a figure, where none was expected."""


@dataclass(frozen=True)
class ExpectedTime:
    """What an item is expected to take.

    Attributes
    ----------
    seconds : float
        Without what is made once.
    once : mapping of str to float
        What it needs that is made once for all items, by name, and the seconds that this takes.
    """

    seconds: float
    once: Mapping[str, float] = field(default_factory=dict)

    def __add__(self, other: ExpectedTime) -> ExpectedTime:
        """Return what two things take that are one item."""
        return ExpectedTime(self.seconds + other.seconds, {**self.once, **other.once})


@dataclass(frozen=True)
class SpentTime:
    """What an item took: all of it, and what of it was spent on what is made once and on compiling."""

    seconds: float
    once_s: float = 0.0
    compiling_s: float = 0.0


class Remaining:
    """The time left.

    Parameters
    ----------
    expected : mapping of str to ExpectedTime or None
        By item; None where nothing is known.
    processes : int or None
        That work at the same time; None where it is not known, and is told from the time that has passed.
    """

    def __init__(self, expected: Mapping[str, ExpectedTime | None], processes: int | None) -> None:
        known = [one.seconds for one in expected.values() if one is not None and one.seconds > 0]
        self._known = len(known) == len(expected)
        self._expected = {
            name: one if self._known and one is not None else ExpectedTime(1.0) for name, one in expected.items()
        }
        self._left = dict(self._expected)
        self._processes = processes
        self._mean = sum(known) / len(known) if self._known and known else 0.0
        self._net = self._pace = 0.0
        self._once_spent = self._once_expected = 0.0
        self._made: set[str] = set()
        self._finished, self._spent = 0, 0.0

    def done(self, name: str, spent: SpentTime) -> None:
        """Learn from an item that is finished."""
        item = self._left.pop(name, None)
        if item is None:
            return
        self._finished += 1
        self._spent += spent.seconds
        self._net += max(spent.seconds - spent.once_s - spent.compiling_s, 0.0)
        self._pace += item.seconds
        self._once_spent += spent.once_s
        self._once_expected += sum(seconds for key, seconds in item.once.items() if key not in self._made)
        self._made |= set(item.once)

    def seconds(self, elapsed_s: float) -> float | None:
        """Return the seconds left, ``elapsed_s`` after the first item was begun; None while nothing tells it."""
        if not self._left:
            return 0.0
        if self._finished < (1 if self._known else FEWEST_UNKNOWN):
            return None
        prior = PRIOR_ITEMS * self._mean
        pace = (self._net + prior) / (self._pace + prior)
        once: dict[str, float] = {}
        for item in self._left.values():
            once |= {key: seconds for key, seconds in item.once.items() if key not in self._made}
        # What others find made already (on the disk, from an earlier run) the rest will find as well.
        share = self._once_spent / self._once_expected if self._once_expected else 1.0
        longest = max(item.seconds for item in self._left.values())
        total = pace * sum(item.seconds for item in self._left.values()) + share * sum(once.values())
        at_once = self._spent / max(elapsed_s, 1e-9) if self._processes is None else self._processes
        return max(total / max(1.0, min(at_once, len(self._left))), pace * longest)
