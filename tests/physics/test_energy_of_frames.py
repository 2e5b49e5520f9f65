"""Energy radiance of rendered frames: sunlight on a white ground without air has a closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from horizonval.earth.spectral import sunlight
from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

BANDS = [
    {"name": "vis", "kind": "solar", "lo_um": 0.45, "hi_um": 0.75},
    {"name": "wide", "kind": "solar", "lo_um": 0.40, "hi_um": 1.00},
    {"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0},
]


@pytest.fixture(scope="module", autouse=True)
def back_end() -> None:
    activate()


def scene_of(**tables: Any) -> SceneSpec:
    tables = {"atmosphere": {"profile": "none"}, "surface": {"albedo": 0.5, "temperature_k": 288.0}} | tables
    return SceneSpec.model_validate(
        {
            "camera": {"file": "test"},
            "platform": {"altitude_km": 500.0, "latitude_deg": 0.0},
            "sun": {"zenith_deg": 30.0, "azimuth_deg": 90.0},
            "earth": {"shape": "sphere", "radius_km": 6371.0},
            **tables,
        }
    )


def test_white_ground_shines_with_the_plain_integral_of_sunlight() -> None:
    """Nadir: albedo / pi times the cosine times the irradiance between the band's ends."""
    camera = CameraSpec.model_validate({"camera": {"width": 3, "height": 3, "fov_deg": 0.5}, "band": BANDS})
    frame = render_frame(scene_of(), camera)
    distance_au = 0.99605  # 20 March
    for band in BANDS[:2]:
        wavelength = np.linspace(band["lo_um"], band["hi_um"], 100_001)
        light = sunlight.irradiance(wavelength, distance_au)
        mean = 0.5 * (band["lo_um"] + band["hi_um"])
        ground = 0.5 / math.pi * math.cos(math.radians(30.0))
        energy = float(frame.energy_radiance[band["name"]][1, 1])
        photons = float(frame.radiance[band["name"]][1, 1])
        ratio = np.trapezoid(light * wavelength / mean, wavelength) / np.trapezoid(light, wavelength)
        assert photons / energy == pytest.approx(float(ratio), rel=1e-6)
        assert energy == pytest.approx(ground * float(np.trapezoid(light, wavelength)), rel=0.03)
    assert frame.energy_radiance["lwir"] is frame.radiance["lwir"]


def test_blue_air_differs_more_than_white_ground() -> None:
    """The limb's own light over a black ground: some 10 % in 450 to 750 nm."""
    camera = CameraSpec.model_validate({"camera": {"width": 24, "height": 16, "fov_deg": 4.0}, "band": BANDS[:1]})
    scene = scene_of(
        atmosphere={"profile": "us_standard", "ozone": False, "aerosol": "none"},
        surface={"albedo": 0.0},
        camera={"file": "test", "mount_roll_deg": 68.5},
        render={"orders": "single", "subsamples": 1},
    )
    frame = render_frame(scene, camera)
    photons, energy = frame.radiance["vis"], frame.energy_radiance["vis"]
    # High in the thin air, where single scattering is wavelength^-4.1 of the Sun's light.
    high = (frame.maps["tangent_height"] > 50e3) & (photons > 0.0)
    assert high.any()
    assert photons[high] / energy[high] == pytest.approx(1.0 - 0.10, abs=0.004)
