"""Height of the visible limb: how it varies, what that does to a fitted cone, and how refraction raises the horizon.

A limb at the height ``h`` above the sphere at azimuth phi appears ``delta = h tan(rho) / R`` outside of it. To first
order the fitted axis ``n`` and half-angle ``rho`` move by the least-squares solution of

    t(phi) . dn + drho = delta(phi),        (dn, drho) = G delta,      G = (J^T J)^-1 J^T,  J = [t, 1]

with ``t`` the unit direction from the axis towards the point. A constant height moves ``rho`` alone; a bow of one
kilometre over a 50 deg arc of limb, seen from 500 km, moves the nadir by 0.3 deg. The covariance K of the heights along
the limb therefore propagates to the nadir as ``G K G^T``. It does not decrease with the number of points and is
separate from noise. Second orders are neglected: (delta / rho)^2 is 1e-5.

**Oblateness.** To first order in the flattening the radius of the ellipsoid in the direction ``u`` from its centre is
``a (1 - f (u . z)^2)``, ``z`` the pole. A method that knows neither position nor heading must treat all directions of
the pole as equally likely; the covariance is the mean over poles spread evenly over the sphere. This gives up to 0.17
deg rms, mostly the angle between geocentric and geodetic vertical.

**Relief.** Height of the visible limb over the ground varies with the Sun's angle along the limb, with clouds and with
the temperature of the air. It is a random function of azimuth with a standard deviation and a correlation length,
``K(phi) = s^2 exp(-phi^2 / (2 l^2))``, measured on rendered limbs.

**Refraction.** A ray that grazes the ground has the impact parameter ``n R`` (Bouguer's law), n the index of the air
there, and leaves the air as a straight line at that distance from the centre. Seen from outside, the planet is larger
by :math:`(n - 1) R`: 1.77 km in visible light for the US standard atmosphere. One index, the mean over the bands'
wavelengths, serves all bands (1 % of n - 1 at either end of the visible, 20 m); R is the mean radius (10 m at most on
the ellipsoid). Horizontal gradients of the air are neglected: they tilt the horizon by arcseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth import atmosphere_file
from horizonval.earth.atmosphere.air import NO_ATMOSPHERE, air_of
from horizonval.earth.atmosphere_file import AtmosphereFile
from horizonval.earth.gases import rayleigh
from horizonval.earth.spectral import bands
from horizonval.geometry.rotation import fibonacci_sphere, tangent_basis
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.scene import SceneSpec


@dataclass(frozen=True)
class Relief:
    """Height of the limb as a random function of azimuth: standard deviation [m], correlation length [rad]."""

    sigma_m: float
    correlation_rad: float


SOLAR_RELIEF = (Relief(250.0, 0.3), Relief(300.0, 0.05))
"""Relief of the steepest point of the sunlit limb: a slow change with the Sun's angle along the arc, and clouds."""

THERMAL_RELIEF = (Relief(800.0, 0.4), Relief(300.0, 0.05))
"""Relief of the infrared limb, which follows the temperature of the stratosphere across latitudes."""

CLOUD_RELIEF_SOLAR = Relief(600.0, 0.05)
"""Additional relief of clouds at the limb in sunlight."""

CLOUD_RELIEF_THERMAL = Relief(2500.0, 0.05)
"""Additional relief of clouds in window bands, which see their tops; bands of carbon dioxide do not."""

SOLAR_HEIGHT_M = (-2e3, 40e3)
THERMAL_HEIGHT_M = (-2e3, 70e3)


def reliefs(band_kind: Literal["solar", "thermal"] | None, sigma_m: float | None = None) -> tuple[Relief, ...]:
    """Return how the limb's height varies along it; the larger variation if the band is unknown.

    ``sigma_m``: total standard deviation in place of the band's, with the same correlation; 0 for none.
    """
    usual = SOLAR_RELIEF if band_kind == "solar" else THERMAL_RELIEF
    if sigma_m is None:
        return usual
    if sigma_m == 0.0:
        return ()
    total = math.hypot(*(relief.sigma_m for relief in usual))
    return tuple(replace(relief, sigma_m=sigma_m / total * relief.sigma_m) for relief in usual)


def limb_height_m(band_kind: Literal["solar", "thermal"] | None) -> tuple[float, float]:
    """Return the lowest and the highest visible limb of clear air above a sphere of the mean radius."""
    return SOLAR_HEIGHT_M if band_kind == "solar" else THERMAL_HEIGHT_M


MOST_POINTS = 240
"""Largest number of points in the covariance matrix; the heights are smooth, so a sample suffices."""
POLES = 400


def systematic_covariance(
    los_cam: FloatArray,
    axis_cam: FloatArray,
    rho_rad: float,
    *,
    flattening: float,
    reliefs: tuple[Relief, ...],
    earth_radius_m: float,
    estimates: Literal["geocentric", "geodetic"] = "geocentric",
    gain: FloatArray | None = None,
) -> FloatArray:
    """Return the covariance [rad^2] of (axis along basis 1, along basis 2, half-angle), shape (3, 3).

    The basis is :func:`horizonval.geometry.rotation.tangent_basis` of the axis. ``los_cam``: shape (n, 3), n >= 3 unit
    lines of sight to limb points; ``flattening``: 0 for a sphere; ``reliefs``: independent contributions;
    ``estimates``: vertical with which the axis is compared, on which the effect of oblateness depends; ``gain``: shape
    (3, n), derivative of the three by the outward shift [rad] at each point, for methods that do not fit a cone. Raises
    ``LinAlgError``: the points do not determine a cone.
    """
    thin = gain is None and len(los_cam) > 3
    some = los_cam[:: max(1, -(-len(los_cam) // MOST_POINTS))] if thin else los_cam
    basis = tangent_basis(axis_cam)
    across = some @ basis
    across = across / np.linalg.norm(across, axis=1)[:, None]
    if gain is None:
        jacobian = np.column_stack([across, np.ones(len(some))])
        gain = np.linalg.inv(jacobian.T @ jacobian) @ jacobian.T
    covariance = gain @ relief_covariance(across, rho_rad, reliefs, earth_radius_m) @ gain.T
    if flattening != 0.0:
        moved = _oblate_moves(across, gain, rho_rad, flattening, estimates)
        covariance = covariance + moved @ moved.T / moved.shape[1]
    return np.asarray(0.5 * (covariance + covariance.T))


def relief_covariance(
    across: FloatArray, rho_rad: float, reliefs: tuple[Relief, ...], earth_radius_m: float
) -> FloatArray:
    """Return the covariance [rad^2], shape (n, n), of the limb's angular distance from the cone due to relief.

    ``across`` (n, 2): unit directions from the axis towards the points, in its tangent basis.
    """
    azimuth = np.arctan2(across[:, 1], across[:, 0])
    apart = np.abs(azimuth[:, None] - azimuth[None, :])
    apart = np.minimum(apart, 2.0 * np.pi - apart)
    heights = np.zeros((len(across), len(across)))
    for relief in reliefs:
        heights += relief.sigma_m**2 * np.exp(-0.5 * (apart / relief.correlation_rad) ** 2)
    return np.asarray((np.tan(rho_rad) / earth_radius_m) ** 2 * heights)


def oblate_limbs(across: FloatArray, rho_rad: float, flattening: float) -> FloatArray:
    """Return how far outside of a cone [rad] an ellipsoid's limb appears, shape (n, poles), for poles spread evenly.

    ``across`` as for :func:`relief_covariance`.
    """
    # From the Earth's centre a tangent point lies 90 deg - rho from the sub-satellite point, which is opposite to the
    # nadir.
    points = np.column_stack([np.cos(rho_rad) * across, np.full(len(across), -np.sin(rho_rad))])
    return np.asarray(-flattening * np.tan(rho_rad) * (points @ _poles().T) ** 2)


def _oblate_moves(
    across: FloatArray, gain: FloatArray, rho_rad: float, flattening: float, estimates: str
) -> FloatArray:
    """Return the errors (3, poles) of (axis 1, axis 2, half-angle), in axes (basis 1, basis 2, nadir)."""
    pole = _poles()
    moved = gain @ oblate_limbs(across, rho_rad, flattening)
    if estimates == "geodetic":
        # The normal at the foot leans from the radius towards the pole by f sin(2 lat) R / (R + H): down leans away.
        moved[:2] -= 2.0 * flattening * np.sin(rho_rad) * pole[:, 2] * pole[:, :2].T
    moved[2] -= moved[2].mean()
    return moved


@cache
def _poles() -> FloatArray:
    """Return unit vectors spread evenly over the sphere (Fibonacci's spiral), shape (POLES, 3)."""
    return fibonacci_sphere(POLES)


def air_refractivity(
    scene: SceneSpec, number_density_air: FloatArray, camera_bands: Sequence[Band]
) -> FloatArray | None:
    """Return n - 1 of air of a number density [1/m3] for a camera's bands; None without refraction."""
    if scene.atmosphere.refraction is False:
        return None
    return rayleigh.refractivity(number_density_air, [bands.reference_wavelength_um(band) for band in camera_bands])


def file_refractivity(scene: SceneSpec, file: AtmosphereFile, altitude_m: FloatArray, where: str) -> FloatArray | None:
    """Return n - 1 of an atmosphere file on other altitudes, None without refraction; ``UserError`` if missing."""
    wanted = scene.atmosphere.refraction
    if wanted is False or (wanted is None and file.refractivity is None):
        return None
    return atmosphere_file.refractivity(file, altitude_m, where)


def horizon_rise_m(
    scene: SceneSpec, camera: CameraSpec, altitude_m: float, mean_radius_m: float, base_dir: Path | None = None
) -> float:
    """Return the height of the refracted horizon above the geometric one [m]; 0 without refraction.

    Inside the air, at index n(h), the planet appears larger by ``(n(0) - n(h)) R``. ``altitude_m``: of the camera;
    ``mean_radius_m``: of the planet; ``base_dir``: folder of the atmosphere's files, default the current one. Raises
    ``UserError``: as :func:`horizonval.earth.optical.optical_model` for the air.
    """
    atmosphere = scene.atmosphere
    if not camera.band or atmosphere.refraction is False:
        return 0.0
    if atmosphere.file is not None:
        path = (base_dir or Path()) / atmosphere.file
        file = atmosphere_file.read_atmosphere(path)
        level_m = atmosphere_file.altitudes_m(file, thermal=False)
        index = file_refractivity(scene, file, level_m, str(path))
    elif atmosphere.profile_file is None and atmosphere.profile == NO_ATMOSPHERE:
        return 0.0
    else:
        air = air_of(scene, base_dir)
        level_m, index = air.altitude_m, air_refractivity(scene, air.state.number_density_air, camera.band)
    return 0.0 if index is None else float(index[0] - np.interp(altitude_m, level_m, index)) * mean_radius_m
