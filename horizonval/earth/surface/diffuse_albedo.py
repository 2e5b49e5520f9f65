"""What the ground at a place reflects of skylight: the one function for whoever scatters light above it.

Of the sea it counts what it sends back from below its surface, its foam, and what its surface reflects of a uniform
sky; not the glint of the Sun's beam. Clouds are not ground.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.surface import surface
from horizonval.earth.surface.land import is_land
from horizonval.geometry.directions import GOLDEN_ANGLE_RAD
from horizonval.spec.scene import SceneSpec

MEAN_RADIUS_KM = 6371.0
REGION_POINTS = 4096


def diffuse_albedo(
    ground: surface.GroundModel, latitude_deg: ArrayLike, longitude_deg: ArrayLike, wavelength_um: float
) -> FloatArray:
    """Return the albedo of the cloudless ground for diffuse light.

    Parameters
    ----------
    ground : GroundModel
        Of the scene, its month included; see :func:`horizonval.earth.surface.surface.ground_model`.
    latitude_deg, longitude_deg : array_like
        Geodetic, broadcast against each other.
    wavelength_um : float

    Returns
    -------
    ndarray
        Of the places' broadcast shape, 0 to 1.
    """
    latitude, longitude = np.broadcast_arrays(np.asarray(latitude_deg, float), np.asarray(longitude_deg, float))
    a = surface.albedos(ground, wavelength_um)
    if ground.kind == "uniform":
        return np.full(latitude.shape, a.land)
    snow = surface.snow_share(latitude, ground.snow_line_deg)
    foam = surface.foam_share(ground.wind_speed_m_s)
    sea = foam * a.foam + (1.0 - foam) * (a.water + a.sky)
    return np.where(is_land(latitude, longitude), snow * a.snow + (1.0 - snow) * a.land, sea)


def mean_albedo(scene: SceneSpec, wavelength_um: float) -> float:
    """Return the mean diffuse albedo of everything in sight of the satellite, clouds included.

    For multiple scattering, which sees the ground from far and wide. Clouds cover their nominal share.
    """
    ground = surface.ground_model(scene)
    if ground.plain:
        return ground.albedo
    below = float(np.mean(diffuse_albedo(ground, *region(scene), wavelength_um)))
    if ground.clouds is None:
        return below
    return ground.clouds.cover * ground.clouds.mean_albedo + (1.0 - ground.clouds.cover) * below


def region(scene: SceneSpec) -> tuple[FloatArray, FloatArray]:
    """Return latitudes and longitudes [deg] of points spread evenly over the part of the globe in sight."""
    place = scene.platform
    cap = 1.0 - MEAN_RADIUS_KM / (MEAN_RADIUS_KM + place.altitude_km)
    k = np.arange(REGION_POINTS) + 0.5
    mu = 1.0 - cap * k / REGION_POINTS
    s = np.sqrt(1.0 - mu * mu)
    phi = GOLDEN_ANGLE_RAD * k
    a, b = math.radians(place.latitude_deg), math.radians(place.longitude_deg)
    up = np.array([math.cos(a) * math.cos(b), math.cos(a) * math.sin(b), math.sin(a)])
    east = np.array([-math.sin(b), math.cos(b), 0.0])
    p = np.outer(mu, up) + np.outer(s * np.cos(phi), east) + np.outer(s * np.sin(phi), np.cross(up, east))
    return np.degrees(np.arcsin(np.clip(p[:, 2], -1.0, 1.0))), np.degrees(np.arctan2(p[:, 1], p[:, 0]))
