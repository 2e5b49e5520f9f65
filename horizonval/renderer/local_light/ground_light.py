r"""A map of the light that the ground around a camera sends up, blurred as the air above sees it.

Light scattered more than once is ``I = I_air + B F``: B is what a ground of reflected flux 1 adds to the field, the
same everywhere, and F the flux that ground and clouds send up, over that which falls on them. On a ground that varies
F is a map,

    F(x) = A(x) / (1 - s A_sky(x)),        A_sky = A weakened by the transfer function of the sky

with the albedo A, clouds at their place, and the spherical albedo s of the air; and the field at a point takes F
weakened by the transfer function of its height (:mod:`horizonval.renderer.scattering.horizontal_transfer`). What is
above a place hundreds of kilometres wide sees its own ground alone, what is above a chequered ground of smaller squares
their mean.

The map is Lambert's equal-area map of everything in sight, :data:`SIDE` cells a side, around the point below the
camera: 9 km a cell at 500 km, 20 km from the geostationary orbit. A cell is the mean of ``SAMPLES^2`` looks from
above. Convolutions are by Fourier transform; the map's edge lies beyond what lights anything in sight.

Neglected: that light falls more obliquely on one end of a footprint than on the other (some per cent of it per 100 km
where the Sun is low), cloud shadows on what is sent up, what goes to and fro between a thin cloud and the ground, and
that light sent up by a high cloud spreads less far.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.surface import surface
from horizonval.geometry.rotation import perpendicular
from horizonval.renderer.kernel.node_batches import Bounce
from horizonval.renderer.kernel.surface import Ground, shares_from_above
from horizonval.renderer.planet import Planet, dot
from horizonval.renderer.scattering.horizontal_transfer import LEVELS_M, WAVE_NUMBERS_PER_M, HorizontalTransfer
from horizonval.renderer.tables import gather_row, table_of
from horizonval.renderer.types import Vec, Vec3, constant, constant_vector

SIDE = 640
SAMPLES = 2
SHARPEST = 2.0
"""Finer cells and more looks (1280, 3) change rays over squares of 50 and 100 km by 1 % at most; with 512 cells they
are up to 4 % off. Between 2 and 4 SHARPEST makes no difference."""
LIT_AIR_M = 12e3
"""The map ends where air this high can still be seen."""
_COARSER = 4


@dataclass(frozen=True)
class GroundLight:
    """The maps of a batch: F as air at the levels sees it, shape (levels * SIDE * SIDE * width,), and as the sky does.

    ``axes``, ``up``: of the map; ``per_unit``: cells per unit of it.
    """

    air: mi.Float32
    sky: mi.Float32
    axes: tuple[Vec, Vec]
    up: Vec
    per_unit: float
    width: int

    @property
    def size_bytes(self) -> int:
        """Return the memory of the maps."""
        return 4 * (len(LEVELS_M) + 1) * SIDE * SIDE * self.width

    def in_air(self, height_m: mi.Float64, normal: Vec) -> list[mi.Float32]:
        """Return F as air sees it at heights above unit normals, per node."""
        place, wx, wy = self._locate(normal)
        level, w = _level(mi.Float32(height_m))
        low = self._bilinear(self.air, level * (SIDE * SIDE) + place, wx, wy)
        high = self._bilinear(self.air, (level + 1) * (SIDE * SIDE) + place, wx, wy)
        return [dr.fma(b - a, w, a) for a, b in zip(low, high, strict=True)]

    def in_sky(self, normal: Vec) -> list[mi.Float32]:
        """Return F as the sky above unit normals sees it, per node."""
        place, wx, wy = self._locate(normal)
        return self._bilinear(self.sky, place, wx, wy)

    def _locate(self, normal: Vec3[mi.Float64]) -> tuple[mi.UInt32, mi.Float32, mi.Float32]:
        stretch = dr.sqrt(2.0 / dr.maximum(1.0 + dot(normal, self.up), 1e-6)) * constant(self.per_unit)
        x, y = (dr.fma(dot(normal, axis), stretch, 0.5 * (SIDE - 1)) for axis in self.axes)
        x, y = (dr.clip(c, 0.0, SIDE - 1.001) for c in (x, y))
        i, j = mi.UInt32(x), mi.UInt32(y)
        return j * SIDE + i, mi.Float32(x - mi.Float64(i)), mi.Float32(y - mi.Float64(j))

    def _bilinear(self, values: mi.Float32, place: mi.UInt32, wx: mi.Float32, wy: mi.Float32) -> list[mi.Float32]:
        corners = (gather_row(values, place + k, self.width) for k in (0, 1, SIDE, SIDE + 1))
        return [dr.lerp(dr.lerp(a, b, wx), dr.lerp(c, d, wx), wy) for a, b, c, d in zip(*corners, strict=True)]


def _level(height_m: mi.Float32) -> tuple[mi.UInt32, mi.Float32]:
    """Return (lower level, weight of the upper one), linear in the logarithm of the height."""
    level, weight = mi.UInt32(0), mi.Float32(0.0)
    h = dr.log(dr.clip(height_m, LEVELS_M[0], LEVELS_M[-1]))
    for k in range(len(LEVELS_M) - 1):
        low, high = math.log(LEVELS_M[k]), math.log(LEVELS_M[k + 1])
        above = h >= low
        level = dr.select(above, mi.UInt32(k), level)
        weight = dr.select(above, (h - low) * (1.0 / (high - low)), weight)
    return level, weight


@dataclass(frozen=True)
class GroundCells:
    """What lies in the cells of the map around a camera.

    ``shares``: of every kind of ground, clouds with their brightness, as much of them as is seen from above.
    """

    ground: Ground
    shares: dict[str, NDArray[np.float32]]
    axes: FloatArray
    per_unit: float
    cell_m: float

    @property
    def size_bytes(self) -> int:
        """Return the memory of the shares."""
        return 4 * SIDE * SIDE * len(self.shares)


def ground_cells(ground: Ground, planet: Planet, origin: FloatArray) -> GroundCells:
    """Look from above at everything around a camera."""
    r = float(np.linalg.norm(origin))
    up = origin / r
    east = perpendicular(up)
    axes = np.stack([east, np.cross(up, east), up])
    radius = min(planet.a_m, planet.b_m)
    # 1 deg for the ellipsoid's normals
    reach = math.acos(min(radius / r, 1.0)) + math.acos(radius / (radius + LIT_AIR_M)) + math.radians(1.0)
    half = 2.0 * math.sin(0.5 * min(reach, math.pi))
    per_unit = 0.5 * (SIDE - 1) / half
    cell = dr.arange(mi.UInt32, SIDE * SIDE)
    x, y = (mi.Float64(c) - 0.5 * (SIDE - 1) for c in (cell % SIDE, cell // SIDE))
    frame = [constant_vector(axis) for axis in axes]
    shares: dict[str, mi.Float32] = {}
    for k in range(SAMPLES * SAMPLES):
        # as data: all samples share a kernel
        aside = [constant((n + 0.5) / SAMPLES - 0.5) for n in (k % SAMPLES, k // SAMPLES)]
        normal = _normal((x + aside[0]) * constant(1.0 / per_unit), (y + aside[1]) * constant(1.0 / per_unit), frame)
        seen = shares_from_above(ground, normal)
        through = mi.Float64(1.0)
        if ground.model.clouds is not None:
            through = dr.square(1.0 - seen["cloud"] * constant(ground.model.clouds.albedo))
        for kind, share in seen.items():
            part = mi.Float32(share if kind == "cloud" else share * through) * (1.0 / SAMPLES**2)
            shares[kind] = shares.get(kind, mi.Float32(0.0)) + part
        dr.eval(shares)
    each = {kind: np.asarray(share) for kind, share in shares.items() if dr.width(share) > 1}
    return GroundCells(ground, each, axes, per_unit, planet.mean_radius_m / per_unit)


def _normal(x: mi.Float64, y: mi.Float64, axes: list[Vec]) -> Vec:
    """Return the unit normals at places of the map."""
    rho2 = dr.minimum(x * x + y * y, 4.0)
    shrink = dr.sqrt(1.0 - 0.25 * rho2)
    east, north, up = axes
    parts = zip(east, north, up, strict=True)
    n1, n2, n3 = (dr.fma(x * shrink, e, dr.fma(y * shrink, n, (1.0 - 0.5 * rho2) * u)) for e, n, u in parts)
    return n1, n2, n3


def ground_light(cells: GroundCells, bounce: Bounce) -> GroundLight:
    """Return the maps of a batch around a camera."""
    waves = _Waves.of(cells.cell_m)
    air = np.zeros((len(LEVELS_M), SIDE, SIDE, bounce.width), dtype=np.float32)
    sky = np.zeros((SIDE, SIDE, bounce.width), dtype=np.float32)
    nodes = zip(bounce.wavelength_um, bounce.transfer, bounce.spherical_albedo, strict=True)
    for k, (wavelength_um, transfer, spherical) in enumerate(nodes):
        sky[..., k], air[..., k] = waves.blurred(_albedo(cells, wavelength_um), transfer, spherical)
    east, north, up = (constant_vector(axis) for axis in cells.axes)
    tables = table_of(mi.Float32, air), table_of(mi.Float32, sky)
    return GroundLight(*tables, (east, north), up, cells.per_unit, bounce.width)


def _albedo(cells: GroundCells, wavelength_um: float) -> NDArray[np.float32]:
    """Return the diffuse albedo of the cells, shape (SIDE, SIDE)."""
    albedos = asdict(surface.albedos(cells.ground.model, wavelength_um))
    albedos["water"] += albedos["sky"]
    total = sum((np.float32(albedos[kind]) * share for kind, share in cells.shares.items()), start=np.float32(0.0))
    return np.asarray(total).reshape(SIDE, SIDE)


@dataclass(frozen=True)
class _Waves:
    """The waves of a map: lower entry of the transfer functions, weight of the upper one, and ``sharpening``.

    A cell holds a mean, and between cells the map is bilinear: both weaken waves, a wave of k cells per radian by
    ``sinc(k/2)^3`` along an axis. The amplitudes are put right for it, by a factor of :data:`SHARPEST` at most.
    """

    cell_m: float
    low: NDArray[np.int64]
    weight: NDArray[np.float32]
    sharpening: NDArray[np.float32]

    @classmethod
    def of(cls, cell_m: float) -> _Waves:
        ky, kx = scipy.fft.fftfreq(SIDE)[:, None], scipy.fft.rfftfreq(SIDE)
        k = 2.0 * math.pi / cell_m * np.hypot(ky, kx)
        place = np.interp(k, WAVE_NUMBERS_PER_M, np.arange(len(WAVE_NUMBERS_PER_M)))
        low = np.minimum(place.astype(np.int64), len(WAVE_NUMBERS_PER_M) - 2)
        sharpening = np.minimum((np.sinc(ky) * np.sinc(kx)) ** -3.0, SHARPEST)
        return cls(cell_m, low, (place - low).astype(np.float32), sharpening.astype(np.float32))

    def blurred(
        self, albedo: NDArray[np.float32], transfer: HorizontalTransfer, spherical: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return F as the sky sees it, and as the levels see it with the levels first."""

        def weakened(spectrum: NDArray[np.complex64], function: FloatArray) -> NDArray[np.float32]:
            f = function.astype(np.float32)
            through = (f[self.low] + self.weight * (f[self.low + 1] - f[self.low])) * self.sharpening
            return np.asarray(np.maximum(scipy.fft.irfft2(spectrum * through, s=albedo.shape), np.float32(0.0)))

        flux = scipy.fft.rfft2(albedo / (1.0 - np.float32(spherical) * self._seen_by_sky(albedo, transfer)))
        return weakened(flux, transfer.sky), np.stack([weakened(flux, f) for f in transfer.air])

    def _seen_by_sky(self, albedo: NDArray[np.float32], transfer: HorizontalTransfer) -> NDArray[np.float32]:
        """Return A_sky, steps of a few cells: it counts s times, a tenth."""
        few = SIDE // _COARSER
        coarse = albedo.reshape(few, _COARSER, few, _COARSER).mean(axis=(1, 3))
        k = (
            2.0
            * math.pi
            / (_COARSER * self.cell_m)
            * np.hypot(scipy.fft.fftfreq(few)[:, None], scipy.fft.rfftfreq(few))
        )
        through = np.interp(k, WAVE_NUMBERS_PER_M, transfer.sky).astype(np.float32)
        seen = np.clip(scipy.fft.irfft2(scipy.fft.rfft2(coarse) * through, s=coarse.shape), 0.0, 1.0)
        return np.repeat(np.repeat(seen.astype(np.float32), _COARSER, axis=0), _COARSER, axis=1)
