"""Parts laid over a frame: ``L = c L_part + (1 - c) L_earth``, with the exact covered share c of every pixel.

The share is that of the truth (:mod:`horizonval.geometry.part`) and not of the rays that lit the parts.

**Surfaces by name.** Reflectance at a few wavelengths, linear between them and constant beyond. Each is read off
typical published curves of its kind (Henninger, Solar absorptance and thermal emittance of some common spacecraft
thermal-control coatings, NASA RP 1121, 1984) with an uncertainty of 0.05: coatings differ from maker to maker, and age.
Roughness is an assumption. In thermal bands every surface is a grey Lambert one.

**Light of parts**, by stock Mitsuba's ``path`` integrator. The scene is metres large, in camera axes with the camera at
its origin, so that single precision serves. Rays are the camera's rays, spread over each pixel (multi-jittered); a
pixel's light is the mean over those that meet a part. Pixels that a part covers by a sliver which no ray met take the
light of the nearest pixel that has some.

Rays go where the light changes (:mod:`horizonval.renderer.part_pixels`): along edges of faces and shadows, and to every
fourth pixel of the faces of matt parts.

Sunlight and the light of the Earth are rendered separately, so that neither adds noise to the other: under the Sun a
Lambert panel is noisy by 2e-4 of its light, by an even Earth by 0.1 % (from above) to 1 % (edge-on) of a pixel's with
256 rays. Light that a metal throws onto another part (a caustic) is noisier. In thermal bands::

    L_part = e B(T) + what the part reflects, with a reflectance of 1 - e, of the Earth

Light goes from part to part, at most :data:`MOST_BOUNCES` times; heat that one part emits and another reflects is
neglected. Seeds come from a hash of the frame's identity, so that equal frames are equal to the last bit.

**What shines on parts**: the Earth all round, and the Sun through the air before it. The Earth is our rendered picture
from the same place: a map in longitude and latitude about the nadir, so that the limb runs along a row and is covered
exactly, from the same tables as the frame. It is a Mitsuba ``envmap``, which is linear between rows from pole
to pole and between the middles of columns; the map's camera has its pixels at those points. The map excludes the Sun,
which is a separate light, and the Moon; moonlight on parts is neglected. The Sun's light is dimmed by the share of its
disc that the Earth hides and by the air before it, mean over points of the disc along straight rays.

**The Sun** is a Mitsuba emitter: a disc at infinity of unit irradiance, which smooth surfaces mirror as a disc. Stock
Mitsuba has no such emitter: ``directional`` is a point, which no mirror shows; a far sphere loses 0.2 % in single
precision; a map of the sky cannot hold half a degree. Directions are sampled evenly over the disc, in ``1 - cos``,
whose small values are computed in double precision.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.spectral.planck import black_body_radiance
from horizonval.frame import PART_MAP, FrameTruth, Hit, RadianceFrame
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.part import coverage
from horizonval.geometry.rotation import perpendicular, tangent_basis
from horizonval.renderer.image import render_bands
from horizonval.renderer.kernel.cells import group_cells
from horizonval.renderer.kernel.frame_geometry import RayCamera
from horizonval.renderer.kernel.march import march
from horizonval.renderer.kernel.node_batches import SolarNodes
from horizonval.renderer.part_pixels import STRIDE, Faces, PixelPlan
from horizonval.renderer.planet import SOLAR_CONCENTRATION
from horizonval.renderer.plugins import CameraSettings, mitsuba_sensor
from horizonval.renderer.tables import table_of, vectors
from horizonval.renderer.types import PluginDict
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.scene import Material, SceneSpec, SpacecraftPart
from horizonval.truth.frame_truth import part_triangles

_UM = (0.4, 0.5, 0.6, 0.7, 0.9, 1.6)


@dataclass(frozen=True)
class _Surface:
    """``reflectance`` at ``_UM``; ``kind``: lambert, metal (rough mirror), glass (clear, smooth, over a Lambert base).

    ``roughness``: root mean square slope of a metal's or glass's facets.
    """

    kind: str
    reflectance: Sequence[float]
    emissivity: float
    roughness: float = 0.0


SURFACES: dict[Material, _Surface] = {
    "white_paint": _Surface("lambert", (0.70, 0.84, 0.85, 0.85, 0.84, 0.75), 0.90),
    "black_paint": _Surface("lambert", (0.04, 0.04, 0.04, 0.04, 0.04, 0.05), 0.90),
    "solar_cell": _Surface("glass", (0.02, 0.02, 0.02, 0.02, 0.03, 0.20), 0.85, 0.02),
    "kapton_foil": _Surface("metal", (0.10, 0.30, 0.62, 0.72, 0.80, 0.85), 0.70, 0.25),
    "gold": _Surface("metal", (0.39, 0.50, 0.92, 0.96, 0.98, 0.98), 0.03, 0.15),
    "aluminium": _Surface("metal", (0.91, 0.91, 0.90, 0.89, 0.88, 0.95), 0.05, 0.20),
}
GLASS_INDEX = 1.45


def emissivity_of(part: SpacecraftPart) -> float:
    """Return the emissivity of a part in thermal bands."""
    return SURFACES[part.material].emissivity if part.emissivity is None else part.emissivity


def solar_bsdf(part: SpacecraftPart, wavelength_um: Sequence[float], weight: Sequence[float], where: str) -> mi.BSDF:
    """Return how a part reflects sunlight of some wavelengths, weighted; ``UserError`` if Mitsuba refuses its BSDF."""
    if part.bsdf is not None:
        return _loaded(part.bsdf, f"{where}.bsdf")
    surface = SURFACES[part.material]
    share = np.asarray(weight) / np.sum(weight)
    reflectance = float(np.interp(wavelength_um, _UM, surface.reflectance) @ share)
    if surface.kind == "lambert":
        plugin: PluginDict = {"type": "diffuse", "reflectance": reflectance}
    elif surface.kind == "metal":
        # a mirror of facets, none of whose light is lost but what the reflectance takes
        plugin = {"type": "roughconductor", "material": "none", "specular_reflectance": reflectance}
        plugin |= {"alpha": surface.roughness, "distribution": "ggx"}
    else:
        plugin = {"type": "roughplastic", "diffuse_reflectance": reflectance, "int_ior": GLASS_INDEX}
        plugin |= {"alpha": surface.roughness, "distribution": "ggx"}
    return _loaded(plugin, where)


def thermal_bsdf(part: SpacecraftPart) -> mi.BSDF:
    """Return how a part reflects in thermal bands."""
    return _loaded({"type": "diffuse", "reflectance": 1.0 - emissivity_of(part)}, "")


def _loaded(plugin: PluginDict, where: str) -> mi.BSDF:
    expected = 'a BSDF of Mitsuba, such as { type = "diffuse", reflectance = 0.5 }'
    try:
        inner = mi.load_dict(_numbers(plugin))
    except Exception as error:
        reason = " ".join(str(error).split())
        raise UserError(f"Mitsuba refuses it: {reason[:160]}", where=where, expected=expected) from None
    if not isinstance(inner, mi.BSDF):
        raise UserError(f"{plugin['type']!r} is not a BSDF", where=where, expected=expected)
    try:
        return mi.load_dict({"type": "twosided", "inner": inner})
    except Exception:
        # what lets light through has two sides by itself
        return inner


def _numbers(value: PluginDict) -> PluginDict:
    """Return a dictionary of TOML as Mitsuba wants it: an integer may be meant as a number."""
    return {
        key: _numbers(item) if isinstance(item, dict) else float(item) if type(item) is int else item
        for key, item in value.items()
    }


COLUMNS, ROWS = 128, 65
SUBSAMPLES = 2
_RINGS, _TURNS = 8, 16
_SUN_NODES = 128


@dataclass(frozen=True)
class Sunlight:
    """The Sun's irradiance at the camera in a solar band, as radiance and as energy count it [W m-2].

    ``wavelength_um``, ``weight``: where the light is, for what reflects it.
    """

    irradiance: float
    energy_irradiance: float
    wavelength_um: list[float]
    weight: list[float]


@dataclass(frozen=True)
class SkyLight:
    """All light that falls on parts at one place.

    ``earth``, ``earth_energy``: radiance by band and energy radiance by solar band, (ROWS, COLUMNS) float32; ``sun``:
    by solar band; ``itrs_from_map``: (3, 3), from the axes of Mitsuba's ``envmap``.
    """

    earth: dict[str, NDArray[np.float32]]
    earth_energy: dict[str, NDArray[np.float32]]
    sun: dict[str, Sunlight]
    itrs_from_map: FloatArray


def sky_light(integrator: Any, r_itrs: FloatArray, film: Any) -> SkyLight:
    """Return what shines on parts at the place of a camera (``r_itrs``, shape (3,)); ``film`` may be any."""
    down = -r_itrs / np.linalg.norm(r_itrs)
    across = perpendicular(down)
    itrs_from_map = np.column_stack([across, down, np.cross(across, down)])
    # rows from pole to pole, columns about their middles: Mitsuba's points
    camera = CameraModel(
        COLUMNS,
        ROWS,
        COLUMNS / math.tau,
        (ROWS - 1) / math.pi,
        -0.5,
        (ROWS - 1) / 2,
        projection="equal_angle",
    )
    sensor = mitsuba_sensor(CameraSettings(camera, r_itrs, itrs_from_map), film)
    view = replace(integrator.apparent_view(sensor), subsamples=SUBSAMPLES)
    prepared, settings = integrator.prepared, integrator.settings
    cells = replace(group_cells(view), sun=None, moon=None)
    radiance, energy = render_bands(
        view,
        prepared.batches,
        integrator.bands,
        settings.nodes,
        prepared.thermal,
        prepared.model.emission,
        settings.tables_digest if settings.method == "table" else None,
        settings.accuracy,
        cells,
    )
    earth, earth_energy = (
        {band: np.array(values, dtype=np.float32).reshape(ROWS, COLUMNS) for band, values in images.items()}
        for images in (radiance, energy)
    )
    return SkyLight(earth, earth_energy, _sunlight(integrator, view), itrs_from_map @ np.diag([1.0, -1.0, -1.0]))


def _sunlight(integrator: Any, view: Any) -> dict[str, Sunlight]:
    terms: dict[str, list[tuple[float, float, float, float]]] = {band: [] for band in integrator.solar_bands}
    sun = np.array([float(c[0]) for c in view.sun])
    points, mu = _disc_points(sun, float(view.sun_radius[0]))
    d = vectors(points)
    mid, _, meets = view.planet.chord(view.origin, d)
    hidden = np.broadcast_to(np.array(meets & (mid > 0.0)), (len(points),))
    for group, batch in integrator.prepared.batches:
        if not isinstance(batch, SolarNodes):
            continue
        _, through = march(
            view.planet, view.top_m, batch, view.origin, d, view.sun, mi.Bool(False), _SUN_NODES, SOLAR_CONCENTRATION
        )
        dr.eval(through)
        for node, t in zip(group, through, strict=False):
            light = sum(a * mu**k for k, a in enumerate(node.limb_darkening)) * np.ones_like(mu)
            seen = np.where(hidden, 0.0, np.broadcast_to(np.array(t), mu.shape))
            share = float(np.sum(light * seen) / np.sum(light))
            reaches = node.solar_irradiance * share
            whole = node.weight * node.solar_irradiance
            ratio = node.energy_ratio
            terms[node.band].append((node.weight * reaches, node.weight * ratio * reaches, node.wavelength_um, whole))
    return {band: _summed(values) for band, values in terms.items()}


def _summed(terms: Sequence[tuple[float, float, float, float]]) -> Sunlight:
    irradiance, energy = sum(t[0] for t in terms), sum(t[1] for t in terms)
    # a Sun that is gone reddens nothing
    weight = [t[0] for t in terms] if irradiance > 0.0 else [t[3] for t in terms]
    return Sunlight(irradiance, energy, [t[2] for t in terms], weight)


def _disc_points(centre: FloatArray, radius_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return directions over the disc, each for the same area, shape (n, 3), and mu, shape (n,)."""
    r = np.sqrt((np.arange(_RINGS) + 0.5) / _RINGS)
    turn = math.tau * (np.arange(_TURNS) + 0.5) / _TURNS
    x, y = (np.outer(r, f(turn)).ravel() * math.tan(radius_rad) for f in (np.cos, np.sin))
    d = centre + np.column_stack([x, y]) @ tangent_basis(centre).T
    return d / np.linalg.norm(d, axis=1)[:, None], np.sqrt(1.0 - np.repeat(r, _TURNS) ** 2)


def sun_emitter(direction: FloatArray, angular_radius_rad: float) -> Any:
    """Return the emitter; ``direction``: unit vector towards the Sun's centre in the scene's axes, shape (3,)."""
    return _plugin(mi.variant())(mi.Properties("part_sun"), direction, angular_radius_rad)


@cache
def _plugin(variant: str) -> type:
    """Return the class for a variant (its base class depends on it)."""

    class PartSun(mi.Emitter):
        def __init__(self, props: mi.Properties, direction: FloatArray, angular_radius_rad: float) -> None:
            super().__init__(props)
            self.m_flags = +mi.EmitterFlags.Infinite
            versine = 2.0 * math.sin(0.5 * angular_radius_rad) ** 2
            x, y, z = (float(c) for c in direction)
            # data, not constants: frames share compiled kernels
            self.centre = mi.Vector3f(*(dr.opaque(mi.Float, c, 1) for c in (x, y, z)))
            self.versine = dr.opaque(mi.Float, versine, 1)
            self.radiance = dr.opaque(mi.Float, 1.0 / (math.pi * math.sin(angular_radius_rad) ** 2), 1)
            self.density = dr.opaque(mi.Float, 1.0 / (2.0 * math.pi * versine), 1)

        def _inside(self, d: Any) -> Any:
            return dr.squared_norm(d - self.centre) <= 2.0 * self.versine

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
            drop = self.versine * sample.x
            sine = dr.sqrt(drop * (2.0 - drop))
            sin_turn, cos_turn = dr.sincos(2.0 * math.pi * sample.y)
            frame = mi.Frame3f(self.centre)
            d = dr.normalize(frame.to_world(mi.Vector3f(sine * cos_turn, sine * sin_turn, 1.0 - drop)))
            ds: Any = dr.zeros(mi.DirectionSample3f)
            ds.dist = mi.Float(1e4)
            ds.p = it.p + d * ds.dist
            ds.n = -d
            ds.d = d
            ds.time = it.time
            ds.delta = mi.Bool(False)
            ds.pdf = self.density
            ds.emitter = mi.EmitterPtr(self)
            return ds, mi.Spectrum(self.radiance / self.density) & active

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return dr.select(self._inside(ds.d), self.density, 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Spectrum(dr.select(self._inside(ds.d), self.radiance, 0.0)) & active

        def eval(self, si: Any, active: Any = True) -> Any:
            return mi.Spectrum(dr.select(self._inside(-si.wi), self.radiance, 0.0)) & active

        def set_scene(self, scene: Any) -> None:
            pass

        def bbox(self) -> mi.ScalarBoundingBox3f:
            return mi.ScalarBoundingBox3f()

        def to_string(self) -> str:
            return "PartSun[]"

    return PartSun


MOST_BOUNCES = 5
LANES = 2**19
"""Rays of one launch."""
SUN_SHARE = 4
"""How many times fewer rays the Sun takes than the Earth."""
ENERGY_SHARE = 16
"""How many times fewer rays give the ratio of energy radiance to radiance, which hardly varies over the Earth."""

Image = FloatArray


@dataclass(frozen=True)
class PartLight:
    """What parts add to a frame: radiance and energy radiance by band, where they cover; distance to them [m]."""

    radiance: dict[str, Image]
    energy: dict[str, Image]
    distance_m: Image


@dataclass(frozen=True)
class _Centres:
    """What rays through the centres of covered pixels meet, shape (n,).

    ``part``: its number, -1 for none; ``normal``, ``place``: of the face, shape (n, 3); ``lit``: whether the Sun's
    centre is in sight; ``distance_m``: along the ray.
    """

    part: NDArray[np.int64]
    normal: FloatArray
    place: FloatArray
    lit: NDArray[np.bool_]
    distance_m: FloatArray


@dataclass(frozen=True)
class PartScene:
    """Parts before a camera, and what lights them.

    ``triangles``: of each part, (n, 3, 3), in camera axes [m]; ``share``: of pixels that parts cover, (H, W);
    ``samples``: rays per pixel for the light of the Earth; ``identity``: of the frame, for the seeds.
    """

    parts: Sequence[SpacecraftPart]
    triangles: Sequence[FloatArray]
    camera: CameraModel
    share: FloatArray
    sky: SkyLight
    cam_from_itrs: FloatArray
    sun_itrs: FloatArray
    sun_angular_radius_rad: float
    samples: int
    identity: str

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Return the pixels that need light."""
        return self.share > 0.0

    def light(self, bands: Sequence[Band]) -> PartLight:
        """Return the light of the parts in some bands; ``UserError`` for a BSDF that Mitsuba refuses."""
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
                unit = self._lit(bsdfs, emitter, few, self._sun_plan)
                total, total_energy = unit * sun.irradiance, unit * sun.energy_irradiance
            radiant, energetic = self._earthlit(bsdfs, self.sky.earth[band.name], self.sky.earth_energy[band.name])
            radiance[band.name], energy[band.name] = total + radiant, total_energy + energetic
        return PartLight(radiance, energy, self._distance_m())

    def _earthlit(
        self, bsdfs: Sequence[Any], radiance: NDArray[np.float32], energy: NDArray[np.float32]
    ) -> tuple[Image, Image]:
        """Return the light of the Earth, as radiance and as energy count it.

        Energy is the radiance times their mean ratio, plus the deviation from it along fewer rays, the same for both.
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

    def _lit(
        self, bsdfs: Sequence[Any], emitter: Any, samples: int | None = None, plan: PixelPlan | None = None
    ) -> Image:
        """Return the mean radiance under an emitter of the rays that meet parts, shape (H, W).

        ``plan``: of the pixels that have rays, by default the one for the light of the Earth. With fewer ``samples``
        than usual noise says nothing of where light changes.
        """
        scene = self._scene(bsdfs, emitter)
        integrator = mi.load_dict({"type": "path", "max_depth": MOST_BOUNCES + 1, "rr_depth": 64})
        across = math.isqrt((samples or self.samples) - 1) + 1
        each = max(LANES // across**2, 1)
        plan, compared = plan or self._earth_plan, samples is None
        total, met = np.zeros(self.covered.size), np.zeros(self.covered.size)

        def follow(pixels: NDArray[np.int64]) -> None:
            for first in range(0, len(pixels), each):
                part = pixels[first : first + each]
                total[part], met[part] = self._batch(scene, integrator, part, across, int(part[0]))

        follow(plan.sampled)
        mean = total / np.maximum(met, 1.0)
        rough = plan.rough(mean) & compared
        follow(plan.between[rough])
        even = plan.between[~rough]
        total[even], met[even] = plan.mean(mean)[~rough], 1.0
        return self._image(total[self.covered.ravel()], met[self.covered.ravel()])

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

    @cached_property
    def _bare(self) -> tuple[Any, FloatArray]:
        """Return the parts alone, and the number of the part of every shape of Mitsuba's."""
        scene = self._scene([mi.load_dict({"type": "diffuse"}) for _ in self.parts])
        return scene, np.array([float(shape.id().rsplit("_", 1)[-1]) for shape in scene.shapes()])

    @cached_property
    def _centres(self) -> _Centres:
        """Return what the rays through the centres of covered pixels meet."""
        (scene, order), pixels = self._bare, np.flatnonzero(self.covered)
        ray = self._rays(pixels, 1)
        meeting = scene.ray_intersect_preliminary(ray)
        meets = np.broadcast_to(np.array(meeting.is_valid()), pixels.shape)
        shape, face = (
            np.where(meets, np.broadcast_to(np.array(v, dtype=np.int64), pixels.shape), 0)
            for v in (meeting.shape_index, meeting.prim_index)
        )
        part = order.astype(np.int64)[shape]
        corners = [t.reshape(-1, 3, 3) for t in self.triangles]
        normals = np.concatenate([np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in corners])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        normal = normals[np.concatenate([[0], np.cumsum([len(t) for t in corners])])[part] + face]
        direction = np.stack([np.broadcast_to(np.array(c, dtype=float), pixels.shape) for c in ray.d], axis=1)
        # faces have no inside
        normal *= -np.sign(np.einsum("ni,ni->n", normal, direction))[:, None]
        sun = mi.Vector3f(*(float(c) for c in self.cam_from_itrs @ self.sun_itrs))
        shadow = scene.ray_test(meeting.compute_surface_interaction(ray).spawn_ray(sun), meeting.is_valid())
        distance = np.broadcast_to(np.where(meets, np.array(meeting.t, dtype=float), math.inf), pixels.shape)
        lit = ~np.broadcast_to(np.array(shadow), pixels.shape)
        place = np.where(meets, distance, 0.0)[:, None] * direction
        return _Centres(np.where(meets, part, -1), normal, place, lit, distance)

    def _plan(self, kinds: Sequence[str], *, shadows: bool) -> PixelPlan:
        """Return which pixels have rays; parts of some kinds of surface are matt; ``shadows``: whether they matter."""
        at, size = self._centres, self.covered.size
        matt = np.array([self._kind(part) in kinds for part in self.parts] + [False])[at.part]
        matt &= self.share[self.covered] > 1.0 - 1e-9
        key = np.full(size, -1, dtype=np.int64)
        normal, place = np.zeros((size, 3)), np.zeros((size, 3))
        pixels = np.flatnonzero(self.covered)
        if shadows:
            dark, bright = (np.full(self.covered.shape, fill) for fill in (1, 0))
            dark[self.covered] = bright[self.covered] = at.lit
            side = 4 * STRIDE + 1
            matt &= (minimum_filter(dark, side) == maximum_filter(bright, side))[self.covered]
        key[pixels] = np.where(matt, at.part, -1)
        normal[pixels], place[pixels] = at.normal, at.place
        return PixelPlan.of(Faces(key, normal, place), self.covered)

    @cached_property
    def _earth_plan(self) -> PixelPlan:
        return self._plan(("lambert", "metal"), shadows=False)

    @cached_property
    def _sun_plan(self) -> PixelPlan:
        """Return the plan for sunlight, which casts shadows, and of which rough metal has highlights."""
        return self._plan(("lambert",), shadows=True)

    @staticmethod
    def _kind(part: SpacecraftPart) -> str:
        if part.bsdf is None:
            return SURFACES[part.material].kind
        return "lambert" if part.bsdf["type"] == "diffuse" and _is_even(part.bsdf) else "other"

    def _emitted(self, band: Band) -> Image:
        """Return what parts emit in a thermal band, shape (H, W), mean over the rays that meet them."""
        across = min(math.isqrt(self.samples - 1) + 1, 8)
        pixels = np.flatnonzero(self.covered)
        each = max(LANES // across**2, 1)
        scene, shapes = self._bare
        own = [emissivity_of(p) * _black(band, p.temperature_k) for p in self.parts]
        own_table = table_of(mi.Float64, np.array(own))
        order = table_of(mi.Float64, shapes)
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
        image = np.full(self.covered.shape, math.inf)
        image[self.covered] = self._centres.distance_m
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


def _is_even(bsdf: PluginDict) -> bool:
    """Return whether a BSDF is the same everywhere: its parameters are numbers."""
    return all(isinstance(value, (int, float, str)) for value in bsdf.values())


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


def with_parts(
    frame: RadianceFrame, scene: SceneSpec, camera: CameraSpec, model: CameraModel, sky: SkyLight
) -> RadianceFrame:
    """Return a frame with its scene's parts in it; ``UserError`` for a BSDF that Mitsuba refuses."""
    truth = frame.truth
    assert truth.part_outline is not None
    share = coverage(truth.part_outline, model)
    parts = PartScene(
        scene.part,
        part_triangles(scene.part, truth.q_cam_from_body),
        model,
        share,
        sky,
        Rotation.from_quat(truth.q_cam_from_itrs).as_matrix(),
        np.array(truth.sun_itrs),
        truth.sun_angular_radius_rad,
        scene.render.part_samples,
        truth.scene_id,
    )
    light = parts.light([band for band in camera.band if band.name in frame.radiance])

    def laid_over(behind: dict[str, np.ndarray], before: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        mixed = {band: share * before[band] + (1.0 - share) * image for band, image in behind.items()}
        return {band: np.asarray(image, dtype=np.float32) for band, image in mixed.items()}

    radiance = laid_over(frame.radiance, light.radiance)
    energy = laid_over(frame.energy_radiance, light.energy)
    thermal = {band.name for band in camera.band if band.kind == "thermal"}
    energy = {band: radiance[band] if band in thermal else image for band, image in energy.items()}
    maps = frame.maps
    if maps:
        maps = _maps(frame.maps, truth, model, share, light.distance_m)
    render = frame.render | {"part_samples": scene.render.part_samples}
    return replace(
        frame, radiance=radiance, energy_radiance=energy, maps=maps, render=render, behind=dict(frame.radiance)
    )


def _maps(
    maps: dict[str, np.ndarray], truth: FrameTruth, model: CameraModel, share: np.ndarray, distance_m: np.ndarray
) -> dict[str, np.ndarray]:
    assert truth.part_outline is not None
    candidates = np.flatnonzero(share > 0.0)
    middle = np.zeros(share.size, dtype=bool)
    middle[candidates] = truth.part_outline.covers(unproject(model, pixel_grid(model).reshape(-1, 2)[candidates]))
    behind = middle.reshape(share.shape)
    hit = np.where(behind, np.float32(Hit.PART), maps["hit"])
    # where single precision just misses a part, its neighbours say how far it is
    near = np.where(np.isfinite(distance_m), distance_m, _nearest(distance_m))
    return maps | {
        "hit": hit,
        "distance": np.where(behind, near, maps["distance"]).astype(np.float32),
        PART_MAP: share.astype(np.float32),
    }


def _nearest(values: np.ndarray) -> np.ndarray:
    from scipy.ndimage import distance_transform_edt

    known = np.isfinite(values)
    if not known.any():
        return values
    index = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(index)])
