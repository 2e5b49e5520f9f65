"""Rows of the SASKTRAN2 tables made anew, where SASKTRAN2 is installed: ``pip install ".[test,reference]"``, then
``pytest -m sasktran2``.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

DATA = Path(__file__).parents[1] / "data"
pytestmark = pytest.mark.sasktran2


def rows_at(name: str, sza: float) -> list[dict[str, str]]:
    with (DATA / name).open() as file:
        return [row for row in csv.DictReader(file) if float(row["sza"]) == sza]


@pytest.mark.parametrize("sza", [20, 60, 85])
def test_ozone_limb(sza: float) -> None:
    """Single scatter to 1e-5; every order with a coarser diffuse field to 1.5 %."""
    from sasktran import sasktran_limb

    data = json.loads((DATA / "atm_ozone.json").read_text())
    rows = rows_at("limb_ozone_sasktran2.csv", sza)[::6]
    rays = [(float(r["azimuth"]), float(r["tangent_km"])) for r in rows]
    bands = ["450nm", "550nm", "600nm"]
    for column, orders, tolerance in (("single", "single", 1e-5), ("radiance", "all", 1.5e-2)):
        ours = sasktran_limb(data, bands, sza, rays, orders=orders, points=110, num_sza=3)
        table = np.array([[float(r[f"{column}_{b}"]) for b in bands] for r in rows])
        np.testing.assert_allclose(ours, table, rtol=tolerance)


def test_refracted_limb() -> None:
    """On 500 m shells: either column to 2e-4, their ratio to 1e-4."""
    from sasktran import sasktran_limb

    data = json.loads((DATA / "atm_rayleigh.json").read_text())
    with (DATA / "refractive_index_550nm.csv").open() as file:
        profile = np.array([[float(x) for x in row.values()] for row in csv.DictReader(file)])
    rows = rows_at("limb_refraction_sasktran2.csv", 60.0)[::3]
    rays = [(float(r["azimuth"]), float(r["tangent_km"])) for r in rows]
    index = (profile[:, 0], 1.0 + profile[:, 1])
    straight = sasktran_limb(data, ["550nm"], 60.0, rays)[:, 0]
    bent = sasktran_limb(data, ["550nm"], 60.0, rays, refractive_index=index)[:, 0]
    table = np.array([[float(r["straight_550nm"]), float(r["refracted_550nm"])] for r in rows])
    np.testing.assert_allclose(np.stack([straight, bent], axis=1), table, rtol=2e-4)
    np.testing.assert_allclose(bent / straight, table[:, 1] / table[:, 0], rtol=1e-4)
