"""Make ``horizonval/earth/data/land_map.npz`` from Natural Earth's land polygons, scale 1:50 million.

Run once, by hand::

    npm pack world-atlas@2.0.2 && tar xzf world-atlas-2.0.2.tgz
    python tests/data/make_land_map.py package/land-50m.json horizonval/earth/data/land_map.npz

A cell of 0.25 degrees is land where its centre lies inside a polygon (even-odd rule in the plane of longitude and
latitude). Rows from south to north, columns eastward from 180 W; eight cells a byte, the first in the lowest bit.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

ROWS, COLUMNS = 720, 1440


def rings(topology: dict) -> list[np.ndarray]:
    """Return the closed rings of every polygon, each of shape (n, 2): longitude and latitude [deg].

    A ring across the date line goes on beyond 180 degrees; the one around the south pole is closed there.
    """
    scale, translate = (np.array(topology["transform"][k]) for k in ("scale", "translate"))
    arcs = [np.cumsum(np.array(arc), axis=0) * scale + translate for arc in topology["arcs"]]
    found = []
    for geometry in topology["objects"]["land"]["geometries"]:
        polygons = geometry["arcs"] if geometry["type"] == "MultiPolygon" else [geometry["arcs"]]
        for polygon in polygons:
            for ring in polygon:
                points = np.concatenate([arcs[i] if i >= 0 else arcs[~i][::-1] for i in ring])
                points[:, 0] = np.unwrap(points[:, 0], period=360.0)
                if abs(points[-1, 0] - points[0, 0]) > 180.0:
                    pole = [[points[-1, 0], -90.0], [points[0, 0], -90.0], points[0]]
                    points = np.concatenate([points, pole])
                found.append(points)
    return found


def rasterised(outlines: list[np.ndarray]) -> np.ndarray:
    """Return land as booleans, shape (ROWS, COLUMNS)."""
    start = np.concatenate([ring[:-1] for ring in outlines])
    end = np.concatenate([ring[1:] for ring in outlines])
    centres = (np.arange(COLUMNS) + 0.5) * 360.0 / COLUMNS - 180.0
    land = np.zeros((ROWS, COLUMNS), dtype=bool)
    for row in range(ROWS):
        latitude = (row + 0.5) * 180.0 / ROWS - 90.0
        crossing = (start[:, 1] <= latitude) != (end[:, 1] <= latitude)
        a, b = start[crossing], end[crossing]
        at = np.sort(a[:, 0] + (latitude - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]))
        # rings that were carried beyond the date line cover the places a turn away too
        land[row] = sum(np.searchsorted(at, centres + turn) for turn in (-360.0, 0.0, 360.0)) % 2 == 1
    return land


if __name__ == "__main__":
    source, target = (Path(p) for p in sys.argv[1:])
    land = rasterised(rings(json.loads(source.read_text())))
    np.savez_compressed(target, land=np.packbits(land, axis=1, bitorder="little"))
