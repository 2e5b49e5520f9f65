"""Key figures of the published systems, computed again in a minute and held against those of the committed pages.

A whole reproduction takes hours, most of them for rendering. Here every system's estimator is run on what is quick to
make or stored beside the pages: ``inputs.npz`` holds the panel's picture of B, the scans of F and the limbs of G. It is
written with the pages, by a reproduction of these three together.

    A  the published set-ups, rendered (bare spheres)
    B  the bench with every imperfection switched off, from the stored picture of its panel
    C  the random and the known poses
    D  tables 1 to 5 through the hard limb, rendered (lines of 160 pixels)
    E  the rounding table
    F  all rows, from the stored scans
    G  all rows, from the stored limbs

Nothing in it is random but for seeds that are fixed, so that a figure is the committed one or something has changed:
the only allowance is for the last digits of floating point, which belong to a machine.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import atomic, files
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.core.json_types import JsonObject
from horizonval.store.folder import read_json
from horizonval.systems.result import ComparisonRow
from horizonval.systems.systems import SYSTEMS
from horizonval.systems.task_cache import TaskCache

INPUTS = "inputs.npz"
STORED_OF = frozenset("BFG")
"""Systems of which something is stored."""
SAME_SHARE = 1e-6
"""Of a figure: float32 images and processors' own sines differ by less; the pages show four digits."""
ROUND_OFF = 1e-10
"""In the figure's own unit: errors of exact formulas are round-off themselves."""
Inputs = dict[str, Any]
"""``B``: text of the packed picture; ``F``: scans by name; ``G``: radiance, shape (places, altitudes, 4, rays)."""


@dataclass(frozen=True)
class KeyFigure:
    """A figure tonight beside the committed one; ``accepted`` is None where the page has no such figure."""

    system: str
    name: str
    unit: str
    accepted: float | None
    measured: float

    @property
    def is_same(self) -> bool:
        """Whether nothing has changed but for the last digits."""
        if self.accepted is None:
            return False
        return abs(self.measured - self.accepted) <= max(ROUND_OFF, SAME_SHARE * abs(self.accepted))

    def plain(self) -> JsonObject:
        """Return plain data, with a verdict in a night's words."""
        return {
            "system": self.system,
            "name": self.name,
            "unit": self.unit,
            "accepted": self.accepted,
            "measured": self.measured,
            "verdict": "PASS" if self.is_same else "FAIL",
        }


def key_figures(cache: TaskCache, pages: Path, systems: Sequence[str] = SYSTEMS) -> list[JsonObject]:
    """Return the systems' key figures beside those of the committed pages, as plain data.

    Parameters
    ----------
    cache : TaskCache
        Its seed must be that of the pages.
    pages : Path
        Folder of the pages' JSON files and of ``inputs.npz``.
    systems : sequence of str

    Raises
    ------
    UserError
        A file of the pages is missing.
    DamagedFileError
        The stored inputs cannot be read.
    """
    inputs = read_inputs(pages / INPUTS)
    found = []
    for system in systems:
        path = pages / f"{system}.json"
        content = read_json(path, bound=False)
        if content is None:
            raise UserError("no such page", where=str(path), fix="take it from version control again")
        accepted = {row["name"]: row["measured"] for row in content["rows"]}
        for row in ROWS[system](cache, inputs):
            found.append(KeyFigure(system, row.name, row.unit, accepted.get(row.name), float(row.measured)).plain())
    return found


def read_inputs(path: Path) -> Inputs:
    """Read the stored inputs."""
    if not path.is_file():
        raise UserError("no such file", where=str(path), expected="what key figures of B, F and G are computed from")
    try:
        with files.open_file(path) as stream, np.load(stream, allow_pickle=False) as file:
            texts = {name: file[name].tobytes().decode() for name in ("B", "F")}
            return {"B": texts["B"], "F": json.loads(texts["F"]), "G": file["G"]}
    except Exception as error:
        raise DamagedFileError(f"cannot be read ({type(error).__name__})", where=str(path)) from error


def write_inputs(path: Path, inputs: Inputs) -> None:
    """Write the inputs, whole or not at all."""
    texts = {"B": inputs["B"], "F": json.dumps(inputs["F"], separators=(",", ":"))}
    b, f = (np.frombuffer(texts[name].encode(), dtype=np.uint8) for name in ("B", "F"))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, B=b, F=f, G=np.asarray(inputs["G"], dtype=np.float64))
    atomic.write_bytes(path, buffer.getvalue())


def make_inputs(cache: TaskCache) -> Inputs:
    """Return what is stored: the panel's picture, all scans, and the limbs at G's two altitudes.

    After the experiments of B, F and G in the same cache nothing of it is rendered again.
    """
    from horizonval.systems.b.rig.frames import make_picture
    from horizonval.systems.f import experiment as f
    from horizonval.systems.g import experiment as g

    days = f.weather_places(f.PLACES, f.INCLINATION_DEG, cache.seed)
    scans = cache.each("F: scans", f.scan, f.scan_items(days))
    places = g.weather_places(g.PLACES, g.INCLINATION_DEG, cache.seed)
    limbs = cache.each("G: limbs", g.limb_profiles, g.limb_items(places))
    kept = [g.ALTITUDES_KM.index(altitude) for altitude in G_ALTITUDES_KM]
    picture = cache.each("panel's picture", make_picture, {"picture": {}})["picture"]["png"]
    return {"B": picture, "F": scans, "G": np.array([one["radiance"] for one in limbs.values()])[:, kept]}


def _set_ups(cache: TaskCache, _inputs: Inputs) -> Sequence[ComparisonRow]:
    from horizonval.systems.a.bank import measure, set_ups
    from horizonval.systems.a.rows import set_up_rows

    return set_up_rows(cache.each("A: set-ups", measure, set_ups(cache.seed)))


def _perfect_bench(cache: TaskCache, inputs: Inputs) -> Sequence[ComparisonRow]:
    from horizonval.systems.b.rig.experiment import perfect_row

    return [perfect_row(cache, inputs["B"])]


def _poses(cache: TaskCache, _inputs: Inputs) -> Sequence[ComparisonRow]:
    from horizonval.systems.c.experiment import measured_pose_rows

    return measured_pose_rows(cache)


def _tables(cache: TaskCache, _inputs: Inputs) -> Sequence[ComparisonRow]:
    from horizonval.systems.d.experiment import read_tables
    from horizonval.systems.d.frames import HARD
    from horizonval.systems.d.rows import cause_rows, moment_rows

    hard = read_tables(cache, "D: hard limb", HARD, {})
    return [*moment_rows(hard), *cause_rows(hard)]


def _rounding(cache: TaskCache, _inputs: Inputs) -> Sequence[ComparisonRow]:
    from horizonval.systems.e.experiment import rounding_rows

    return rounding_rows(cache)


def _scans(cache: TaskCache, inputs: Inputs) -> Sequence[ComparisonRow]:
    from horizonval.systems.f.experiment import rows_of_scans

    return rows_of_scans(inputs["F"], cache.seed)


def _limbs(cache: TaskCache, inputs: Inputs) -> Sequence[ComparisonRow]:
    from horizonval.systems.g.experiment import rows_of_limbs

    return rows_of_limbs(inputs["G"], G_ALTITUDES_KM, cache.seed)


G_ALTITUDES_KM = (350.0, 402.5)
ROWS: dict[str, Callable[[TaskCache, Inputs], Sequence[ComparisonRow]]] = dict(
    zip(SYSTEMS, (_set_ups, _perfect_bench, _poses, _tables, _rounding, _scans, _limbs), strict=True)
)
"""What computes a system's key figures, by its letter."""
