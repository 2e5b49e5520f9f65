"""Rays of the limb reference tables, and how ``make_tables.py`` writes its tables.

An observer 500 km above the ground looks past it; the ray's lowest point (the point where it meets the ground) lies on
the z axis, where the Sun has its zenith angle, and azimuth 0 looks towards the Sun. Heights below zero are impact
parameters minus the planet's radius, of rays that meet the ground.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import atomic

DATA = Path(__file__).parents[1] / "data"
RADIUS_KM = 6371.0
OBSERVER_KM = 500.0
VECTORS = tuple(f"{name}_{axis}{unit}" for name, unit in (("obs", "_km"), ("dir", ""), ("sun", "")) for axis in "xyz")


def limb_ray(sza_deg: float, azimuth_deg: float, height_km: float) -> dict[str, Any]:
    """Return a row with the vectors of a ray, rounded as they are written."""
    distance = RADIUS_KM + OBSERVER_KM
    impact = RADIUS_KM + height_km
    if height_km < 0:
        sine = impact / RADIUS_KM
        cosine = np.sqrt(1.0 - sine**2)
        along = np.sqrt(distance**2 - impact**2) - RADIUS_KM * cosine
        direction = np.array([sine, 0.0, -cosine])
        observer = np.array([0.0, 0.0, RADIUS_KM]) - along * direction
    else:
        direction = np.array([1.0, 0.0, 0.0])
        observer = np.array([-np.sqrt(distance**2 - impact**2), 0.0, impact])
    z, a = np.radians([sza_deg, azimuth_deg])
    sun = np.array([np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), np.cos(z)])
    values = [*(round(float(x), 9) for x in observer), *(round(float(x), 15) + 0.0 for x in (*direction, *sun))]
    kind = "ground" if height_km < 0 else "limb"
    ray = dict(zip(VECTORS, values, strict=True))
    return {"kind": kind, "sza": sza_deg, "azimuth": azimuth_deg, "tangent_km": height_km, **ray}


def vector(row: dict[str, Any], name: str) -> np.ndarray:
    """Return ``obs``, ``dir`` or ``sun`` of a row."""
    return np.array([float(row[key]) for key in VECTORS if key.startswith(name)])


class RayTable:
    """A table of rays: its columns as numbers, and the vectors of all rays."""

    def __init__(self, name: str) -> None:
        with (DATA / name).open(newline="") as file:
            self.rows = list(csv.DictReader(file))

    def __getitem__(self, key: str) -> np.ndarray:
        return np.array([float(row[key]) for row in self.rows])

    @property
    def vectors(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Observers [m], directions and directions to the Sun, shapes (n, 3)."""
        observer, direction, sun = (
            np.stack([vector(row, name) for row in self.rows]) for name in ("obs", "dir", "sun")
        )
        return 1e3 * observer, direction, sun


def fill(
    path: Path, jobs: Iterable[dict[str, Any]], key: tuple[str, ...], work: Callable[[dict[str, Any]], Any]
) -> None:
    """Compute the rows that a table lacks, one process per processor, and keep the table sorted as the jobs are.

    The table is rewritten after every row: a stopped run goes on where it was, and a half-made table can be read.
    """
    jobs = list(jobs)

    def name(row: dict[str, Any]) -> tuple[str, ...]:
        return tuple(str(row[k]) for k in key)

    done: dict[tuple[str, ...], dict[str, Any]] = {}
    if path.exists():
        with path.open(newline="") as file:
            done = {name(row): row for row in csv.DictReader(file)}
    todo = [job for job in jobs if name(job) not in done]
    with ProcessPoolExecutor(int(os.environ.get("PROCESSES", 0)) or os.cpu_count()) as pool:
        for future in as_completed([pool.submit(work, job) for job in todo]):
            row = future.result()
            done[name(row)] = row
            rows = [done[name(job)] for job in jobs if name(job) in done]
            with atomic.replacing(path) as temporary, temporary.open("w", newline="") as file:
                writer = csv.DictWriter(file, list(row), lineterminator="\n")
                writer.writeheader()
                writer.writerows(rows)
