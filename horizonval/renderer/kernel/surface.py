"""What lies at the end of rays: land, snow, ice, water or cloud, and how it reflects the Sun.

Only the albedos depend on wavelength, so every group of rays is traced once a frame (:func:`surface_hits`), and each
node batch mixes its albedos with those shares (:meth:`SurfaceHit.reflectance`). The physics is that of
:mod:`horizonval.earth.surface.surface` and :mod:`horizonval.earth.surface.ground_map`, written again for the kernel.

Cloud tops are horizontal Lambert reflectors at their height; those of the Earth's pattern transmit to the ground
below what they do not reflect, as diffuse light, so that snow under them has no forward peak. Transmission of the
direct beam by thin ones is neglected. Where a cloud stands before the Sun, ground and clouds get the share of the beam
that the cloud transmits: one ray to the Sun's centre decides. Facets of the sea reflect the Sun's beam to the camera;
skylight sees them as an albedo.

**Ground cover**: the map is a table of words, eight cells in each. Kinds of ground are read from a table of mixtures,
four cells a ray, and blended; sea ice in the latitudes of its edges in the month at hand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.earth.clouds.relief import BASE_M
from horizonval.earth.surface import city_lights as city_lights_map
from horizonval.earth.surface import ground_map, surface
from horizonval.earth.surface.ground_map import DRY
from horizonval.earth.surface.surface import Albedos, GroundModel, mean_snow_reflection
from horizonval.renderer.kernel.clouds import CloudTable, cloud_table, first_cloud, first_cloud_and_turn
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.refraction import BendingField, ray_end
from horizonval.renderer.tables import table_of
from horizonval.renderer.types import Values, Vec, constant


@dataclass(frozen=True)
class GroundTable:
    """The ground of a month. ``words``: the map; ``mixtures``: of kinds; ``edges``.

    Of sea ice, north and then south [deg].

    ``heights`` [m]; ``snow``: divisor of the reflectance of snow; ``inhabitants``: per square metre, where cities
    shine.
    """

    words: mi.UInt32
    mixtures: mi.Float64
    edges: mi.Float64
    heights: mi.Float32
    snow_line_deg: mi.Float64
    white_north: mi.Float64
    white_south: mi.Float64
    snow: mi.Float64
    inhabitants: mi.Float32 | None = None

    @classmethod
    def of(cls, month: float, city_lights: bool = False) -> GroundTable:
        """Return the ground of a month."""
        edges = np.concatenate(ground_map.edges_deg(month))
        north, south = ground_map.white_shares(month)
        return cls(
            mi.UInt32(ground_map.packed_words()),
            mi.Float64(ground_map.mixtures().ravel()),
            mi.Float64(edges),
            mi.Float32(ground_map.heights_m().ravel()),
            constant(ground_map.snow_line_deg(month)),
            constant(north),
            constant(south),
            mi.Float64(mean_snow_reflection()),
            mi.Float32(city_lights_map.inhabitants_per_m2().ravel()) if city_lights else None,
        )


@dataclass(frozen=True)
class Places:
    """Where rays meet the ground. ``latitude``, ``longitude``: geodetic [deg], longitude from 0 to 720."""

    latitude: mi.Float64
    longitude: mi.Float64

    @classmethod
    def below(cls, normal: Vec) -> Places:
        """Return the places with given unit normals of the ellipsoid."""
        latitude = dr.rad2deg(dr.asin(dr.clip(normal[2], -1.0, 1.0)))
        # one turn and a half on from 180 W: never negative
        return cls(latitude, dr.rad2deg(dr.atan2(normal[1], normal[0])) + 540.0)


@dataclass(frozen=True)
class MapCells:
    """The four cells of the map around places: their kinds, and their weights, sea left out."""

    kinds: tuple[mi.UInt32, ...]
    weights: tuple[mi.Float64, ...]

    @property
    def alike(self) -> mi.Bool:
        """Return whether all are of one kind."""
        first, *others = self.kinds
        same = mi.Bool(True)
        for kind in others:
            same &= kind == first
        return same

    @property
    def on_land(self) -> mi.Float64:
        """Return the weight of land."""
        a, b, c, d = self.weights
        return a + b + c + d


def cells_around(table: GroundTable, places: Places) -> MapCells:
    """Look the map up."""
    rows, columns, weights = _around(places, ground_map.PER_DEGREE, ground_map.ROWS, ground_map.COLUMNS)
    kinds, dry = [], []
    for row, column, weight in zip(rows, columns, weights, strict=True):
        cell = row * ground_map.COLUMNS + column
        kind = (dr.gather(mi.UInt32, table.words, cell >> 3) >> ((cell & 7) * 4)) & 15
        kinds.append(kind)
        dry.append(dr.select(kind != ground_map.SEA, weight, 0.0))
    return MapCells(tuple(kinds), tuple(dry))


def look_alike(table: GroundTable, places: Places) -> tuple[mi.UInt32, mi.Bool]:
    """Return a number for the ground at places, and whether it is the same all around them.

    Places of one number have the same ground, except for the gradual onset of snow and ice (the number distinguishes
    none, some and all of them) and for the height of land (it distinguishes the squares in which heights are bilinear).
    """
    cells = cells_around(table, places)
    sea = cells.kinds[0] == ground_map.SEA
    white = dr.select(sea, frozen(table, places), snow_share(table, places))
    rows, columns, _ = _around(places, 1.0, 180, 360)
    square = dr.select(sea, mi.UInt32(0), 64 * (rows[0] * 360 + columns[0]))
    return square + 3 * cells.kinds[0] + mi.UInt32(dr.ceil(white)) + mi.UInt32(dr.floor(white)), cells.alike


def cover(table: GroundTable, places: Places) -> tuple[mi.Bool, dict[str, mi.Float64]]:
    """Return :func:`horizonval.earth.surface.ground_map.ground_cover`: whether there is land, and the shares."""
    cells = cells_around(table, places)
    land = cells.on_land > 0.5
    scale = dr.select(land, 1.0 / dr.maximum(cells.on_land, 0.5), 0.0)
    columns = len(ground_map.mixtures()[0])

    def blended(column: int) -> mi.Float64:
        total = mi.Float64(0.0)
        for kind, weight in zip(cells.kinds, cells.weights, strict=True):
            total = dr.fma(weight, dr.gather(mi.Float64, table.mixtures, kind * columns + column), total)
        return total * scale

    vegetation, soil, sand, firn, seen = (blended(k) for k in range(columns))
    snow = seen * snow_share(table, places)
    bare = 1.0 - snow / dr.maximum(1.0 - firn, 1e-6)
    white = dr.select(land, 0.0, white_share(table, places))
    shares = dict(zip(DRY, (vegetation * bare, soil * bare, sand * bare, snow + white, firn), strict=True))
    return land, shares | {"water": dr.select(land, 0.0, 1.0 - white)}


def snow_share(table: GroundTable, places: Places) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.ground_map.snow_share`."""
    into = (places.latitude - table.snow_line_deg) * (0.5 / ground_map.SNOW_EDGE_DEG) + 0.5
    return dr.clip(into, 0.0, 1.0)


def frozen(table: GroundTable, places: Places) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.ground_map.frozen`."""
    count = ground_map.SECTORS
    x = places.longitude * (count / 360.0) - 0.5
    i = mi.UInt32(x)
    w = x - mi.Float64(i)

    def edge(hemisphere: int) -> mi.Float64:
        low, high = (dr.gather(mi.Float64, table.edges, (i + k) % count + hemisphere * count) for k in (0, 1))
        return dr.lerp(low, high, w)

    beyond = dr.maximum(places.latitude - edge(0), -places.latitude - edge(1))
    return dr.clip(beyond / ground_map.EDGE_DEG, 0.0, 1.0)


def white_share(table: GroundTable, places: Places) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.ground_map.white_share`."""
    return frozen(table, places) * dr.select(places.latitude > 0.0, table.white_north, table.white_south)


def height_m(table: GroundTable, places: Places) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.ground_map.height_m`."""
    rows, columns, weights = _around(places, 1.0, 180, 360)
    total = mi.Float64(0.0)
    for row, column, weight in zip(rows, columns, weights, strict=True):
        total = dr.fma(weight, mi.Float64(dr.gather(mi.Float32, table.heights, row * 360 + column)), total)
    return total


def luminance(table: GroundTable, places: Places, mu_sun: mi.Float64, mu_view: mi.Float64) -> mi.Float64:
    """Return what cities shine [lm m-2 sr-1]; :mod:`horizonval.earth.surface.city_lights`, written again."""
    assert table.inhabitants is not None
    per_degree = city_lights_map.PER_DEGREE
    rows, columns, weights = _around(places, float(per_degree), 180 * per_degree, 360 * per_degree)
    density = mi.Float64(0.0)
    for row, column, weight in zip(rows, columns, weights, strict=True):
        cell = row * (360 * per_degree) + column
        density = dr.fma(weight, mi.Float64(dr.gather(mi.Float32, table.inhabitants, cell)), density)
    c = dr.clip(mu_view, city_lights_map.LEAST_COSINE, 1.0)
    z = dr.acos(c)
    down = 2.0 * city_lights_map.GROUND_REFLECTANCE * (1.0 - city_lights_map.UPWARD_SHARE) * c
    per_head = (down + 0.554 * city_lights_map.UPWARD_SHARE * z * z * z * z) / c
    burning = dr.clip(-mu_sun / city_lights_map.ALL_ON_SINE, 0.0, 1.0)
    return density * burning * per_head * (city_lights_map.LUMENS_PER_HEAD / (2.0 * math.pi))


def _around(
    places: Places, per_degree: float, rows: int, columns: int
) -> tuple[list[mi.UInt32], list[mi.UInt32], list[mi.Float64]]:
    """Return rows, columns and weights of the four cells around places."""
    y = dr.clip((places.latitude + 90.0) * per_degree - 0.5, 0.0, rows - 1.0)
    x = places.longitude * per_degree - 0.5
    i, j = dr.minimum(mi.UInt32(y), rows - 2), mi.UInt32(x)
    wy, wx = y - mi.Float64(i), x - mi.Float64(j)
    west, east = j % columns, (j + 1) % columns
    weights = [(1.0 - wy) * (1.0 - wx), (1.0 - wy) * wx, wy * (1.0 - wx), wy * wx]
    return [i, i, i + 1, i + 1], [west, east, west, east], weights


def snow_factor(mean: mi.Float64, mu_sun: mi.Float64, mu_view: mi.Float64, cosine: mi.Float64) -> mi.Float64:
    """Return the factor of snow in :mod:`horizonval.earth.surface.surface`; ``mean``: its table of N."""
    x = dr.clip(mu_sun, 0.0, 1.0) * (surface.SNOW_NODES - 1.0)
    i = dr.minimum(mi.UInt32(x), surface.SNOW_NODES - 2)
    over = dr.lerp(dr.gather(mi.Float64, mean, i), dr.gather(mi.Float64, mean, i + 1), x - mi.Float64(i))
    return surface.snow_reflection(mu_sun, mu_view, cosine, dr) / over


@dataclass(frozen=True)
class Ground:
    """Ground and clouds of a frame; ``table``: cover of an "earth"; ``pieces``: per belt of a chequered ground."""

    model: GroundModel
    table: GroundTable | None
    clouds: CloudTable | None
    pieces: mi.Float64 | None = None


@dataclass(frozen=True)
class SurfaceHit:
    """Where rays end (``ends``: on anything at all) and what is there; ``cloud``: whether that is a cloud.

    ``t``: ray parameter of the end on a cloud; elsewhere the ellipsoid decides. ``sunlit``: 1 without a cloud before
    the Sun, else the share that the first transmits. ``shares``: of every material in the end's area, keys of Albedos;
    a cloud counts with its brightness. ``entering``: share of the beam that enters water, over its mean for skylight;
    scales what comes back from below the surface. ``glint``: reflectance of the sea's facets [1/sr]. ``forward``:
    radiance of snow in the Sun's beam over that of a Lambert surface; 1 under clouds, whose light is diffuse.
    ``bending``: angle of a ray at its end [rad]; None without refraction. ``lamps``: luminance of cities [lm m-2 sr-1],
    under the Sun; None where none shine. ``albedos``: of the spectral nodes at hand; size-1 arrays.
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
        return replace(self, albedos=tuple({k: constant(v) for k, v in asdict(a).items()} for a in nodes))

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

    Both are albedos of diffuse light, at most 1, so that the series of reflections between them converges. The ground's
    is zero under opaque clouds, which transmit nothing.
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
    """Return where rays end, under every light.

    ``to_ground``: they all meet the ellipsoid, unless a cloud is before it. ``bending``: with refraction; ``planet``
    and rays are then the apparent ones. Sunlight past clouds is not refracted: low Suns shine over edges of clouds
    displaced by up to the Sun's diameter.
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
    variance = constant(surface.slope_variance(ground.model.wind_speed_m_s))
    hits = []
    for light, lit in zip(lights, sunlit, strict=True):
        mu_sun = dot(normal, light)
        mu_view, cosine = -dot(normal, arriving), -dot(arriving, light)
        glint = wet * bare * surface.glint_brdf(mu_sun, mu_view, cosine, variance, dr)
        forward = dr.select(cloud, 1.0, snow_factor(ground.table.snow, mu_sun, mu_view, cosine))
        entering = (1.0 - surface.fresnel(dr.maximum(mu_sun, 0.0), of=dr)) / (1.0 - surface.water_sky_albedo())
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
    foam = constant(surface.foam_share(ground.model.wind_speed_m_s))
    shares = {name: clear * share for name, share in below.items()}
    return shares | {"water": shares["water"] * (1.0 - foam), "foam": shares["water"] * foam}


def shares_from_above(ground: Ground, normal: Vec) -> dict[str, mi.Float64]:
    """Return shares seen from straight above, clouds with their brightness.

    A cloud is where the relief is above its base.
    """
    white, clear = mi.Float64(0.0), mi.Float64(1.0)
    if ground.clouds is not None:
        top = ground.clouds.top(normal)
        cloud = top > BASE_M
        white = dr.select(cloud, ground.clouds.brightness(top, normal), 0.0)
        clear = clear if ground.clouds.translucent else dr.select(cloud, mi.Float64(0.0), 1.0)
    return {"cloud": white} | ground_shares(ground, normal, clear)


def _sunlit(clouds: CloudTable, planet: Planet, p: Vec, sun: Vec) -> mi.Float64:
    """Return 1 where no cloud is between points and the Sun, else what the first transmits; starts a step away."""
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
