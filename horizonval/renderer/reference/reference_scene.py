r"""The scene of the cross-check: one spectral node in stock Mitsuba plugins, for its Monte Carlo ``volpath``.

What it holds: molecules, ozone and particles in spherical (ellipsoidal) shells, Lambert ground of uniform albedo, the
Sun as a delta light. What it leaves out: the Sun's disc and glare, surface maps, clouds, thermal emission, refraction
and polarisation.

It shares the physics rooms' optical properties with the march and nothing else: height above the ellipsoid, phase
functions, camera (``perspective``) and all sampling are separate code.

Single precision forces three choices, all measured:

* kilometres, and the origin on the ground below the camera: a ray that leaves a surface starts
  ``8.9e-5 (1 + max|p|)`` above it, 0.57 km with the origin at the planet's centre and at most a third of that in view
  of a low orbit;
* the camera is inside the medium and the shell that bounds it lies outside the camera, so that no ray of the camera
  crosses a boundary (each crossing shifts a ray sideways, which costs up to 9 % at the limb);
* the ground is an ``instance`` of a unit sphere: a ``sphere`` with unequal scales is silently a sphere.

**Air on a grid**, for Mitsuba without us, is one oriented box around the air that a camera sees and the way of the
sunlight to there, with axes along the local vertical, along the line of sight and across. (Of the whole shell a grid
has 25 km a voxel, against a scale height of 8 km.) A voxel's edges are in inverse proportion to the rms component of
the vertical along them, which makes the interpolation's error least for a number of voxels.

Trilinear interpolation of an exponential between samples :math:`\delta` apart is :math:`(x/2) \coth(x/2)` too high in
the mean, with :math:`x = \delta / H`; the scattering of molecules is divided by that along each axis, and goes on below
the ground. Haze and absorbing gases may end within a voxel: what is left of the extinction is the mean over the height
of a voxel, the air mirrored in the ground, so that the column above the ground stays whatever the voxels. All else is a
mean weighted by the extinction.

Against exact shells (550 nm, 500 km up, no haze) a 6 deg limb camera is within noise, 0.3 % up to 40 km; a 60 deg one
within 0.4 % up to 20 km, but 10 % high at 20 to 40 km. Ground: 0.1 %.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core import atomic
from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.geometry.camera import CameraModel
from horizonval.renderer.planet import Planet
from horizonval.renderer.types import PluginDict, constant_vector, inverse_root

KM = 1e-3
RAYLEIGH_COS2 = 0.75
TABLE_NODES = 4096
ASYMMETRY_STEP = 0.02
"""Step in g of the phase functions that are blended, weights keeping g: within 0.4 % at g = 0.7 (forward peak)."""
MARGIN_M = 50e3

Volume = Callable[[str, FloatArray], Any]
"""Make a volume plugin of a named quantity given at the model's altitudes."""


@dataclass(frozen=True)
class Placement:
    """Where planet, camera and Sun are, in Earth-fixed axes; ``origin_m`` is the origin of the Mitsuba scene."""

    planet: Planet
    camera_m: FloatArray
    itrs_from_cam: FloatArray
    sun: FloatArray
    origin_m: FloatArray

    @classmethod
    def below(cls, planet: Planet, camera_m: FloatArray, itrs_from_cam: FloatArray, sun: Sequence[float]) -> Placement:
        """Place the scene's origin where the line from the camera to the planet's centre meets the ground."""
        stretched = camera_m * np.array([1.0, 1.0, planet.a_m / planet.b_m])
        ground = camera_m * (planet.a_m / np.linalg.norm(stretched))
        return cls(planet, camera_m, itrs_from_cam, np.array(sun), ground)

    @property
    def centre_km(self) -> FloatArray:
        """The planet's centre in the scene, shape (3,)."""
        return -self.origin_m * KM


def reference_scene(
    model: OpticalModel,
    node: SpectralNode,
    place: Placement,
    sensor: PluginDict,
    volume: Volume,
    orders: int | None = None,
) -> PluginDict:
    """Return the scene of one spectral node, under sunlight of unit irradiance.

    ``sensor``: :func:`perspective`, or another sensor in the scene's kilometres; ``volume``: :func:`shell_volumes` for
    exact shells; ``orders`` of scattering, ground included, all by default.
    """
    planet, top = place.planet, model.top_m
    outer_m = max(float(np.linalg.norm(place.camera_m)), planet.a_m + top) + MARGIN_M
    scene: PluginDict = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": -1 if orders is None else orders + 1, "rr_depth": 16},
    }
    inside: PluginDict = {}
    if node.extinction_per_m.any():
        scene["air"] = _medium(node, volume)
        inside = {"type": "ref", "id": "air"}
        scene["shell"] = {
            "type": "sphere",
            "center": place.centre_km.tolist(),
            "radius": outer_m * KM,
            "bsdf": {"type": "null"},
            "interior": dict(inside),
        }
        sensor = sensor | {"medium": dict(inside)}
    axes = [planet.a_m * KM, planet.a_m * KM, planet.b_m * KM]
    scene["unit_sphere"] = {
        "type": "shapegroup",
        "id": "unit_sphere",
        "sphere": {
            "type": "sphere",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": float(model.albedo)}},
        },
    }
    scene["ground"] = {
        "type": "instance",
        "to_world": mi.ScalarTransform4f().translate(place.centre_km.tolist()).scale(axes),
        "shapegroup": {"type": "ref", "id": "unit_sphere"},
    }
    scene["sun"] = {
        "type": "directional",
        "direction": [-float(v) for v in place.sun],
        "irradiance": {"type": "uniform", "value": 1.0},
    }
    scene["sensor"] = sensor
    return scene


def is_stock(camera: CameraModel) -> bool:
    """Return whether ``perspective`` projects like this camera: pinhole, square pixels, no distortion."""
    square = camera.fx == camera.fy and not camera.skew
    return camera.projection == "pinhole" and square and not any(camera.distortion)


def perspective(camera: CameraModel, place: Placement) -> PluginDict:
    """Return the stock pinhole; distortion, unequal ``fy`` and equal-angle projection are left out."""
    sensor = pinhole(camera, (place.camera_m - place.origin_m) * KM, place.itrs_from_cam, 1.0, 1e7)
    return sensor | {"sampler": {"type": "independent", "sample_count": 64}}


def pinhole(
    camera: CameraModel, position: FloatArray, world_from_cam: FloatArray, near: float, far: float
) -> PluginDict:
    """Return the stock pinhole anywhere, all lengths in the scene's unit; what it leaves out: see above."""
    to_world = np.eye(4)
    # Mitsuba's camera: x left, y up, z forward
    to_world[:3, :3] = world_from_cam @ np.diag([-1.0, -1.0, 1.0])
    to_world[:3, 3] = position
    return {
        "type": "perspective",
        "fov": math.degrees(2.0 * math.atan(0.5 * camera.width / camera.fx)),
        "fov_axis": "x",
        "principal_point_offset_x": 0.5 - (camera.cx + 0.5) / camera.width,
        "principal_point_offset_y": 0.5 - (camera.cy + 0.5) / camera.height,
        "near_clip": near,
        "far_clip": far,
        "to_world": mi.ScalarTransform4f(to_world.tolist()),
        "film": film(camera),
    }


def film(camera: CameraModel) -> PluginDict:
    """Return a film of the camera's size; with the box filter every sample counts in one pixel only."""
    return {
        "type": "hdrfilm",
        "width": camera.width,
        "height": camera.height,
        "pixel_format": "luminance",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }


def _medium(node: SpectralNode, volume: Volume) -> PluginDict:
    extinction = node.extinction_per_m
    albedo = np.divide(node.scattering_per_m, extinction, out=np.zeros_like(extinction), where=extinction > 0.0)
    constant = np.ptp(albedo[extinction > 0.0]) == 0.0
    return {
        "type": "heterogeneous",
        "id": "air",
        # one channel: volpath would else divide exp(-majorant x distance) by itself, which is 0/0 where a ray has left
        # the grid and majorant times distance to the next surface is above 100
        "has_spectral_extinction": False,
        "sigma_t": volume("sigma_t", extinction / KM),
        "albedo": _constant(float(albedo.max())) if constant else volume("albedo", albedo),
        "phase": _phase(node, volume),
    }


def _constant(value: float) -> PluginDict:
    return {"type": "constvolume", "value": value}


def _blend(one: PluginDict, other: PluginDict, weight: PluginDict) -> PluginDict:
    """Return ``(1 - weight) one + weight other``."""
    return {"type": "blendphase", "one": one, "other": other, "weight": weight}


def _phase(node: SpectralNode, volume: Volume) -> PluginDict:
    """Return the phase function.

    ``c / 0.75`` parts Rayleigh, the rest isotropic, and particles by share at each height.
    """
    share = node.molecular_cos2 / RAYLEIGH_COS2
    molecules: PluginDict = {"type": "rayleigh"}
    if share < 1.0:
        isotropic: PluginDict = {"type": "isotropic"}
        molecules = _blend(isotropic, molecules, _constant(share)) if share > 0.0 else isotropic
    if not node.particle_per_m.any():
        return molecules
    particles = _particle_phase(node, volume)
    if not node.molecular_per_m.any():
        return particles
    total = node.scattering_per_m
    weight = np.divide(node.particle_per_m, total, out=np.zeros_like(total), where=total > 0.0)
    return _blend(molecules, particles, volume("particles", weight))


def _particle_phase(node: SpectralNode, volume: Volume) -> PluginDict:
    """Return Henyey and Greenstein's function; a chain of blends where its asymmetry changes with altitude.

    ``((g0 . w1 . g1) . w2 . g2) ...``: at most two neighbours have weight anywhere.
    """
    present = node.particle_per_m > 0.0
    low, high = float(node.asymmetry[present].min()), float(node.asymmetry[present].max())
    count = 1 + math.ceil(round((high - low) / ASYMMETRY_STEP, 6))
    levels = np.linspace(low, high, count)
    phase: PluginDict = {"type": "hg", "g": low}
    asymmetry = np.clip(node.asymmetry, low, high)
    for i, (below, above) in enumerate(pairwise(levels), start=1):
        weight = np.clip((asymmetry - below) / (above - below), 0.0, 1.0)
        phase = _blend(phase, {"type": "hg", "g": float(above)}, volume(f"asymmetry-{i}", weight))
    return phase


def shell_volumes(model: OpticalModel, place: Placement) -> Volume:
    """Return a maker of volumes that are functions of geodetic height alone: linear in altitude, nothing outside.

    A Python plugin, traced into the kernel. Height comes from Bowring's formula, good to 1e-6 m in this range.
    """
    planet, top_m = place.planet, model.top_m
    half = (planet.a_m + top_m) * KM
    to_world = mi.ScalarTransform4f().translate((place.centre_km - half).tolist()).scale(2.0 * half)
    grid = np.linspace(0.0, top_m, TABLE_NODES)
    origin = mi.Vector3d(*constant_vector(place.origin_m))

    class Shells(mi.Volume):
        def __init__(self, props: mi.Properties, values: FloatArray) -> None:
            super().__init__(props)
            self.table = mi.Float(np.interp(grid, model.altitude_m, values))
            self.largest = float(values.max())

        def _at(self, it: Any, active: Any) -> Any:
            height, _ = geodetic(planet, mi.Vector3d(it.p) / KM + origin)
            inside = active & (height >= 0.0) & (height <= top_m)
            x = dr.clip(mi.Float(height) * ((TABLE_NODES - 1) / top_m), 0.0, TABLE_NODES - 1.0)
            i = dr.minimum(mi.UInt32(x), TABLE_NODES - 2)
            low, high = dr.gather(mi.Float, self.table, i, inside), dr.gather(mi.Float, self.table, i + 1, inside)
            return dr.select(inside, dr.fma(high - low, x - mi.Float(i), low), 0.0)

        def eval(self, it: Any, active: Any = True) -> Any:
            return mi.UnpolarizedSpectrum(self._at(it, active))

        def eval_1(self, it: Any, active: Any = True) -> Any:
            return self._at(it, active)

        def max(self) -> float:
            return self.largest

        def resolution(self) -> mi.ScalarVector3i:
            return mi.ScalarVector3i(1, 1, 1)

        def to_string(self) -> str:
            return f"Shells[{self.id()}]"

    def make(name: str, values: FloatArray) -> mi.Volume:
        props = mi.Properties(name)
        props["to_world"] = to_world
        return Shells(props, values)

    return make


def geodetic(planet: Planet, p: Any) -> tuple[mi.Float64, Any]:
    """Return the height above the ellipsoid by Bowring (1976), one step, and its normal below; stable at the poles."""
    a, b = planet.a_m, planet.b_m
    e2, f2 = 1.0 - (b / a) ** 2, (a / b) ** 2 - 1.0
    rho = dr.sqrt(p.x * p.x + p.y * p.y)
    s, c = p.z * a, rho * b
    norm = inverse_root(s * s + c * c)
    s, c = s * norm, c * norm
    s, c = p.z + f2 * b * s * s * s, rho - e2 * a * c * c * c
    norm = inverse_root(s * s + c * c)
    s, c = s * norm, c * norm
    flat = c / dr.maximum(rho, 1e-3)
    return rho * c + p.z * s - a * dr.sqrt(1.0 - e2 * s * s), mi.Vector3d(flat * p.x, flat * p.y, s)


VOXELS = 2**23
RAYS_PER_AXIS = 41
POINTS_PER_RAY = 65
HIDDEN_COLUMN = 1e-4
"""The grid ends where this share of the column is left above."""
LONGEST_SUN_PATH_M = 400e3


@dataclass(frozen=True)
class Box:
    """An oriented box [m]. ``axes``: rows are its unit vectors; ``low``, ``size``: along them, from the scene's origin.

    ``count``: voxels along each axis. ``top_m``: highest altitude it is meant to hold.
    """

    axes: FloatArray
    low: FloatArray
    size: FloatArray
    count: tuple[int, int, int]
    top_m: float

    @property
    def spacing_m(self) -> FloatArray:
        """Distance between samples, shape (3,)."""
        return self.size / np.array(self.count)

    def coarser(self) -> Box:
        """Return the same box with half as many voxels along each axis."""
        x, y, z = (max(n // 2, 2) for n in self.count)
        return Box(self.axes, self.low, self.size, (x, y, z), self.top_m)

    def to_world(self) -> mi.ScalarTransform4f:
        """Return the transform of the unit cube to the box, in kilometres."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.axes.T * self.size * KM
        matrix[:3, 3] = self.axes.T @ self.low * KM
        return mi.ScalarTransform4f(matrix.tolist())

    def slab(self, k: int) -> FloatArray:
        """Return the positions of the voxels in layer ``k``, from the scene's origin, shape (ny, nx, 3)."""
        x, y = ((np.arange(n) + 0.5) / n for n in self.count[:2])
        unit = np.stack(np.broadcast_arrays(x, y[:, None], (k + 0.5) / self.count[2]), axis=-1)
        return (self.low + unit * self.size) @ self.axes


def seen_air(model: OpticalModel, place: Placement, camera: CameraModel, extinction: FloatArray) -> Box | None:
    """Return the box around the air that a pinhole camera sees; None where it sees none."""
    top = _effective_top(model, extinction)
    origin = place.camera_m
    u = np.linspace(-0.5, camera.width - 0.5, RAYS_PER_AXIS)
    v = np.linspace(-0.5, camera.height - 0.5, RAYS_PER_AXIS)
    x, y = np.meshgrid((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fx)
    d = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) @ place.itrs_from_cam.T
    d /= np.linalg.norm(d, axis=1)[:, None]
    mid, half = _chord(place, origin, d, top)
    ground_mid, ground_half = _chord(place, origin, d, 0.0)
    near = np.maximum(mid - half, 0.0)
    far = np.where((ground_half > 0.0) & (ground_mid > 0.0), ground_mid - ground_half, mid + half)
    seen = (half > 0.0) & (far > near)
    if not seen.any():
        return None
    t = near[seen, None] + (far - near)[seen, None] * np.linspace(0.0, 1.0, POINTS_PER_RAY)
    p = (origin + t[..., None] * d[seen, None, :]).reshape(-1, 3)
    sun_mid, sun_half = _chord(place, p, np.broadcast_to(place.sun, p.shape), top)
    lit = p + np.clip(sun_mid + sun_half, 0.0, LONGEST_SUN_PATH_M)[:, None] * place.sun
    vertical = p.mean(axis=0) / np.linalg.norm(p.mean(axis=0))
    sight = d[seen].mean(axis=0)
    across = np.cross(vertical, sight)
    if np.linalg.norm(across) < 0.1 * np.linalg.norm(sight):  # looking straight down
        across = np.cross(vertical, np.eye(3)[np.argmin(np.abs(vertical))])
    across /= np.linalg.norm(across)
    axes = np.stack([np.cross(across, vertical), across, vertical])
    local = (np.concatenate([p, lit]) - place.origin_m) @ axes.T
    low, size = local.min(axis=0), np.maximum(np.ptp(local, axis=0), 1e3)
    component = np.sqrt(np.mean(((p / np.linalg.norm(p, axis=1)[:, None]) @ axes.T) ** 2, axis=0))
    per_metre = np.maximum(component, 0.02)
    scale = (VOXELS / np.prod(per_metre * size)) ** (1 / 3)
    nx, ny, nz = (max(int(n), 2) for n in per_metre * size * scale)
    return Box(axes, low, size, (nx, ny, nz), top)


def grid_volumes(model: OpticalModel, node: SpectralNode, place: Placement, box: Box, folder: Path) -> Volume:
    """Return a maker of grids of one node, each a ``.vol`` file in ``folder`` named relative to it by the scene.

    Extinction follows the module text; the others vary slowly and have half the resolution.
    """
    extinction = node.extinction_per_m
    rest = np.maximum(extinction - node.molecular_per_m, 0.0)

    def make(name: str, values: FloatArray) -> PluginDict:
        dense = name == "sigma_t"
        grid = box if dense else box.coarser()
        nx, ny, nz = grid.count
        data = np.empty((nz, ny, nx, 1), dtype=np.float32)
        for k in range(nz):
            p = grid.slab(k) + place.origin_m
            radius, height = _radius_and_height(place, p)
            steps = np.abs((p / radius[..., None]) @ grid.axes.T) * grid.spacing_m
            if dense:
                sigma = _molecules(model, node.molecular_per_m, height, steps) + _mean(model, rest, height, steps)
                data[k, :, :, 0] = np.where(height <= model.top_m, sigma, 0.0) / KM
            else:
                weight = _mean(model, extinction, height, steps)
                share = _mean(model, extinction * values, height, steps)
                data[k, :, :, 0] = np.where(weight > 0.0, share / np.maximum(weight, 1e-300), values[-1])
        path = folder / f"{name}.vol"
        with atomic.replacing(path) as temporary:
            mi.VolumeGrid(data).write(str(temporary))
        return {
            "type": "gridvolume",
            "filename": path.name,
            "to_world": grid.to_world(),
            "raw": True,
            "filter_type": "trilinear",
            "wrap_mode": "clamp",
        }

    return make


def _radius_and_height(place: Placement, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distance from the centre and the height along it: 0.6 m from geodetic at 100 km."""
    radius = np.linalg.norm(p, axis=-1)
    a, b = place.planet.a_m, place.planet.b_m
    return radius, radius - radius / np.linalg.norm(p / np.array([a, a, b]), axis=-1)


def _molecules(model: OpticalModel, values: FloatArray, height: FloatArray, steps: FloatArray) -> FloatArray:
    """Return what falls off exponentially at voxels whose edges rise by ``steps`` [m], shape (..., 3)."""
    if not values.any():
        return np.zeros_like(height)
    z = model.altitude_m
    log = np.log(np.maximum(values, 1e-12 * values.max()))
    inverse_scale = np.maximum(-np.gradient(log, z), 0.0)
    # a voxel below the ground matters only if its neighbour is above
    low = np.maximum(height, -steps.sum(axis=-1))
    sigma = np.exp(np.interp(low, z, log)) * np.exp(np.maximum(-low, 0.0) * inverse_scale[0])
    half = 0.5 * steps * np.interp(height, z, inverse_scale)[..., None]
    excess = np.where(half > 1e-3, half / np.tanh(np.maximum(half, 1e-3)), 1.0)
    return np.asarray(sigma / excess.prod(axis=-1))


def _mean(model: OpticalModel, values: FloatArray, height: FloatArray, steps: FloatArray) -> FloatArray:
    """Return means over the heights of voxels, as wide as the three edges' rms rise, air mirrored in the ground."""
    z = model.altitude_m
    column = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(z))])
    wide = np.maximum(np.linalg.norm(steps, axis=-1), 1.0)

    def below(h: FloatArray) -> FloatArray:
        return np.sign(h) * np.interp(np.abs(h), z, column)

    return np.asarray((below(height + 0.5 * wide) - below(height - 0.5 * wide)) / wide)


def _effective_top(model: OpticalModel, extinction: FloatArray) -> float:
    z = model.altitude_m
    layers = 0.5 * (extinction[1:] + extinction[:-1]) * np.diff(z)
    above = np.append(np.cumsum(layers[::-1])[::-1], 0.0)
    return float(z[np.argmax(above <= HIDDEN_COLUMN * above[0])])


def _chord(place: Placement, o: FloatArray, d: FloatArray, height_m: float) -> tuple[FloatArray, FloatArray]:
    """Return middle and half length of the chords cut out by the ellipsoid raised by ``height_m``; 0 for misses."""
    a, b = place.planet.a_m + height_m, place.planet.b_m + height_m
    stretch = np.array([1.0, 1.0, a / b])
    o, d = o * stretch, d * stretch
    d2 = (d * d).sum(axis=-1)
    mid = -(o * d).sum(axis=-1) / d2
    nearest2 = ((o + mid[..., None] * d) ** 2).sum(axis=-1)
    return mid, np.sqrt(np.maximum(a * a - nearest2, 0.0) / d2)
