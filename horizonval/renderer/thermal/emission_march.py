r"""The march of emitting air: band radiance along rays through columns that vary with height and latitude.

For every g point, with extinction k and source S at a place, seen from the observer::

    L_air = sum over g of int S_g exp(-tau_g) dtau_g,        through_g = exp(-tau_g at the end)

Steps, their two Gauss points and what a step adds are those of :mod:`horizonval.renderer.kernel.march`; there is no
Sun, so that steps are even in its ray parameter. The latitude of a place is that of the ellipsoid's normal below it.

Asked for stations, the march also writes down what a cloud top between the ends of a ray must know: at every station t
the radiance P of the air before it, and ``Q = sum over g of exp(-tau_g(t)) S_g(air at t)``, the emission of a black
body as warm as the air there.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.renderer.layer_steps import LayeredSteps, layered_steps
from horizonval.renderer.planet import Planet, along
from horizonval.renderer.ray_path import GAUSS_LOW, THERMAL_CONCENTRATION, AirPath, find_path, warp
from horizonval.renderer.thermal.emission_columns import ColumnBatch
from horizonval.renderer.types import Values, Vec

THICK_STEP = 0.02
"""Optical depth from which the source is integrated against exp(-tau) exactly; emission knows its source everywhere, so
that this is right for isothermal air of any opacity to 1e-6."""
_FAR = 0.5 * GAUSS_LOW**2 / (1.0 - 2.0 * GAUSS_LOW)
_NEAR = GAUSS_LOW + _FAR
"""Optical depth from a step's beginning to its first point is ``h (_NEAR k_a - _FAR k_b)``."""


@dataclass(frozen=True)
class Stations:
    """Places along rays at which P and Q are wanted: ``count`` of them, even in t from ``first`` to ``last``.

    ``steps``: march steps from each to the next.
    """

    first: mi.Float64
    last: mi.Float64
    count: int
    steps: int


def march_emission(
    planet: Planet,
    top_m: float,
    batch: ColumnBatch,
    o: Vec,
    d: Vec,
    to_ground: mi.Bool,
    nodes: int,
    stations: Stations | None = None,
) -> tuple[Values, Values, tuple[mi.Float64, mi.Float64] | None]:
    """Return what the air of a few g points sends along rays.

    Parameters
    ----------
    o, d : Vec
        Origins [m, planet-centred] and unit directions.
    to_ground : Bool
        Stop at the ground (the ray must hit it).
    nodes : int
        Evaluations along each ray (two per step); before the stations if there are any.
    stations : Stations, optional
        Then the march ends at the last one.

    Returns
    -------
    radiance, through : lists of Float64
        Of the air, and transmittance from the observer to the end of the path; per g point that is not filling.
    at_stations : tuple of two Float64, shape (count * rays,), or None
        P and Q, station by station.
    """
    path = find_path(planet, top_m, o, d, to_ground)
    count = max(nodes // 2, 3)
    layered = None
    if batch.bands and stations is None:
        layered = layered_steps(planet, path, o, d, batch.bands, count, THERMAL_CONCENTRATION)
    rays = dr.width(path.t_low)
    zero = dr.zeros(mi.Float64, rays)
    total: int | mi.UInt32 = count if stations is None else count + (stations.count - 1) * stations.steps
    if layered is not None:
        total = layered.count
    # as data: frames with other numbers of rays share the kernel
    lane, width = dr.arange(mi.UInt32, rays), dr.opaque(mi.UInt32, rays, 1)
    at_stations = None
    if stations is not None:
        at_stations = dr.zeros(mi.Float64, rays * stations.count), dr.zeros(mi.Float64, rays * stations.count)

    def boundary(i: mi.UInt32) -> mi.Float64:
        return _boundary(path, mi.Float64(i), count, stations, layered)

    def air_at(t: mi.Float64) -> tuple[Values, Values]:
        height, normal = planet.height_and_normal(along(o, d, t))
        return batch.at(height, normal)

    def body(
        i: mi.UInt32, t0: mi.Float64, passed: Values, radiance: Values
    ) -> tuple[mi.UInt32, mi.Float64, Values, Values]:
        passed, radiance = list(passed), list(radiance)
        t1 = boundary(i + 1)
        h = t1 - t0
        k_a, s_a = air_at(t0 + GAUSS_LOW * h)
        k_b, s_b = air_at(t0 + (1.0 - GAUSS_LOW) * h)
        for n in range(batch.width):
            added, escaped = step_emission(h, k_a[n], k_b[n], s_a[n], s_b[n])
            radiance[n] = dr.fma(passed[n], added, radiance[n])
            passed[n] = passed[n] * escaped
        if stations is not None and at_stations is not None:
            _, s = air_at(t1)
            black = sum(passed[n] * s[n] for n in range(batch.width))
            past = i + 1 - count
            station = (i + 1 >= count) & (past % stations.steps == 0)
            index = past // stations.steps * width + lane
            dr.scatter(at_stations[0], sum(radiance), index, station, mode=dr.ReduceMode.NoConflicts)
            dr.scatter(at_stations[1], black, index, station, mode=dr.ReduceMode.NoConflicts)
        return i + 1, t1, passed, radiance

    nothing, everything = [zero + 0.0] * batch.width, [zero + 1.0] * batch.width
    _, _, passed, radiance = dr.while_loop(
        (mi.UInt32(0), boundary(mi.UInt32(0)) + zero, everything, nothing),
        lambda i, *_: i < total,
        body,
        labels=("i", "t", "passed", "radiance"),
        label="emission march",
    )
    through = passed[: batch.used]
    radiance = radiance[: batch.used]
    dr.eval(radiance, through, at_stations)
    return radiance, through, at_stations


def step_emission(
    h: mi.Float64, k_a: mi.Float64, k_b: mi.Float64, s_a: mi.Float64, s_b: mi.Float64
) -> tuple[mi.Float64, mi.Float64]:
    """Return what one step of length ``h`` adds, seen from its beginning, and the transmittance through it.

    ``k``, ``s``: extinction and source at the step's Gauss points. Extinction is linear over the step. Below
    :data:`THICK_STEP` four terms of the exponential's series are as good as it is (7e-9), and cost a fraction.
    """
    tau_a = h * (_NEAR * k_a - _FAR * k_b)
    step = 0.5 * h * (k_a + k_b)
    tau_b = dr.fma(1.0 - 2.0 * GAUSS_LOW, step, tau_a)
    tau_a = dr.maximum(tau_a, 0.0)
    escaped = dr.exp(-step)

    def faded(tau: mi.Float64) -> mi.Float64:
        return dr.fma(tau, dr.fma(tau, dr.fma(tau, -1.0 / 6.0, 0.5), -1.0), 1.0)

    thin = 0.5 * h * (k_a * s_a * faded(tau_a) + k_b * s_b * faded(tau_b))
    # thick: S linear in tau through the two points, integrated against exp(-tau)
    e0 = 1.0 - escaped
    e1 = e0 - step * escaped
    thick = s_a * e0 + (s_b - s_a) * (e1 - tau_a * e0) / dr.maximum(tau_b - tau_a, 1e-30)
    return dr.select(step < THICK_STEP, thin, dr.maximum(thick, 0.0)), escaped


def _boundary(
    path: AirPath, i: mi.Float64, count: int, stations: Stations | None, layered: LayeredSteps | None
) -> mi.Float64:
    """Return the ray parameter of step boundary ``i``."""
    if layered is not None:
        return warp(path, layered.boundary(path, i, count), THERMAL_CONCENTRATION)
    if stations is None:
        return warp(path, path.y0 + (path.y1 - path.y0) * (i / count), THERMAL_CONCENTRATION)
    start = path.t_low - path.length_before
    before = start + (stations.first - start) * (i / count)
    x = (i - count) / ((stations.count - 1.0) * stations.steps)
    return dr.select(i < count, before, dr.fma(stations.last - stations.first, x, stations.first))
