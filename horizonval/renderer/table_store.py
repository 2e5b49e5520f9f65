"""Tables of light in memory, cached by the digest of everything that they depend on.

A table's values depend on its key alone, so that a frame has the same bytes whether it made the table or found it, and
in whatever order frames come. The least recently used tables are dropped once all together exceed a bound.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import RLock
from typing import Any, Protocol, TypeVar


class Sized(Protocol):
    """A table that knows its memory; it may grow."""

    @property
    def nbytes(self) -> int:
        """Return the memory of the table."""


Table = TypeVar("Table", bound=Sized)
MOST_BYTES = 256_000_000
"""Memory limit of all tables of a process."""


class TableStore:
    """Tables by key, at most ``most_bytes`` of them together, except for the one that was asked for last."""

    def __init__(self, most_bytes: int) -> None:
        self.most_bytes = most_bytes
        self._tables: OrderedDict[str, Any] = OrderedDict()
        # making a table may ask for another
        self._lock = RLock()

    def get_or_make(self, key: str, make: Callable[[], Table]) -> Table:
        """Return the table of a key; made now if it is not here.

        ``key``: digest of everything that the table depends on, its kind and the kernels' variant included.
        """
        with self._lock:
            if key not in self._tables:
                self._tables[key] = make()
            self._tables.move_to_end(key)
            table: Table = self._tables[key]
            excess = self.nbytes - self.most_bytes
            while excess > 0 and len(self._tables) > 1:
                excess -= self._tables.popitem(last=False)[1].nbytes
            return table

    @property
    def nbytes(self) -> int:
        """Bytes of all tables."""
        return sum(table.nbytes for table in self._tables.values())

    def clear(self) -> None:
        """Drop all tables."""
        with self._lock:
            self._tables.clear()

    def __contains__(self, key: str) -> bool:
        return key in self._tables

    def __len__(self) -> int:
        return len(self._tables)


TABLES = TableStore(MOST_BYTES)
"""Those of this process."""
