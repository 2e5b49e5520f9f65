"""Thermal radiance through a climate that varies with latitude, over WGS84, by brute force: numpy, 10 m steps.

The blend of climates is written down here once more, from its description: tropical air at 15 deg, midlatitude at 45,
subarctic at 60, between them ``x^2 (3 - 2 x)``, beyond them the last; summer's share ``(1 + cos(2 pi (month - 7) / 12))
/ 2`` in the north, half a year later in the south; temperatures and logarithms of densities and mixing ratios are
blended. Poleward of 68 deg, and by ``x^2 (3 - 2 x)`` from 55 on, in the south all year and in the north by winter's
share ``(1 + cos(2 pi (month - 1) / 12)) / 2``, the temperature below 8 km is that of the zonal table, above 12 km the
blend's; the air's density and relative humidity stay. What such air absorbs is the product's look-up, which is judged
elsewhere (by the compiled original's check
states and the six climates' published tables). Here it is made at 801 sines of latitude, four times as close as the
product's rows, and at levels 20 m apart where it jumps, and read between them by lines in its logarithm. Everything
else is by itself.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from emission_reference import Band

from horizonval.earth.gases import rrtmg

A_M, B_M = 6378137.0, 6378137.0 * (1 - 1 / 298.257223563)
TOP_M = 100e3
STEP_M = 10.0
BATCH = 20_000
LATITUDES, SEAM_STEP_M = 801, 20.0
LOOKUP = Path(rrtmg.__file__).parents[1] / "data" / "rrtmg_lw.npz"
ZONAL = LOOKUP.with_name("zonal_temperature.npz")
CLIMATES = ("tropical", "midlatitude_summer", "midlatitude_winter", "subarctic_summer", "subarctic_winter")


def geodetic(point_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return height [m] and latitude of points (n, 3), Bowring's formula: a millimetre below 1000 km."""
    p, z = np.hypot(point_m[:, 0], point_m[:, 1]), point_m[:, 2]
    beta = np.arctan2(z * A_M, p * B_M)
    e2, ep2 = 1 - (B_M / A_M) ** 2, (A_M / B_M) ** 2 - 1
    latitude = np.arctan2(z + ep2 * B_M * np.sin(beta) ** 3, p - e2 * A_M * np.cos(beta) ** 3)
    sine = np.sin(latitude)
    return p * np.cos(latitude) + z * sine - A_M * np.sqrt(1 - e2 * sine**2), latitude


def position(latitude_deg: float, longitude_deg: float, height_m: float) -> np.ndarray:
    """Return a place, geodetic."""
    latitude, longitude = np.radians([latitude_deg, longitude_deg])
    e2 = 1 - (B_M / A_M) ** 2
    n = A_M / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
    around = (n + height_m) * np.cos(latitude)
    return np.array(
        [around * np.cos(longitude), around * np.sin(longitude), (n * (1 - e2) + height_m) * np.sin(latitude)]
    )


def look(observer_m: np.ndarray, azimuth_deg: float, depression_rad: float) -> np.ndarray:
    """Return a direction: azimuth from north through east, depression below the observer's horizontal."""
    _, latitude = geodetic(observer_m[None, :])
    longitude = np.arctan2(observer_m[1], observer_m[0])
    sin_lat, cos_lat = float(np.sin(latitude[0])), float(np.cos(latitude[0]))
    sin_lon, cos_lon = np.sin(longitude), np.cos(longitude)
    north = np.array([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat])
    east = np.array([-sin_lon, cos_lon, 0.0])
    up = np.array([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat])
    a = np.radians(azimuth_deg)
    flat = np.cos(a) * north + np.sin(a) * east
    return np.asarray(np.cos(depression_rad) * flat - np.sin(depression_rad) * up)


def lowest_m(observer_m: np.ndarray, direction: np.ndarray) -> float:
    """Return the lowest geodetic height of a line; below zero inside the Earth."""
    middle = -float(observer_m @ direction)
    for reach in (3e5, 3e3, 30.0):
        s = middle + np.linspace(-reach, reach, 601)
        height, _ = geodetic(observer_m + s[:, None] * direction)
        middle = float(s[np.argmin(height)])
    return float(height.min())


def aim(observer_m: np.ndarray, azimuth_deg: float, height_m: float) -> np.ndarray:
    """Return the direction whose line has this lowest height, to 1 cm."""
    lo, hi = 0.0, np.pi / 2 - 0.05
    while hi - lo > 1e-9:
        middle = (lo + hi) / 2
        below = lowest_m(observer_m, look(observer_m, azimuth_deg, middle)) < height_m
        lo, hi = (lo, middle) if below else (middle, hi)
    return look(observer_m, azimuth_deg, lo)


def shares(latitude: np.ndarray, month: float) -> np.ndarray:
    """Return the weights of :data:`CLIMATES` at latitudes (n,), shape (n, 5)."""
    degrees = np.abs(np.degrees(latitude))
    x, y = np.clip((degrees - 15) / 30, 0, 1), np.clip((degrees - 45) / 15, 0, 1)
    x, y = x * x * (3 - 2 * x), y * y * (3 - 2 * y)
    summer = (1 + np.cos(2 * np.pi * (month - 7) / 12) * np.where(latitude >= 0, 1, -1)) / 2
    middle, north = x * (1 - y), y
    return np.stack([1 - x, middle * summer, middle * (1 - summer), north * summer, north * (1 - summer)], axis=1)


def _saturation_pa(t: np.ndarray) -> np.ndarray:
    """Return the pressure of saturated vapour: Murphy and Koop's eq. 7 over ice, Magnus' with Sonntag's constants."""
    ice = np.exp(9.550426 - 5723.265 / t + 3.53068 * np.log(t) - 0.00728332 * t)
    water = 611.2 * np.exp(17.62 * (t - 273.15) / (t - 273.15 + 243.12))
    return np.where(t < 273.15, ice, water)


class Climate:
    """A top hat through the blend of a month."""

    def __init__(self, lo_um: float, hi_um: float, month: float, co2_ppm: int = 420) -> None:
        self.band = Band(CLIMATES[0], lo_um, hi_um, filled=True)
        near = np.arange(14e3, 18e3, SEAM_STEP_M)
        self.level_m = np.union1d(self.band.level_m, near)
        weight = shares(np.arcsin(np.linspace(-1, 1, LATITUDES)), month)
        with np.load(LOOKUP, allow_pickle=False) as file:
            t = {
                name: np.array(file[name], dtype=np.float64)
                for name in file.files
                if name.startswith("afgl_") and "atm" not in name
            }
            order = [[str(n) for n in file["afgl_atmosphere"]].index(c) for c in CLIMATES]
        z = t.pop("afgl_altitude_m")

        def blend(rows: np.ndarray) -> np.ndarray:
            rows = rows[order] if rows.ndim == 2 else np.tile(rows, (len(CLIMATES), 1))
            return weight @ np.stack([np.interp(self.level_m, z, row) for row in rows])

        self.temperature_k = blend(t["afgl_temperature_k"])
        of_climates = [np.interp(self.level_m, z, row) for row in t["afgl_temperature_k"][order]]
        # ln p is that of the blended density: sum of w ln(p / T), plus ln of the blended T.
        ln_p = blend(np.log(t["afgl_pressure_pa"])) - weight @ np.log(of_climates) + np.log(self.temperature_k)
        gases = {gas: np.exp(blend(np.log(t[f"afgl_{gas}_vmr"]))) for gas in ("h2o", "o3", "n2o", "ch4", "hno3")}
        gases["co2"] = np.exp(blend(np.log(t["afgl_co2_330ppm_vmr"]))) * co2_ppm / 330
        ln_p = self._over_poles(month, ln_p, gases)
        k = rrtmg.absorption_per_m(np.exp(ln_p), self.temperature_k, gases, self.band.places)
        self.ln_k = np.log(np.moveaxis(k.reshape(-1, *ln_p.shape), 0, 2))

    def _over_poles(self, month: float, ln_p: np.ndarray, gases: dict[str, np.ndarray]) -> np.ndarray:
        """Put cold air over the poles; return the logarithm of its pressure."""
        degrees = np.degrees(np.arcsin(np.linspace(-1, 1, LATITUDES)))
        x = np.clip((np.abs(degrees) - 55) / 13, 0, 1)
        polar = x * x * (3 - 2 * x) * np.where(degrees < 0, 1.0, (1 + np.cos(2 * np.pi * (month - 1) / 12)) / 2)
        share = polar[:, None] * np.clip((12e3 - self.level_m) / 4e3, 0, 1)
        with np.load(ZONAL, allow_pickle=False) as file:
            rows = [np.interp(self.level_m, file["altitude_m"], row) for row in file["temperature_k"][int(month) - 1]]
            table = np.array([np.interp(degrees, file["latitude_deg"], column) for column in np.array(rows).T]).T
        before = self.temperature_k
        self.temperature_k = before + share * (table - before)
        ln_p = ln_p + np.log(self.temperature_k / before)
        holds = _saturation_pa(self.temperature_k) / _saturation_pa(before)
        gases["h2o"] = gases["h2o"] * holds * (before / self.temperature_k)
        return ln_p

    def at(self, point_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return absorption [1/m] and source [W m-2 sr-1] at points (n, 3), shapes (n, g); vacuum above the top."""
        height, latitude = geodetic(point_m)
        z = np.clip(height, 0.0, TOP_M)
        i = np.clip(np.searchsorted(self.level_m, z, side="right") - 1, 0, len(self.level_m) - 2)
        w = (z - self.level_m[i]) / (self.level_m[i + 1] - self.level_m[i])
        place = (np.sin(latitude) + 1) / 2 * (LATITUDES - 1)
        j = np.clip(place.astype(int), 0, LATITUDES - 2)
        v = place - j

        def read(f: np.ndarray) -> np.ndarray:
            a, b = (w, v) if f.ndim == 2 else (w[:, None], v[:, None])
            return (1 - b) * ((1 - a) * f[j, i] + a * f[j, i + 1]) + b * ((1 - a) * f[j + 1, i] + a * f[j + 1, i + 1])

        k = np.where((height <= TOP_M)[:, None], np.exp(read(self.ln_k)), 0.0)
        return k, self.band.source(read(self.temperature_k))

    def radiance(self, observer_m: np.ndarray, direction: np.ndarray, ground_k: float, step_m: float = STEP_M) -> float:
        """Return the radiance [W m-2 sr-1] over a black ground, midpoints of equal steps, each isothermal."""
        start, end, hits = crossing(observer_m, direction)
        count = int(np.ceil((end - start) / step_m))
        step = (end - start) / count
        depth, total = np.zeros(self.ln_k.shape[2]), 0.0
        for first in range(0, count, BATCH):
            s = start + (np.arange(first, min(first + BATCH, count)) + 0.5) * step
            k, source = self.at(observer_m + s[:, None] * direction)
            tau = depth + np.cumsum(k * step, axis=0)
            before = np.concatenate([depth[None, :], tau[:-1]])
            total += float(np.sum(np.exp(-before) * -np.expm1(-k * step) * source))
            depth = tau[-1]
        if hits:
            total += float(np.sum(self.band.source(np.array([ground_k]))[0] * np.exp(-depth)))
        return total


def crossing(observer_m: np.ndarray, direction: np.ndarray) -> tuple[float, float, bool]:
    """Return where a ray enters the air, where it leaves it or meets the ground, and whether it does, to 0.1 mm."""
    middle = -float(observer_m @ direction)

    def height(s: float) -> float:
        return float(geodetic(observer_m[None, :] + s * direction[None, :])[0][0])

    def root(outside: float, inside: float, level: float) -> float:
        while abs(outside - inside) > 1e-4:
            between = (outside + inside) / 2
            outside, inside = (between, inside) if height(between) > level else (outside, between)
        return (outside + inside) / 2

    lowest = min(np.linspace(middle - 3e5, middle + 3e5, 601), key=height)
    start = root(0.0, lowest, TOP_M) if height(0.0) > TOP_M else 0.0
    if height(lowest) < 0.0:
        return start, root(start, lowest, 0.0), True
    return start, root(lowest + 4e6, lowest, TOP_M), False
