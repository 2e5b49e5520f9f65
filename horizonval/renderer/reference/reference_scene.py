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
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.geometry.camera import CameraModel
from horizonval.renderer.planet import Planet
from horizonval.renderer.types import PluginDict, constant_vector, inverse_root

KM = 1e-3
RAYLEIGH_COS2 = 0.75
TABLE_NODES = 4096
ASYMMETRY_STEP = 0.02
"""Particles whose asymmetry changes with altitude are blended from phase functions this far apart in g, with weights
that keep g; the phase function is then within 0.4 % where g = 0.7 (forward peak)."""
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

    Parameters
    ----------
    sensor : dict
        :func:`perspective`, or another sensor in the scene's kilometres.
    volume : callable
        :func:`shell_volumes` for exact shells.
    orders : int, optional
        Orders of scattering, ground included; all by default.
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
    return camera.projection == "pinhole" and camera.fx == camera.fy and not any(camera.distortion)


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
    """Return the phase function: molecules, and particles by their share in scattering at every altitude.

    ``1 - c/3 + c cos^2`` is ``c / 0.75`` parts Rayleigh and the rest isotropic.
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
