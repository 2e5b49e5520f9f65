"""What lies at the end of rays: land, snow, ice, water or cloud, and how it reflects the Sun.

Nothing here depends on wavelength but the albedos, so every group of rays is traced once a frame
(:func:`surface_hits`), and each node batch only mixes its albedos with those shares (:meth:`SurfaceHit.reflectance`).
The physics is that of :mod:`horizonval.earth.surface.surface`, written again for the kernel.

Cloud tops are horizontal Lambert reflectors at their height; those of the pattern of the Earth hand on to the ground
below what they do not reflect, as diffuse light: snow under them does not shine forward. That thin ones let part of the
beam through as it is is left out. Where a cloud stands before the Sun, ground and clouds have of its beam what the
cloud lets through: one ray to the Sun's centre decides. Facets of the sea reflect the Sun's beam to the camera;
skylight sees them as an albedo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace

import drjit as dr
import mitsuba as mi

from horizonval.earth.clouds.relief import BASE_M
from horizonval.earth.surface import ground_map, surface
from horizonval.earth.surface.surface import Albedos, GroundModel
from horizonval.renderer.ground.cover import GroundTable, Places, cover, luminance
from horizonval.renderer.ground.reflectance import fresnel, glint_brdf, snow_factor
from horizonval.renderer.kernel.clouds import CloudTable, cloud_table, first_cloud, first_cloud_and_turn
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.refraction.bending import BendingField
from horizonval.renderer.refraction.ray_end import ray_end
from horizonval.renderer.tables import table_of
from horizonval.renderer.types import Values, Vec, constant


@dataclass(frozen=True)
class Ground:
    """Ground and clouds of a frame.

    ``table``: what covers an "earth". ``pieces``: how many a belt of a chequered ground has.
    """

    model: GroundModel
    table: GroundTable | None
    clouds: CloudTable | None
    pieces: mi.Float64 | None = None


@dataclass(frozen=True)
class SurfaceHit:
    """Where rays end and what is there.

    Attributes
    ----------
    ends : Bool
        Whether a ray ends on anything at all.
    cloud : Bool
        Whether that is a cloud.
    t : Float64
        Ray parameter of the end where there is a cloud; elsewhere the ray ends where the ellipsoid says.
    sunlit : Float64
        1 where no cloud is before the Sun, else what the first lets through: nothing, if clouds are opaque.
    shares : dict of Float64
        Share of every material in the end's area: keys of Albedos. A cloud counts with its brightness.
    entering : Float64
        Share of the beam that enters water, over its mean for skylight; scales what comes back from below the surface.
    glint : Float64
        Reflectance of the sea's facets [1/sr].
    forward : Float64
        Radiance of snow in the Sun's beam over that of a Lambert surface; 1 under clouds, whose light is diffuse.
    bending : Float64 or None
        By how much a ray has turned at its end [rad]; None without refraction.
    lamps : Float64 or None
        Luminance of cities [lm m-2 sr-1], under the Sun; None where none shine.
    albedos : list of Albedos
        Of the spectral nodes at hand; size-1 arrays.
    """

    ends: mi.Bool
    cloud: mi.Bool
    t: mi.Float64
    sunlit: mi.Float64
    shares: dict[str, mi.Float64]
    entering: mi.Float64
    glint: mi.Float64
    forward: mi.Float64
    bending: mi.Float64 | None = None
    lamps: mi.Float64 | None = None
    albedos: tuple[dict[str, mi.Float64], ...] = ()

    def at(self, model: GroundModel, wavelength_um: Sequence[float], width: int) -> SurfaceHit:
        """Return the same for the nodes of a batch, padded to its width."""
        nodes = [surface.albedos(model, w) for w in wavelength_um]
        nodes += [Albedos(*(0.0,) * len(fields(Albedos)))] * (width - len(nodes))
        return replace(
            self, albedos=tuple({k: dr.opaque(mi.Float64, v, 1) for k, v in asdict(a).items()} for a in nodes)
        )

    def reflectance(self) -> tuple[Values, Values]:
        """Return ``(direct, diffuse)`` per node [1/sr]: radiance per irradiance of the Sun's beam and of the sky."""
        direct, diffuse = [], []
        for a in self.albedos:
            cloud = self.shares["cloud"] * a["cloud"]
            kinds = [k for k in self.shares if k not in ("cloud", "water", "snow", "firn")]
            dry = sum((self.shares[k] * a[k] for k in kinds), start=mi.Float64(0.0))
            if "water" not in self.shares:
                ground = _through(cloud, dry) / math.pi
                direct.append(self.sunlit * ground)
                diffuse.append(ground)
                continue
            wet = self.shares["water"] * a["water"] * self.entering
            icy = self.shares["snow"] * a["snow"] + self.shares["firn"] * a["firn"]
            beam = _through(cloud, dry + wet + icy * self.forward) / math.pi
            direct.append(self.sunlit * (beam + self.glint))
            diffuse.append(_through(cloud, dry + icy + self.shares["water"] * (a["water"] + a["sky"])) / math.pi)
        return direct, diffuse


def _through(cloud: mi.Float64, ground: mi.Float64) -> mi.Float64:
    """Return the albedo of ground under a cloud that absorbs nothing, by the albedos of both (the adding method).

    Albedos of diffuse light, never above 1: with one direction's reflectance of the beam, which may be above, the light
    to and fro between ground and cloud would have no end.
    The ground's is zero under opaque clouds, which let nothing through.
    """
    return cloud + (1.0 - cloud) * (1.0 - cloud) * ground / (1.0 - cloud * ground)


def make_ground(model: GroundModel, planet: Planet, origin: tuple[float, float, float]) -> Ground | None:
    """Return kernel data of a ground seen from ``origin``; None for a Lambert ground, which needs none."""
    if model.plain:
        return None
    table = GroundTable.of(model.month, model.city_lights) if model.kind == "earth" else None
    pieces = table_of(mi.Float64, ground_map.piece_counts(model.square_km)) if model.kind == "chequered" else None
    return Ground(model, table, cloud_table(model.clouds, planet, origin) if model.clouds else None, pieces)


def surface_hits(
    ground: Ground,
    planet: Planet,
    o: Vec,
    d: Vec,
    lights: Sequence[Vec],
    to_ground: bool,
    bending: BendingField | None = None,
) -> list[SurfaceHit]:
    """Find where rays end, under every light.

    ``to_ground``: they all meet the ellipsoid, unless a cloud is before it. ``bending``: with refraction; ``planet``
    and rays are then the apparent ones. Sunlight on its way past clouds goes straight even so: low Suns shine over
    edges of clouds by up to their own diameter from elsewhere.
    """
    count = dr.width(d[0])
    cloud, zero = dr.full(mi.Bool, False, count), dr.zeros(mi.Float64, count)
    t = white = zero
    angle = None
    if ground.clouds is not None:
        cloud, t, angle = first_cloud_and_turn(ground.clouds, planet, o, d, to_ground, bending)
    end = t
    if to_ground:
        mid, half, _ = planet.chord(o, d)
        end = dr.select(cloud, t, mid - half)
    dr.eval(cloud, t, end, angle)
    place = ray_end(planet, bending, o, d, end, angle)
    if ground.clouds is not None:
        white = dr.select(cloud, ground.clouds.brightness(place.height_m, place.vertical), 0.0)
    dr.eval(white, place.vertical, place.direction, place.point, place.bending)
    sunlit = [dr.full(mi.Float64, 1.0, count) for _ in lights]
    if ground.clouds is not None:
        true_planet = planet if bending is None else bending.true_planet
        sunlit = [_sunlit(ground.clouds, true_planet, place.point, light) for light in lights]
        dr.eval(sunlit)
    shares: dict[str, mi.Float64] = {"cloud": white}
    if not to_ground:
        return [SurfaceHit(cloud, cloud, t, lit, shares, zero, zero, zero, place.bending) for lit in sunlit]
    everywhere = dr.full(mi.Bool, True, count)
    # under clouds that let light through the ground is there as well
    bare = dr.select(cloud, mi.Float64(0.0), 1.0)
    clear = mi.Float64(1.0) if ground.clouds is not None and ground.clouds.translucent else bare
    shares |= ground_shares(ground, place.vertical, clear)
    if ground.table is None:
        dr.eval(shares)
        return [SurfaceHit(everywhere, cloud, t, lit, shares, zero, zero, zero, place.bending) for lit in sunlit]
    normal, arriving = place.vertical, place.direction
    wet = shares["water"]
    variance = dr.opaque(mi.Float64, surface.slope_variance(ground.model.wind_speed_m_s), 1)
    hits = []
    for light, lit in zip(lights, sunlit, strict=True):
        mu_sun = dot(normal, light)
        mu_view, cosine = -dot(normal, arriving), -dot(arriving, light)
        glint = wet * bare * glint_brdf(mu_sun, mu_view, cosine, variance)
        forward = dr.select(cloud, 1.0, snow_factor(ground.table.snow, mu_sun, mu_view, cosine))
        entering = (1.0 - fresnel(dr.maximum(mu_sun, 0.0))) / (1.0 - surface.water_sky_albedo())
        hits.append(SurfaceHit(everywhere, cloud, t, lit, shares, entering, glint, forward, place.bending))
    if ground.table.inhabitants is not None:
        lamps = bare * luminance(ground.table, Places.below(normal), dot(normal, lights[0]), -dot(normal, arriving))
        dr.eval(lamps)
        hits[0] = replace(hits[0], lamps=lamps)
    dr.eval(shares, [(hit.entering, hit.glint, hit.forward) for hit in hits])
    return hits


def ground_shares(ground: Ground, normal: Vec, clear: mi.Float64) -> dict[str, mi.Float64]:
    """Return the shares of the ground's materials below unit normals; ``clear``: of the ground that is seen."""
    if ground.table is None:
        if ground.pieces is None:
            return {"ground": clear}
        first = dr.select(is_first_square(ground.pieces, normal), clear, 0.0)
        return {"ground": first, "other": clear - first}
    _, below = cover(ground.table, Places.below(normal))
    foam = dr.opaque(mi.Float64, surface.foam_share(ground.model.wind_speed_m_s), 1)
    shares = {name: clear * share for name, share in below.items()}
    return shares | {"water": shares["water"] * (1.0 - foam), "foam": shares["water"] * foam}


def shares_from_above(ground: Ground, normal: Vec) -> dict[str, mi.Float64]:
    """Return what is seen from straight above unit normals, clouds with their brightness: keys of Albedos.

    No search is needed there: a cloud stands where the relief is above the lowest base.
    """
    white, clear = mi.Float64(0.0), mi.Float64(1.0)
    if ground.clouds is not None:
        top = ground.clouds.top(normal)
        cloud = top > BASE_M
        white = dr.select(cloud, ground.clouds.brightness(top, normal), 0.0)
        clear = clear if ground.clouds.translucent else dr.select(cloud, mi.Float64(0.0), 1.0)
    return {"cloud": white} | ground_shares(ground, normal, clear)


def _sunlit(clouds: CloudTable, planet: Planet, p: Vec, sun: Vec) -> mi.Float64:
    """Return 1 where no cloud is between points and the Sun, else what the first lets through.

    The search begins a step away from the point.
    """
    start = along(p, sun, clouds.step_m)
    shaded, t = first_cloud(clouds, planet, start, sun, to_ground=False)
    if not clouds.translucent:
        return dr.select(shaded, mi.Float64(0.0), 1.0)
    white = clouds.brightness(*planet.height_and_normal(along(start, sun, t)))
    return dr.select(shaded, 1.0 - clouds.field.albedo * white, 1.0)


def is_first_square(pieces: mi.Float64, normal: Vec) -> mi.Bool:
    """Return whether unit normals stand on a square of the first kind (:mod:`horizonval.earth.surface.ground_map`)."""
    # as data: any number of belts shares the kernel
    belts = constant(dr.width(pieces))
    latitude = dr.asin(dr.clip(normal[2], -1.0, 1.0)) * (1.0 / math.pi) + 0.5
    belt = dr.minimum(dr.floor(latitude * belts), belts - 1.0)
    count = dr.gather(mi.Float64, pieces, mi.UInt32(belt))
    longitude = dr.atan2(normal[1], normal[0]) * (0.5 / math.pi) + 0.5
    number = belt + dr.minimum(dr.floor(longitude * count), count - 1.0)
    return dr.abs(number - 2.0 * dr.floor(0.5 * number)) < 0.5
