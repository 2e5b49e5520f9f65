"""Radiance of the clear limb against height: seen by the heads round the orbit, and along parallels.

The rays come from the renderer's own march through the air of one month; the ground is behind those that end on it.
Round the orbit every head has its own profile, since the air changes under its line of sight. Along parallels the line
of sight stays near one latitude: that is the horizon as a function of latitude, whoever looks at it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import WGS84
from horizonval.spec.camera import CameraGeometry, CameraSpec
from horizonval.spec.scene import CameraUse, Platform, SceneName, SceneSpec
from horizonval.spec.stability import FieldSensor, StabilityBand, StabilitySpec
from horizonval.studies.stability.orbit import Heads, heads_round_orbit, offsets_of_heights, rays_along_parallels

if TYPE_CHECKING:
    from horizonval.earth.column import OpticalModel


LATITUDE_DEG = np.arange(-90.0, 91.0, 2.5)
"""Parallels at which the horizon is looked at."""

NODES = 128
"""Of the march: the half heights are within 4 m of those of 512."""

_HEIGHT_KM = (
    *(-10.0, -6.0, -3.0, -1.0, -0.05, 0.05, 0.5, 1.0, 1.5, 2.0, 2.5),
    *range(3, 56),
    *range(57, 72, 2),
    *(75.0, 80.0, 85.0, 90.0, 95.0, 100.0),
)
"""Four times as many rays move the half height by 4 m in the bands of carbon dioxide, by 24 m in the windows.

Two rays stand on either side of the ground, where a window's radiance may jump.
"""


_FAR_KM = 2e6
"""A scene holds the air that its satellite can see; from here that is every latitude."""


@dataclass(frozen=True)
class Profiles:
    """Clear limb radiances of one band in one month, W m-2 sr-1.

    Attributes
    ----------
    height_m : ndarray, shape (n,)
        Lowest geodetic height of the rays, rising; minus the depth of the chord below ground.
    orbit : ndarray, shape (p, 4, n)
        Per position and head.
    parallels : ndarray, shape (m, n)
        Per latitude of :data:`LATITUDE_DEG`.
    """

    height_m: FloatArray
    orbit: FloatArray
    parallels: FloatArray


def heads_of(spec: StabilitySpec) -> Heads:
    """Return the heads of a study round its orbit."""
    radius = WGS84.a_m + 1e3 * spec.altitude_km
    return heads_round_orbit(
        radius, math.radians(spec.inclination_deg), spec.positions, math.radians(spec.first_head_deg)
    )


def heights_m(spec: StabilitySpec) -> FloatArray:
    """Return the heights of a profile's rays, from below the lowest field of the study to the top of the air."""
    widest = max((sensor.field_deg for sensor in spec.sensor if isinstance(sensor, FieldSensor)), default=0.0)
    distance_km = math.sqrt((spec.altitude_km + 6378.0) ** 2 - 6357.0**2)
    # Half a field below a horizon that stands above the ground, and a tenth more.
    depth_km = 0.55 * math.radians(widest) * distance_km
    # The disc is smooth below the horizon: six steps are enough.
    below = -np.linspace(depth_km, 10.0, 7)[:-1] if depth_km > 10.0 else np.zeros(0)
    return 1e3 * np.array([*below, *_HEIGHT_KM])


def month_scene(spec: StabilitySpec, month: int) -> SceneSpec:
    """Return a scene that has the study's air and ground in the middle of a month."""
    return SceneSpec(
        scene=SceneName(name=f"stability-{month:02d}"),
        camera=CameraUse(file="stability"),
        platform=Platform(epoch_utc=datetime(2026, month, 16, tzinfo=UTC), altitude_km=_FAR_KM),
        atmosphere=spec.atmosphere.model_copy(update=_month(spec, month)),
        surface=spec.surface,
    )


def month_model(spec: StabilitySpec, band: StabilityBand, month: int) -> OpticalModel:
    """Return the optical properties of a month for one band.

    Raises
    ------
    UserError
        A band outside the tables, or air that is unknown.
    """
    from horizonval.earth.optical import optical_model

    camera = CameraSpec(camera=CameraGeometry(width=1, height=1, fov_deg=1.0), band=[band.band])
    return optical_model(month_scene(spec, month), camera)


def month_profiles(spec: StabilitySpec, band: StabilityBand, month: int) -> Profiles:
    """March every ray of one band in one month."""
    from horizonval.renderer.rays.thermal_radiance import thermal_radiance

    heads = heads_of(spec)
    height = heights_m(spec)
    direction = heads.directions(offsets_of_heights(heads, height))
    origin = np.broadcast_to(heads.r_itrs[:, None, None, :], direction.shape)
    parallel_origin, parallel_direction = rays_along_parallels(np.radians(LATITUDE_DEG), height)
    # The Sun stands across the orbit, where no head looks.
    inclination = math.radians(spec.inclination_deg)
    sun = (0.0, -math.sin(inclination), math.cos(inclination))
    found = thermal_radiance(
        month_model(spec, band, month),
        WGS84.a_m,
        np.concatenate([origin.reshape(-1, 3), parallel_origin.reshape(-1, 3)]),
        np.concatenate([direction.reshape(-1, 3), parallel_direction.reshape(-1, 3)]),
        sun_itrs=sun,
        polar_radius_m=WGS84.b_m,
        nodes=NODES,
    )[band.name]
    count = direction[..., 0].size
    return Profiles(
        height_m=height,
        orbit=np.asarray(found[:count], dtype=np.float64).reshape(direction.shape[:-1]),
        parallels=np.asarray(found[count:], dtype=np.float64).reshape(len(LATITUDE_DEG), len(height)),
    )


def _month(spec: StabilitySpec, month: int) -> dict[str, int]:
    return {"month": month} if spec.atmosphere.profile == "by_latitude_month" else {}
