from typing import Any

import numpy as np
import pytest
from earth_forms import camera, solar, thermal
from earth_forms import scene as scene_of

from horizonval.earth.atmosphere import climate
from horizonval.earth.gases import afgl
from horizonval.earth.optical import optical_model
from horizonval.earth.spectral import thermal_absorption
from horizonval.earth.weather.zonal_climate import with_cold_poles
from horizonval.spec.scene import SceneSpec

CAMERA = camera(thermal(14.5, 15.5))


def scene(
    latitude: float = 0.0, altitude_km: float = 500.0, epoch: str = "2026-01-16T00:00:00Z", **air: Any
) -> SceneSpec:
    platform = {"altitude_km": altitude_km, "latitude_deg": latitude, "epoch_utc": epoch}
    return scene_of(platform=platform, atmosphere={"profile": "by_latitude_month", **air})


@pytest.mark.parametrize("latitude", [-90.0, -62.0, 0.0, 33.3, 85.0])
@pytest.mark.parametrize("height_km", [80.0, 500.0, 2000.0, 35_786.0])
def test_rows_reach_as_far_as_the_rays(latitude: float, height_km: float) -> None:
    rows = climate.rows_in_sight(latitude, height_km * 1e3)
    np.testing.assert_allclose(np.diff(rows), 0.01, atol=1e-12)
    # Rays in all directions from the satellite that graze the ground, followed to where they leave the air at 100 km.
    radius, top = 6371.0, 6471.0
    distance = radius + height_km
    far = np.arccos(radius / distance) + np.arccos(radius / top)
    azimuth = np.linspace(0, 2 * np.pi, 721)
    phi = np.radians(latitude)
    sine = np.sin(phi) * np.cos(far) + np.cos(phi) * np.sin(far) * np.cos(azimuth)
    assert rows[0] <= sine.min() + 1e-9
    assert rows[-1] >= sine.max() - 1e-9
    # And not much further: a degree of margin and one row.
    reach = np.degrees(far) + 1.0
    assert rows[0] >= np.sin(np.radians(max(latitude - reach, -90.0))) - 0.0101
    assert rows[-1] <= np.sin(np.radians(min(latitude + reach, 90.0))) + 0.0101


def test_a_row_is_the_climate_of_its_latitude() -> None:
    (band,) = optical_model(scene(latitude=20.0), CAMERA).thermal
    tropics = np.flatnonzero(np.abs(band.sin_latitude) < 0.25)
    north = int(np.argmin(np.abs(band.sin_latitude - np.sin(np.radians(45.0)))))
    assert band.ln_extinction.shape == (16, len(band.sin_latitude), 148)
    level = afgl.levels_m()
    for row in tropics:
        np.testing.assert_array_equal(band.temperature_k[row], afgl.state("tropical", level).temperature_k)
    # The row nearest to 45 deg is within 0.4 deg of the climate of the middle latitudes in January.
    winter = afgl.state("midlatitude_winter", level).temperature_k
    assert np.abs(band.temperature_k[north] - winter).max() < 0.2


def test_seasons_are_opposite_in_the_two_hemispheres() -> None:
    january, july = (
        optical_model(scene(altitude_km=35_786.0, epoch=f"2026-0{m}-16T00:00:00Z"), CAMERA).thermal[0] for m in (1, 7)
    )
    np.testing.assert_allclose(january.sin_latitude, -january.sin_latitude[::-1], atol=1e-15)
    assert len(january.sin_latitude) == 201
    # The middle of January is mid-winter within half a day, that of July mid-summer: half a day is 1e-4 of the swing.
    # Poleward of 55 deg the troposphere is another one in the south.
    same = np.abs(january.sin_latitude) < np.sin(np.radians(55.0))
    level = afgl.levels_m()
    np.testing.assert_allclose(january.temperature_k[same], july.temperature_k[::-1][same], atol=0.02)
    np.testing.assert_allclose(
        january.temperature_k[:, level >= 12e3], july.temperature_k[::-1][:, level >= 12e3], atol=0.02
    )
    assert july.temperature_k[-1, 0] == pytest.approx(287.2, abs=0.1)  # AFGL subarctic summer, ground


def test_half_way_between_rows() -> None:
    rows = climate.all_rows()
    middle = (rows[1:] + rows[:-1]) / 2
    points = thermal_absorption.g_points(CAMERA.band[0])
    z = afgl.levels_m()
    at_rows, between = (afgl.blended(climate.row_weights(sines, 1.0), z) for sines in (rows, middle))
    t = at_rows.temperature_k
    assert np.abs((t[1:] + t[:-1]) / 2 - between.temperature_k).max() < 0.05
    k, exact = (np.exp(points.ln_absorption(state)) for state in (at_rows, between))
    error = np.abs((k[:, 1:] + k[:, :-1]) / 2 / exact - 1)[:, :, (z < 60e3) & (np.abs(z - 16.5e3) > 1.2e3)]
    # A class whose absorption changes by a tenth from row to row lies 0.13 % high; most, far less. Where the tables
    # change, near 16.5 km, the height of the step moves from row to row.
    assert error.max() < 2.5e-3
    assert np.median(error) < 4e-4


def test_a_given_latitude_serves_everywhere() -> None:
    (band,) = optical_model(scene(latitude=20.0, latitude_deg=60.0, month=1), CAMERA).thermal
    assert band.sin_latitude.shape == (1,)
    winter = afgl.blended([{"subarctic_winter": 1.0}], afgl.levels_m())
    np.testing.assert_allclose(
        band.temperature_k, with_cold_poles(winter, np.array([60.0]), 1.0).temperature_k, atol=1e-9
    )


def test_solar_bands_keep_the_column_below() -> None:
    vis = camera(solar(0.5, 0.6, nodes=1))
    below = optical_model(scene(latitude=52.0), vis).nodes[0]
    fixed = optical_model(scene(latitude=0.0, latitude_deg=52.0), vis).nodes[0]
    np.testing.assert_array_equal(below.extinction_per_m, fixed.extinction_per_m)
