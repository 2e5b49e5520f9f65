"""Parts laid over a frame: ``L = c L_part + (1 - c) L_earth``, with the exact covered share c of every pixel.

The share is that of the truth (:mod:`horizonval.geometry.part`), not of the rays that light the parts.

**Surfaces by name** have a reflectance at a few wavelengths, linear between them. It is read off typical published
curves (Henninger, Solar absorptance and thermal emittance of some common spacecraft thermal-control coatings, NASA RP
1121, 1984) with an uncertainty of 0.05: coatings differ from maker to maker, and age. Roughness is an assumption. In
thermal bands every surface is a grey Lambert one.

**Light of parts** comes from stock Mitsuba's surfaces, in a scene metres large, in camera axes with the camera at its
origin, so that single precision serves. Rays are the camera's rays, spread over each pixel; a pixel's light is the mean
over those that meet a part. Pixels that no ray met take the light of the nearest pixel that has some. Rays go where the
light changes (:mod:`horizonval.renderer.part_pixels`).

- *The Earth and the sky*: each ray is followed from part to part until it leaves for the sky. Where it leaves does not
  depend on the attitude, so the ways are followed once for a camera and its parts; every frame only reads a map of the
  sky there. The map is our rendered picture all round from the same place, in longitude and latitude about the nadir,
  so that the limb runs along a row and is covered exactly. It has neither Sun nor Moon; moonlight is neglected.
- *Heat* that parts emit, and that other parts reflect, is added along the same ways.
- *The Sun* is rendered for every frame by Mitsuba's ``path``, dimmed by the share of its disc that the Earth hides and
  by the air before it, mean over points of the disc along straight rays. It is a disc at infinity of unit irradiance.
  Stock Mitsuba has no such emitter: ``directional`` is a point, which no mirror shows; a far sphere loses 0.2 % in
  single precision. Directions are sampled evenly over the disc, in ``1 - cos``, in double precision.

Light goes from part to part at most :data:`MOST_BOUNCES` times. Seeds depend on the parts and the camera, so that equal
frames are equal to the last bit. Noise of a pixel's light on an open Lambert panel is 0.1 to 0.6 % under an even Earth
with 256 rays, and 2e-4 under the Sun; light that comes from part to part, or from a metal, is noisier.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.digests import content_digest
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
from horizonval.renderer.planet import dot
from horizonval.renderer.plugins import CameraSettings, mitsuba_sensor
from horizonval.renderer.table_store import TABLES
from horizonval.renderer.tables import table_of, vectors
from horizonval.renderer.types import PluginDict, Vec3, constant_vector, in_single
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
    by solar band; ``itrs_from_map``: (3, 3), from the axes of the map's camera, whose y points down.
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
    return SkyLight(earth, earth_energy, _sunlight(integrator, view), itrs_from_map)


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
        _, through = march(view.planet, view.top_m, batch, view.origin, d, view.sun, mi.Bool(False), _SUN_NODES)
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


@cache
def _plugin(variant: str) -> type:
    """Return the class for a variant (its base class depends on it)."""

    class PartSun(mi.Emitter):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_flags = +mi.EmitterFlags.Infinite
            # Mitsuba traces the Suns of all scenes in memory
            self.put(np.array([0.0, 0.0, 1.0]), 0.005)

        def put(self, direction: FloatArray, angular_radius_rad: float) -> None:
            """Put the Sun's centre into a direction of the scene, shape (3,)."""
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
SUN_SHARE = 7
"""How many times fewer rays the Sun takes than the Earth."""

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

    ``part``: its number, -1 for none; ``normal``, ``place``: of the face, shape (n, 3); ``distance_m``: along the ray;
    ``surface``: the same for Mitsuba.
    """

    part: NDArray[np.int64]
    normal: FloatArray
    place: FloatArray
    distance_m: FloatArray
    surface: Any


@dataclass(frozen=True)
class _Ways:
    """Ways on which light of the sky comes to some ``pixels``, the same number for each.

    ``direction``: into the sky, in camera axes; ``weight``: share of the light that parts hand on, 0 for rays that meet
    no part; ``met``: of each pixel, how many meet one; ``emitted``: mean radiance that the parts emit along these.
    """

    pixels: NDArray[np.int64]
    direction: Vec3[mi.Float32]
    weight: mi.Float32
    met: FloatArray
    emitted: FloatArray


@dataclass(frozen=True)
class PartScene:
    """Parts before a camera.

    ``triangles``: of each part, (n, 3, 3), in camera axes [m]; ``share``: of pixels that parts cover, (H, W);
    ``samples``: rays per pixel for the light of the Earth; ``identity``: for the seeds.
    """

    parts: Sequence[SpacecraftPart]
    triangles: Sequence[FloatArray]
    camera: CameraModel
    share: FloatArray
    samples: int
    identity: str
    _scenes: dict[str, tuple[Any, Any]] = field(default_factory=dict)
    _ways_of: dict[str, list[_Ways]] = field(default_factory=dict)

    @cached_property
    def covered(self) -> NDArray[np.bool_]:
        """Return the pixels that need light."""
        return self.share > 0.0

    @property
    def nbytes(self) -> int:
        """Return the memory of the ways."""
        return sum(16 * dr.width(part.weight) for ways in self._ways_of.values() for part in ways)

    def light(
        self, bands: Sequence[Band], sky: SkyLight, cam_from_itrs: FloatArray, sun_itrs: FloatArray, radius_rad: float
    ) -> PartLight:
        """Return the light of the parts in some bands; the last two are the Sun's."""
        radiance: dict[str, Image] = {}
        energy: dict[str, Image] = {}
        map_from_cam = (cam_from_itrs @ sky.itrs_from_map).T
        for band in bands:
            name = band.name
            if band.kind == "thermal":
                own = [emissivity_of(p) * _black(band, p.temperature_k) for p in self.parts]
                ways = self._ways(name, [thermal_bsdf(part) for part in self.parts], own)
                radiance[name] = energy[name] = self._sky_light(ways, sky.earth[name], map_from_cam)
                continue
            light = sky.sun[name]
            bsdfs = [
                solar_bsdf(part, light.wavelength_um, light.weight, f"part[{i}] ({part.name})")
                for i, part in enumerate(self.parts, start=1)
            ]
            ways = self._ways(name, bsdfs, [0.0] * len(bsdfs))
            radiance[name] = self._sky_light(ways, sky.earth[name], map_from_cam)
            energy[name] = self._sky_light(ways, sky.earth_energy[name], map_from_cam)
            if light.irradiance > 0.0:
                unit = self._sunlight(name, bsdfs, cam_from_itrs @ sun_itrs, radius_rad)
                radiance[name] += unit * light.irradiance
                energy[name] += unit * light.energy_irradiance
        return PartLight(radiance, energy, self._distance_m())

    def _scene(self, band: str, bsdfs: Sequence[Any]) -> tuple[Any, Any]:
        """Return Mitsuba's scene of a band, and the Sun in it."""
        if band not in self._scenes:
            sun = _plugin(mi.variant())(mi.Properties("part_sun"))
            shapes = {f"part_{i}": _mesh(t, b) for i, (t, b) in enumerate(zip(self.triangles, bsdfs, strict=True))}
            self._scenes[band] = mi.load_dict({"type": "scene", "light": sun, **shapes}), sun
        return self._scenes[band]

    def _ways(self, band: str, bsdfs: Sequence[Any], own: Sequence[float]) -> list[_Ways]:
        """Return the ways to the pixels of the Earth's plan; ``own``: radiance that each part emits."""
        scene, _ = self._scene(band, bsdfs)
        if band not in self._ways_of:
            by_shape = table_of(mi.Float64, np.array(own)[_numbers_of(scene)])
            across, pixels = math.isqrt(self.samples - 1) + 1, self._earth_plan.sampled
            each = max(LANES // across**2, 1)
            self._ways_of[band] = [
                self._followed(scene, pixels[first : first + each], across**2, by_shape)
                for first in range(0, len(pixels), each)
            ]
        return self._ways_of[band]

    def _followed(self, scene: Any, pixels: NDArray[np.int64], count: int, own: mi.Float64) -> _Ways:
        """Return the ways of pixels, backwards from the camera until they leave the parts."""
        sampler = self._sampler(pixels, count)
        ray, context = self._rays(pixels, count, sampler.next_2d()), mi.BSDFContext()
        lanes = dr.width(ray.d)

        def follow(
            sampler: Any, ray: Any, weight: mi.Float32, glow: mi.Float64, bounces: mi.UInt32, going: mi.Bool
        ) -> tuple[Any, ...]:
            meeting = scene.ray_intersect_preliminary(ray, active=going)
            meets = meeting.is_valid()
            si = meeting.compute_surface_interaction(ray, active=meets)
            glow = dr.fma(mi.Float64(weight), dr.gather(mi.Float64, own, meeting.shape_index, meets), glow)
            ended = meets & (bounces == MOST_BOUNCES)
            going = meets & ~ended
            sample, value = si.bsdf().sample(context, si, sampler.next_1d(going), sampler.next_2d(going), going)
            weight = dr.select(going, weight * value[0], dr.select(ended, 0.0, weight))
            following = si.spawn_ray(si.to_world(sample.wo))
            ray.o, ray.d = dr.select(going, following.o, ray.o), dr.select(going, following.d, ray.d)
            return sampler, ray, weight, glow, bounces + dr.select(going, mi.UInt32(1), 0), going & (weight > 0.0)

        whole, dark, none = dr.ones(mi.Float, lanes), dr.zeros(mi.Float64, lanes), dr.zeros(mi.UInt32, lanes)
        state: tuple[Any, ...] = sampler, mi.Ray3f(ray), whole, dark, none, dr.full(mi.Bool, True, lanes)
        _, ray, weight, glow, bounces, _ = dr.while_loop(state, lambda *s: s[-1], follow, label="ways to the sky")
        weight = dr.select(bounces > 0, weight, 0.0)
        met = dr.select(bounces > 0, mi.Float64(1.0), 0.0)
        dr.eval(ray.d, weight, glow, met)
        hits, emitted = (np.array(dr.block_sum(v, count)) for v in (met, glow))
        return _Ways(pixels, (ray.d.x, ray.d.y, ray.d.z), weight, hits, emitted / np.maximum(hits, 1.0))

    def _sky_light(self, ways: Sequence[_Ways], sky: NDArray[np.float32], map_from_cam: FloatArray) -> Image:
        """Return the light of parts under a map of the sky."""
        total, met = np.zeros(self.covered.size), np.zeros(self.covered.size)
        table, rows = table_of(mi.Float32, sky), [constant_vector(row) for row in map_from_cam]
        for part in ways:
            light = np.zeros(len(part.pixels))
            if sky.any():
                x, y, z = (dot(part.direction, in_single(row)) for row in rows)
                found = mi.Float64(part.weight * _on_map(table, x, y, z))
                dr.eval(found)
                light = np.array(dr.block_sum(found, dr.width(found) // len(part.pixels)))
            total[part.pixels] = light / np.maximum(part.met, 1.0) + part.emitted
            met[part.pixels] = part.met
        return self._image(self._earth_plan, total, met)

    def _sunlight(self, band: str, bsdfs: Sequence[Any], direction: FloatArray, radius_rad: float) -> Image:
        """Return the mean radiance under a Sun of unit irradiance of the rays that meet parts, shape (H, W)."""
        scene, sun = self._scene(band, bsdfs)
        sun.put(direction, radius_rad)
        integrator = mi.load_dict({"type": "path", "max_depth": MOST_BOUNCES + 1, "rr_depth": 64})
        across = math.isqrt(max(self.samples // SUN_SHARE, 1) - 1) + 1
        count, each = across**2, max(LANES // across**2, 1)
        plan = self._plan(
            ("lambert",),
            scene.ray_test(self._centres.surface.spawn_ray(mi.Vector3f(*in_single(constant_vector(direction))))),
        )
        total, met = np.zeros(self.covered.size), np.zeros(self.covered.size)
        for first in range(0, len(plan.sampled), each):
            pixels = plan.sampled[first : first + each]
            sampler = self._sampler(pixels, count)
            ray = self._rays(pixels, count, sampler.next_2d())
            hit = scene.ray_test(ray)
            light, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(ray), None, hit)
            value, valid = dr.select(hit, mi.Float64(light[0]), 0.0), dr.select(hit, mi.Float64(1.0), 0.0)
            # together: every sum would follow the rays again
            dr.eval(value, valid)
            lit, met[pixels] = (np.array(dr.block_sum(v, count)) for v in (value, valid))
            total[pixels] = lit / np.maximum(met[pixels], 1.0)
        return self._image(plan, total, met)

    def _sampler(self, pixels: NDArray[np.int64], count: int) -> Any:
        sampler = mi.load_dict({"type": "multijitter", "sample_count": count})
        sampler.set_samples_per_wavefront(count)
        key = f"light on parts\0{self.identity}\0{pixels[0]}".encode()
        sampler.seed(int.from_bytes(hashlib.sha256(key).digest()[:4], "little"), len(pixels) * count)
        return sampler

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
    def _centres(self) -> _Centres:
        """Return what the rays through the centres of covered pixels meet."""
        (scene, _), pixels = next(iter(self._scenes.values())), np.flatnonzero(self.covered)
        ray = self._rays(pixels, 1)
        meeting = scene.ray_intersect_preliminary(ray)
        meets = np.broadcast_to(np.array(meeting.is_valid()), pixels.shape)
        shape, face = (
            np.where(meets, np.broadcast_to(np.array(v, dtype=np.int64), pixels.shape), 0)
            for v in (meeting.shape_index, meeting.prim_index)
        )
        part = _numbers_of(scene)[shape]
        corners = [t.reshape(-1, 3, 3) for t in self.triangles]
        normals = np.concatenate([np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in corners])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        normal = normals[np.concatenate([[0], np.cumsum([len(t) for t in corners])])[part] + face]
        direction = np.stack([np.broadcast_to(np.array(c, dtype=float), pixels.shape) for c in ray.d], axis=1)
        # faces have no inside
        normal *= -np.sign(np.einsum("ni,ni->n", normal, direction))[:, None]
        distance = np.broadcast_to(np.where(meets, np.array(meeting.t, dtype=float), math.inf), pixels.shape)
        place = np.where(meets, distance, 0.0)[:, None] * direction
        return _Centres(np.where(meets, part, -1), normal, place, distance, meeting.compute_surface_interaction(ray))

    def _plan(self, kinds: Sequence[str], dark: Any = None) -> PixelPlan:
        """Return which pixels have rays; parts of some kinds of surface are matt; ``dark``: shadows at the centres."""
        at, size = self._centres, self.covered.size
        matt = np.array([self._kind(part) in kinds for part in self.parts] + [False])[at.part]
        matt &= self.share[self.covered] > 1.0 - 1e-9
        key = np.full(size, -1, dtype=np.int64)
        normal, place = np.zeros((size, 3)), np.zeros((size, 3))
        pixels = np.flatnonzero(self.covered)
        if dark is not None:
            low, high = (np.full(self.covered.shape, fill) for fill in (1, 0))
            low[self.covered] = high[self.covered] = np.broadcast_to(np.array(dark), pixels.shape)
            side = 4 * STRIDE + 1
            matt &= (minimum_filter(low, side) == maximum_filter(high, side))[self.covered]
        key[pixels] = np.where(matt, at.part, -1)
        normal[pixels], place[pixels] = at.normal, at.place
        return PixelPlan.of(Faces(key, normal, place), self.covered)

    @cached_property
    def _earth_plan(self) -> PixelPlan:
        """Return the plan for the light of the Earth, without the shadows and highlights of sunlight."""
        return self._plan(("lambert", "metal"))

    @staticmethod
    def _kind(part: SpacecraftPart) -> str:
        if part.bsdf is None:
            return SURFACES[part.material].kind
        return "lambert" if part.bsdf["type"] == "diffuse" and _is_even(part.bsdf) else "other"

    def _distance_m(self) -> Image:
        """Return how far parts are along the rays through pixels' centres, shape (H, W); infinite beside them."""
        image = np.full(self.covered.shape, math.inf)
        image[self.covered] = self._centres.distance_m
        return image

    def _image(self, plan: PixelPlan, light: FloatArray, met: FloatArray) -> Image:
        """Return light by pixel as an image; pixels whose rays met nothing take the nearest light, others are 0."""
        light[plan.between], met[plan.between] = plan.mean(light), 1.0
        image, known = light.reshape(self.covered.shape), (met > 0.0).reshape(self.covered.shape)
        if known.any() and not known[self.covered].all():
            nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
            image = np.where(self.covered, image[tuple(nearest)], 0.0)
        return image


def _numbers_of(scene: Any) -> NDArray[np.int64]:
    """Return the number of the part of every shape of a scene."""
    return np.array([int(shape.id().rsplit("_", 1)[-1]) for shape in scene.shapes()])


def _on_map(table: mi.Float32, x: mi.Float32, y: mi.Float32, z: mi.Float32) -> mi.Float32:
    """Return a map of the sky in directions of its axes, of which y is down: linear in longitude and latitude."""
    v = dr.asin(dr.clip(y, -1.0, 1.0)) * ((ROWS - 1) / math.pi) + 0.5 * (ROWS - 1)
    u = dr.atan2(x, z) * (COLUMNS / math.tau) - 0.5
    u = dr.select(u < 0.0, u + COLUMNS, u)
    i, j = dr.minimum(mi.UInt32(v), ROWS - 2), dr.minimum(mi.UInt32(u), COLUMNS - 1)
    row, after = i * COLUMNS, dr.select(j == COLUMNS - 1, 0, j + 1)
    low, high = (
        dr.lerp(dr.gather(mi.Float32, table, k + j), dr.gather(mi.Float32, table, k + after), u - mi.Float32(j))
        for k in (row, row + COLUMNS)
    )
    return dr.lerp(low, high, v - mi.Float32(i))


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
    triangles, samples = part_triangles(scene.part, truth.q_cam_from_body), scene.render.part_samples
    what = [part.model_dump_json() for part in scene.part]
    bands = [band for band in camera.band if band.name in frame.radiance]
    named = [(band.model_dump_json(), sky.sun.get(band.name)) for band in bands]
    key = content_digest("light on parts", what, triangles, model, share, samples, named, mi.variant())
    parts = TABLES.get_or_make(
        key,
        lambda: PartScene(scene.part, triangles, model, share, samples, key),
    )
    sun, radius = np.array(truth.sun_itrs), truth.sun_angular_radius_rad
    light = parts.light(bands, sky, Rotation.from_quat(truth.q_cam_from_itrs).as_matrix(), sun, radius)

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
