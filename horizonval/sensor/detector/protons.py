"""Protons of the South Atlantic anomaly: streaks across the image.

Through a plane array passes half the omnidirectional flux J per area; the angle theta between track and normal of
those that pass has the density ``2 cos(theta) sin(theta)``. A track through the layer of depth h that collects charge
is ``h / cos(theta)`` long and covers ``h tan(theta)`` of the image; it frees ``charge_e_per_um`` per length, times a
factor of mean one and log-normal spread of one half for the protons' different energies. 400 electrons per um belong
to some 90 MeV in silicon (stopping power 6.3 MeV cm2/g at 3.65 eV per pair; NIST PSTAR).

The anomaly is a bump over 26 S, 49 W, 12 deg of latitude and 24 deg of longitude wide (one sigma): place and size of
the maps of E. J. Daly et al. (IEEE Trans. Nucl. Sci. 43, 403 (1996)) at 500 to 800 km, in round numbers.

Neglected: electrons and heavy ions, secondaries, diffusion of the charge to neighbours, lasting damage.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray

CENTRE_LATITUDE_DEG, CENTRE_LONGITUDE_DEG = -26.0, -49.0
WIDTH_LATITUDE_DEG, WIDTH_LONGITUDE_DEG = 12.0, 24.0
SPREAD = 0.5
POINTS_PER_PX = 4
LONGEST_PX = 400.0
"""Of a streak; one track in 1e4 would be longer at 5 um depth and 2 um pitch."""
_TRACKS_AT_ONCE = 100_000


def anomaly(latitude_deg: float, longitude_deg: float) -> float:
    """Return the flux relative to that in the middle of the anomaly."""
    east = (longitude_deg - CENTRE_LONGITUDE_DEG + 180.0) % 360.0 - 180.0
    north = latitude_deg - CENTRE_LATITUDE_DEG
    return float(np.exp(-0.5 * ((north / WIDTH_LATITUDE_DEG) ** 2 + (east / WIDTH_LONGITUDE_DEG) ** 2)))


def mean_hits(flux_per_cm2_s: float, shape: tuple[int, int], pitch_um: float, seconds: float) -> float:
    """Return how many protons cross the array on average."""
    area_cm2 = shape[0] * shape[1] * (pitch_um * 1e-4) ** 2
    return 0.5 * flux_per_cm2_s * area_cm2 * seconds


def streaks_e(
    hits: float,
    shape: tuple[int, int],
    pitch_um: float,
    depth_um: float,
    charge_e_per_um: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the electrons that protons leave in the pixels, shape (H, W), for a mean number of ``hits``."""
    out = np.zeros(shape)
    n = int(rng.poisson(hits))
    if n == 0:
        return out
    cosine = np.sqrt(1.0 - rng.random(n))
    azimuth, energy = rng.uniform(0.0, 2.0 * np.pi, n), np.exp(SPREAD * rng.standard_normal(n) - 0.5 * SPREAD**2)
    start = rng.random((n, 2)) * shape - 0.5
    length = np.minimum(depth_um / pitch_um * np.sqrt(1.0 / cosine**2 - 1.0), LONGEST_PX)
    charge = charge_e_per_um * energy * np.hypot(length * pitch_um, depth_um)
    step = length[:, None] * np.stack([np.sin(azimuth), np.cos(azimuth)], axis=1)
    for first in range(0, n, _TRACKS_AT_ONCE):
        some = slice(first, first + _TRACKS_AT_ONCE)
        _draw(out, start[some], step[some], charge[some])
    return out


def _draw(out: FloatArray, start: FloatArray, step: FloatArray, charge: FloatArray) -> None:
    """Add the charge of tracks, evenly along them; places and steps as rows and columns, shape (n, 2)."""
    points = np.ceil(POINTS_PER_PX * np.hypot(step[:, 0], step[:, 1])).astype(int) + 1
    track = np.repeat(np.arange(len(points)), points)
    along = (np.arange(points.sum()) - np.repeat(np.cumsum(points) - points, points) + 0.5) / points[track]
    row, column = np.rint(start[track] + along[:, None] * step[track]).astype(int).T
    inside = (row >= 0) & (row < out.shape[0]) & (column >= 0) & (column < out.shape[1])
    np.add.at(out, (row[inside], column[inside]), (charge / points)[track][inside])
