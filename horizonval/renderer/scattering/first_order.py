"""The light that the orders of scattering begin with: scattered once, or straight from the ground."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.scattering.diffuse_field import SMALLEST
from horizonval.renderer.scattering.shell_column import ShellColumn
from horizonval.renderer.scattering.shell_rays import ShellRays
from horizonval.renderer.scattering.sun_angles import sun_angle_position


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


def single_scattering(column: ShellColumn, rays: ShellRays, n_azimuth: int) -> FloatArray:
    """Return radiance of light scattered once, Float64: the shadow's edge is found to the metre."""
    node = column.node
    shape = lane_shape(column, rays, n_azimuth)
    ray, azimuth, k, lane = lane_indices(shape)
    n_nodes = rays.node_radius_m.shape[-1]
    r = rays.node_radius_m
    height = mi.Float64((r - column.planet_m).ravel())
    radius, distance = mi.Float64(r.ravel()), mi.Float64(rays.node_distance_m.ravel())
    molecular = mi.Float64((rays.node_weight * column.at(node.molecular_per_m, r)).ravel())
    particle = mi.Float64((rays.node_weight * column.at(node.particle_per_m, r)).ravel())
    asymmetry = mi.Float64(column.at(node.asymmetry, r).ravel())
    start = dr.gather(mi.Float64, mi.Float64(np.repeat(rays.radius_m, shape[1])), ray)
    mu_s = dr.gather(mi.Float64, mi.Float64(column.sun_cosines), k)
    mu = dr.gather(mi.Float64, mi.Float64(rays.cosine.ravel()), ray)
    nu = _along_sun(mu_s, mu, (mi.Float64(azimuth) + 0.5) * (math.pi / n_azimuth))
    cos2 = dr.opaque(mi.Float64, node.molecular_cos2, 1)
    with_particles = bool(node.particle_per_m.any())
    molecules = (1.0 - cos2 / 3.0 + cos2 * nu * nu) * (0.25 / math.pi)

    def body(n: mi.UInt32, radiance: mi.Float64) -> tuple[mi.UInt32, mi.Float64]:
        at = ray * n_nodes + n
        r_n = dr.gather(mi.Float64, radius, at)
        h_n = dr.gather(mi.Float64, height, at)
        mu_n = (start * mu_s + dr.gather(mi.Float64, distance, at) * nu) / r_n
        lit = (mu_n > 0.0) | (r_n * r_n * (1.0 - mu_n * mu_n) > column.planet_m**2)
        emitted = dr.gather(mi.Float64, molecular, at) * molecules
        if with_particles:
            g = dr.gather(mi.Float64, asymmetry, at)
            base = 1.0 + g * g - 2.0 * g * nu
            phase = (1.0 - g * g) / (base * dr.sqrt(base)) * (0.25 / math.pi)
            emitted = emitted + dr.gather(mi.Float64, particle, at) * phase
        emitted = emitted * column.sun_table.transmittance(h_n, mu_n, 1)[0]
        return n + 1, radiance + dr.select(lit, emitted, 0.0)

    zero = dr.zeros(mi.Float64, dr.width(lane))
    _, radiance = dr.while_loop((mi.UInt32(0), zero), lambda n, _: n < n_nodes, body, label="single scattering")
    return np.array(radiance).reshape(shape)


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
