"""What the ground at a place reflects of skylight: the one function for whoever scatters light above it.

Of the sea it counts what it sends back from below its surface, its foam, and what its surface reflects of a uniform
sky; not the glint of the Sun's beam. Clouds are not ground.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds.relief import cover_and_albedo
from horizonval.earth.surface import surface
from horizonval.earth.surface.ground_cover import ground_cover
from horizonval.earth.surface.materials import DRY
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
    a = surface.albedos(ground, wavelength_um)
    if ground.kind == "uniform":
        return np.full(np.broadcast(latitude_deg, longitude_deg).shape, a.ground)
    shares = ground_cover(latitude_deg, longitude_deg, ground.month).shares
    foam = surface.foam_share(ground.wind_speed_m_s)
    water = foam * a.foam + (1.0 - foam) * (a.water + a.sky)
    return np.asarray(sum(shares[name] * getattr(a, name) for name in DRY) + shares["water"] * water)


def mean_albedo(scene: SceneSpec, wavelength_um: float) -> float:
    """Return the mean diffuse albedo of everything in sight of the satellite, clouds included.

    For multiple scattering, which sees the ground from far and wide. Clouds cover the share to be expected there.
    """
    ground = surface.ground_model(scene)
    if ground.plain:
        return ground.albedo
    latitude, longitude = region(scene)
    below = diffuse_albedo(ground, latitude, longitude, wavelength_um)
    if ground.clouds is None:
        return float(np.mean(below))
    if ground.clouds.pattern == "uniform":
        return ground.clouds.share * ground.clouds.mean_albedo + (1.0 - ground.clouds.share) * float(np.mean(below))
    cover, cloud = cover_and_albedo(ground.clouds, latitude, longitude)
    return float(np.mean(cover * (cloud + (1.0 - cloud) ** 2 * below / (1.0 - cloud * below)) + (1.0 - cover) * below))


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
