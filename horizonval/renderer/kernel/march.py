r"""The march: radiance along rays through a spherical-shell atmosphere over an ellipsoid, without Monte Carlo noise.

For every spectral node, with extinction k, optical depth :math:`\tau(t) = \int_0^t k\,dt'` from the observer and source
function S::

    L = int S exp(-tau) dtau  +  L_ground exp(-tau_ground)

    sunlight:  S = (k_scattering / k) E0 P(Theta) T_sun        single scattering; T_sun = 0 in the umbra
    emission:  S = B(T)                                        LTE
    airglow:   k S = g                                         emission per metre, given

**Where the nodes go.** A ray is cut at its lowest point into a descending and an ascending piece. With ``y`` from -1
(entry) over 0 (lowest point) to 1 (exit) the distance from the lowest point is ``l (c |y| + (1 - c) |y|^3)``: dense
where the air is dense. The interval of ``y`` is shared out among the pieces between the umbra's edges, so that no step
straddles a shadow edge. Airglow comes from a thin layer high up: there the steps crowd above its lower edge.

**One step** holds two Gauss points. Extinction and source are linear through them: the optical depth at the points and
over the step follow exactly; thin steps (optical depth below 0.5) sum ``k S exp(-tau)`` with Gauss weights, thick ones
integrate a source linear in optical depth against ``exp(-tau)`` exactly, so that an isothermal black body comes out as
one however thick the step.

    sunlight, scattered before:  S = (k_molecules S_molecules + k_particles S_particles) E0 / k     (source_table)

The diffuse source is smooth and dear: it is looked up at the steps' ends (with particles, many moments, at every
second), and its logarithm is linear between.

**Refraction** (``Chunk.bending``) makes no bent rays: the columns are those of :mod:`.straightened`, in which light
goes straight; by how much the bent ray has turned is summed beside the optical depth and turns the Sun instead. The
diffuse source is that of air without refraction, at the true height and under the true Sun.

Neglected: polarisation, a Sun that is not a point (for illumination). Deterministic: no random numbers, no
atomics; every ray is summed in its own lane in a fixed order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.straightened import Bending, BentRay
from horizonval.renderer.kernel.surface import Landing
from horizonval.renderer.planet import Planet, Vec, along, dot
from horizonval.renderer.scattering.source_table import SourceTable
from horizonval.renderer.tables import AltitudeGrid, SunTable, interpolate

GAUSS_LOW = 0.5 - math.sqrt(3.0) / 6.0
THICK_STEP = 0.5
CHUNK = 4
"""Spectral nodes per kernel launch; they share all geometry."""

PARTICLE_STRIDE = 2
"""Steps from one lookup of the diffuse source to the next where there are particles; without them 1."""

Kind = Literal["solar", "thermal", "glow", "depth"]


@dataclass(frozen=True)
class Chunk:
    """Tables of up to :data:`CHUNK` spectral nodes, interleaved in memory. Everything is evaluated (no literals).

    Attributes
    ----------
    kind : "solar", "thermal", "glow" or "depth"
        "depth" wants the transmittance only.
    width : int
        Nodes, padded ones included.
    extinction, emission : Float64, shape (n_altitude * width,)
        ``emission``: scattering coefficient of molecules of solar nodes, source function of thermal ones, emission per
        metre of glowing ones.
    particle, asymmetry : Float64, shape (n_altitude * width,), or None
        Scattering coefficient and Henyey-Greenstein asymmetry of particles; None where no node has any.
    sun_table : SunTable or None
        Towards the Sun along straight lines.
    irradiance, ground : lists of Float64, size 1
        Solar irradiance; for the ground its albedo / pi (solar) or emitted and reflected radiance (thermal).
    cos2 : list of Float64, size 1
        The c of the molecules' phase function ``(1 - c/3 + c cos^2) / (4 pi)``.
    diffuse : SourceTable or None
        Light scattered more than once; None for single scattering.
    glow : Chunk of kind "glow", or None
        The airglow of the same nodes; marched by itself.
    moonlight : list of Float64, size 1, or None
        The Moon's irradiance, to take the Sun's place.
    layer_m : float
        Height below which nothing glows.
    bending : Bending or None
        None: no refraction. It takes the place of ``sun_table``.
    """

    kind: Kind
    width: int
    grid: AltitudeGrid
    extinction: Any
    emission: Any
    sun_table: SunTable | None
    irradiance: list[Any]
    ground: list[Any]
    cos2: list[Any]
    particle: Any = None
    asymmetry: Any = None
    diffuse: SourceTable | None = None
    glow: Chunk | None = None
    moonlight: list[Any] | None = None
    layer_m: float = 0.0
    bending: Bending | None = None


@dataclass(frozen=True)
class Path:
    """The stretch of a ray inside the atmosphere and in front of the ground, ready to be marched.

    ``t_low`` is the lowest point; ``y0``, ``y1`` bound the ray parameter; ``length_*`` are the pieces' lengths [m].
    """

    t_low: Any
    length_before: Any
    length_after: Any
    y0: Any
    y1: Any


def find_path(planet: Planet, top_m: float, o: Vec, d: Vec, to_ground: Any, landing: Landing | None = None) -> Path:
    """Return the marched stretch of rays with unit directions; zero length for rays above the atmosphere.

    ``to_ground``: march up to the ground (the ray must hit it) instead of past the lowest point. Clouds of ``landing``
    end a ray before either.
    """
    mid, half, meets = planet.chord(o, d, top_m)
    ground_mid, ground_half, _ = planet.chord(o, d)
    t_in = dr.maximum(mid - half, 0.0)
    t_out = dr.select(to_ground, ground_mid - ground_half, mid + half)
    if landing is not None:
        t_out = dr.select(landing.cloud, landing.t, t_out)
    t_out = dr.select(meets, dr.maximum(t_out, t_in), t_in)
    # at the ground the path may end before the lowest point of the line
    t_low = dr.clip(dr.select(to_ground, t_out, mid), t_in, t_out)
    before, after = t_low - t_in, t_out - t_low
    return Path(
        t_low,
        before,
        after,
        dr.select(before > 0.0, mi.Float64(-1.0), 0.0),
        dr.select(after > 0.0, mi.Float64(1.0), 0.0),
    )


def warp(path: Path, y: Any, c: float) -> Any:
    reach = dr.abs(y)
    reach = reach * dr.fma(reach * reach, 1.0 - c, c)
    return path.t_low + dr.select(y < 0.0, -path.length_before, path.length_after) * reach


def unwarp(path: Path, t: Any, c: float) -> Any:
    """Return ``y`` of a ray parameter: the real root of ``c y + (1 - c) y^3 = x``, by the hyperbolic solution."""
    s = t - path.t_low
    length = dr.select(s < 0.0, path.length_before, path.length_after)
    x = dr.minimum(dr.abs(s) / dr.maximum(length, 1e-3), 1.0)
    p = c / (1.0 - c)
    q = x / (1.0 - c)
    scale = 2.0 * math.sqrt(p / 3.0)
    arg = 3.0 * q / (p * scale)
    y = scale * dr.sinh(dr.log(arg + dr.sqrt(arg * arg + 1.0)) / 3.0)
    return dr.select(s < 0.0, -dr.minimum(y, 1.0), dr.minimum(y, 1.0))


@dataclass(frozen=True)
class Steps:
    """How the steps are shared out: step index boundaries ``n1 <= n2`` at the parameters ``y1 <= y2``."""

    n1: Any
    n2: Any
    y1: Any
    y2: Any


def _umbra(planet: Planet, path: Path, o: Vec, d: Vec, sun: Vec, c: float) -> tuple[Any, Any]:
    """Return ``y`` where the ray enters and leaves the umbra; its ends where it does not."""
    t1, t2, crosses = planet.shadow_crossings(o, d, sun)
    # a crossing counts only on the side away from the Sun: look a metre into the cylinder
    real1 = crosses & planet.in_umbra(along(o, d, t1 + 1.0), sun)
    real2 = crosses & planet.in_umbra(along(o, d, t2 - 1.0), sun)
    y1 = dr.select(real1, dr.clip(unwarp(path, t1, c), path.y0, path.y1), path.y0)
    y2 = dr.select(real2, dr.clip(unwarp(path, t2, c), path.y0, path.y1), path.y1)
    return y1, y2


def _bent_umbra(
    planet: Planet, path: Path, o: Vec, d: Vec, ray: BentRay, grid: AltitudeGrid, count: int, c: float
) -> tuple[Any, Any]:
    """Return the same under refraction, whose shadow has no closed form: between ``count`` looks along the ray."""

    def look(y: Any) -> tuple[Any, Any, Any, Vec]:
        t = warp(path, y, c)
        height, normal = planet.height_and_normal(along(o, d, t))
        return t, ray.turn_per_m(*grid.locate(height), normal), height, normal

    span = (path.y1 - path.y0) / count
    zero = dr.zeros(mi.Float64, dr.width(path.t_low))
    t, rate, height, normal = look(path.y0 + zero)
    above = ray.sun_above_lowest(height, normal, zero)

    def body(
        i: Any, t0: Any, rate0: Any, turned: Any, above0: Any, y1: Any, y2: Any
    ) -> tuple[Any, Any, Any, Any, Any, Any, Any]:
        y = path.y0 + span * (mi.Float64(i) + 1.0)
        t, rate, height, normal = look(y)
        turned = turned + 0.5 * (rate0 + rate) * (t - t0)
        above = ray.sun_above_lowest(height, normal, turned)
        edge = y - span * above / dr.select(above == above0, 1.0, above - above0)
        y1 = dr.select((above0 >= 0.0) & (above < 0.0), edge, y1)
        y2 = dr.select((above0 < 0.0) & (above >= 0.0), edge, y2)
        return i + 1, t, rate, turned, above, y1, y2

    state = (mi.UInt32(0), t, rate, zero + 0.0, above, path.y0 + zero, path.y1 + zero)
    *_, y1, y2 = dr.while_loop(state, lambda i, *_: i < count, body, label="refracted umbra")
    return y1, y2


def _share_steps(path: Path, y1: Any, y2: Any, count: int) -> Steps:
    span = dr.maximum(path.y1 - path.y0, 1e-9)
    tiny = 1e-6 * span
    y1 = dr.select(y1 - path.y0 < tiny, path.y0, y1)
    y2 = dr.select(path.y1 - y2 < tiny, path.y1, dr.maximum(y2, y1))
    n1 = dr.round(count * (y1 - path.y0) / span)
    n2 = dr.round(count * (y2 - path.y0) / span)
    n1 = dr.clip(n1, dr.select(y1 > path.y0, mi.Float64(1.0), 0.0), count - 2.0)
    n2 = dr.clip(
        n2, n1 + dr.select(y2 > y1, mi.Float64(1.0), 0.0), count - dr.select(y2 < path.y1, mi.Float64(1.0), 0.0)
    )
    return Steps(n1, n2, y1, y2)


def _share_layer_steps(planet: Planet, path: Path, o: Vec, d: Vec, layer_m: float, count: int, c: float) -> Steps:
    """Give each passage through what lies above ``layer_m`` two fifths of the steps."""
    mid, half, meets = planet.chord(o, d, layer_m)
    y1 = dr.select(meets, dr.clip(unwarp(path, mid - half, c), path.y0, path.y1), path.y0)
    y2 = dr.select(meets, dr.clip(unwarp(path, mid + half, c), path.y0, path.y1), path.y1)
    tiny = 1e-9 * dr.maximum(path.y1 - path.y0, 1e-9)
    many = float(round(0.4 * count))
    n1 = dr.select(y1 > path.y0 + tiny, mi.Float64(many), 0.0)
    n2 = dr.select(y2 < path.y1 - tiny, mi.Float64(count - many), float(count))
    return Steps(n1, n2, dr.select(n1 > 0.0, y1, path.y0), dr.select(n2 < count, y2, path.y1))


def _step_boundary(path: Path, steps: Steps, i: Any, count: int) -> Any:
    """Return ``y`` at step boundary ``i``: linear between the shared-out boundaries."""
    first = path.y0 + (steps.y1 - path.y0) * (i / dr.maximum(steps.n1, 1.0))
    middle = steps.y1 + (steps.y2 - steps.y1) * ((i - steps.n1) / dr.maximum(steps.n2 - steps.n1, 1.0))
    last = steps.y2 + (path.y1 - steps.y2) * ((i - steps.n2) / dr.maximum(count - steps.n2, 1.0))
    return dr.select(i < steps.n1, first, dr.select(i < steps.n2, middle, last))


def _molecular_phase(cos2: Any, cosine: Any) -> Any:
    return (dr.fma(cos2, cosine * cosine, 1.0) - cos2 / 3.0) * (0.25 / math.pi)


def _particle_phase(asymmetry: Any, cosine: Any) -> Any:
    """Return the phase function of Henyey and Greenstein."""
    g2 = asymmetry * asymmetry
    base = 1.0 + g2 - 2.0 * asymmetry * cosine
    return (1.0 - g2) / (base * dr.sqrt(base)) * (0.25 / math.pi)


def _molecular_weight(chunk: Chunk, cosine: Any) -> list[Any]:
    return [e * _molecular_phase(c, cosine) for e, c in zip(chunk.irradiance, chunk.cos2, strict=True)]


def march(
    planet: Planet,
    top_m: float,
    chunk: Chunk,
    o: Vec,
    d: Vec,
    sun: Vec,
    to_ground: Any,
    nodes: int,
    concentration: float,
    landing: Landing | None = None,
) -> tuple[list[Any], list[Any]]:
    """Return radiance and transmittance of every spectral node of a chunk along rays.

    Parameters
    ----------
    o, d : Vec
        Origins [m, planet-centred] and unit directions.
    sun : Vec
        Unit vector towards the Sun.
    to_ground : Bool
        Add the ground and stop there; the rays must hit it.
    nodes : int
        Evaluations along each ray (two per step).
    concentration : float
        The ``c`` of the module text: smaller is denser near the lowest point.
    landing : Landing, optional
        What is at the rays' ends, clouds included; without it a Lambert ground, no clouds.

    Returns
    -------
    radiance, transmittance : lists of Float64
        Transmittance from the observer to the end of the path.
    """
    width = chunk.width
    stride = PARTICLE_STRIDE if chunk.diffuse is not None and chunk.particle is not None else 1
    count = -(-max(nodes // 2, 3) // stride) * stride
    path = find_path(planet, top_m, o, d, to_ground, landing)
    solar = chunk.kind == "solar"
    bent = None
    if solar:
        if chunk.bending is None:
            umbra = _umbra(planet, path, o, d, sun, concentration)
        else:
            vertical = planet.height_and_normal(along(o, d, path.t_low))[1]
            bent = BentRay.of(chunk.bending, d, sun, vertical)
            umbra = _bent_umbra(planet, path, o, d, bent, chunk.grid, count // 2, concentration)
        steps = _share_steps(path, *umbra, count)
    else:
        steps = Steps(mi.Float64(0.0), mi.Float64(count), path.y0, path.y1)
        if chunk.kind == "glow":
            steps = _share_layer_steps(planet, path, o, d, chunk.layer_m, count, concentration)
    # along a straight ray the scattering angle stays the same
    weight = _molecular_weight(chunk, dot(d, sun)) if solar and bent is None else []

    def turn_over(t0: Any, t1: Any, turned: Any) -> tuple[Any, Any, Any]:
        """Return by how much the ray has turned at the two Gauss points of a step and at its end."""
        if bent is None:
            return None, None, None
        h = t1 - t0
        rates = []
        for share in (GAUSS_LOW, 1.0 - GAUSS_LOW):
            height, normal = planet.height_and_normal(along(o, d, t0 + share * h))
            rates.append(bent.turn_per_m(*chunk.grid.locate(height), normal))
        a, b = rates
        # the integral of the line through both points
        at_a = turned + h * (0.25 * a + (GAUSS_LOW - 0.25) * b)
        at_b = turned + h * ((0.75 - GAUSS_LOW) * a + 0.25 * b)
        return at_a, at_b, turned + 0.5 * h * (a + b)

    def sunlight(p: Vec, height: Any, normal: Vec, turned: Any) -> tuple[list[Any], Any, Any, list[Any]]:
        """Return the Sun's light: share that arrives, where it shines, cosine of the scattering angle, weights."""
        if bent is not None:
            share, lit, _, cosine = bent.sunlight(height, normal, turned, width)
            return share, lit, cosine, _molecular_weight(chunk, cosine)
        assert chunk.sun_table is not None
        lit = ~planet.in_umbra(p, sun)
        return chunk.sun_table.transmittance(height, dot(normal, sun), width), lit, dot(d, sun), weight

    def log_diffuse(t: Any, turned: Any) -> list[Any]:
        """Return ``ln`` of the diffuse source per scattering coefficient, molecules' and then particles', at ``t``."""
        if chunk.diffuse is None:
            return []
        # in single precision heights are good to a metre, plenty for light that changes over kilometres
        x, y, z = (mi.Float32(v) for v in along(o, d, t))
        height, normal = planet.height_and_normal((x, y, z))
        i, w, _ = chunk.grid.locate(mi.Float64(height))
        asymmetry = None if chunk.asymmetry is None else interpolate(chunk.asymmetry, i, w, width)
        there = sun
        if bent is not None:
            height, there = bent.true_height(i, w), bent.sun_at(turned)
        return chunk.diffuse.log_sources(height, normal, d, there, chunk.cos2, asymmetry)

    def evaluate(t: Any, diffuse: list[Any], turned: Any) -> tuple[list[Any], list[Any]]:
        """Return extinction [1/m] and emission per metre at ``t``; ``diffuse`` as in ``log_diffuse``, without ln."""
        p = along(o, d, t)
        height, normal = planet.height_and_normal(p)
        i, w, inside = chunk.grid.locate(height)
        k = [dr.select(inside, v, 0.0) for v in interpolate(chunk.extinction, i, w, width)]
        if chunk.kind == "depth":
            return k, k
        e = interpolate(chunk.emission, i, w, width)
        if chunk.kind == "glow":
            return k, [dr.select(inside, v, 0.0) for v in e]
        if not solar:
            return k, [a * b for a, b in zip(k, e, strict=True)]
        t_sun, lit, cosine, molecules = sunlight(p, height, normal, turned)
        scattered = [s * f for s, f in zip(e, molecules, strict=True)]
        particle = interpolate(chunk.particle, i, w, width) if chunk.particle is not None else []
        if particle:
            g = interpolate(chunk.asymmetry, i, w, width)
            phase = [irr * _particle_phase(v, cosine) for irr, v in zip(chunk.irradiance, g, strict=True)]
            scattered = [a + s * f for a, s, f in zip(scattered, particle, phase, strict=True)]
        emission = [dr.select(inside & lit, s * v, 0.0) for s, v in zip(scattered, t_sun, strict=True)]
        for n, source in enumerate(diffuse):
            scatterer = (e + particle)[n] * chunk.irradiance[n % width]
            emission[n % width] = emission[n % width] + dr.select(inside, scatterer * source, 0.0)
        return k, emission

    zero = dr.zeros(mi.Float64, dr.width(path.t_low))
    start = warp(path, path.y0 + zero, concentration)

    def body(
        i: Any, t0: Any, before: list[Any], tau: list[Any], radiance: list[Any], turned: Any
    ) -> tuple[Any, Any, list[Any], list[Any], list[Any], Any]:
        tau, radiance = list(tau), list(radiance)
        ends = [
            warp(path, _step_boundary(path, steps, mi.Float64(i) + float(k), count), concentration)
            for k in range(1, stride + 1)
        ]
        turns = []
        for begin, end in zip([t0, *ends], ends, strict=False):
            turns.append(turn_over(begin, end, turned))
            turned = turns[-1][-1]
        after = log_diffuse(ends[-1], turned)

        def diffuse(share: float) -> list[Any]:
            return [mi.Float64(dr.exp(dr.fma(b - a, share, a))) for a, b in zip(before, after, strict=True)]

        for k, t1 in enumerate(ends):
            h = t1 - t0
            turned_a, turned_b, _ = turns[k]
            k_a, j_a = evaluate(t0 + GAUSS_LOW * h, diffuse((k + GAUSS_LOW) / stride), turned_a)
            k_b, j_b = evaluate(t0 + (1.0 - GAUSS_LOW) * h, diffuse((k + 1.0 - GAUSS_LOW) / stride), turned_b)
            for n in range(width):
                step = 0.5 * h * (k_a[n] + k_b[n])
                if chunk.kind != "depth":
                    added = gain(h, k_a[n], k_b[n], j_a[n], j_b[n], step)
                    radiance[n] = radiance[n] + dr.exp(-tau[n]) * added
                tau[n] = tau[n] + step
            t0 = t1
        return i + stride, t0, after, tau, radiance, turned

    turned = None if bent is None else zero + 0.0
    _, _, _, tau, radiance, turned = dr.while_loop(
        (mi.UInt32(0), start, log_diffuse(start, turned), [zero + 0.0] * width, [zero + 0.0] * width, turned),
        lambda i, *_: i < count,
        body,
        labels=("i", "t", "diffuse", "tau", "radiance", "turned"),
        label="limb march",
    )
    transmittance = [dr.exp(-v) for v in tau]
    if chunk.kind == "depth":
        return tau, transmittance
    ground = _ground_radiance(planet, chunk, o, d, sun, path, landing, bent, turned)
    ends = to_ground if landing is None else landing.hit
    return [
        r + dr.select(ends, g * t, 0.0) for r, g, t in zip(radiance, ground, transmittance, strict=True)
    ], transmittance


def gain(h: Any, k_a: Any, k_b: Any, j_a: Any, j_b: Any, step: Any, thick_step: float = THICK_STEP) -> Any:
    """Return what one step adds, seen from its beginning; ``thick_step``: optical depth of the least thick one."""
    slope = (k_b - k_a) / (1.0 - 2.0 * GAUSS_LOW)  # of k over the step, per unit of h
    k_0 = k_a - slope * GAUSS_LOW
    tau_a = dr.maximum(h * GAUSS_LOW * (k_0 + 0.5 * GAUSS_LOW * slope), 0.0)
    tau_b = h * (1.0 - GAUSS_LOW) * (k_0 + 0.5 * (1.0 - GAUSS_LOW) * slope)
    thin = 0.5 * h * (j_a * dr.exp(-tau_a) + j_b * dr.exp(-tau_b))
    # thick: S linear in tau through the two points, integrated against exp(-tau)
    s_a, s_b = j_a / dr.maximum(k_a, 1e-300), j_b / dr.maximum(k_b, 1e-300)
    escaped = dr.exp(-step)
    e0 = 1.0 - escaped
    e1 = e0 - step * escaped
    thick = s_a * e0 + (s_b - s_a) * (e1 - tau_a * e0) / dr.maximum(tau_b - tau_a, 1e-30)
    return dr.select(step < thick_step, thin, dr.maximum(thick, 0.0))


def _ground_radiance(
    planet: Planet,
    chunk: Chunk,
    o: Vec,
    d: Vec,
    sun: Vec,
    path: Path,
    landing: Landing | None,
    bent: BentRay | None,
    turned: Any,
) -> list[Any]:
    """Return the radiance of what is at the rays' ends, towards the observer, per node.

    Sunlight: ``direct E0 mu T_sun + diffuse E_sky`` with the ground's two reflectances [1/sr] (both are albedo / pi for
    a Lambert ground). Emission: the chunk's ground.
    """
    if chunk.kind != "solar":
        return chunk.ground
    height, normal = planet.height_and_normal(along(o, d, path.t_low + path.length_after))
    height = mi.Float64(0.0) if landing is None else dr.select(landing.cloud, height, 0.0)
    direct, diffuse = (chunk.ground, chunk.ground) if landing is None else landing.reflectance()
    if bent is not None:
        mu = dot(normal, bent.sun_at(turned))
        t_sun, lit, local, _ = bent.sunlight(height, normal, turned, chunk.width)
        level = dr.select(lit, dr.maximum(local, 0.0), 0.0)
    else:
        assert chunk.sun_table is not None
        mu = dot(normal, sun)
        t_sun = chunk.sun_table.transmittance(height, mu, chunk.width)
        level = dr.maximum(mu, 0.0)
    radiance = [a * e * level * t for a, e, t in zip(direct, chunk.irradiance, t_sun, strict=True)]
    sky = _sky_irradiance(chunk, mu)
    if sky is None:
        return radiance
    return [r + a * e for r, a, e in zip(radiance, diffuse, sky, strict=True)]


def _sky_irradiance(chunk: Chunk, mu: Any) -> list[Any] | None:
    """Return the diffuse irradiance [W m-2 um-1] on level ground under a Sun of zenith cosine ``mu``, per node.

    Cloud tops get as much as the ground.
    """
    if chunk.diffuse is None:
        return None
    return [e * v for e, v in zip(chunk.irradiance, chunk.diffuse.ground_irradiance(mu), strict=True)]
