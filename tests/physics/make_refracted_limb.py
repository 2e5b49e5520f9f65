"""Make ``limb_refraction_sasktran2.csv`` and ``refractive_index_550nm.csv`` (SASKTRAN2; 4 minutes on a free processor).

    python tests/physics/make_refracted_limb.py

Single scattering of ``atm_rayleigh.json`` at 550 nm on 200 m shells, straight and with lines of sight and the Sun's
rays bent. The refractive index minus 1 is proportional to the air's scattering coefficient, 2.7782e-4 at the ground
(Peck and Reeder 1972, doi:10.1364/JOSA.62.000958, at 288.15 K and 101 325 Pa, which is the ground's air). Heights are
those of the unbent rays. Shells of 500 and 200 m give the ratio of bent to straight of 100 m shells to 7e-5 and 2e-5.
"""

from __future__ import annotations

import csv
import json

import numpy as np
from reference_rays import DATA, limb_ray
from sasktran_limb import sasktran_limb

HEIGHTS_KM = (2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 25, 30)
WAVENUMBER2 = 1.0 / 0.55**2  # [um-2]
REFRACTIVITY = 1e-8 * (8060.51 + 2480990.0 / (132.274 - WAVENUMBER2) + 17455.7 / (39.32957 - WAVENUMBER2))


def main() -> None:
    """Make both tables."""
    data = json.loads((DATA / "atm_rayleigh.json").read_text())
    z = np.array(data["altitude_km"])
    k = np.array(next(b for b in data["bands"] if b["name"] == "550nm")["scattering_per_m"])
    with (DATA / "refractive_index_550nm.csv").open("w", newline="") as file:
        file.write("altitude_km,refractivity\n")
        file.writelines(f"{a:g},{v:.12g}\n" for a, v in zip(z, REFRACTIVITY * k / k[0], strict=True))
    rows = []
    for sza in (30, 60, 75):
        rays = [(azimuth, height) for azimuth in (0, 90, 180) for height in HEIGHTS_KM]
        straight = sasktran_limb(data, ["550nm"], sza, rays, step_km=0.2, threads=2)[:, 0]
        index = (z, 1.0 + REFRACTIVITY * k / k[0])
        bent = sasktran_limb(data, ["550nm"], sza, rays, step_km=0.2, refractive_index=index, threads=2)[:, 0]
        for (azimuth, height), a, b in zip(rays, straight, bent, strict=True):
            rows.append(limb_ray(sza, azimuth, height) | {"straight_550nm": f"{a:.8g}", "refracted_550nm": f"{b:.8g}"})
    with (DATA / "limb_refraction_sasktran2.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
