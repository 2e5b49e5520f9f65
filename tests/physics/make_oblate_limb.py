"""Make ``limb_oblate_montecarlo_550nm.csv``: the limb of the WGS84 ellipsoid, by ``monte_carlo.py``.

    python tests/physics/make_oblate_limb.py

The air of ``atm_rayleigh.json`` with its heights geodetic; an observer 500 km above latitude 45 deg, longitude 0, looks
north, south and east; the Sun has its zenith angle at the ray's lowest point, 60 deg beside the direction of view. Axes
as ITRS: z polar. Rows that are there stay.
"""

from __future__ import annotations

import time
from functools import partial
from itertools import product
from typing import Any

import monte_carlo
import numpy as np
from reference_rays import DATA, VECTORS, fill, vector

AXES_KM = (6378.137, 6378.137 * (1.0 - 1.0 / 298.257223563))
LATITUDE_DEG, OBSERVER_KM, SUN_BESIDE_DEG = 45.0, 500.0, 60.0
VIEWS = {"north": 0.0, "south": 180.0, "east": 90.0}
HEIGHTS_KM = (2, 5, 10, 20, 30, 40)
GOAL = {60: 2e-3, 88: 4e-3}


def oblate_ray(air: monte_carlo.Air, view: str, height_km: float, sza_deg: float) -> dict[str, Any]:
    """Return a row; the ray's lowest geodetic height is found by halving the angle of view."""
    latitude = np.radians(LATITUDE_DEG)
    up = np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    north, east = np.array([-np.sin(latitude), 0.0, np.cos(latitude)]), np.array([0.0, 1.0, 0.0])
    curvature = AXES_KM[0] / np.sqrt(1.0 - (1.0 - (AXES_KM[1] / AXES_KM[0]) ** 2) * np.sin(latitude) ** 2)
    observer = (curvature + OBSERVER_KM) * up
    observer[2] = (curvature * (AXES_KM[1] / AXES_KM[0]) ** 2 + OBSERVER_KM) * np.sin(latitude)
    azimuth = np.radians(VIEWS[view])
    level = np.cos(azimuth) * north + np.sin(azimuth) * east

    def lowest(dip: float) -> tuple[float, np.ndarray, np.ndarray]:
        direction = np.cos(dip) * level - np.sin(dip) * up

        def height(t: float) -> float:
            return float(monte_carlo._height(air, *(observer + t * direction)))

        lo, hi = 1000.0, 4500.0
        for _ in range(100):
            a, b = lo + (hi - lo) / 3.0, hi - (hi - lo) / 3.0
            lo, hi = (lo, b) if height(a) < height(b) else (a, hi)
        return height(0.5 * (lo + hi)), observer + 0.5 * (lo + hi) * direction, direction

    lo, hi = np.radians(15.0), np.radians(25.0)
    for _ in range(60):
        dip = 0.5 * (lo + hi)
        lo, hi = (dip, hi) if lowest(dip)[0] > height_km else (lo, dip)
    _, point, direction = lowest(0.5 * (lo + hi))
    vertical = monte_carlo._up(air, point)
    z, beside = np.radians([sza_deg, SUN_BESIDE_DEG])
    sun = np.cos(z) * vertical
    sun += np.sin(z) * (np.cos(beside) * direction + np.sin(beside) * np.cross(vertical, direction))
    numbers = [*(round(float(x), 9) for x in observer), *(round(float(x), 15) + 0.0 for x in (*direction, *sun))]
    return {"view": view, "sza": sza_deg, "tangent_km": height_km, **dict(zip(VECTORS, numbers, strict=True))}


def work(job: dict[str, Any], air: monte_carlo.Air) -> dict[str, Any]:
    """Return a finished row."""
    start = time.perf_counter()
    answer = monte_carlo.radiance(
        air,
        vector(job, "obs"),
        vector(job, "dir"),
        vector(job, "sun"),
        20_000,
        monte_carlo.seed_of("oblate", job),
        monte_carlo.Plan(),
        se=GOAL[job["sza"]],
        max_paths=1_000_000,
    )
    print(
        f"{job['view']} {job['sza']} {job['tangent_km']}: {answer.total:.5g}, "
        f"se {100 * answer.multiple_se / answer.total:.2f} %, {answer.n_paths} paths, "
        f"{time.perf_counter() - start:.0f} s",
        flush=True,
    )
    return {
        **job,
        "radiance_550nm": f"{answer.total:.6g}",
        "se": f"{answer.multiple_se:.2g}",
        "single_550nm": f"{answer.single_exact:.6g}",
        "n_paths": answer.n_paths,
    }


def main() -> None:
    """Make the table."""
    air = monte_carlo.read_air(DATA / "atm_rayleigh.json", "550nm", axes_km=AXES_KM)
    jobs = [oblate_ray(air, view, height, sza) for sza, height, view in product(GOAL, HEIGHTS_KM, VIEWS)]
    key = ("view", "sza", "tangent_km")
    fill(DATA / "limb_oblate_montecarlo_550nm.csv", jobs, key, partial(work, air=air))


if __name__ == "__main__":
    main()
