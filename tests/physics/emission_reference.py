"""Thermal emission along straight rays through a published absorption table, by itself: numpy and the table's file.

Nothing of the product is used: ``thermal_ck.npz`` has the absorption of six climates by others than the product's
look-up; own Planck function, own reading of the map from g points to wavenumber, own paths. Absorption is log-linear
and temperature linear between the table's
levels; the path is cut where it crosses a level and every piece into ``cells`` equal cells. In a cell the optical
depth is a three-point Gauss sum and the source is linear in it::

    L = sum over cells of exp(-tau) [S_near (1 - q) + S_far (q - exp(-d))],   q = (1 - exp(-d)) / d

With 8 cells a whole ray is within 2e-6 of 32 cells.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

FILE = Path(__file__).parents[1] / "data" / "thermal_ck.npz"
SEAM_PA = 100.0 * float(np.exp(4.56))
RADIUS_M = 6_371_230.0
"""Of the sphere on which the verification table was made."""

INTERVALS_UM = {
    "14.0-16.3um": (14.0, 16.3),
    "14.16-16.25um": (14.16, 16.25),
    "8-14um": (8.0, 14.0),
    "10.5-12.5um": (10.5, 12.5),
}
BAND_EDGES_PER_CM = {
    "band3": (500.0, 630.0),
    "band4": (630.0, 700.0),
    "band5": (700.0, 820.0),
    "band6": (820.0, 980.0),
    "band7": (980.0, 1080.0),
    "band8": (1080.0, 1180.0),
    "band9": (1180.0, 1390.0),
}
"""Whole bands of RRTMG-LW."""

H, C, K = 6.62607015e-34, 299792458.0, 1.380649e-23


def limits_um(interval: str) -> tuple[float, float]:
    """Return the wavelengths of an interval of the verification table."""
    if interval in INTERVALS_UM:
        return INTERVALS_UM[interval]
    lo, hi = BAND_EDGES_PER_CM[interval]
    return 1e4 / hi, 1e4 / lo


def planck_per_cm(nu_per_cm: np.ndarray, temperature_k: np.ndarray) -> np.ndarray:
    """Return B_nu [W m-2 sr-1 / cm-1]."""
    nu = 100.0 * nu_per_cm
    with np.errstate(over="ignore"):
        return 200.0 * H * C**2 * nu**3 / np.expm1(H * C * nu / (K * temperature_k))


@cache
def table() -> dict[str, np.ndarray]:
    """Return the arrays of the file."""
    with np.load(FILE, allow_pickle=False) as file:
        return {name: np.array(file[name]) for name in file.files}


class Band:
    """The g points of a top hat in one climate.

    ``places``: which of the table's bands. ``ln_k`` has shape (levels, g); ``source`` turns temperatures (n,) into
    (n, g), W m-2 sr-1. ``filled``: the shares of a bin are scaled so that the g points fill it exactly, as the product
    does (0.45 % of one bin in 820 to 980 cm-1,
    1e-7 elsewhere), and the published figures do not. ``seam``: at 95.58 hPa, where the tables change and k jumps, the
    lines through the two levels below and the two above are carried on to that height, in place of one line across.
    """

    def __init__(
        self, climate: str, lo_um: float, hi_um: float, co2_ppm: int = 420, *, filled: bool = False, seam: bool = False
    ) -> None:
        t = table()
        a = [str(name) for name in t["atmosphere"]].index(climate)
        key = {420: "absorption_per_m", 330: "absorption_co2_330ppm_per_m"}[co2_ppm]
        self.level_m = t["altitude_m"].astype(np.float64)
        self.temperature_k = t["temperature_k"][a].astype(np.float64)
        self.pressure_pa = t["pressure_pa"][a].astype(np.float64)
        self._seam = seam
        bins = t["bin_edges_per_cm"].astype(np.float64)
        lo, hi = np.maximum(bins[:, 0], 1e4 / hi_um), np.minimum(bins[:, 1], 1e4 / lo_um)
        covered = np.maximum(hi - lo, 0.0) / (bins[:, 1] - bins[:, 0])
        self.places: list[int] = []
        ln_k, nodes = [], []
        for b, (nu_lo, nu_hi) in enumerate(t["band_edges_per_cm"]):
            used = np.flatnonzero((t["bin_band_index"] == b) & (covered > 0.0))
            if used.size:
                self.places.append(b)
                ln_k.append(np.log(t[key][a, b].astype(np.float64)))
                weight = t["g_weight"] * (nu_hi - nu_lo) * t["gpoint_spectral_fraction"][used]
                if filled:
                    weight = weight * ((bins[used, 1] - bins[used, 0]) / weight.sum(axis=1))[:, None]
                weight = weight * covered[used, None]
                nodes.append(((lo[used] + hi[used]) / 2, weight))
        self.ln_k = np.concatenate(ln_k, axis=1)
        grid = np.arange(100.0, 361.0)
        self._grid = grid
        self._ln_source = np.log(
            np.concatenate([planck_per_cm(nu, grid[:, None]) @ weight for nu, weight in nodes], axis=1) + 1e-300
        )

    def source(self, temperature_k: np.ndarray) -> np.ndarray:
        """Cubic through the logarithm on a grid of 1 K (1e-9 of S)."""
        i = np.clip(np.floor(temperature_k - self._grid[0]).astype(int), 1, len(self._grid) - 3)
        x = (temperature_k - self._grid[i])[:, None]
        f = self._ln_source
        return np.exp(
            -x * (x - 1) * (x - 2) / 6 * f[i - 1]
            + (x + 1) * (x - 1) * (x - 2) / 2 * f[i]
            - (x + 1) * x * (x - 2) / 2 * f[i + 1]
            + (x + 1) * x * (x - 1) / 6 * f[i + 2]
        )

    def absorption(self, z_m: np.ndarray) -> np.ndarray:
        """Return k [1/m] at heights (n,), shape (n, g)."""
        i = np.clip(np.searchsorted(self.level_m, z_m, side="right") - 1, 0, len(self.level_m) - 2)
        if self._seam:
            j = int(np.searchsorted(-self.pressure_pa, -SEAM_PA)) - 1
            seam_m = np.interp(-np.log(SEAM_PA), -np.log(self.pressure_pa), self.level_m)
            i = np.where(i == j, np.where(z_m < seam_m, j - 1, j + 1), i)
        w = ((z_m - self.level_m[i]) / (self.level_m[i + 1] - self.level_m[i]))[:, None]
        return np.exp((1 - w) * self.ln_k[i] + w * self.ln_k[i + 1])

    def air_k(self, z_m: np.ndarray) -> np.ndarray:
        """Return the temperature at heights (n,)."""
        return np.interp(z_m, self.level_m, self.temperature_k)


def march(
    s_m: np.ndarray,
    height_m: Callable[[np.ndarray], np.ndarray],
    absorption: Callable[[np.ndarray], np.ndarray],
    source: Callable[[np.ndarray], np.ndarray],
    ground: np.ndarray | None,
) -> np.ndarray:
    """Return the radiance per g at the end ``s_m[0]`` of a path of cells ``s_m`` (n + 1,), shape (g,).

    ``height_m`` of a distance; ``absorption`` and ``source`` of a height, shapes (n, g); ``ground``: what shines at
    ``s_m[-1]``, shape (g,).
    """
    step, middle = np.abs(np.diff(s_m)), (s_m[1:] + s_m[:-1]) / 2
    reach = np.sqrt(0.15) * np.diff(s_m)
    depth = sum(
        share / 18 * absorption(height_m(middle + side * reach)) for share, side in ((5.0, -1), (8.0, 0), (5.0, 1))
    )
    depth = depth * step[:, None]
    tau = np.concatenate([np.zeros((1, depth.shape[1])), np.cumsum(depth, axis=0)])
    at = source(height_m(s_m))
    small = depth < 1e-4
    d = np.where(small, 1.0, depth)
    q = np.where(small, 1 - depth / 2 + depth**2 / 6, -np.expm1(-d) / d)
    gone = -np.expm1(-depth)
    near = np.where(small, depth / 2 - depth**2 / 6, 1 - q)
    # By difference the far end loses its figures where a cell is thin.
    far = np.where(small, depth / 2 - depth**2 / 3, gone - near)
    total = np.sum(np.exp(-tau[:-1]) * (at[:-1] * near + at[1:] * far), axis=0)
    return np.asarray(total if ground is None else total + ground * np.exp(-tau[-1]))


def radiance(
    band: Band, impact_m: float, radius_m: float = RADIUS_M, cells: int = 8, ground_k: float | None = None
) -> float:
    """Return the radiance [W m-2 sr-1] from outside along the ray of an impact parameter ``radius_m + impact_m``.

    Below the ground the ray ends on it: black, by default as warm as the lowest air.
    """
    b, r = radius_m + impact_m, radius_m + band.level_m
    crossing = np.sqrt(np.maximum(r**2 - b**2, 0.0)) if impact_m > 0 else np.sqrt((r - b) * (r + b))
    if impact_m > 0:
        half = np.concatenate([[0.0], crossing[r > b]])
        edges = np.concatenate([half[:0:-1], -half])
    else:
        edges = crossing[::-1]
    pieces = [np.linspace(edges[i], edges[i + 1], cells, endpoint=False) for i in range(len(edges) - 1)]
    s = np.concatenate([*pieces, edges[-1:]])

    def height(x: np.ndarray) -> np.ndarray:
        return (x**2 + b**2 - radius_m**2) / (np.hypot(x, b) + radius_m)

    ground = None
    if impact_m <= 0:
        ground = band.source(np.array([band.temperature_k[0] if ground_k is None else ground_k]))[0]
    return float(march(s, height, band.absorption, lambda z: band.source(band.air_k(z)), ground).sum())
