"""What shines on parts of the spacecraft: the Earth all round, and the Sun through whatever air is before it.

The Earth is our own picture of it from the same place: a map in longitude and latitude about the nadir, so that the
limb runs along a row and is covered exactly, looked up in the same tables as the frame. It is a Mitsuba ``envmap``,
which is linear between rows from pole to pole and between the middles of columns; the map's camera is laid so that its
pixels are those points. Sun and Moon are left out of it: the Sun is a light of its own, moonlight on parts is nothing.

The Sun's light is dimmed by the share of its disc that the Earth hides and by the air before it, mean over points of
the disc along straight rays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.rotation import perpendicular, tangent_basis
from horizonval.renderer.kernel.cells import group_cells
from horizonval.renderer.kernel.march import march
from horizonval.renderer.kernel.node_batches import SolarNodes
from horizonval.renderer.plugin.image import render_bands
from horizonval.renderer.plugin.plugins import mitsuba_sensor
from horizonval.renderer.plugin.settings import CameraSettings
from horizonval.renderer.ray_path import SOLAR_CONCENTRATION
from horizonval.renderer.tables import vectors

COLUMNS, ROWS = 128, 65
SUBSAMPLES = 2
_RINGS, _TURNS = 8, 16
_SUN_NODES = 128


@dataclass(frozen=True)
class Sunlight:
    """Of a solar band: the Sun's irradiance at the camera, as radiance and as energy count it [W m-2].

    ``wavelength_um``, ``weight``: where the light is, for what reflects it.
    """

    irradiance: float
    energy_irradiance: float
    wavelength_um: list[float]
    weight: list[float]


@dataclass(frozen=True)
class SkyLight:
    """All light that falls on parts at one place.

    Attributes
    ----------
    earth, earth_energy : dict of ndarray, shape (ROWS, COLUMNS), float32
        Radiance by band; energy radiance by solar band.
    sun : dict of Sunlight
        By solar band.
    itrs_from_map : ndarray, shape (3, 3)
        From the axes of Mitsuba's ``envmap``.
    """

    earth: dict[str, NDArray[np.float32]]
    earth_energy: dict[str, NDArray[np.float32]]
    sun: dict[str, Sunlight]
    itrs_from_map: FloatArray


def sky_light(integrator: Any, r_itrs: FloatArray, film: Any) -> SkyLight:
    """Return what shines on parts at the place of a camera.

    Parameters
    ----------
    integrator : horizon_limb
    r_itrs : ndarray, shape (3,)
    film : mi.Film
        Any.
    """
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
        cells=cells,
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
