"""Make ``limb_latitude_thermal.csv`` by :mod:`latitude_limb`: brute force, 10 m steps, 4 minutes of processor time.

    python tests/physics/make_latitude_limb.py

Seen from 900 km over four places, through the climate of a month by latitude, WGS84, black ground of 285 K.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from latitude_limb import Climate, aim, lowest_m, position
from reference_rays import DATA, fill

HEIGHT_M, GROUND_K = 900e3, 285.0
# latitude, longitude [deg], month
PLACES = ((52.0, 20.0, 2), (-20.0, 179.0, 7), (88.0, -60.0, 10), (-72.0, 60.0, 9))
AZIMUTHS_DEG = (0.0, 100.0, 200.0, 290.0)
HEIGHTS_KM = (-20.0, -1.0, 6.0, 16.0, 30.0, 45.0)
BANDS = {"co2": (14.0, 16.3), "window": (10.5, 12.5)}


@cache
def climate(lo_um: float, hi_um: float, month: int) -> Climate:
    """Return a band through a month's air, looked up once."""
    return Climate(lo_um, hi_um, month)


def row_of(job: dict[str, Any]) -> dict[str, Any]:
    """Return one row."""
    observer = position(job["latitude_deg"], job["longitude_deg"], HEIGHT_M)
    direction = aim(observer, job["azimuth_deg"], 1e3 * job["height_km"])
    row = dict(job)
    row["lowest_km"] = round(lowest_m(observer, direction) / 1e3, 4)
    row |= {f"obs_{axis}_m": f"{x:.4f}" for axis, x in zip("xyz", observer, strict=True)}
    row |= {f"dir_{axis}": f"{x:.15f}" for axis, x in zip("xyz", direction, strict=True)}
    for name, (lo, hi) in BANDS.items():
        row[f"radiance_{name}"] = f"{climate(lo, hi, job['month']).radiance(observer, direction, GROUND_K):.7g}"
    return row


def main() -> None:
    """Make the table."""
    jobs = [
        {"latitude_deg": lat, "longitude_deg": lon, "month": month, "azimuth_deg": azimuth, "height_km": height}
        for lat, lon, month in PLACES
        for azimuth in AZIMUTHS_DEG
        for height in HEIGHTS_KM
    ]
    keys = ("latitude_deg", "longitude_deg", "month", "azimuth_deg", "height_km")
    fill(DATA / "limb_latitude_thermal.csv", jobs, keys, row_of)


if __name__ == "__main__":
    main()
