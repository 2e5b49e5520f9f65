"""Make ``limb_aerosol_*_montecarlo.csv``: the limb through air with particles, by ``monte_carlo.py``.

    python tests/physics/make_aerosol_limb.py haze day        (minutes)
    python tests/physics/make_aerosol_limb.py haze twilight
    python tests/physics/make_aerosol_limb.py volcanic day
    python tests/physics/make_aerosol_limb.py volcanic twilight

Rows that are there stay; delete the file to make all of them anew. ``PROCESSES`` sets how many rays run at a time.
"""

from __future__ import annotations

import json
import sys
import time
from functools import partial
from itertools import product
from typing import Any

import monte_carlo
import numpy as np
from reference_rays import DATA, fill, limb_ray, vector

HEIGHTS_KM = (2, 10, 20, 30, -1, -10, -100)
AZIMUTHS = (180, 90, 0)
ZENITHS = {"day": (30, 60, 85), "twilight": (90, 92, 95)}
GOAL = {"day": 2e-3, "twilight": 1e-2}
MAX_PATHS = {"day": 2_000_000, "twilight": 1_500_000}
ALTITUDE_KM = np.concatenate([np.arange(0, 30, 0.25), np.arange(30, 50, 0.5), np.arange(50, 101, 1.0)])


def layer(shape: np.ndarray, depth: float) -> np.ndarray:
    """Return a column [1/m] of a given shape and vertical optical depth."""
    return shape * depth / np.trapezoid(shape, 1e3 * ALTITUDE_KM)


def atmosphere(case: str) -> dict[str, Any]:
    """Return the content of an atmosphere file: Rayleigh at 550 nm and particles of asymmetry 0.7."""
    rayleigh = json.loads((DATA / "atm_rayleigh.json").read_text())
    z = np.array(rayleigh["altitude_km"])
    molecules = next(b for b in rayleigh["bands"] if b["name"] == "550nm")["scattering_per_m"]
    if case == "haze":
        note = "tau 0.15 of scale height 2 km and tau 0.01 at 20 km (Gauss, 1 km); single scattering albedo 0.95"
        particles = layer(np.exp(-ALTITUDE_KM / 2.0), 0.15)
        particles += layer(np.exp(-0.5 * (ALTITUDE_KM - 20.0) ** 2), 0.01)
        albedo = 0.95
    else:
        note = "tau 0.1 from 12 to 25 km, edges 1 km wide; single scattering albedo 0.99"
        particles = layer(np.interp(ALTITUDE_KM, [12, 13, 24, 25], [0, 1, 1, 0]), 0.1)
        albedo = 0.99
    return {
        "note": f"US Standard 1976 Rayleigh scattering, albedo of the ground 0.3; particles: {note}.",
        "planet_radius_km": 6371.0,
        "top_km": 100.0,
        "altitude_km": ALTITUDE_KM.tolist(),
        "temperature_K": np.interp(ALTITUDE_KM, z, rayleigh["temperature_K"]).tolist(),
        "bands": [
            {
                "name": "550nm",
                "wavelength_nm": 550.0,
                "scattering_per_m": np.exp(np.interp(ALTITUDE_KM, z, np.log(molecules))).tolist(),
                "absorption_per_m": ((1.0 - albedo) * particles).tolist(),
                "phase": "rayleigh",
                "particle_scattering_per_m": (albedo * particles).tolist(),
                "asymmetry": 0.7,
            }
        ],
        "surface": rayleigh["surface"],
    }


def work(job: dict[str, Any], air: monte_carlo.Air, case: str, goal: float, most: int) -> dict[str, Any]:
    """Return a finished row."""
    start = time.perf_counter()
    seed = monte_carlo.seed_of(case, job)
    answer = monte_carlo.radiance(
        air, vector(job, "obs"), vector(job, "dir"), vector(job, "sun"), 20_000, seed, se=goal, max_paths=most
    )
    print(
        f"{case} {job['sza']} {job['azimuth']} {job['tangent_km']}: {answer.total:.5g}, "
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


def main(case: str, when: str) -> None:
    """Make one table."""
    data = atmosphere(case)
    (DATA / f"atm_aerosol_{case}.json").write_text(json.dumps(data) + "\n")
    air = monte_carlo.air_of(data, data["bands"][0])
    jobs = [limb_ray(*ray) for ray in product(ZENITHS[when], AZIMUTHS, HEIGHTS_KM)]
    one = partial(work, air=air, case=case, goal=GOAL[when], most=MAX_PATHS[when])
    fill(DATA / f"limb_aerosol_{case}_{when}_montecarlo.csv", jobs, ("sza", "azimuth", "tangent_km"), one)


if __name__ == "__main__":
    main(*sys.argv[1:])
