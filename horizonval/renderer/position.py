"""A camera's position: the key of the tables of what is seen from there, and the tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mitsuba as mi

from horizonval.core.digests import content_digest
from horizonval.renderer.planet import Planet
from horizonval.renderer.table_store import TABLES, Table


@dataclass(frozen=True)
class Position:
    """A camera at ``place_m``, planet-centred [m], around a planet; apparent ones with refraction."""

    planet: Planet
    place_m: tuple[float, float, float]

    def table(self, make: Callable[[], Table], *key: object) -> Table:
        """Return a table of this position; made now if it is not here. ``key``: what else it depends on."""
        digest = content_digest(self.planet, self.place_m, mi.variant(), *key)
        return TABLES.get_or_make(digest, make)
