"""Limb radiances by SASKTRAN2 (pip, MIT; only for making and checking reference tables)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sasktran2 as sk
from reference_rays import OBSERVER_KM


def _config(threads: int = 1) -> sk.Config:
    config = sk.Config()
    config.num_threads = threads
    config.num_stokes = 1
    return config


def _geometry(cos_sza: float, radius_km: float, altitude_m: np.ndarray) -> sk.Geometry1D:
    return sk.Geometry1D(
        cos_sza=cos_sza,
        solar_azimuth=0.0,
        earth_radius_m=1e3 * radius_km,
        altitude_grid_m=altitude_m,
        interpolation_method=sk.InterpolationMethod.LinearInterpolation,
        geometry_type=sk.GeometryType.Spherical,
    )


def _viewing(cos_sza: float, radius_km: float, rays: Sequence[tuple[float, float]]) -> sk.ViewingGeometry:
    viewing = sk.ViewingGeometry()
    for azimuth_deg, height_km in rays:
        azimuth, observer = float(np.radians(azimuth_deg)), 1e3 * OBSERVER_KM
        if height_km >= 0:
            viewing.add_ray(sk.TangentAltitudeSolar(1e3 * height_km, azimuth, observer, cos_sza))
        else:
            cosine = float(np.sqrt(1.0 - ((radius_km + height_km) / radius_km) ** 2))
            viewing.add_ray(sk.GroundViewingSolar(cos_sza, azimuth, cosine, observer))
    return viewing


def sasktran_emission(
    altitude_m: np.ndarray,
    absorption_per_m: np.ndarray,
    temperature_k: np.ndarray,
    wavelength_um: float,
    heights_km: Sequence[float],
    *,
    radius_km: float,
    ground_k: float,
) -> np.ndarray:
    """Return thermal radiances [W m-2 sr-1 um-1] over a black ground, seen from 500 km, shape (rays, g).

    Parameters
    ----------
    altitude_m : ndarray, shape (n,)
        Shells; absorption and source are linear between them.
    absorption_per_m : ndarray, shape (n, g)
        Any number of absorbers, all at the one wavelength.
    temperature_k : ndarray, shape (n,)
    wavelength_um : float
        At which the Planck function is taken.
    heights_km : sequence of float
        Tangent heights; below zero impact parameters minus the radius, of rays that meet the ground.
    """
    config = _config()
    config.single_scatter_source = sk.SingleScatterSource.NoSource
    config.emission_source = sk.EmissionSource.Standard
    geometry = _geometry(0.6, radius_km, altitude_m)
    wavelengths_nm = np.full(absorption_per_m.shape[1], 1e3 * wavelength_um)
    atmosphere = sk.Atmosphere(geometry, config, wavelengths_nm=wavelengths_nm, calculate_derivatives=False)
    atmosphere.temperature_k = temperature_k
    atmosphere["air"] = sk.constituent.Manual(absorption_per_m, np.zeros_like(absorption_per_m))
    atmosphere["emission"] = sk.constituent.ThermalEmission()
    atmosphere["ground"] = sk.constituent.LambertianSurface(0.0)
    atmosphere["warm ground"] = sk.constituent.SurfaceThermalEmission(ground_k, np.ones(1))
    viewing = _viewing(0.6, radius_km, [(0.0, height) for height in heights_km])
    result = sk.Engine(config, geometry, viewing).calculate_radiance(atmosphere)
    return 1e3 * np.asarray(result["radiance"].isel(stokes=0).transpose("los", "wavelength"))


def sasktran_limb(
    data: dict[str, Any],
    bands: Sequence[str],
    sza_deg: float,
    rays: Sequence[tuple[float, float]],
    *,
    orders: str = "single",
    points: int = 302,
    num_sza: int = 5,
    step_km: float | None = None,
    refractive_index: tuple[np.ndarray, np.ndarray] | None = None,
    threads: int = 1,
) -> np.ndarray:
    """Return radiances of an atmosphere file per unit solar irradiance [1/sr], shape (rays, bands).

    Parameters
    ----------
    data : dict
        Content of an atmosphere file.
    bands : sequence of str
        Names of bands.
    sza_deg : float
        The Sun's zenith angle at the rays' lowest points.
    rays : sequence of (azimuth_deg, height_km)
        As :func:`reference_rays.limb_ray` means them.
    orders : str
        ``"single"`` or ``"all"`` (successive orders).
    points, num_sza : int
        Directions and Sun angles of the diffuse field.
    step_km : float, optional
        Shells; default the file's own nodes.
    refractive_index : (altitude_km, index), optional
        Bends the lines of sight and the Sun's rays; heights are then those of the unbent rays.
    """
    z_km = np.array(data["altitude_km"])
    grid_km = z_km if step_km is None else np.linspace(0.0, z_km[-1], round(z_km[-1] / step_km) + 1)
    config = _config(threads)
    config.single_scatter_source = sk.SingleScatterSource.Exact
    config.num_singlescatter_moments = 64
    config.num_streams = 16
    config.delta_m_scaling = False
    if orders == "all":
        config.multiple_scatter_source = sk.MultipleScatterSource.SuccessiveOrders
        config.num_successive_orders_incoming = points
        config.num_successive_orders_outgoing = points
        config.num_successive_orders_points = 56
        config.num_successive_orders_iterations = 50
        config.num_sza = num_sza
    cos_sza, radius_km = float(np.cos(np.radians(sza_deg))), data["planet_radius_km"]
    if refractive_index is not None:
        config.los_refraction = True
        config.solar_refraction = True
    geometry = _geometry(cos_sza, radius_km, 1e3 * grid_km)
    if refractive_index is not None:
        geometry.refractive_index = np.interp(grid_km, *refractive_index)
    chosen = [next(b for b in data["bands"] if b["name"] == name) for name in bands]
    wavelengths_nm = np.array([b["wavelength_nm"] for b in chosen])
    atmosphere = sk.Atmosphere(geometry, config, wavelengths_nm=wavelengths_nm, calculate_derivatives=False)

    def columns(key: str) -> np.ndarray:
        return np.stack([np.interp(grid_km, z_km, b[key]) for b in chosen], axis=1)

    molecules, absorption = columns("scattering_per_m"), columns("absorption_per_m")
    scattering = molecules.copy()
    moments = np.zeros((atmosphere.storage.leg_coeff.shape[0], *scattering.shape))
    moments[0], moments[2] = molecules, 0.5 * molecules
    for i, band in enumerate(chosen):
        if "asymmetry" in band:
            particles = np.interp(grid_km, z_km, band["particle_scattering_per_m"])
            scattering[:, i] += particles
            for order in range(len(moments)):
                moments[order, :, i] += (2 * order + 1) * band["asymmetry"] ** order * particles
    moments /= scattering
    extinction = scattering + absorption
    atmosphere["air"] = sk.constituent.Manual(extinction, scattering / extinction, moments)
    atmosphere["ground"] = sk.constituent.LambertianSurface(data["surface"]["albedo"])
    result = sk.Engine(config, geometry, _viewing(cos_sza, radius_km, rays)).calculate_radiance(atmosphere)
    return np.asarray(result["radiance"].isel(stokes=0).transpose("los", "wavelength"))
