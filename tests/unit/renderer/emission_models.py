"""Scenes, cameras and thermal models made by hand, and frames of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.column import OpticalModel
from horizonval.earth.spectral.planck import radiance_per_wavenumber
from horizonval.earth.surface.ground_emission import GroundEmission, uniform_ground
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

RADIUS_M = 6_371_000.0
WAVENUMBER_PER_CM = 1000.0
PACIFIC = {"altitude_km": 500.0, "latitude_deg": 20.0, "longitude_deg": -160.0}


def band(extinction_per_m: np.ndarray, altitude_m: np.ndarray, temperature_k: np.ndarray) -> EmittingBand:
    """One class of absorption per row of ``extinction_per_m`` (g, n), each 1 cm-1 wide; temperatures (m, n)."""
    count, rows = len(extinction_per_m), len(temperature_k)
    ln = np.log(np.maximum(extinction_per_m, 1e-300))[:, None, :]
    return EmittingBand(
        name="b",
        wavelength_um=np.full(count, 1e4 / WAVENUMBER_PER_CM),
        altitude_m=altitude_m,
        sin_latitude=np.linspace(-1.0, 1.0, rows) if rows > 1 else np.zeros(1),
        level_m=altitude_m,
        ln_extinction=np.repeat(ln, rows, axis=1),
        temperature_k=temperature_k,
        source_wavenumber_per_cm=np.array([WAVENUMBER_PER_CM]),
        source_weight_per_cm=np.ones((count, 1)),
        sun_radiance=np.zeros(count),
    )


def model(emitting: EmittingBand, ground: GroundEmission) -> OpticalModel:
    z = emitting.altitude_m
    return OpticalModel(z, float(z[-1]), (), 0.0, thermal=(emitting,), emission=ground)


def isothermal(extinction_per_m: float, temperature_k: float, emissivity: float = 1.0) -> OpticalModel:
    """Air with a scale height of 7 km over ground of the same temperature; three g points a decade apart."""
    z = np.linspace(0.0, 1e5, 501)
    k = extinction_per_m * np.array([[0.1], [1.0], [10.0]]) * np.exp(-z / 7000.0)
    return model(band(k, z, np.full((1, len(z)), temperature_k)), uniform_ground(temperature_k, emissivity))


def black(temperature_k: float, points: int = 3) -> float:
    return points * float(radiance_per_wavenumber(WAVENUMBER_PER_CM, temperature_k))


def scene(**changes: Any) -> SceneSpec:
    base: dict[str, Any] = {
        "camera": {"file": "test", "mount_roll_deg": 66.0},
        "platform": {"altitude_km": 500.0, "latitude_deg": 20.0},
        "sun": {"zenith_deg": 40.0, "azimuth_deg": 60.0},
    }
    return SceneSpec.model_validate(base | changes)


def camera(*bands: dict[str, Any], pixels: int = 64, fov_deg: float = 60.0, **geometry: Any) -> CameraSpec:
    size = {"width": pixels, "height": pixels, "fov_deg": fov_deg} | geometry
    return CameraSpec.model_validate({"camera": size, "band": list(bands)})


def frame_of(air: OpticalModel, seen: SceneSpec, spec: CameraSpec, roll_rad: float = 0.0) -> np.ndarray:
    """Return the radiance (height, width, bands) of any model in a scene's geometry, the camera rolled."""
    import mitsuba as mi

    from horizonval.renderer.description import describe
    from horizonval.renderer.planet import Planet
    from horizonval.renderer.plugins import CameraSettings, LimbSettings, mitsuba_scene

    described = describe(seen, spec)
    truth = described.truth
    turned = described.itrs_from_cam @ Rotation.from_rotvec([0.0, 0.0, roll_rad]).as_matrix()
    limb = LimbSettings(
        air,
        Planet(truth.ellipsoid_a_m, truth.ellipsoid_b_m),
        truth.sun_itrs,
        truth.sun_angular_radius_rad,
        seen.render.subsamples,
        seen.render.nodes,
        "single",
    )
    sensor = CameraSettings(described.camera, np.array(truth.r_itrs), turned)
    return np.array(mi.render(mitsuba_scene(limb, sensor), spp=1))
