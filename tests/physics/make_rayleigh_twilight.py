"""Make ``limb_rayleigh_twilight_montecarlo.csv``: ``atm_rayleigh.json`` at 450 and 850 nm, Sun below the horizon.

    python tests/physics/make_rayleigh_twilight.py

By ``monte_carlo.py``; rows that are there stay.
"""

from __future__ import annotations

import time
from typing import Any

import monte_carlo
from reference_rays import DATA, fill, limb_ray, vector

RAYS = (
    (92, 0, 2), (92, 90, 10), (92, 180, 20), (92, 0, -1), (92, 90, -10),
    (95, 0, 10), (95, 90, 2), (95, 180, 10), (95, 90, 30), (95, 180, -10),
    (98, 0, 20), (98, 90, 20), (98, 180, 10),
    (100, 0, 30), (100, 90, 20), (100, 180, 20),
)  # fmt: skip


def work(job: dict[str, Any]) -> dict[str, Any]:
    """Return a finished row."""
    start = time.perf_counter()
    air = monte_carlo.read_air(DATA / "atm_rayleigh.json", f"{job['wavelength_nm']}nm")
    answer = monte_carlo.radiance(
        air,
        vector(job, "obs"),
        vector(job, "dir"),
        vector(job, "sun"),
        50_000,
        monte_carlo.seed_of("rayleigh twilight", job),
        se=1e-2,
        max_paths=1_500_000,
    )
    print(
        f"{job['wavelength_nm']} {job['sza']} {job['azimuth']} {job['tangent_km']}: {answer.total:.5g}, "
        f"se {100 * answer.multiple_se / answer.total:.2f} %, {answer.n_paths} paths, "
        f"{time.perf_counter() - start:.0f} s",
        flush=True,
    )
    return {
        **job,
        "radiance": f"{answer.total:.6g}",
        "se": f"{answer.multiple_se:.2g}",
        "single": f"{answer.single_exact:.6g}",
        "n_paths": answer.n_paths,
    }


def main() -> None:
    """Make the table."""
    jobs = [{"wavelength_nm": nm} | limb_ray(*ray) for nm in (450, 850) for ray in RAYS]
    key = ("wavelength_nm", "sza", "azimuth", "tangent_km")
    fill(DATA / "limb_rayleigh_twilight_montecarlo.csv", jobs, key, work)


if __name__ == "__main__":
    main()
