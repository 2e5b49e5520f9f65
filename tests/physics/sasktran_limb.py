"""Limb radiances of an atmosphere file by SASKTRAN2 (pip, MIT; only for remaking and checking reference tables)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sasktran2 as sk
from reference_rays import OBSERVER_KM


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
    """Return radiances per unit solar irradiance [1/sr], shape (rays, bands).

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
    config = sk.Config()
    config.num_threads = threads
    config.num_stokes = 1
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
    if refractive_index is not None:
        config.los_refraction = True
        config.solar_refraction = True
    geometry = sk.Geometry1D(
        cos_sza=float(np.cos(np.radians(sza_deg))),
        solar_azimuth=0.0,
        earth_radius_m=1e3 * data["planet_radius_km"],
        altitude_grid_m=1e3 * grid_km,
        interpolation_method=sk.InterpolationMethod.LinearInterpolation,
        geometry_type=sk.GeometryType.Spherical,
    )
    if refractive_index is not None:
        geometry.refractive_index = np.interp(grid_km, *refractive_index)
    chosen = [next(b for b in data["bands"] if b["name"] == name) for name in bands]
    viewing = sk.ViewingGeometry()
    radius = data["planet_radius_km"]
    cos_sza = float(np.cos(np.radians(sza_deg)))
    for azimuth, height in rays:
        if height >= 0:
            viewing.add_ray(
                sk.TangentAltitudeSolar(1e3 * height, float(np.radians(azimuth)), 1e3 * OBSERVER_KM, cos_sza)
            )
        else:
            sine = (radius + height) / radius
            viewing.add_ray(
                sk.GroundViewingSolar(
                    cos_sza, float(np.radians(azimuth)), float(np.sqrt(1.0 - sine**2)), 1e3 * OBSERVER_KM
                )
            )
    atmosphere = sk.Atmosphere(
        geometry, config, wavelengths_nm=np.array([b["wavelength_nm"] for b in chosen]), calculate_derivatives=False
    )

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
    result = sk.Engine(config, geometry, viewing).calculate_radiance(atmosphere)
    return np.asarray(result["radiance"].isel(stokes=0).transpose("los", "wavelength"))
