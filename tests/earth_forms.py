"""Shared by tests of the Earth: scenes and cameras in one line, air as a file, and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import constants
from scipy.special import bernoulli, factorial

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.profiles import profile
from horizonval.earth.column import OpticalModel
from horizonval.earth.gases import ozone, rayleigh
from horizonval.earth.optical import optical_model
from horizonval.earth.surface import ground_map, surface
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec


def scene(**tables: Any) -> SceneSpec:
    return SceneSpec.model_validate({"camera": {"file": "cam.toml"}, "platform": {"altitude_km": 500}, **tables})


def camera(*band: Any) -> CameraSpec:
    return CameraSpec.model_validate({"camera": {"width": 4, "height": 4, "fov_deg": 20}, "band": list(band)})


def solar(lo_um: float, hi_um: float, **more: Any) -> dict[str, Any]:
    return {"name": "b", "kind": "solar", "lo_um": lo_um, "hi_um": hi_um, **more}


def thermal(lo_um: float, hi_um: float) -> dict[str, Any]:
    return {"name": "tir", "kind": "thermal", "lo_um": lo_um, "hi_um": hi_um}


def model_of(*band: Any, **tables: Any) -> OpticalModel:
    return optical_model(scene(**tables), camera(*band))


def rayleigh_air(name: str, wavelengths_nm: list[float], *, with_ozone: bool = True) -> dict[str, Any]:
    """Return an atmosphere file's content for a named profile: Rayleigh scattering, and ozone absorption to 1 um."""
    z = np.linspace(0.0, 100.0, 201)
    state = profile(name).at(z * 1e3)
    bands = []
    for wavelength_nm in wavelengths_nm:
        um = wavelength_nm * 1e-3
        absorption = np.zeros_like(z)
        if with_ozone and um <= ozone.MAX_UM:
            absorption = state.number_density_o3 * ozone.cross_section_m2(um, state.temperature_k)
        band = {"name": f"{wavelength_nm:g}nm", "wavelength_nm": float(wavelength_nm), "phase": "rayleigh"}
        band["scattering_per_m"] = (state.number_density_air * rayleigh.cross_section_m2(um)).tolist()
        bands.append(band | {"absorption_per_m": absorption.tolist()})
    return {
        "planet_radius_km": 6371.0,
        "top_km": 100.0,
        "altitude_km": z.tolist(),
        "temperature_K": state.temperature_k.tolist(),
        "bands": bands,
        "surface": {"albedo": 0.3, "temperature_K": float(state.temperature_k[0]), "emissivity": 1.0},
    }


def black_body_share(wavelength_um: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return the share of a black body's radiance at shorter wavelengths, by exact series in x = h c / (lambda k T).

    Widger and Woodall, Bull. Amer. Meteor. Soc. 57, 1217 (1976); for small x the power series of t^3 / (e^t - 1).
    """
    c2 = constants.h * constants.c / constants.k
    x = c2 / (np.asarray(wavelength_um, dtype=np.float64) * 1e-6 * np.asarray(temperature_k, dtype=np.float64))
    large, small = np.maximum(x, 2.0)[..., None], np.minimum(x, 2.0)
    n, k2 = np.arange(1.0, 25.0), np.arange(2, 32, 2)
    exponential = np.sum(np.exp(-n * large) / n * (large**3 + 3 * large**2 / n + 6 * large / n**2 + 6 / n**3), axis=-1)
    power = small**3 / 3 - small**4 / 8
    power = power + np.sum(bernoulli(30)[k2] / factorial(k2) / (k2 + 3) * small[..., None] ** (k2 + 3.0), axis=-1)
    return np.where(x > 2.0, 15 / np.pi**4 * exponential, 1 - 15 / np.pi**4 * power)


def black_body_band(lo_um: ArrayLike, hi_um: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return the black-body radiance [W m-2 sr-1] between two wavelengths, without quadrature."""
    total = constants.sigma * np.asarray(temperature_k, dtype=np.float64) ** 4 / np.pi
    return total * (black_body_share(hi_um, temperature_k) - black_body_share(lo_um, temperature_k))


def is_land(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> np.ndarray:
    kinds, weights = ground_map.kinds_around(latitude_deg, longitude_deg)
    return np.sum(weights * (kinds != ground_map.SEA), axis=0) > 0.5


def snow_factor(mu_sun: ArrayLike, mu_view: ArrayLike, cosine: ArrayLike) -> FloatArray:
    """Return the radiance of sunlit snow over that of a Lambert surface of the same albedo."""
    nodes = np.linspace(0.0, 1.0, surface.SNOW_NODES)
    mean = np.interp(np.asarray(mu_sun, dtype=np.float64), nodes, surface.mean_snow_reflection())
    cosines = (np.asarray(mu, dtype=np.float64) for mu in (mu_sun, mu_view, cosine))
    return np.asarray(surface.snow_reflection(*cosines) / mean)
