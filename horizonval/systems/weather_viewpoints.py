"""Places round a circular orbit, each on a day of its own: a month, a longitude, weather drawn from a seed.

The k-th place has argument of latitude, node and month::

    u = 2 pi frac(a k),    node = 2 pi frac(a^2 k),    month = 1 + k mod 12

with a = 0.7548776662 (1 / a^3 = 1 / a + 1: the additive recurrence that fills a square most evenly), so that places,
longitudes and seasons are all covered however few there are. The orbit is a circle about the Earth's centre, its radius
the equator's plus the altitude: over latitude 35 the ellipsoid lies 7 km lower.

*Orbit* over an Earth that does not turn. With the argument of latitude u, the inclination i and the longitude of the
ascending node::

    sin latitude = sin i sin u,    longitude = node + atan2(cos i sin u, cos u),    tan heading = cot i / cos u

The spherical triangle of node, equator and place. Neglected: the Earth's turn meanwhile, and the difference of
geocentric and geodetic latitude (0.19 deg at most), which only shifts where along the orbit a frame is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.earth.clouds.relief import CloudField, cloud_field
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.frames import lvlh_from_itrs
from horizonval.spec.camera import Band, CameraGeometry, CameraSpec
from horizonval.spec.scene import SceneSpec

if TYPE_CHECKING:
    from horizonval.earth.column import OpticalModel


def place_on_orbit(argument_rad: float, inclination_rad: float, node_rad: float) -> dict[str, float]:
    """Return latitude, longitude and heading (from north, through east) as keys of a scene's platform table [deg]."""
    u, i = argument_rad, inclination_rad
    longitude = node_rad + math.atan2(math.sin(u) * math.cos(i), math.cos(u))
    return {
        "latitude_deg": math.degrees(math.asin(math.sin(i) * math.sin(u))),
        "longitude_deg": math.degrees(math.remainder(longitude, math.tau)),
        "heading_deg": math.degrees(math.atan2(math.cos(i), math.sin(i) * math.cos(u))),
    }


PLASTIC = 0.7548776662466927
YEAR = 2026


def weather_places(count: int, inclination_deg: float, seed: int) -> dict[str, JsonObject]:
    """Return places by name, as plain data for :class:`WeatherPlace`; the seed draws the weather of each."""
    out = {}
    for k in range(count):
        u, node = (2.0 * math.pi * math.fmod(step * k, 1.0) for step in (PLASTIC, PLASTIC**2))
        place = place_on_orbit(u, math.radians(inclination_deg), node)
        out[f"place {k}"] = {**place, "month": 1 + k % 12, "weather": 1000 * seed + k, "clouds": seed}
    return out


@dataclass(frozen=True)
class WeatherPlace:
    """One geocentric position on one day; ``weather``, ``clouds``: seeds."""

    latitude_deg: float
    longitude_deg: float
    heading_deg: float
    month: int
    weather: int
    clouds: int

    @classmethod
    def of(cls, item: JsonObject) -> WeatherPlace:
        """Return the place of an item that has further keys."""
        return cls(**{key: item[key] for key in cls.__dataclass_fields__})

    def position(self, altitude_km: float) -> FloatArray:
        """Return the position [m], shape (3,), Earth-fixed."""
        latitude, longitude = math.radians(self.latitude_deg), math.radians(self.longitude_deg)
        level = math.cos(latitude)
        up = np.array([level * math.cos(longitude), level * math.sin(longitude), math.sin(latitude)])
        return (WGS84.a_m + 1e3 * altitude_km) * up

    def lvlh(self) -> FloatArray:
        """Return the quaternion from Earth-fixed axes to lvlh."""
        return lvlh_from_itrs(self.position(0.0), math.radians(self.heading_deg))

    def scene(self, altitude_km: float) -> SceneSpec:
        """Return a scene with the air of the day as far as can be seen from an altitude, and the month's clouds."""
        platform: dict[str, Any] = {
            "epoch_utc": datetime(YEAR, self.month, 16, tzinfo=UTC),
            "latitude_deg": self.latitude_deg,
            "longitude_deg": self.longitude_deg,
            "altitude_km": altitude_km,
        }
        return SceneSpec.model_validate(
            {
                "camera": {"file": "rays"},
                "platform": platform,
                "atmosphere": {"profile": "weather", "seed": self.weather, "refraction": False},
                "clouds": {"cover": "climate", "seed": self.clouds},
            }
        )

    def model(self, altitude_km: float, band_um: tuple[float, float]) -> OpticalModel:
        """Return the optical properties of one thermal band, named ``band``."""
        from horizonval.earth.optical import optical_model

        band = Band(name="band", kind="thermal", lo_um=band_um[0], hi_um=band_um[1])
        camera = CameraSpec(camera=CameraGeometry(width=1, height=1, fov_deg=1.0), band=[band])
        return optical_model(self.scene(altitude_km), camera)

    def clouds_of(self, altitude_km: float) -> CloudField:
        """Return the clouds of the day."""
        field = cloud_field(self.scene(altitude_km))
        assert field is not None
        return field
