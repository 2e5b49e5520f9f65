"""Make ``varied_ground_montecarlo_550nm.csv``: rays over chequered grounds, by ``monte_carlo.py``.

Rayleigh air of ``atm_rayleigh.json``; squares of two albedos; places and directions drawn from a seed. Squares of
20 000 km are halves of the globe that meet at the meridian 0. Standard errors are below 0.4 % but for a few limb rays.
Takes a minute.
"""

from __future__ import annotations

from typing import Any

import monte_carlo
import numpy as np
from reference_rays import DATA, fill
from varied_ground import BRIGHT, DARK, nadir_angle_deg, vectors_of

PLACES = {50.0: (3.0, 5.0), 100.0: (21.0, -33.0), 300.0: (3.0, 5.0), 1000.0: (21.0, -33.0), 20_000.0: (40.0, 2.0)}
KEY = ("square_km", "sza_deg", "view", "number")
PATHS, MOST_PATHS, GOAL = 12_800, 200_000, 0.003


def jobs() -> list[dict[str, Any]]:
    """Return the rays."""
    rng = np.random.default_rng(20)
    out = []
    for square_km, (latitude, longitude) in PLACES.items():
        for sza in (20.0, 60.0):
            for view in ("disc", "limb"):
                for number in range(8):
                    angle = rng.uniform(0.0, 62.0) if view == "disc" else nadir_angle_deg(rng.uniform(2.0, 45.0))
                    place = {"latitude_deg": latitude, "longitude_deg": longitude}
                    look = {"nadir_deg": round(angle, 6), "azimuth_deg": round(rng.uniform(0.0, 360.0), 6)}
                    names = dict(zip(KEY, (square_km, sza, view, number), strict=True))
                    out.append(names | place | look)
    return out


def work(job: dict[str, Any]) -> dict[str, Any]:
    """Return the row of a ray."""
    ground = monte_carlo.chequered(job["square_km"], BRIGHT, DARK)
    air = monte_carlo.read_air(DATA / "atm_rayleigh.json", "550nm")._replace(ground=ground)
    seed = monte_carlo.seed_of("varied ground", job)
    answer = monte_carlo.radiance(air, *vectors_of(job), PATHS, seed, se=GOAL, max_paths=MOST_PATHS)
    return job | {"total_per_sr": f"{answer.total:.6e}", "se_per_sr": f"{answer.multiple_se:.2e}"}


if __name__ == "__main__":
    fill(DATA / "varied_ground_montecarlo_550nm.csv", jobs(), KEY, work)
