"""What lies at the end of rays: land, snow, water or cloud, and how it reflects the Sun.

Nothing here depends on wavelength but the albedos, so every group of rays is traced once a frame
(:func:`surface_hits`), and each node batch only mixes its albedos with those shares (:meth:`SurfaceHit.reflectance`).
The physics is that of :mod:`horizonval.earth.surface.surface`, written again for the kernel.

Cloud tops are horizontal Lambert reflectors at their height. Where a cloud stands before the Sun, ground and clouds are
without its beam: one ray to the Sun's centre decides. Facets of the sea reflect the Sun's beam to the camera; skylight
sees them as an albedo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import drjit as dr
import mitsuba as mi

from horizonval.earth.surface import land, surface
from horizonval.earth.surface.surface import Albedos, GroundModel
from horizonval.renderer.kernel.clouds import CloudTable, brightness, cloud_table, first_cloud
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.refraction.bending import BendingField
from horizonval.renderer.refraction.ray_end import ray_end
from horizonval.renderer.types import Values, Vec


@dataclass(frozen=True)
class Ground:
    """Ground and clouds of a frame. ``land``: the packed map, or None for a uniform ground."""

    model: GroundModel
    land: mi.UInt32 | None
    clouds: CloudTable | None


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
        1 where no cloud is before the Sun, else 0.
    shares : dict of Float64
        Share of every kind of ground in the end's area: keys of Albedos. A cloud counts with its brightness.
    entering : Float64
        Share of the beam that enters water, over its mean for skylight; scales what comes back from below the surface.
    glint : Float64
        Reflectance of the sea's facets [1/sr].
    bending : Float64 or None
        By how much a ray has turned at its end [rad]; None without refraction.
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
    bending: mi.Float64 | None = None
    albedos: tuple[dict[str, mi.Float64], ...] = ()

    def at(self, model: GroundModel, wavelength_um: Sequence[float], width: int) -> SurfaceHit:
        """Return the same for the nodes of a batch, padded to its width."""
        nodes = [surface.albedos(model, w) for w in wavelength_um]
        nodes += [Albedos(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)] * (width - len(nodes))
        return replace(
            self, albedos=tuple({k: dr.opaque(mi.Float64, v, 1) for k, v in asdict(a).items()} for a in nodes)
        )

    def reflectance(self) -> tuple[Values, Values]:
        """Return ``(direct, diffuse)`` per node [1/sr]: radiance per irradiance of the Sun's beam and of the sky."""
        direct, diffuse = [], []
        for a in self.albedos:
            kinds = [k for k in self.shares if k not in ("water", "sky")]
            dry = sum((self.shares[k] * a[k] for k in kinds), start=mi.Float64(0.0))
            if "water" not in self.shares:
                direct.append(self.sunlit * dry / math.pi)
                diffuse.append(dry / math.pi)
                continue
            wet = self.shares["water"] * a["water"] * self.entering
            direct.append(self.sunlit * ((dry + wet) / math.pi + self.glint))
            diffuse.append((dry + self.shares["water"] * (a["water"] + a["sky"])) / math.pi)
        return direct, diffuse


def make_ground(model: GroundModel, planet: Planet, origin: tuple[float, float, float]) -> Ground | None:
    """Return kernel data of a ground seen from ``origin``; None for a Lambert ground, which needs none."""
    if model.plain:
        return None
    words = mi.UInt32(land.packed_words()) if model.kind == "earth" else None
    return Ground(model, words, cloud_table(model.clouds, planet, origin) if model.clouds else None)


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
    if ground.clouds is not None and ground.model.clouds is not None:
        cloud, t = first_cloud(ground.clouds, planet, o, d, to_ground, bending)
    end = t
    if to_ground:
        mid, half, _ = planet.chord(o, d)
        end = dr.select(cloud, t, mid - half)
    dr.eval(cloud, t, end)
    place = ray_end(planet, bending, o, d, end)
    if ground.model.clouds is not None:
        white = dr.select(cloud, brightness(ground.model.clouds, place.height_m, place.vertical), 0.0)
    dr.eval(white, place.vertical, place.direction, place.point, place.bending)
    sunlit = [dr.full(mi.Float64, 1.0, count) for _ in lights]
    if ground.clouds is not None:
        true_planet = planet if bending is None else bending.true_planet
        sunlit = [_sunlit(ground.clouds, true_planet, place.point, light) for light in lights]
        dr.eval(sunlit)
    shares: dict[str, mi.Float64] = {"cloud": white}
    if not to_ground:
        return [SurfaceHit(cloud, cloud, t, lit, shares, zero, zero, place.bending) for lit in sunlit]
    everywhere = dr.full(mi.Bool, True, count)
    clear = dr.select(cloud, mi.Float64(0.0), 1.0)
    if ground.land is None:
        shares["land"] = clear
        return [SurfaceHit(everywhere, cloud, t, lit, shares, zero, zero, place.bending) for lit in sunlit]
    normal, arriving = place.vertical, place.direction
    dry = dr.select(is_land(ground.land, normal), clear, 0.0)
    snow = snow_share(normal, ground.model.snow_line_deg)
    foam = dr.opaque(mi.Float64, surface.foam_share(ground.model.wind_speed_m_s), 1)
    wet = (clear - dry) * (1.0 - foam)
    shares |= {"land": dry * (1.0 - snow), "snow": dry * snow, "water": wet, "foam": (clear - dry) * foam}
    variance = dr.opaque(mi.Float64, surface.slope_variance(ground.model.wind_speed_m_s), 1)
    hits = []
    for light, lit in zip(lights, sunlit, strict=True):
        mu_sun = dot(normal, light)
        glint = wet * glint_brdf(mu_sun, -dot(normal, arriving), -dot(arriving, light), variance)
        entering = (1.0 - fresnel(dr.maximum(mu_sun, 0.0))) / (1.0 - surface.water_sky_albedo())
        hits.append(SurfaceHit(everywhere, cloud, t, lit, shares, entering, glint, place.bending))
    dr.eval(shares, [(hit.entering, hit.glint) for hit in hits])
    return hits


def _sunlit(clouds: CloudTable, planet: Planet, p: Vec, sun: Vec) -> mi.Float64:
    """Return 1 where no cloud is between points and the Sun, else 0. The search begins a step away from the point."""
    start = along(p, sun, clouds.step_m)
    shaded, _ = first_cloud(clouds, planet, start, sun, to_ground=False)
    return dr.select(shaded, mi.Float64(0.0), 1.0)


def is_land(words: mi.UInt32, normal: Vec) -> mi.Bool:
    """Return :func:`horizonval.earth.surface.land.is_land` below unit normals of the ellipsoid."""
    latitude = dr.rad2deg(dr.asin(dr.clip(normal[2], -1.0, 1.0)))
    longitude = dr.rad2deg(dr.atan2(normal[1], normal[0]))
    y = dr.clip((latitude + 90.0) * land.PER_DEGREE - 0.5, 0.0, land.ROWS - 1.0)
    # one turn on: never negative
    x = (longitude + 540.0) * land.PER_DEGREE - 0.5
    i, j = dr.minimum(mi.UInt32(y), land.ROWS - 2), mi.UInt32(x)
    wy, wx = y - mi.Float64(i), x - mi.Float64(j)

    def cell(row: mi.UInt32, column: mi.UInt32) -> mi.Float64:
        bit = row * land.COLUMNS + column % land.COLUMNS
        word = dr.gather(mi.UInt32, words, bit >> 5)
        return mi.Float64((word >> (bit & 31)) & 1)

    low = dr.lerp(cell(i, j), cell(i, j + 1), wx)
    high = dr.lerp(cell(i + 1, j), cell(i + 1, j + 1), wx)
    return dr.lerp(low, high, wy) > 0.5


def snow_share(normal: Vec, line_deg: float) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.surface.snow_share` below unit normals of the ellipsoid."""
    latitude = dr.rad2deg(dr.asin(dr.clip(normal[2], -1.0, 1.0)))
    line = dr.opaque(mi.Float64, line_deg, 1)
    north = dr.clip((latitude - line) * (0.5 / surface.SNOW_EDGE_DEG) + 0.5, 0.0, 1.0)
    return dr.maximum(north, dr.select(latitude < surface.SOUTHERN_SNOW_DEG, mi.Float64(1.0), 0.0))


def fresnel(c: mi.Float64) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.surface.fresnel` of water."""
    g = dr.sqrt(surface.WATER_INDEX**2 - 1.0 + c * c)
    across = (g - c) / (g + c)
    along_ = (c * (g + c) - 1.0) / (c * (g - c) + 1.0)
    return 0.5 * across * across * (1.0 + along_ * along_)


def _hidden(mu: mi.Float64, variance: mi.Float64) -> mi.Float64:
    v = dr.minimum(mu * dr.rsqrt(dr.maximum(1.0 - mu * mu, 1e-12) * variance), 25.0)
    return dr.maximum(0.5 * (dr.exp(-v * v) / (v * math.sqrt(math.pi)) - (1.0 - dr.erf(v))), 0.0)


def glint_brdf(mu_sun: mi.Float64, mu_view: mi.Float64, cosine: mi.Float64, variance: mi.Float64) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.surface.glint_brdf`."""
    up = (mu_sun > 0.0) & (mu_view > 0.0)
    mu_sun, mu_view = dr.clip(mu_sun, 1e-6, 1.0), dr.clip(mu_view, 1e-6, 1.0)
    incidence = dr.sqrt(dr.maximum(0.5 * (1.0 + cosine), 1e-12))
    tilt = (mu_sun + mu_view) / (2.0 * incidence)
    tilt2 = dr.minimum(tilt * tilt, 1.0)
    seen = 1.0 / (1.0 + _hidden(mu_sun, variance) + _hidden(mu_view, variance))
    density = dr.exp((1.0 - 1.0 / tilt2) / variance) / (math.pi * variance)
    return dr.select(up, fresnel(incidence) * density * seen / (4.0 * mu_sun * mu_view * tilt2 * tilt2), 0.0)
