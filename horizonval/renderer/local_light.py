"""The local light of a frame: how much of the ground's light reaches the air of its rays and the sky at their ends.

Tables are keyed by what they depend on: the columns of air, the ground, the camera's position and the light.

**The map** of the light that the ground around a camera sends up, blurred as the air above sees it. Light scattered
more than once is ``I = I_air + B F``: B is what a ground of reflected flux 1 adds to the field, the same everywhere,
and F the flux that ground and clouds send up, over that which falls on them. On a ground that varies F is a map,

    F(x) = A(x) / (1 - s A_sky(x)),        A_sky = A weakened by the transfer function of the sky

with the albedo A, clouds at their place, and the spherical albedo s of the air; and the field at a point takes F
weakened by the transfer function of its height (:mod:`horizonval.renderer.scattering.source_table`). Air above a
place hundreds of kilometres wide sees that ground alone, air above a chequered ground of smaller squares their mean.

The map is Lambert's equal-area map of everything in sight, :data:`SIDE` cells a side, around the point below the
camera: 9 km a cell at 500 km, 20 km from the geostationary orbit. A cell is the mean of ``SAMPLES^2`` samples from
above. Convolutions are by Fourier transform; the map's edge lies beyond what lights anything in sight.

Neglected: the change of the light's angle across a footprint (some per cent per 100 km where the Sun is low), cloud
shadows in the light sent up, reflections between a thin cloud and the ground, and the smaller spread of light from a
high cloud.

**Factors of rays**: the ground factor of a ray's air. The radiance of the air along a ray is ``L = L_air + q L_B``: L_B
over a ground of reflected flux 1, and q the mean of what the ray's air sees of the true ground, weighted by what each
piece of the ray adds to L_B,

    w = (1 - exp(-dtau)) exp(-tau) s / k I_B

with the scattering coefficient s, the extinction k and the mean radiance I_B of the field over a ground of flux 1 at
the place's height and Sun. The weights neglect the field's dependence on direction. q is tabulated on even
knots; L_air and L_B are as smooth as over a uniform ground. Rays that end on a cloud have the
q of the whole ray.
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
from horizonval.renderer.kernel.frame_geometry import FrameGeometry
from horizonval.renderer.kernel.node_batches import Bounce, Place, SolarNodes
from horizonval.renderer.kernel.surface import Ground, shares_from_above
from horizonval.renderer.planet import Planet, along, dot, find_path, warp
from horizonval.renderer.scattering.source_table import LEVELS_M, WAVE_NUMBERS_PER_M, HorizontalTransfer
from horizonval.renderer.tables import gather_row, table_of
from horizonval.renderer.types import Values, Vec, Vec3, constant, constant_vector
from horizonval.renderer.view_table.ray_table import Knots, RayPlane, RayTable

SIDE = 640
SAMPLES = 2
SHARPEST = 2.0
"""Largest factor of ``sharpening``. With this map rays over squares of 50 and 100 km are within 1 % of finer maps."""
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
    def nbytes(self) -> int:
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
    """The map around a camera; ``shares``: of every kind of ground seen from above, clouds with their brightness."""

    ground: Ground
    shares: dict[str, NDArray[np.float32]]
    axes: FloatArray
    per_unit: float
    cell_m: float

    @property
    def nbytes(self) -> int:
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

    A cell holds a mean, and between cells the map is bilinear: both weaken a wave of k cells per radian by
    ``sinc(k/2)^3`` along an axis. ``sharpening`` corrects the amplitudes, by a factor of :data:`SHARPEST` at most.
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


GROUND_KNOTS, GROUND_STEPS = Knots(112, 128), 5
LIMB_KNOTS, LIMB_STEPS = Knots(2, 96), 24
"""Knots of the tables, and steps along each ray. At 500 km rows are 3 km apart on the ground in the middle of the disc.

Under clouds at the terminator twice as many knots change the radiance by up to 3e-3 of the bright limb. Next to borders
of squares of 50 and 100 km the radiance differs from Monte Carlo by up to 2.3 %.
"""
_NO_LIGHT = 1e-60


def ray_factors(batch: SolarNodes, plane: RayPlane, ground: GroundLight, light: Vec, top_m: float) -> RayTable:
    """Return the empty table of q of a batch over a plane of rays."""

    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        return _factors(batch, plane, ground, light, top_m, plane.directions(x, azimuth))

    return RayTable(values, batch.width, GROUND_KNOTS if plane.to_ground else LIMB_KNOTS, single=True)


def _factors(batch: SolarNodes, plane: RayPlane, ground: GroundLight, light: Vec, top_m: float, d: Vec) -> FloatArray:
    """March rays, and return their q, shape (rays, nodes)."""
    to_ground, o = plane.to_ground, plane.camera
    steps = GROUND_STEPS if to_ground else LIMB_STEPS
    planet, width = plane.coordinates.planet, batch.width
    assert batch.bounce is not None
    field = batch.bounce.field
    path = find_path(planet, top_m, o, d, mi.Bool(to_ground))
    low, span = (-1.0, 1.0) if to_ground else (-1.0, 2.0)

    def body(i: mi.UInt32, tau: Values, total: Values, weighted: Values) -> tuple[mi.UInt32, Values, Values, Values]:
        tau, total, weighted = list(tau), list(total), list(weighted)
        y = [dr.clip(low + span / steps * (mi.Float64(i) + k), path.y0, path.y1) for k in (0.0, 0.5, 1.0)]
        before, t, after = (warp(path, v) for v in y)
        place = Place.of(planet, batch.grid, o, d, t)
        extinction, scattering = batch.extinction_at(place), batch.scattering_at(place)
        shining = field.mean_radiance(mi.Float32(place.height_m), mi.Float32(dot(place.normal, light)))
        seen = ground.in_air(place.height_m, place.normal)
        for n in range(width):
            depth = extinction[n] * (after - before)
            share = dr.select(depth > 1e-12, (1.0 - dr.exp(-depth)) / dr.maximum(extinction[n], 1e-30), 0.0)
            w = dr.exp(-tau[n]) * share * scattering[n] * mi.Float64(shining[n]) + _NO_LIGHT
            total[n] = total[n] + w
            weighted[n] = dr.fma(w, mi.Float64(seen[n]), weighted[n])
            tau[n] = tau[n] + depth
        return i + 1, tau, total, weighted

    nothing = [dr.zeros(mi.Float64, dr.width(path.t_low)) for _ in range(3 * width)]
    _, _, total, weighted = dr.while_loop(
        (mi.UInt32(0), nothing[:width], nothing[width : 2 * width], nothing[2 * width :]),
        lambda i, *_: i < steps,
        body,
        labels=("i", "tau", "total", "weighted"),
        label="local light",
    )
    factors = [w / t for w, t in zip(weighted, total, strict=True)]
    dr.eval(factors)
    return np.stack([np.asarray(factor) for factor in factors], axis=1)


@dataclass(frozen=True)
class GroundFactors:
    """By how much the ground counts, per node: for the air along rays, and for the sky at their ends."""

    air: Values
    sky: Values | None


@dataclass(frozen=True)
class LocalLight:
    """The local light of a frame's rays."""

    view: FrameGeometry

    def factors(
        self,
        batch: SolarNodes,
        light: Vec,
        direction: Vec,
        to_ground: bool,
        cloud: tuple[mi.Bool, mi.Float64] | None,
    ) -> GroundFactors | None:
        """Return the factors of rays; None over a uniform ground without clouds. ``cloud``.

        Whether and where clouds end rays.
        """
        if batch.bounce is None:
            return None
        view = self.view
        plane = RayPlane(view.coordinates(view.top_m), to_ground)
        air = self._rays(batch, plane, light).covered(*plane.place(view.origin, direction))[: batch.width]
        if not to_ground and cloud is None:
            return GroundFactors(air, None)
        path = find_path(view.planet, view.top_m, view.origin, direction, mi.Bool(to_ground), cloud)
        _, normal = view.planet.height_and_normal(along(view.origin, direction, path.t_low + path.length_after))
        sky = [mi.Float64(v) for v in self._ground(batch).in_sky(normal)]
        return GroundFactors(air, sky)

    def _ground(self, batch: SolarNodes) -> GroundLight:
        bounce, ground, position = batch.bounce, self.view.ground, self.view.position
        assert bounce is not None
        assert ground is not None

        def look() -> GroundCells:
            return ground_cells(ground, self.view.planet, np.array(position.place_m))

        def make() -> GroundLight:
            return ground_light(position.table(look, "ground cells", ground.model), bounce)

        return position.table(make, "ground light", ground.model, bounce.digest, bounce.width)

    def _rays(self, batch: SolarNodes, plane: RayPlane, light: Vec) -> RayTable:
        assert batch.bounce is not None
        assert self.view.ground is not None
        sun, top_m = tuple(float(c[0]) for c in light), self.view.top_m
        key = self.view.ground.model, batch.bounce.digest, batch.width, sun, top_m, plane.to_ground

        def make() -> RayTable:
            return ray_factors(batch, plane, self._ground(batch), light, top_m)

        return self.view.position.table(make, "ray factors", *key)
