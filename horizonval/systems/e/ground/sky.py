"""The light that reaches a ground station: sky, satellite, and refraction on the way down.

*Sky.* The renderer looks up from the station with a fisheye: light scattered any number of times, airglow and the sky
behind, straight rays. A cloudless sky away from the Sun is smooth, so that the logarithm of its radiance on a grid of
some degrees is enough for a spline; in time, a parabola through three epochs.

*Brightness of a satellite.* A convex body that tumbles shows on average a quarter of its surface (Cauchy). Its light is
taken to be that of a diffuse (Lambert) sphere of that cross-section A and albedo rho; at phase angle a and distance d::

    E = E_sun (rho A / d^2) (2 / 3 pi) (sin a + (pi - a) cos a) / pi

Neglected: glints, the shadow of one part on another, earthshine (a few per cent), and where on the satellite the
light comes from: up to some metres beside its centre of mass, 0.8 arcsec for 3 m at 800 km.

*Refraction as it is.* In spherical layers ``n r sin z`` is constant along a ray (Bouguer). A ray that arrives at the
apparent elevation ``E`` has ``c = n0 r0 cos E`` and turns about the Earth's centre by ::

    phi(E) = int_{r0}^{r} c dr / (r sqrt(n^2 r^2 - c^2))

up to radius r. The apparent elevation is the one whose ``phi`` is the angle at the centre between station and
satellite: exact for a satellite at its finite distance. With the air of a scene, integrated by the trapezoidal rule.

*Refraction as an observer takes it off.* ``z = z' + A tan z' + B tan^3 z'`` (``erfa.refco`` of the observer's pressure
and temperature) leads to the direction of the ray above the air, which passes beside the station by ::

    delta = r0 (n0 sin z' - sin z),     n0 - 1 = A (1 + H / r0), H = 8 km

so that the direction to a satellite at distance d is higher by ``delta / d`` (0.6 arcsec sin z at 800 km).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import erfa
import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RectBivariateSpline

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel
from horizonval.geometry import clock
from horizonval.geometry.camera import camera_from_spec, project
from horizonval.geometry.frames import rotate
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.systems.e.localisation.stations import Station

FIELD_DEG = 124.0
"""Field of the fisheye, whose image circle reaches down to an elevation of 28 deg."""


@dataclass(frozen=True)
class Sky:
    """Radiance over a station in one band.

    ``seconds``: shape (3,), after the pass's epoch; ``log_radiance``: shape (3, n, n), ln of W m-2 sr-1 in the
    fisheye's pixels; ``q_cam_from_itrs``: its attitude.
    """

    seconds: FloatArray
    log_radiance: FloatArray
    q_cam_from_itrs: tuple[float, ...]

    def radiance(self, direction_itrs: ArrayLike, second: float) -> FloatArray:
        """Return the radiance [W m-2 sr-1], shape (...), in directions (..., 3) at one instant."""
        n = self.log_radiance.shape[-1]
        uv, _ = project(camera_from_spec(fisheye(n, []).camera), rotate(self.q_cam_from_itrs, direction_itrs))
        at = np.arange(n, dtype=float)
        looks = [RectBivariateSpline(at, at, image).ev(uv[..., 1], uv[..., 0]) for image in self.log_radiance]
        t0, t1, t2 = self.seconds
        t = second
        weights = (
            (t - t1) * (t - t2) / ((t0 - t1) * (t0 - t2)),
            (t - t0) * (t - t2) / ((t1 - t0) * (t1 - t2)),
            (t - t0) * (t - t1) / ((t2 - t0) * (t2 - t1)),
        )
        return np.asarray(np.exp(sum(w * look for w, look in zip(weights, looks, strict=True))))

    def plain(self) -> dict[str, Any]:
        """Return plain data from which :meth:`of_plain` makes the same sky."""
        return {
            "seconds": self.seconds.tolist(),
            "log_radiance": self.log_radiance.tolist(),
            "q_cam_from_itrs": list(self.q_cam_from_itrs),
        }

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> Sky:
        """Build from :meth:`plain`."""
        return cls(np.array(plain["seconds"]), np.array(plain["log_radiance"]), tuple(plain["q_cam_from_itrs"]))


def fisheye(pixels: int, band: Sequence[Band]) -> CameraSpec:
    """Return a camera for the sky: ``pixels`` squared, f-theta, over :data:`FIELD_DEG`."""
    geometry = {"name": "sky", "width": pixels, "height": pixels, "fov_deg": FIELD_DEG, "projection": "fisheye"}
    return CameraSpec.model_validate({"camera": geometry, "band": [b.model_dump(exclude_none=True) for b in band]})


def sky_scene(station: Station, epoch_utc: datetime, second: float) -> SceneSpec:
    """Return the scene of a camera that looks up from a station: clean US 1976 air over a ground of albedo 0.3."""
    return SceneSpec.model_validate(
        {
            "scene": {"name": f"sky-{station.name}"},
            "camera": {"file": "sky"},
            "platform": {
                "epoch_utc": clock.utc_after(epoch_utc, second),
                "latitude_deg": float(np.degrees(station.latitude_rad)),
                "longitude_deg": float(np.degrees(station.longitude_rad)),
                "altitude_km": station.height_m * 1e-3,
            },
            "attitude": {"pitch_deg": 180.0},
            "render": {"subsamples": 1},
        }
    )


def render_sky(station: Station, epoch_utc: datetime, seconds: Sequence[float], band: Band, pixels: int = 33) -> Sky:
    """Return the sky over a station from three rendered frames, at ``seconds`` after the epoch."""
    camera = fisheye(pixels, [band])
    frames = [render_frame(sky_scene(station, epoch_utc, s), camera) for s in seconds]
    images = np.stack([np.log(np.asarray(f.radiance[band.name], float)) for f in frames])
    return Sky(np.asarray(seconds, float), images, tuple(frames[0].truth.q_cam_from_itrs))


SUN_MAGNITUDE = -26.74
"""V magnitude of the Sun at 1 au (Willmer, ApJS 236, 47 (2018): -26.76; -26.74 by tradition)."""


@dataclass(frozen=True)
class Brightness:
    """A satellite's parts: cross-sections [m2] and diffuse albedos, shape (k,) each."""

    cross_section_m2: tuple[float, ...]
    albedo: tuple[float, ...]

    @property
    def reflecting_m2(self) -> float:
        """Cross-section times albedo."""
        return math.fsum(a * rho for a, rho in zip(self.cross_section_m2, self.albedo, strict=True))


def box_cross_section_m2(x_m: float, y_m: float, z_m: float) -> float:
    """Return the mean cross-section of a box (of a plate where one side is 0) over all directions: surface / 4."""
    return (x_m * y_m + y_m * z_m + z_m * x_m) / 2.0


ENVISAT = Brightness((box_cross_section_m2(10.0, 4.6, 4.6), box_cross_section_m2(14.0, 5.0, 0.0)), (0.15, 0.06))
"""Body of 10 x 4.6 x 4.6 m and solar array of 14 x 5 m. Assumed albedos give the standard magnitude of observers'
lists, about 3.7, from which single passes depart by a magnitude and more."""


def sunlight_share(body: Brightness, phase_rad: ArrayLike, distance_m: ArrayLike) -> FloatArray:
    """Return the satellite's irradiance at the observer over the Sun's at the satellite, outside the air."""
    a, d = np.asarray(phase_rad, float), np.asarray(distance_m, float)
    law = (np.sin(a) + (np.pi - a) * np.cos(a)) / np.pi
    return np.asarray(body.reflecting_m2 * 2.0 / (3.0 * np.pi) * law / d**2)


def magnitude(share: ArrayLike) -> FloatArray:
    """Return the magnitude of something as bright as this share of the Sun."""
    return np.asarray(SUN_MAGNITUDE - 2.5 * np.log10(np.asarray(share, float)))


def standard_magnitude(body: Brightness) -> float:
    """Return the magnitude outside the air at 1000 km, half lit (phase 90 deg)."""
    return float(magnitude(sunlight_share(body, math.pi / 2, 1e6)))


def sunlight_through_air(
    model: OpticalModel, band: str, height_m: float, elevation_rad: ArrayLike
) -> tuple[FloatArray, float]:
    """Return a band's sunlight [W m-2] after the air above a station, shape (...), and before it.

    Along straight rays in spherical layers; light scattered back into the beam is neglected.
    """
    sine = np.sin(np.asarray(elevation_rad, float))[..., None]
    z = np.concatenate([[height_m], model.altitude_m[model.altitude_m > height_m]])
    radius = 6_371_008.8
    slant = (radius + z) / np.sqrt((radius + z) ** 2 - (radius + height_m) ** 2 * (1.0 - sine**2))
    after: FloatArray = np.zeros(sine.shape[:-1])
    before = 0.0
    for node in model.nodes:
        if node.band == band:
            extinction = np.interp(z, model.altitude_m, node.extinction_per_m)
            depth = np.trapezoid(extinction * slant, z, axis=-1)
            light = node.weight * node.solar_irradiance
            after, before = after + light * np.exp(-depth), before + light
    return after, before


_SCALE_HEIGHT_M = 8000.0
_STEPS = 12


@dataclass(frozen=True)
class RefractingAir:
    """Refractivity n - 1, linear over height above a sphere, shape (n,) each; vacuum above."""

    altitude_m: FloatArray
    refractivity: FloatArray
    radius_m: float = 6_371_008.8


@dataclass(frozen=True)
class Correction:
    """What an observer knows of the air: A and B [rad] of ``erfa.refco`` and the height of the station [m]."""

    a: float
    b: float
    height_m: float

    @classmethod
    def of(cls, pressure_hpa: float, temperature_c: float, height_m: float, wavelength_um: float) -> Correction:
        """Build from dry air at the station."""
        a, b = erfa.refco(pressure_hpa, temperature_c, 0.0, wavelength_um)
        return cls(float(a), float(b), height_m)


def apparent_elevation(
    air: RefractingAir, height_m: float, elevation_rad: ArrayLike, distance_m: ArrayLike
) -> FloatArray:
    """Return the apparent elevation of targets above the air, shape (...), from a station inside it.

    ``elevation_rad``, ``distance_m``: shape (...), of the straight line, 10 to 90 deg: near the horizon the secant
    steps that invert the integral could fail.
    """
    elevation, distance = np.broadcast_arrays(np.asarray(elevation_rad, float), np.asarray(distance_m, float))
    r0 = air.radius_m + height_m
    across, up = distance * np.cos(elevation), r0 + distance * np.sin(elevation)
    radius, central_angle = np.hypot(across, up), np.arctan2(across, up)
    above = air.altitude_m[air.altitude_m > height_m]
    r = air.radius_m + np.concatenate([[height_m], above])
    index = 1.0 + np.interp(r - air.radius_m, air.altitude_m, air.refractivity)

    def turned(apparent: FloatArray) -> FloatArray:
        c = (index[0] * r0 * np.cos(apparent))[..., None]
        # What bends: the difference to a straight ray with the same c, which is known in closed form.
        bent = c / (r * np.sqrt((index * r) ** 2 - c**2)) - c / (r * np.sqrt(r**2 - c**2))
        c = c[..., 0]
        return np.trapezoid(bent, r, axis=-1) + np.arccos(c / radius) - np.arccos(np.minimum(c / r0, 1.0))

    # n0 r0 cos E may exceed r0 only below 1.4 deg; the zenith is straight.
    first, second = elevation, elevation + 2.8e-4 / np.tan(np.maximum(elevation, 0.1)) + 1e-9
    y_first, y_second = turned(first) - central_angle, turned(second) - central_angle
    for _ in range(_STEPS):
        slope = y_second - y_first
        moved = np.abs(slope) > 0.0
        step = np.divide(y_second * (second - first), slope, out=np.zeros_like(slope), where=moved)
        first, y_first = second, y_second
        second = second - step
        y_second = turned(second) - central_angle
    return np.asarray(second)


def true_elevation(correction: Correction, apparent_rad: ArrayLike, distance_m: ArrayLike) -> FloatArray:
    """Return the elevation of the straight line to something seen at a distance, shape (...), as an observer would."""
    z_apparent = np.pi / 2 - np.asarray(apparent_rad, float)
    tangent = np.tan(z_apparent)
    z = z_apparent + correction.a * tangent + correction.b * tangent**3
    r0 = 6_371_008.8 + correction.height_m
    index = 1.0 + correction.a * (1.0 + _SCALE_HEIGHT_M / r0)
    beside = r0 * (index * np.sin(z_apparent) - np.sin(z))
    return np.asarray(np.pi / 2 - z + beside / np.asarray(distance_m, float))
