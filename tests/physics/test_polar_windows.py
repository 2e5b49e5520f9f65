"""Windows over the ice of the poles, against monthly means of stations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel
from horizonval.earth.optical import optical_model
from horizonval.geometry.ellipsoid import WGS84
from horizonval.renderer.rays import thermal_radiance
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.infrared_radiance import angle_of_height

# Monthly means, K, of air or ice at the ground: South Pole (READER), Arctic Ocean (Rigor and others 2000), Greenland's
# summit (Steffen and Box 2001), whose table the ground itself has.
PLACES = [
    (-90.0, 0.0, "2026-09-16", 213.8, 8.0),
    (-90.0, 0.0, "2026-01-16", 245.0, 4.0),
    (90.0, 0.0, "2026-06-16", 271.4, 4.0),
    (90.0, 0.0, "2026-02-14", 241.2, 4.0),
    (72.6, -38.0, "2026-01-16", 231.0, 4.0),
]
BANDS = [
    {"name": "w8", "kind": "thermal", "lo_um": 8.3, "hi_um": 8.9},
    {"name": "w12", "kind": "thermal", "lo_um": 12.0, "hi_um": 12.8},
]
CAMERA = CameraSpec.model_validate({"camera": {"width": 8, "height": 8, "fov_deg": 8.0}, "band": BANDS})


@pytest.mark.parametrize("profile", ["by_latitude_month", "weather"])
@pytest.mark.parametrize(("latitude", "longitude", "day", "published_k", "within_k"), PLACES)
def test_ice_seen_straight_down_is_as_cold_as_published(
    latitude: float, longitude: float, day: str, published_k: float, within_k: float, profile: str
) -> None:
    """8.3 to 8.9 and 12.0 to 12.8 um: leads and emissivity take and air gives some."""
    place = {
        "altitude_km": 500.0,
        "latitude_deg": latitude,
        "longitude_deg": longitude,
        "epoch_utc": f"{day}T00:00:00Z",
    }
    air = {"profile": profile, "refraction": False} | ({"seed": 1} if profile == "weather" else {})
    tables = {"platform": place, "surface": {"kind": "earth"}, "atmosphere": air}
    model = optical_model(SceneSpec.model_validate({"camera": {"file": "t"}, **tables}), CAMERA, 1.0)
    north, east = np.radians(latitude), np.radians(longitude)
    up = np.array([np.cos(north) * np.cos(east), np.cos(north) * np.sin(east), np.sin(north)])
    # A kilometre off the axis, where there is an east.
    observer = 6.86e6 * up + np.array([1e3, 0.0, 0.0])
    for band, kelvin in brightness_k(model, observer[None], -up[None]).items():
        assert kelvin == pytest.approx(published_k, abs=within_k), band


def brightness_k(model: OpticalModel, observer: FloatArray, direction: FloatArray) -> dict[str, float]:
    found = thermal_radiance(model, WGS84.a_m, observer, direction, polar_radius_m=WGS84.b_m, nodes=96)
    kelvin = np.linspace(190.0, 300.0, 221)
    return {
        band.name: float(np.interp(found[band.name][0], band.source(kelvin).sum(axis=-1), kelvin))
        for band in model.thermal
    }


@pytest.mark.parametrize(
    "days",
    [
        [{"profile": "by_latitude_month"}],
        pytest.param([{"profile": "weather", "seed": seed} for seed in range(1, 5)], marks=pytest.mark.slow),
    ],
)
def test_the_limb_over_the_south_pole_in_september_is_cold(days: list[dict[str, Any]]) -> None:
    """12 km inside the limb, 8.6 and 12.4 um, mean of four days of weather: within 8 K of the station's 213.8 K."""
    latitude = np.radians(-69.3)
    e2 = 1.0 - (WGS84.b_m / WGS84.a_m) ** 2
    n = WGS84.a_m / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    observer = np.array([[(n + 5e5) * np.cos(latitude), 0.0, (n * (1.0 - e2) + 5e5) * np.sin(latitude)]])
    nadir, south = -observer[0] / np.linalg.norm(observer), np.array([0.0, 0.0, -1.0])
    south = south - nadir * (south @ nadir)
    south /= np.linalg.norm(south)
    angle = angle_of_height(observer[0], WGS84, np.pi, -12e3)
    direction = (np.cos(angle) * nadir + np.sin(angle) * south)[None]
    seen: dict[str, list[float]] = {"w8": [], "w12": []}
    for air in days:
        tables = {
            "camera": {"file": "t"},
            "platform": {"altitude_km": 500.0, "latitude_deg": -69.3, "epoch_utc": "2026-09-16T00:00:00Z"},
            "surface": {"kind": "earth"},
            "atmosphere": {**air, "refraction": False},
        }
        model = optical_model(SceneSpec.model_validate(tables), CAMERA, 1.0)
        for band, kelvin in brightness_k(model, observer, direction).items():
            seen[band].append(kelvin)
    for band, kelvins in seen.items():
        assert np.mean(kelvins) == pytest.approx(213.8, abs=8.0), (band, kelvins)
