"""Make the shipped profiles of the limb: ``python tests/data/make_limb_templates.py KIND WORK [MONTHS]``.

``thermal`` makes those of 14 to 16.3, 8 to 14 and 10.5 to 12.5 um, ``solar`` those of the shipped visible cameras and
of the three colours of the others. WORK is a folder where finished months and states are kept,
so that a run that was stopped goes on; several runs with other MONTHS (1,2,3) may share it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from horizonval.core.progress import Silent
from horizonval.estimation.fit import templates
from horizonval.renderer.backend import activate
from horizonval.spec.camera import Band
from horizonval.spec.load import load_camera
from horizonval.tables.modes import MONTHS
from horizonval.tables.sunlit import sunlit_table
from horizonval.tables.thermal import thermal_table

RGB = "rgb-rolling-648-53deg"
SOLAR = {"vis": "vis-cmos-512-60deg", "red": RGB, "green": RGB, "blue": RGB}
THERMAL = {"co2": (14.0, 16.3), "lwir": (8.0, 14.0), "window": (10.5, 12.5)}


class Told(Silent):
    """Tells every step."""

    def step(self, what: str, detail: str = "") -> None:
        """Tell a step."""
        print(what, detail, flush=True)  # noqa: T201


def main() -> None:
    """Make the tables of the kind that is asked for."""
    activate()
    kind, work = sys.argv[1], Path(sys.argv[2])
    work.mkdir(parents=True, exist_ok=True)
    months = np.array([float(m) for m in sys.argv[3].split(",")]) if len(sys.argv) > 3 else MONTHS
    if kind == "thermal":
        some = [Band(name=name, kind="thermal", lo_um=lo, hi_um=hi) for name, (lo, hi) in THERMAL.items()]
        tables = thermal_table(some, work, Told(), months)
        names = list(THERMAL)
    else:
        shipped = {name: load_camera(camera).band for name, camera in SOLAR.items()}
        some = [next(band for band in found if band.name == name) for name, found in shipped.items()]
        tables = sunlit_table(some, work, Told())
        names = list(SOLAR)
    templates.FOLDER.mkdir(exist_ok=True)
    for name, table in zip(names, tables, strict=True):
        table.save(templates.FOLDER / f"limb-{name}.npz")


if __name__ == "__main__":
    main()
