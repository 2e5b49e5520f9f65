"""Make ``limb_hazy_twilight_montecarlo.csv``: the limb through LOWTRAN7's particles with the Sun set, by Monte Carlo.

    python tests/physics/make_hazy_twilight.py        (an hour)

Rows that are there stay; delete the file to make all of them anew. ``PROCESSES`` sets how many rays run at a time.

The columns of air are in ``hazy_columns.npz``: US standard air with ozone at 450 and 850 nm, as scenes had it when they
were written, and the particles of two models. How light goes through them is ``monte_carlo.py``'s alone.
"""

from __future__ import annotations

import time
from functools import cache
from itertools import product
from typing import Any

import monte_carlo
import numpy as np
from reference_rays import DATA, fill, limb_ray, vector

from horizonval.earth.column import OpticalModel, SpectralNode

TABLE, COLUMNS = DATA / "limb_hazy_twilight_montecarlo.csv", DATA / "hazy_columns.npz"
MODELS = ("background", "volcanic_high")
WAVELENGTHS_NM = (450, 850)
DEPRESSIONS_DEG = (5, 8, 10, 12)
AZIMUTHS = (180, 0, 90)
HEIGHTS_KM = (20, 40, 10)
ALBEDO = 0.3
GOAL = 0.01
MAX_PATHS = 300_000


@cache
def model_of(aerosol: str) -> OpticalModel:
    """Return the columns with a model of particles, a node per wavelength, named after it; the irradiance is 1."""
    with np.load(COLUMNS) as data:
        z = data["altitude_m"]
        nodes = [
            SpectralNode(
                name=str(w),
                band=str(w),
                weight=1.0,
                wavelength_um=1e-3 * w,
                extinction_per_m=data[f"{aerosol}_{w}_extinction_per_m"],
                molecular_per_m=data[f"{aerosol}_{w}_molecular_per_m"],
                molecular_cos2=float(data[f"{aerosol}_{w}_cos2"]),
                particle_per_m=data[f"{aerosol}_{w}_particle_per_m"],
                asymmetry=data[f"{aerosol}_{w}_asymmetry"],
                solar_irradiance=1.0,
                sun_radiance=0.0,
            )
            for w in WAVELENGTHS_NM
        ]
    return OpticalModel(altitude_m=z, top_m=float(z[-1]), nodes=tuple(nodes), albedo=ALBEDO)


@cache
def air_of(aerosol: str, wavelength_nm: int) -> monte_carlo.Air:
    """Return the column of a wavelength as the Monte Carlo has it."""
    model = model_of(aerosol)
    node = next(n for n in model.nodes if n.band == str(wavelength_nm))
    return monte_carlo.make_air(
        1e-3 * model.altitude_m,
        1e3 * node.molecular_per_m,
        1e3 * (node.extinction_per_m - node.scattering_per_m),
        [(1e3 * node.particle_per_m, node.asymmetry)],
        cos2=node.molecular_cos2,
        ground=monte_carlo.uniform(ALBEDO),
    )


def work(job: dict[str, Any]) -> dict[str, Any]:
    """Return a finished row."""
    start = time.perf_counter()
    answer = monte_carlo.radiance(
        air_of(job["aerosol"], job["wavelength_nm"]),
        vector(job, "obs"),
        vector(job, "dir"),
        vector(job, "sun"),
        20_000,
        monte_carlo.seed_of("hazy twilight", job),
        se=GOAL,
        max_paths=MAX_PATHS,
    )
    name = " ".join(str(job[key]) for key in KEY)
    share = answer.multiple_se / answer.total
    print(f"{name}: {answer.total:.4g}, se {share:.2%}, {answer.n_paths} paths, {time.perf_counter() - start:.0f} s",
          flush=True)  # fmt: skip
    return {**job, "radiance": f"{answer.total:.6g}", "se": f"{answer.multiple_se:.2g}"}


KEY = ("aerosol", "wavelength_nm", "sza", "azimuth", "tangent_km")


def jobs() -> list[dict[str, Any]]:
    """Return all rays of the table, the cheap ones first."""
    rays = product(AZIMUTHS, HEIGHTS_KM, DEPRESSIONS_DEG, MODELS, WAVELENGTHS_NM)
    return [
        {"aerosol": name, "wavelength_nm": wavelength} | limb_ray(90.0 + depression, azimuth, height)
        for azimuth, height, depression, name, wavelength in rays
    ]


if __name__ == "__main__":
    fill(TABLE, jobs(), KEY, work)
