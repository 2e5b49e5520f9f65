r"""Thermal emission by Monte Carlo: an integrator for Mitsuba, whose own ``volpath`` knows no air that shines.

A path is walked backward from the camera, and ends where a photon that came along it was emitted: at the first
absorption. Along the ray the optical depth to that place is distributed as :math:`\exp(-\tau)`, and so

.. math:: L_g = \int S_g \, e^{-\tau_g} \, d\tau_g + \dots = E[S_g(\text{place of absorption})]

with S = 0 for paths that leave into space. On the ground a path ends with the probability of the emissivity
(Kirchhoff) and is reflected otherwise. Each path belongs to one g point, drawn with a probability :math:`p_g`, and
counts :math:`1 / p_g` times; the paths of a pixel lie evenly in the sum of these probabilities. Half of :math:`p_g` is
:math:`S_g / \sum S_g` of air of :data:`TYPICAL_K`, half the same for all: the middle of a line, which has next to no
width and which is all that shines high up, would else have too few paths.

Distances are found by null collisions (Woodcock): a tentative flight through air of the majorant :math:`M \ge k`, then
absorption with the probability :math:`k / M`. Where a majorant holds follows from one fact: height above a convex body
is a convex function along a line, so that a ray at height h whose height changes by :math:`\mu` per metre is never
below :math:`h + \mu s`. A flight ends where the ray may have sunk by :data:`SINK_M`, and goes on with the majorant
from there.

From Mitsuba come the rays of the camera, the ground that they hit and its normal (an ``instance``, as in sunlight), the
random numbers and the film. With the march it shares no code but that of the optical properties.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.renderer.reference.air_tables import AirTables
from horizonval.renderer.reference.ground_tables import GroundTables
from horizonval.renderer.reference.reference_scene import KM, Placement, geodetic
from horizonval.renderer.tables import table_of
from horizonval.renderer.types import PluginDict, constant_vector, inverse_root

TYPICAL_K = 250.0
SINK_M = 4000.0
LONGEST_M = 100e3
"""Of a flight within the air."""
_NEVER = 1e12


def emission_scene(place: Placement, band: EmittingBand, ground: GroundTables, sensor: PluginDict) -> PluginDict:
    """Return the scene of a thermal band: the ellipsoid, the camera, and the integrator with the band's air."""
    planet = place.planet
    axes = [planet.a_m * KM, planet.a_m * KM, planet.b_m * KM]
    return {
        "type": "scene",
        "integrator": _integrator(place, band, ground),
        "unit_sphere": {"type": "shapegroup", "id": "unit_sphere", "sphere": {"type": "sphere"}},
        "ground": {
            "type": "instance",
            "to_world": mi.ScalarTransform4f().translate(place.centre_km.tolist()).scale(axes),
            "shapegroup": {"type": "ref", "id": "unit_sphere"},
        },
        "sensor": sensor,
    }


def _integrator(place: Placement, band: EmittingBand, ground: GroundTables) -> Any:
    """Return the integrator of the module text, made for the active variant."""
    air = AirTables.of(band)
    weight = band.source(TYPICAL_K)
    share = 0.5 * weight / weight.sum() + 0.5 / len(weight)
    until = table_of(mi.Float32, np.cumsum(share)[:-1] if len(share) > 1 else np.ones(1))
    shares = table_of(mi.Float32, share)
    origin = mi.Vector3d(*constant_vector(place.origin_m))
    planet = place.planet

    def flight(
        height: mi.Float64, rise: mi.Float64, g: mi.UInt32, sample: mi.Float64
    ) -> tuple[mi.Float64, mi.Bool, mi.Float64]:
        """Return how far to go, whether a tentative collision is there, and the majorant."""
        sink = dr.maximum(SINK_M, height - air.top_m + 1.0)
        down = rise < 0.0
        lowest = height - dr.select(down, sink, 10.0)
        reach = dr.select(down, sink, SINK_M) / dr.maximum(dr.abs(rise), 1e-9)
        reach = dr.select(height > air.top_m, reach, dr.minimum(reach, LONGEST_M))
        majorant = air.most_above(g, lowest)
        free = -dr.log(1.0 - sample) / dr.maximum(majorant, 1e-30)
        return dr.minimum(free, reach), free < reach, majorant

    class EmissionWalk(mi.SamplingIntegrator):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)

        def sample(
            self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
        ) -> tuple[Any, Any, list[Any]]:
            count = sampler.sample_count()
            index = dr.arange(mi.UInt32, sampler.wavefront_size()) % dr.opaque(mi.UInt32, count, 1)
            u = (mi.Float32(index) + sampler.next_1d()) / dr.opaque(mi.Float32, count, 1)
            g = mi.UInt32(0)
            if len(share) > 1:
                g = dr.binary_search(0, len(share) - 1, lambda i: dr.gather(mi.Float32, until, i) <= u)
            si = scene.ray_intersect(mi.Ray3f(ray), active=mi.Bool(active))
            o: Any = mi.Vector3d(ray.o) / KM + origin
            d = _unit(mi.Vector3d(ray.d))
            hit = si.is_valid()
            t_hit = dr.select(hit, mi.Float64(si.t) / KM, _NEVER)
            _, normal = geodetic(planet, o + dr.select(hit, t_hit, 0.0) * d)
            kind, temperature = ground.grid.at(normal, sampler.next_1d())
            cosine = -dr.dot(normal, d)
            lens = sampler.next_2d()
            stays = mi.Float64(sampler.next_1d()) < ground.emissivity_of(g, kind, cosine)
            glow = ground.source_of(g, temperature)
            even = mi.Vector3d(mi.Frame3f(mi.Vector3f(normal)).to_world(mi.warp.square_to_cosine_hemisphere(lens)))
            up = _unit(dr.select(kind == ground.water, d + 2.0 * cosine * normal, even))

            def body(
                sampler: Any,
                walking: mi.Bool,
                o: Any,
                d: Any,
                t: mi.Float64,
                t_hit: mi.Float64,
                tentative: mi.Bool,
                majorant: mi.Float64,
                found: mi.Float64,
            ) -> tuple[Any, ...]:
                height, normal = geodetic(planet, o + t * d)
                rise = dr.dot(normal, d)
                extinction, source = air.at(g, height, normal.z)
                absorbed = tentative & (mi.Float64(sampler.next_1d(walking)) * majorant < extinction)
                step, tentative, majorant = flight(height, rise, g, mi.Float64(sampler.next_1d(walking)))
                lands = ~absorbed & (t + step >= t_hit)
                ends = lands & stays
                found = dr.select(absorbed, source, dr.select(ends, glow, found))
                walking = walking & ~absorbed & ~ends & ((height <= air.top_m) | (rise < 0.0))
                reflected = lands & ~stays
                return (
                    sampler,
                    walking,
                    dr.select(reflected, o + t_hit * d, o),
                    dr.select(reflected, up, d),
                    dr.select(reflected, 0.0, t + step),
                    dr.select(reflected, _NEVER, t_hit),
                    tentative & ~lands,
                    majorant,
                    found,
                )

            zero = dr.zeros(mi.Float64, dr.width(t_hit))
            state = (sampler, mi.Bool(active), o, d, zero, t_hit, mi.Bool(False), zero, zero)
            names = ("sampler", "walking", "o", "d", "t", "t_hit", "tentative", "majorant", "found")
            *_, found = dr.while_loop(state, lambda _, walking, *rest: walking, body, labels=names)
            counts = found / mi.Float64(dr.gather(mi.Float32, shares, g))
            return mi.Spectrum(mi.Float32(counts)), mi.Bool(active), []

        def aov_names(self) -> list[str]:
            return []

    return EmissionWalk(mi.Properties("emission_walk"))


def _unit(v: Any) -> Any:
    return v * inverse_root(dr.squared_norm(v))
