"""Cities at night, in the kernel and in frames."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from emission_models import camera, scene

from horizonval.earth import tables
from horizonval.earth.surface import city_lights
from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame

TOKYO = (35.69, 139.69)


def luminance_per_density(cosine: Any) -> np.ndarray:
    """Garstang's I(z) / cos z for one inhabitant to a square metre [lm m-2 sr-1]."""
    c, share = np.clip(cosine, city_lights.LEAST_COSINE, 1.0), city_lights.UPWARD_SHARE
    down = 2.0 * city_lights.GROUND_REFLECTANCE * (1.0 - share) * c
    return city_lights.LUMENS_PER_HEAD / (2.0 * np.pi) * (down + 0.554 * share * np.arccos(c) ** 4) / c


def test_all_inhabitants_are_on_the_map() -> None:
    """1e-3 of 2.2 billion: cells are as wide as their middles."""
    latitude = np.radians((np.arange(1800) + 0.5) / 10.0 - 90.0)
    area = (np.radians(0.1) * 6371e3) ** 2 * np.cos(latitude)[:, None]
    people = float(np.sum(city_lights.inhabitants_per_m2() * area))
    assert people == pytest.approx(1e3 * tables.csv("cities.csv")[2].sum(), rel=1e-3)


def test_paris_is_as_bright_as_seen() -> None:
    """The night band of VIIRS has 100 to 200 nW cm-2 sr-1 over the middle of the largest cities; a factor of two."""
    density = float(city_lights.inhabitants_per_m2()[int((48.85 + 90) * 10), int((2.35 + 180) * 10)])
    um = np.linspace(0.5, 0.8, 301)
    spectral = [city_lights.radiance_per_luminance(float(v)) for v in um]
    watts = density * float(luminance_per_density(1.0)) * float(np.sum(spectral)) * 1e-3
    assert 50.0 < watts * 1e5 < 400.0


def test_kernel_luminance_equals_numpy() -> None:
    activate()
    import mitsuba as mi

    from horizonval.renderer.kernel.surface import GroundTable, Places, luminance

    rng = np.random.default_rng(np.random.SeedSequence(19))
    latitude, longitude = TOKYO[0] + rng.normal(0, 0.3, 500), TOKYO[1] + rng.normal(0, 0.3, 500)
    sun, view = rng.uniform(-0.3, 0.1, 500), rng.uniform(0.0, 1.0, 500)
    places = Places(mi.Float64(latitude), mi.Float64(longitude + 540.0))
    ours = np.array(luminance(GroundTable.of(7.0, True), places, mi.Float64(sun), mi.Float64(view)))
    row, column = (latitude + 90.0) * 10.0 - 0.5, (longitude + 180.0) * 10.0 - 0.5
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    wy, wx = row - i, column - j
    table = city_lights.inhabitants_per_m2()
    low = (1 - wx) * table[i, j] + wx * table[i, j + 1]
    high = (1 - wx) * table[i + 1, j] + wx * table[i + 1, j + 1]
    density = (1 - wy) * low + wy * high
    expected = density * city_lights.burning(sun) * luminance_per_density(view)
    assert ours == pytest.approx(expected, rel=1e-5, abs=1e-9)


def _frame(sun_zenith_deg: float, **surface: Any) -> np.ndarray:
    seen = scene(
        camera={"file": "test"},
        platform={"altitude_km": 500.0, "latitude_deg": TOKYO[0], "longitude_deg": TOKYO[1]},
        sun={"zenith_deg": sun_zenith_deg, "azimuth_deg": 90.0},
        atmosphere={"profile": "none"},
        surface={"kind": "earth", **surface},
    )
    band = {"name": "vis", "kind": "solar", "lo_um": 0.55, "hi_um": 0.65, "nodes": 1}
    image = render_frame(seen, camera(band, pixels=33, fov_deg=8.0)).radiance["vis"]
    return np.asarray(image, dtype=np.float64)


def test_a_city_shines_by_night_and_by_night_only() -> None:
    """Straight down on Tokyo through no air, 10 %: density, Garstang's 2 G (1 - F), and the spectrum of the band."""
    dark, lit = _frame(150.0), _frame(150.0, city_lights=True)
    assert dark.max() < 1e-3 * lit.max(), "airglow"
    density = float(city_lights.inhabitants_per_m2()[int((TOKYO[0] + 90) * 10), int((TOKYO[1] + 180) * 10)])
    straight_down = density * 1000.0 / (2.0 * np.pi) * 2.0 * 0.15 * 0.85
    spectrum = city_lights.radiance_per_luminance(0.6)
    assert lit.max() == pytest.approx(straight_down * spectrum * 0.1, rel=0.1)
    assert lit.max() > 3.0 * lit.min()
    assert np.array_equal(_frame(40.0), _frame(40.0, city_lights=True))
