"""Thermal limb radiances of any k(z) by SASKTRAN2 (pip, MIT; only for remaking and checking reference tables)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import sasktran2 as sk
from reference_rays import OBSERVER_KM


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
    """Return radiances [W m-2 sr-1 um-1] over a black ground, seen from 500 km, shape (rays, g).

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
    count = absorption_per_m.shape[1]
    config = sk.Config()
    config.num_threads = 1
    config.num_stokes = 1
    config.single_scatter_source = sk.SingleScatterSource.NoSource
    config.emission_source = sk.EmissionSource.Standard
    geometry = sk.Geometry1D(
        cos_sza=0.6,
        solar_azimuth=0.0,
        earth_radius_m=1e3 * radius_km,
        altitude_grid_m=altitude_m,
        interpolation_method=sk.InterpolationMethod.LinearInterpolation,
        geometry_type=sk.GeometryType.Spherical,
    )
    viewing = sk.ViewingGeometry()
    for height in heights_km:
        if height >= 0:
            viewing.add_ray(sk.TangentAltitudeSolar(1e3 * height, 0.0, 1e3 * OBSERVER_KM, 0.6))
        else:
            cosine = float(np.sqrt(1.0 - ((radius_km + height) / radius_km) ** 2))
            viewing.add_ray(sk.GroundViewingSolar(0.6, 0.0, cosine, 1e3 * OBSERVER_KM))
    atmosphere = sk.Atmosphere(
        geometry, config, wavelengths_nm=np.full(count, 1e3 * wavelength_um), calculate_derivatives=False
    )
    atmosphere.temperature_k = temperature_k
    atmosphere["air"] = sk.constituent.Manual(absorption_per_m, np.zeros_like(absorption_per_m))
    atmosphere["emission"] = sk.constituent.ThermalEmission()
    atmosphere["ground"] = sk.constituent.LambertianSurface(0.0)
    atmosphere["warm ground"] = sk.constituent.SurfaceThermalEmission(ground_k, np.ones(1))
    result = sk.Engine(config, geometry, viewing).calculate_radiance(atmosphere)
    return 1e3 * np.asarray(result["radiance"].isel(stokes=0).transpose("los", "wavelength"))
