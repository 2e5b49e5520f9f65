"""Make ``grey_limb_thermal_10um.csv`` and ``thermal_ck_sasktran2.csv`` (SASKTRAN2, 100 m shells, a second).

    python tests/physics/make_emission_limb.py

The first: the absorbers of ``atm_grey_15um.json`` at 10 um over a black ground of 300 K. The second: the shipped
absorption table, 16 g points of three bands in two climates, each as if monochromatic with the Planck function at the
middle of its band, over a black ground as warm as the lowest air. Absorption is taken from the table log-linearly at
the shells and is linear between them.
"""

from __future__ import annotations

import csv
import json
from typing import Any

import numpy as np
from emission_reference import BAND_EDGES_PER_CM, Band
from numpy.typing import NDArray
from reference_rays import DATA, RADIUS_KM

SHELLS_M: NDArray[np.float64] = np.linspace(0.0, 100e3, 1001)
HEIGHTS_KM = (0.5, 8.0, 16.0, 25.0, 40.0, 55.0, 70.0, 90.0, -1.0, -20.0)
CLIMATES = ("tropical", "subarctic_winter")
BANDS = ("band4", "band5", "band7")
GREY_HEIGHTS_KM = (0.25, 1, 4, 8, 12, 16, 20, 24, 28, 32, 36, 40, 46, 52, 60, 70, 80, 90, 98, -0.5, -5, -100)
GREY_GROUND_K = 300.0


def middle_um(band: str) -> float:
    """Return the wavelength in the middle (in wavenumber) of a band."""
    return 2e4 / sum(BAND_EDGES_PER_CM[band])


def absorption(climate: str, band: str) -> tuple[np.ndarray, np.ndarray]:
    """Return absorption [1/m] on the shells, shape (n, 16), and temperature, shape (n,)."""
    lo, hi = BAND_EDGES_PER_CM[band]
    table = Band(climate, 1e4 / hi, 1e4 / lo)
    return table.absorption(SHELLS_M), table.air_k(SHELLS_M)


def correlated_k(climate: str, band: str, heights_km: tuple[float, ...] = HEIGHTS_KM) -> np.ndarray:
    """Return radiances [W m-2 sr-1 um-1], shape (rays, 16)."""
    from sasktran_emission import sasktran_emission

    k, temperature = absorption(climate, band)
    ground_k = float(temperature[0])
    return sasktran_emission(
        SHELLS_M, k, temperature, middle_um(band), heights_km, radius_km=RADIUS_KM, ground_k=ground_k
    )


def grey() -> np.ndarray:
    """Return radiances [W m-2 sr-1 um-1], shape (rays, opacities)."""
    from sasktran_emission import sasktran_emission

    data = json.loads((DATA / "atm_grey_15um.json").read_text())
    return sasktran_emission(
        1e3 * np.array(data["altitude_km"]),
        np.array([b["absorption_per_m"] for b in data["bands"]]).T,
        np.array(data["temperature_K"]),
        10.0,
        GREY_HEIGHTS_KM,
        radius_km=RADIUS_KM,
        ground_k=GREY_GROUND_K,
    )


def write(name: str, rows: list[dict[str, Any]]) -> None:
    """Write a table."""
    with (DATA / name).open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    """Make both files."""
    names = [b["name"] for b in json.loads((DATA / "atm_grey_15um.json").read_text())["bands"]]
    write(
        "grey_limb_thermal_10um.csv",
        [
            {"tangent_km": height} | {name: f"{x:.8g}" for name, x in zip(names, row, strict=True)}
            for height, row in zip(GREY_HEIGHTS_KM, grey(), strict=True)
        ],
    )
    write(
        "thermal_ck_sasktran2.csv",
        [
            {"climate": climate, "band": band, "tangent_km": height}
            | {f"g{g + 1:02d}": f"{x:.7g}" for g, x in enumerate(row)}
            for climate in CLIMATES
            for band in BANDS
            for height, row in zip(HEIGHTS_KM, correlated_k(climate, band), strict=True)
        ],
    )


if __name__ == "__main__":
    main()
