"""Profiles of many places from one file: what is read, what lies between places, and that frames' air has it."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from earth_forms import camera, scene, thermal

from horizonval.core.errors import UserError
from horizonval.earth.atmosphere.air import air_of
from horizonval.earth.atmosphere.placed_profiles import PlacedProfiles
from horizonval.earth.atmosphere.profile_file import has_places, read_profiles
from horizonval.earth.optical import optical_model
from horizonval.earth.weather.field import latitude_longitude_deg

KM = [float(z) for z in (*range(0, 30, 2), *range(30, 101, 5))]
Z = np.arange(0.0, 60e3, 1500.0)
CUBE = [(35.26, lon) for lon in (45, 135, -135, -45)] + [(-35.26, lon) for lon in (45, 135, -135, -45)]


def kelvin_at(latitude: float, longitude: float) -> float:
    """A field that is linear in space: no authority is needed for what lies between places close together."""
    phi, lam = np.radians(latitude), np.radians(longitude)
    return float(250.0 + 30.0 * np.sin(phi) + 20.0 * np.cos(phi) * np.cos(lam))


def table_of(places: list[tuple[float, ...]], kelvin: Callable[..., float]) -> dict[str, list[float]]:
    table: dict[str, list[float]] = {}
    for place in places:
        named = dict(zip(("latitude_deg", "longitude_deg"), place, strict=False))
        t = kelvin(*place)
        for z in KM:
            row = named | {
                "altitude_km": z,
                "temperature_K": t,
                "pressure_hPa": 1000.0 * float(np.exp(-z * 1e3 * 9.8 / (287.0 * t))),
                "ozone_ppmv": 1.0,
                "water_vapour_ppmv": 10.0 * (1.0 + (place[0] > 0)),
            }
            for key, value in row.items():
                table.setdefault(key, []).append(value)
    return table


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    def write(table: dict[str, list[float]], name: str = "air.csv") -> Path:
        path = tmp_path / name
        lines = [",".join(table), *(",".join(map(repr, row)) for row in zip(*table.values(), strict=True))]
        path.write_text(json.dumps(table) if name.endswith("json") else "\n".join(lines) + "\n")
        return path

    return write


@pytest.mark.parametrize("name", ["air.csv", "air.json"])
def test_places_come_back_whatever_the_order_of_lines(written: Callable[..., Path], name: str) -> None:
    table = table_of(CUBE, kelvin_at)
    order = np.argsort(table["altitude_km"], kind="stable")
    path = written({key: [values[i] for i in order] for key, values in table.items()}, name)
    assert has_places(path)
    air = PlacedProfiles(read_profiles(path))
    assert [(one.latitude_deg, one.longitude_deg) for one in air.profiles] == CUBE
    found = air.columns(*np.array(CUBE, dtype=float).T, Z)
    for (latitude, longitude), kelvin, pressure in zip(CUBE, found.temperature_k, found.pressure_pa, strict=True):
        np.testing.assert_allclose(kelvin, kelvin_at(latitude, longitude), rtol=1e-9)
        np.testing.assert_allclose(pressure, 1e5 * np.exp(-Z * 9.8 / (287.0 * kelvin)), rtol=1e-6)


def test_between_places_of_a_lattice(written: Callable[..., Path]) -> None:
    lattice = [(lat, lon) for lat in range(-80, 81, 20) for lon in range(-180, 180, 20)]
    air = PlacedProfiles(read_profiles(written(table_of([*lattice, (-90, 0), (90, 0)], kelvin_at))))
    rng = np.random.default_rng(5)
    latitude, longitude = np.degrees(np.arcsin(rng.uniform(-1, 1, 400))), rng.uniform(-180, 180, 400)
    found = air.columns(latitude, longitude, Z[:1]).temperature_k[:, 0]
    wanted = [kelvin_at(*place) for place in zip(latitude, longitude, strict=True)]
    # 72 K from pole to pole over places 20 deg apart: what bends in such a step is 0.6 K (30 K (1 - cos 10 deg) is 0.5)
    np.testing.assert_allclose(found, wanted, atol=0.6)
    # no seam at the date line nor at a pole
    for one, other in (((10.0, 179.999), (10.0, -179.999)), ((89.999, 0.0), (89.999, 180.0))):
        pair = air.columns(*np.array([one, other]).T, Z[:1]).temperature_k[:, 0]
        assert abs(pair[0] - pair[1]) < 0.01


def test_latitudes_hold_all_around_and_one_place_everywhere(written: Callable[..., Path]) -> None:
    air = PlacedProfiles(read_profiles(written(table_of([(-30.0,), (90.0,), (30.0,)], lambda lat: 260.0 + lat / 3.0))))
    latitude = np.array([-90.0, -30.0, 0.0, 0.0, 48.590378, 90.0])
    longitude = np.array([0.0, 5.0, 170.0, -20.0, 33.0, 0.0])
    found = air.columns(latitude, longitude, Z).temperature_k
    # 48.590378 deg is half way between 30 and 90 in the sine
    np.testing.assert_allclose(found[:, 0], [250.0, 250.0, 260.0, 260.0, 280.0, 290.0], atol=1e-6)
    np.testing.assert_allclose(found, found[:, :1] * np.ones_like(Z), rtol=1e-12)
    assert not PlacedProfiles(read_profiles(written(table_of([(10.0, 20.0)], kelvin_at)))).vary


def changed(key: str, line: int, value: float) -> dict[str, list[float]]:
    table = table_of(CUBE, kelvin_at)
    table[key][line - 2] = value
    return table


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (changed("latitude_deg", 3, 91.0), r"line 3, column latitude_deg: is 91; expected -90 to 90 degrees"),
        (changed("longitude_deg", 3, -181.0), r"line 3, column longitude_deg: is -181; expected -180 to 360 degrees"),
        (changed("longitude_deg", 3, float("nan")), r"line 3, column longitude_deg: is nan"),
        (changed("temperature_K", 40, 12.0), r"line 40, column temperature_K: is 12; expected 100 to 400 K"),
        (
            changed("latitude_deg", 40, 35.3),
            r"altitude_km, latitude 35\.3, longitude 135: 1 levels; expected at least 10 levels",
        ),
        (
            table_of([(0.0, -180.0), (0.0, 180.0)], kelvin_at),
            r"line 32, column longitude_deg: is 180: the same place as longitude -180; expected every place once",
        ),
        (
            {k: v for k, v in table_of(CUBE, kelvin_at).items() if k != "latitude_deg"},
            r"line 1: missing: latitude_deg; expected latitude_deg beside longitude_deg",
        ),
        (table_of([(i / 100.0,) for i in range(1001)], lambda lat: 250.0), r"profiles of 1001 places; .* at most 1000"),
    ],
)
def test_mistakes(written: Callable[..., Path], table: dict[str, list[float]], message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        read_profiles(written(table))
    assert re.match(r".*air\.csv: .*$", str(caught.value))


def test_a_scene_sees_the_places(written: Callable[..., Path]) -> None:
    path = written(table_of(CUBE, kelvin_at))
    seen = scene(
        platform={"altitude_km": 500, "latitude_deg": 20.0, "longitude_deg": 100.0},
        atmosphere={"aerosol": "none", "profile_file": str(path)},
    )
    model = optical_model(seen, camera(thermal(14.0, 16.3)))
    (band,) = model.thermal
    assert band.column_map is not None
    latitude, longitude = latitude_longitude_deg(band.column_map.normals())
    expected = PlacedProfiles(read_profiles(path)).columns(latitude, longitude, band.level_m).temperature_k
    np.testing.assert_allclose(band.temperature_k, expected, rtol=1e-12)
    assert np.ptp(band.temperature_k[:, 0]) > 20.0
    below = air_of(seen).state.temperature_k[0]
    assert below == pytest.approx(
        PlacedProfiles(read_profiles(path)).columns(20.0 * np.ones(1), 100.0 * np.ones(1), Z[:1]).temperature_k[0, 0]
    )
    # the ground is as warm as the mean of the lowest air around its latitude
    assert model.emission is not None
    around = np.arange(-180.0, 180.0, 4.0)
    north = PlacedProfiles(read_profiles(path)).columns(np.full(len(around), 30.0), around, Z[:1]).temperature_k
    assert model.emission.land_k[150] == pytest.approx(north.mean(), abs=0.05)
