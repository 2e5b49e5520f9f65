"""Make ``atm_ozone.json`` and ``limb_ozone_sasktran2.csv`` (SASKTRAN2, successive orders).

    python tests/physics/make_ozone_limb.py [DIRECTIONS]

Rayleigh scattering without depolarisation and ozone's absorption, US standard atmosphere, given to SASKTRAN2 as plain
coefficients; 302 directions unless said otherwise, 5 Sun angles, the file's 500 m shells.
"""

from __future__ import annotations

import csv
import json
import sys
import time

from reference_rays import DATA, limb_ray
from sasktran_limb import sasktran_limb

from horizonval.earth.atmosphere_file import atmosphere_from_profile

WAVELENGTHS_NM = (450, 550, 600)
BANDS = [f"{w}nm" for w in WAVELENGTHS_NM]
HEIGHTS_KM = (1, 2, 4, 6, 8, 10, 12, 15, 20, 25, 30, 35, 40, 50, 60, 70, 80, 90, -1, -10, -100)
ZENITHS = (60, 20, 85)
RAYS = [(azimuth, height) for azimuth in (0, 90, 180) for height in HEIGHTS_KM]


def main(points: int = 302) -> None:
    """Make both files."""
    data = atmosphere_from_profile("us_standard", list(WAVELENGTHS_NM), use_ozone=True)
    for band in data["bands"]:
        for key in ("scattering_per_m", "absorption_per_m"):
            band[key] = [float(f"{x:.7g}") for x in band[key]]
    (DATA / "atm_ozone.json").write_text(json.dumps(data) + "\n")
    rows = []
    for sza in ZENITHS:
        start = time.perf_counter()
        single = sasktran_limb(data, BANDS, sza, RAYS)
        every = sasktran_limb(data, BANDS, sza, RAYS, orders="all", points=points)
        for (azimuth, height), one, all_of_them in zip(RAYS, single, every, strict=True):
            row = limb_ray(sza, azimuth, height)
            row |= {f"single_{b}": f"{x:.8g}" for b, x in zip(BANDS, one, strict=True)}
            row["directions"] = points
            row |= {f"radiance_{b}": f"{x:.8g}" for b, x in zip(BANDS, all_of_them, strict=True)}
            rows.append(row)
        print(f"SZA {sza}: {time.perf_counter() - start:.0f} s", flush=True)
        with (DATA / "limb_ozone_sasktran2.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:]))
