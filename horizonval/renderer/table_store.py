"""Tables of light in memory, cached by the digest of everything that they depend on.

A table's values depend on its key alone, so that a frame has the same bytes whether it made the table or found it, and
in whatever order frames come. The least recently used tables are dropped once all together exceed a bound.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from threading import RLock
from typing import Any, TypeVar

Table = TypeVar("Table")
MOST_BYTES = 256_000_000
"""Of all tables of a process."""


@dataclass(frozen=True)
class _Kept:
    table: Any
    size: Callable[[Any], int]

    @property
    def nbytes(self) -> int:
        return self.size(self.table)


class TableStore:
    """Tables by key, at most ``most_bytes`` of them together, beside the one that was asked for last."""

    def __init__(self, most_bytes: int) -> None:
        self.most_bytes = most_bytes
        self._kept: OrderedDict[str, _Kept] = OrderedDict()
        # making a table may ask for another
        self._lock = RLock()

    def get_or_make(self, key: str, make: Callable[[], Table], size: Callable[[Table], int]) -> Table:
        """Return the table of a key; made now if it is not here.

        ``key``: digest of everything that the table depends on, its kind and the kernels' variant included; ``size``:
        bytes of a table, evaluated at every call, for tables that grow.
        """
        with self._lock:
            kept = self._kept.get(key)
            if kept is None:
                kept = _Kept(make(), size)
                self._kept[key] = kept
            self._kept.move_to_end(key)
            self._drop()
            table: Table = kept.table
            return table

    @property
    def nbytes(self) -> int:
        """Bytes of all tables."""
        return sum(kept.nbytes for kept in self._kept.values())

    def clear(self) -> None:
        """Drop all tables."""
        with self._lock:
            self._kept.clear()

    def _drop(self) -> None:
        excess = self.nbytes - self.most_bytes
        while excess > 0 and len(self._kept) > 1:
            _, oldest = self._kept.popitem(last=False)
            excess -= oldest.nbytes

    def __contains__(self, key: str) -> bool:
        return key in self._kept

    def __len__(self) -> int:
        return len(self._kept)


TABLES = TableStore(MOST_BYTES)
"""Those of this process."""
