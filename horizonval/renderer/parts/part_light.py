"""The light of parts in every pixel that they cover, by stock Mitsuba's ``path`` integrator.

The scene is metres large, in camera axes with the camera at its origin, so that single precision serves. Rays are the
camera's own, spread over each pixel (multi-jittered); a pixel's light is the mean over those that meet a part. Pixels
that a part covers by a sliver which no ray met take the light of the nearest pixel that has some.

Sunlight and the light of the Earth are rendered apart, for neither is noisy then because of the other: under the Sun a
Lambert panel is noisy by 2e-4 of its light, by an even Earth by 0.1 % (from above)
to 1 % (edge-on) of a pixel's with 256 rays. Light that a metal
throws onto another part (a caustic) is noisier: single pixels may stand out. In thermal bands::

    L_part = e B(T) + what the part reflects, with a reflectance of 1 - e, of the Earth

Light goes from part to part, at most :data:`MOST_BOUNCES` times; heat that one part emits and another reflects is left
out. Seeds come from a hash of the frame's identity, so that equal frames are equal to the last bit.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral.planck import black_body_radiance
from horizonval.geometry.camera import CameraModel
from horizonval.renderer.kernel.rays import RayCamera
from horizonval.renderer.parts.materials import emissivity_of, solar_bsdf, thermal_bsdf
from horizonval.renderer.parts.sky_light import SkyLight
from horizonval.renderer.parts.sun_emitter import sun_emitter
from horizonval.renderer.tables import table_of
from horizonval.spec.camera import Band
from horizonval.spec.scene import SpacecraftPart

MOST_BOUNCES = 5
LANES = 2**19
"""Rays of one launch."""
SUN_SHARE = 4
"""How many times fewer rays the Sun takes than the Earth."""
ENERGY_SHARE = 16
"""How many times fewer rays tell energy radiance from radiance, whose ratio hardly changes over the Earth: pixels of a
white boom in 0.4 to 0.9 um differ by 4e-4 rms from as many rays, less than either is noisy by."""

Image = FloatArray


@dataclass(frozen=True)
class PartLight:
    """What parts add to a frame: radiance and energy radiance by band, where they cover; distance to them [m]."""

    radiance: dict[str, Image]
    energy: dict[str, Image]
    distance_m: Image


@dataclass(frozen=True)
class PartScene:
    """Parts before a camera, and what lights them.

    Attributes
    ----------
    parts : sequence of SpacecraftPart
    triangles : sequence of ndarray, shape (n, 3, 3)
        Of each part, in camera axes [m].
    camera : CameraModel
    covered : ndarray of bool, shape (H, W)
        Pixels that want light.
    sky : SkyLight
    cam_from_itrs : ndarray, shape (3, 3)
    sun_itrs : ndarray, shape (3,)
    sun_angular_radius_rad : float
    samples : int
        Rays per pixel for the light of the Earth.
    identity : str
        Of the frame, for the seeds.
    """

    parts: Sequence[SpacecraftPart]
    triangles: Sequence[FloatArray]
    camera: CameraModel
    covered: NDArray[np.bool_]
    sky: SkyLight
    cam_from_itrs: FloatArray
    sun_itrs: FloatArray
    sun_angular_radius_rad: float
    samples: int
    identity: str

    def light(self, bands: Sequence[Band]) -> PartLight:
        """Return the light of the parts in some bands.

        Raises
        ------
        UserError
            For a BSDF that Mitsuba refuses.
        """
        radiance: dict[str, Image] = {}
        energy: dict[str, Image] = {}
        few = max(self.samples // SUN_SHARE, 1)
        for band in bands:
            if band.kind == "thermal":
                reflected = self._lit(
                    [thermal_bsdf(part) for part in self.parts], self._earth(self.sky.earth[band.name])
                )
                radiance[band.name] = self._emitted(band) + reflected
                energy[band.name] = radiance[band.name]
                continue
            sun = self.sky.sun[band.name]
            bsdfs = [
                solar_bsdf(part, sun.wavelength_um, sun.weight, f"part[{i}] ({part.name})")
                for i, part in enumerate(self.parts, start=1)
            ]
            total, total_energy = np.zeros(self.covered.shape), np.zeros(self.covered.shape)
            if sun.irradiance > 0.0:
                emitter = sun_emitter(self.cam_from_itrs @ self.sun_itrs, self.sun_angular_radius_rad)
                unit = self._lit(bsdfs, emitter, few)
                total, total_energy = unit * sun.irradiance, unit * sun.energy_irradiance
            radiant, energetic = self._earthlit(bsdfs, self.sky.earth[band.name], self.sky.earth_energy[band.name])
            radiance[band.name], energy[band.name] = total + radiant, total_energy + energetic
        return PartLight(radiance, energy, self._distance_m())

    def _earthlit(
        self, bsdfs: Sequence[Any], radiance: NDArray[np.float32], energy: NDArray[np.float32]
    ) -> tuple[Image, Image]:
        """Return the light of the Earth, as radiance and as energy count it.

        Energy is the radiance times their mean ratio, and by how much that is off along fewer rays, the same for both.
        """
        if not radiance.any():
            return np.zeros(self.covered.shape), np.zeros(self.covered.shape)
        earth, few = self._earth(radiance), max(self.samples // ENERGY_SHARE, 1)
        light = self._lit(bsdfs, earth)
        ratio = float(energy.sum(dtype=np.float64) / radiance.sum(dtype=np.float64))
        off = self._lit(bsdfs, self._earth(energy), few) - ratio * self._lit(bsdfs, earth, few)
        return light, np.maximum(ratio * light + off, 0.0)

    def _earth(self, radiance: NDArray[np.float32]) -> Any:
        """Return a map of the sky as an emitter."""
        to_world = np.eye(4)
        to_world[:3, :3] = self.cam_from_itrs @ self.sky.itrs_from_map
        grey = np.ascontiguousarray(np.repeat(radiance[:, :, None], 3, axis=2), dtype=np.float32)
        return mi.load_dict(
            {"type": "envmap", "bitmap": mi.Bitmap(grey), "to_world": mi.ScalarTransform4f(to_world.tolist())}
        )

    def _scene(self, bsdfs: Sequence[Any], emitter: Any = None) -> Any:
        content: dict[str, Any] = {"type": "scene"}
        for i, (triangles, bsdf) in enumerate(zip(self.triangles, bsdfs, strict=True)):
            content[f"part_{i}"] = _mesh(triangles, bsdf)
        if emitter is not None:
            content["light"] = emitter
        return mi.load_dict(content)

    def _lit(self, bsdfs: Sequence[Any], emitter: Any, samples: int | None = None) -> Image:
        """Return the mean radiance under an emitter of the rays that meet parts, shape (H, W)."""
        scene = self._scene(bsdfs, emitter)
        integrator = mi.load_dict({"type": "path", "max_depth": MOST_BOUNCES + 1, "rr_depth": 64})
        across = math.isqrt((samples or self.samples) - 1) + 1
        pixels = np.flatnonzero(self.covered)
        total, met = np.zeros(len(pixels)), np.zeros(len(pixels))
        each = max(LANES // across**2, 1)
        for number, first in enumerate(range(0, len(pixels), each)):
            part = slice(first, first + each)
            light, hits = self._batch(scene, integrator, pixels[part], across, number)
            total[part], met[part] = light, hits
        return self._image(total, met)

    def _batch(
        self, scene: Any, integrator: Any, pixels: NDArray[np.int64], across: int, number: int
    ) -> tuple[FloatArray, FloatArray]:
        count = across**2
        sampler = mi.load_dict({"type": "multijitter", "sample_count": count})
        sampler.set_samples_per_wavefront(count)
        sampler.seed(self._seed(number), len(pixels) * count)
        ray = self._rays(pixels, count, sampler.next_2d())
        hit = scene.ray_test(ray)
        light, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(ray), None, hit)
        value, met = dr.select(hit, mi.Float64(light[0]), 0.0), dr.select(hit, mi.Float64(1.0), 0.0)
        # together: every sum would follow the rays again
        dr.eval(value, met)
        totals = dr.block_sum(value, count), dr.block_sum(met, count)
        dr.eval(totals)
        light_sum, hits = (np.array(t) for t in totals)
        return light_sum, hits

    def _rays(self, pixels: NDArray[np.int64], count: int, offset: Any = None) -> Any:
        """Return rays through pixels, ``count`` each: at offsets in [0, 1)^2, or through the centres."""
        pixel = dr.arange(mi.UInt32, len(pixels) * count) // dr.opaque(mi.UInt32, count, 1)
        column, row = (
            dr.gather(mi.Float64, table_of(mi.Float64, values.astype(np.float64)), pixel)
            for values in (pixels % self.camera.width, pixels // self.camera.width)
        )
        if offset is not None:
            column, row = column + mi.Float64(offset.x) - 0.5, row + mi.Float64(offset.y) - 0.5
        direction = RayCamera.of(self.camera, np.eye(3)).direction(column, row)
        return mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(*(mi.Float(c) for c in direction)))

    def _centres(self) -> tuple[Any, NDArray[np.int64]]:
        pixels = np.flatnonzero(self.covered)
        scene = self._scene([mi.load_dict({"type": "diffuse"}) for _ in self.parts])
        return scene.ray_intersect_preliminary(self._rays(pixels, 1)), pixels

    def _emitted(self, band: Band) -> Image:
        """Return what parts emit in a thermal band, shape (H, W), mean over the rays that meet them."""
        bsdf = mi.load_dict({"type": "diffuse"})
        across = min(math.isqrt(self.samples - 1) + 1, 8)
        pixels = np.flatnonzero(self.covered)
        each = max(LANES // across**2, 1)
        scene = self._scene([bsdf] * len(self.parts))
        own = [emissivity_of(p) * _black(band, p.temperature_k) for p in self.parts]
        own_table = table_of(mi.Float64, np.array(own))
        shapes = [shape.id() for shape in scene.shapes()]
        order = table_of(mi.Float64, np.array([float(s.rsplit("_", 1)[-1]) for s in shapes]))
        total, met = np.zeros(len(pixels)), np.zeros(len(pixels))
        for first in range(0, len(pixels), each):
            part = slice(first, first + each)
            count, number = across**2, len(pixels[part])
            k = dr.arange(mi.UInt32, number * count) % dr.opaque(mi.UInt32, count, 1)
            side = dr.opaque(mi.UInt32, across, 1)
            offset = mi.Point2f(
                (mi.Float(k % side) + 0.5) / mi.Float(side), (mi.Float(k // side) + 0.5) / mi.Float(side)
            )
            meeting = scene.ray_intersect_preliminary(self._rays(pixels[part], count, offset))
            hit = meeting.is_valid()
            shape = mi.UInt32(dr.gather(mi.Float64, order, meeting.shape_index, hit))
            value = dr.select(hit, dr.gather(mi.Float64, own_table, shape, hit), 0.0)
            valid = dr.select(hit, mi.Float64(1.0), 0.0)
            dr.eval(value, valid)
            totals = dr.block_sum(value, count), dr.block_sum(valid, count)
            dr.eval(totals)
            total[part], met[part] = np.array(totals[0]), np.array(totals[1])
        return self._image(total, met)

    def _distance_m(self) -> Image:
        """Return how far parts are along the rays through pixels' centres, shape (H, W); infinite beside them."""
        meeting, pixels = self._centres()
        image = np.full(self.covered.shape, math.inf)
        t = np.where(np.array(meeting.is_valid()), np.array(meeting.t, dtype=np.float64), math.inf)
        image.ravel()[pixels] = np.broadcast_to(t, pixels.shape)
        return image

    def _image(self, total: FloatArray, met: FloatArray) -> Image:
        """Return means over rays as an image; pixels whose rays met nothing take the nearest light, others are 0."""
        image, known = np.zeros(self.covered.shape), np.zeros(self.covered.shape, dtype=bool)
        known[self.covered] = met > 0.0
        image[self.covered] = total / np.maximum(met, 1.0)
        if known.any() and not known[self.covered].all():
            nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
            image = np.where(self.covered, image[tuple(nearest)], 0.0)
        return image

    def _seed(self, number: int) -> int:
        key = f"light on parts\0{self.identity}\0{number}".encode()
        return int.from_bytes(hashlib.sha256(key).digest()[:4], "little")


def _black(band: Band, temperature_k: float) -> float:
    return float(black_body_radiance(band, temperature_k)) if temperature_k > 0.0 else 0.0


def _mesh(triangles: FloatArray, bsdf: Any) -> Any:
    """Return triangles as a Mitsuba shape, every one with corners of its own: faces are flat."""
    props = mi.Properties("part")
    props["bsdf"] = bsdf
    count = len(triangles)
    mesh = mi.Mesh("part", vertex_count=3 * count, face_count=count, props=props)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(triangles.astype(np.float32).ravel())
    parameters["faces"] = dr.arange(mi.UInt32, 3 * count)
    parameters.update()
    return mesh
