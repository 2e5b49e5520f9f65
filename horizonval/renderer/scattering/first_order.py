"""The light that the orders of scattering begin with: scattered once, or straight from the ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer import tables
from horizonval.renderer.scattering.diffuse_field import SMALLEST
from horizonval.renderer.scattering.quality import MOLECULAR_DEGREE
from horizonval.renderer.scattering.shell_column import ShellColumn
from horizonval.renderer.scattering.shell_rays import ShellRays
from horizonval.renderer.scattering.sun_angles import sun_angle_position
from horizonval.renderer.tables import SunTable, table_of
from horizonval.renderer.types import Values, constant


def lane_shape(column: ShellColumn, rays: ShellRays, n_azimuth: int) -> tuple[int, ...]:
    return (*rays.cosine.shape, n_azimuth, len(column.sun_cosines))


def lane_indices(shape: tuple[int, ...]) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.UInt32]:
    """Return height-and-direction, azimuth, Sun angle indices of all lanes; the Sun angle runs fastest."""
    n_h, n_d, n_a, n_k = shape
    lane = dr.arange(mi.UInt32, n_h * n_d * n_a * n_k)
    return lane // (n_a * n_k), (lane // n_k) % n_a, lane % n_k, lane


def _along_sun(mu_s: mi.Float64, mu: mi.Float64, azimuth: mi.Float64) -> mi.Float64:
    """Return the cosine of the angle between ray and Sun."""
    sines = dr.sqrt(dr.maximum(1.0 - mu_s * mu_s, 0.0) * dr.maximum(1.0 - mu * mu, 0.0))
    return mu_s * mu + sines * dr.cos(azimuth)


def single_scattering(
    columns: Sequence[ShellColumn], rays: Sequence[ShellRays], n_azimuth: int, sun_table: SunTable
) -> list[FloatArray]:
    """Return radiance of light scattered once, per column, Float64: the shadow's edge is found to the metre.

    The columns differ in their nodes alone, ``SOLVED_TOGETHER`` of them; ``sun_table`` is as wide.
    """
    first, geometry = columns[0], rays[0]
    shape = lane_shape(first, geometry, n_azimuth)
    ray, azimuth, k, lane = lane_indices(shape)
    r = geometry.node_radius_m
    n_nodes = r.shape[-1]
    packet = tables.packet_type(mi.Float64)
    start = np.broadcast_to(geometry.radius_m[:, None, None], r.shape)
    height = r - first.planet_m
    # the cosine of the Sun's zenith angle at a node is a sum of two terms of these factors
    places = table_of(mi.Float64, np.stack([height, r, start / r, geometry.node_distance_m / r], axis=-1))
    with_particles = first.degree > MOLECULAR_DEGREE

    def table(values: Sequence[FloatArray]) -> mi.Float64:
        return table_of(mi.Float64, np.stack(values, axis=-1))

    def weighted(name: str) -> mi.Float64:
        return table([v.node_weight * c.at(getattr(c.node, name), r) for c, v in zip(columns, rays, strict=True)])

    molecular = weighted("molecular_per_m")
    if with_particles:
        particle = weighted("particle_per_m")
        asymmetry = table([c.at(c.node.asymmetry, r) for c in columns])
    peaks = any(len(c.node.forward_per_m) for c in columns)
    forward = weighted("forward_per_m") if peaks else mi.Float64(0.0)
    mu_s = dr.gather(mi.Float64, table_of(mi.Float64, first.sun_cosines), k)
    mu = dr.gather(mi.Float64, table_of(mi.Float64, geometry.cosine), ray)
    nu = _along_sun(mu_s, mu, (mi.Float64(azimuth) + 0.5) * (math.pi / n_azimuth))
    cos2 = [constant(c.node.molecular_cos2) for c in columns]
    molecules = [(1.0 - c / 3.0 + c * nu * nu) * (0.25 / math.pi) for c in cos2]
    sun_table = replace(sun_table, values=mi.Float32(sun_table.values))
    dr.eval(sun_table.values)
    ground2 = constant(first.planet_m**2)
    peak = _cut_peak(nu, first.degree) if peaks else nu

    def body(n: mi.UInt32, radiance: Values) -> tuple[mi.UInt32, Values]:
        at = ray * n_nodes + n
        place = dr.gather(packet, places, at)
        h_n, r_n = place[0], place[1]
        mu_n = dr.fma(place[2], mu_s, place[3] * nu)
        lit = (mu_n > 0.0) | (r_n * r_n * (1.0 - mu_n * mu_n) > ground2)
        scattering = dr.gather(packet, molecular, at)
        emitted = [scattering[c] * molecules[c] for c in range(len(columns))]
        if with_particles:
            scattering, asymmetries = dr.gather(packet, particle, at), dr.gather(packet, asymmetry, at)
            for c in range(len(columns)):
                g = asymmetries[c]
                base = 1.0 + g * g - 2.0 * g * nu
                phase = (1.0 - g * g) / (base * dr.sqrt(base)) * (0.25 / math.pi)
                emitted[c] = emitted[c] + scattering[c] * phase
            if peaks:
                ahead = dr.gather(packet, forward, at)
                emitted = [e - ahead[c] * peak for c, e in enumerate(emitted)]
        through = sun_table.transmittance(h_n, mu_n, len(columns))
        gain = [dr.select(lit, e * t, 0.0) for e, t in zip(emitted, through, strict=True)]
        return n + 1, [v + g for v, g in zip(radiance, gain, strict=True)]

    zero = dr.zeros(mi.Float64, dr.width(lane))
    nothing = [zero + 0.0 for _ in columns]
    _, radiance = dr.while_loop((mi.UInt32(0), nothing), lambda n, _: n < n_nodes, body, label="single scattering")
    dr.eval(radiance)
    return [np.array(v).reshape(shape) for v in radiance]


def _cut_peak(cosine: mi.Float64, degree: int) -> mi.Float64:
    """Return a peak straight on as moments up to a degree have it: ``sum of (2 l + 1) P_l / 4 pi``.

    What scatters so has not left the beam (:mod:`.forward_peak`).
    """
    before, now = mi.Float64(1.0), cosine
    total = before + 3.0 * now
    for n in range(2, degree + 1):
        before, now = now, ((2.0 * n - 1.0) * cosine * now - (n - 1.0) * before) * (1.0 / n)
        total = dr.fma(2.0 * n + 1.0, now, total)
    return total * (0.25 / math.pi)


def ground_light(column: ShellColumn, rays: ShellRays, n_azimuth: int, lit: FloatArray) -> FloatArray:
    """Return radiance that comes straight from a ground of radiance ``lit`` (n_sun,)."""
    shape = lane_shape(column, rays, n_azimuth)
    phi = (np.arange(n_azimuth) + 0.5) * math.pi / n_azimuth
    mu_s, mu = column.sun_cosines, rays.cosine[:, :, None, None]
    sines = np.sqrt((1 - mu_s**2) * (1 - mu**2))
    nu = mu_s * mu + sines * np.cos(phi)[:, None]
    at_ground = (rays.radius_m[:, None, None, None] * mu_s + rays.end_m[:, :, None, None] * nu) / column.planet_m
    position = sun_angle_position(at_ground, len(mu_s))
    value = np.exp(np.interp(position, np.arange(len(mu_s)), np.log(np.maximum(lit, SMALLEST))))
    seen = rays.reaches_ground * rays.end_transmittance
    return np.broadcast_to(value * seen[:, :, None, None], shape)
