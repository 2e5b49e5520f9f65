import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from earth_forms import camera, scene

from horizonval.core.errors import UserError
from horizonval.earth.atmosphere.profile_file import read_profiles
from horizonval.earth.atmosphere.profiles import AtmosphereProfile, profile
from horizonval.earth.optical import optical_model

EMPTY = '{"altitude_km": %s, "temperature_K": [], "pressure_Pa": [], "ozone_ppmv": []}'
KM = [*range(0, 30), *range(30, 101, 2)]


def read_profile(path: Path, **options: Any) -> AtmosphereProfile:
    (one,) = read_profiles(path, **options)
    return one.profile


def columns(name: str = "midlatitude_summer") -> dict[str, list[float]]:
    state = profile(name).at(np.array(KM) * 1e3)
    return {
        "altitude_km": [float(z) for z in KM],
        "temperature_K": state.temperature_k.tolist(),
        "pressure_Pa": state.pressure_pa.tolist(),
        "ozone_ppmv": (1e6 * state.number_density_o3 / state.number_density_air).tolist(),
    }


def as_csv(table: dict[str, list[Any]]) -> str:
    rows = zip(*table.values(), strict=True)
    return "\n".join([",".join(table), *(",".join(str(v) for v in row) for row in rows)]) + "\n"


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    def write(table: Any, name: str = "air.csv") -> Path:
        path = tmp_path / name
        text = table if isinstance(table, str) else json.dumps(table) if name.endswith("json") else as_csv(table)
        path.write_text(text)
        return path

    return write


@pytest.mark.parametrize("name", ["air.csv", "air.json"])
def test_a_climate_comes_back(written: Callable[..., Path], name: str) -> None:
    z = np.arange(0.0, 100_001.0, 100.0)
    found, own = read_profile(written(columns(), name)).at(z), profile("midlatitude_summer").at(z)
    low = z <= 29e3
    for key in ("temperature_k", "pressure_pa", "number_density_air", "number_density_o3"):
        # The shipped table has single precision.
        np.testing.assert_allclose(getattr(found, key)[low], getattr(own, key)[low], rtol=2e-7)
    # Every second level is left out above.
    np.testing.assert_allclose(found.number_density_air, own.number_density_air, rtol=0.015)
    assert found.name == "air"


def test_units_say_the_same(written: Callable[..., Path]) -> None:
    table = columns()
    pascal = read_profile(written(table))
    density = profile("midlatitude_summer").at(np.array(KM) * 1e3)
    hecto = {**table, "pressure_hPa": [p / 100 for p in table["pressure_Pa"]]}
    del hecto["pressure_Pa"]
    counted = {
        "altitude_km": table["altitude_km"],
        "temperature_K": table["temperature_K"],
        "number_density_per_m3": density.number_density_air.tolist(),
        "ozone_per_m3": density.number_density_o3.tolist(),
    }
    for other in (hecto, counted):
        found = read_profile(written(other))
        np.testing.assert_allclose(found.number_density_air, pascal.number_density_air, rtol=1e-6)
        np.testing.assert_allclose(found.number_density_o3, pascal.number_density_o3, rtol=1e-6)


def test_comments_blank_lines_and_a_byte_order_mark(written: Callable[..., Path]) -> None:
    lines = as_csv(columns()).splitlines()
    text = "\ufeff" + "\n".join(["# a sounding", *lines[:3], "", "# more", *lines[3:]])
    np.testing.assert_array_equal(read_profile(written(text)).pressure_pa, read_profile(written(columns())).pressure_pa)


def test_no_ozone_is_none(written: Callable[..., Path]) -> None:
    table = columns()
    table["ozone_ppmv"] = [0.0 if 5 <= z <= 10 else 1.0 for z in table["altitude_km"]]
    found = read_profile(written(table)).at(np.array([4000.0, 4500.0, 7000.0, 11000.0, 50_000.0]))
    share = found.number_density_o3 / found.number_density_air * 1e6
    np.testing.assert_allclose(share, [1, 0.5, 0, 1, 1], rtol=1e-6, atol=1e-20)


def test_above_the_last_level(written: Callable[..., Path]) -> None:
    table = {key: values[: KM.index(60) + 1] for key, values in columns().items()}
    found, own = read_profile(written(table)), profile("midlatitude_summer")
    z = np.array([60e3, 70e3, 80e3, 100e3])
    a, b = found.at(z), own.at(z)
    np.testing.assert_allclose(a.temperature_k, b.temperature_k[0])
    km, pressure = table["altitude_km"], table["pressure_Pa"]
    slope = np.log(pressure[-1] / pressure[-2]) / (km[-1] - km[-2]) / 1e3
    np.testing.assert_allclose(a.pressure_pa, pressure[-1] * np.exp(slope * (z - 60e3)), rtol=1e-9)
    # The true atmosphere cools there and has less ten kilometres further: 13 %.
    assert 1.10 < a.pressure_pa[1] / b.pressure_pa[1] < 1.15


def change(key: str, i: int, value: Any) -> Callable[[dict[str, list[Any]]], None]:
    def apply(table: dict[str, list[Any]]) -> None:
        table[key][i] = value

    return apply


@pytest.mark.parametrize("kind", ["csv", "json"])
@pytest.mark.parametrize(
    ("edit", "key", "expected"),
    [
        (change("pressure_Pa", 3, 0.0), "pressure_Pa", "a finite number above 0"),
        (change("pressure_Pa", 3, float("nan")), "pressure_Pa", "a finite number above 0"),
        (change("pressure_Pa", 3, float("inf")), "pressure_Pa", "a finite number above 0"),
        (change("pressure_Pa", 3, "x"), "pressure_Pa", "a finite number above 0"),
        (change("ozone_ppmv", 3, -0.1), "ozone_ppmv", "a finite number of 0 or more"),
        (change("temperature_K", 3, 15.0), "temperature_K", "100 to 400 K"),
        (change("altitude_km", 3, 2.0), "altitude_km", "rising altitudes"),
        (change("pressure_Pa", 3, 99_000.0), "pressure_Pa", "a pressure that falls"),
    ],
)
def test_mistakes_at_the_fourth_level(
    written: Callable[..., Path], kind: str, edit: Callable[[dict[str, list[Any]]], None], key: str, expected: str
) -> None:
    table: dict[str, list[Any]] = columns()
    edit(table)
    place = rf"air\.csv: line 5, column {key}: " if kind == "csv" else rf"air\.json: {key}, level 4: "
    with pytest.raises(UserError, match=f"{place}.*; expected .*{expected}") as caught:
        read_profile(written(table, f"air.{kind}"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda t: t.update(pressure_Pa=[p / 100 for p in t["pressure_Pa"]]), r"pressure_Pa: is 1013.*30000 to 120000"),
        (lambda t: t.pop("ozone_ppmv"), r"missing: ozone_per_m3 or ozone_ppmv; expected exactly one of"),
        (lambda t: t.pop("pressure_Pa"), r"missing: pressure_Pa or pressure_hPa or number_density_per_m3"),
        (lambda t: t.update(pressure_hPa=t["pressure_Pa"]), r"pressure_Pa and pressure_hPa are given"),
        (
            lambda t: t.update(temperature_C=t.pop("temperature_K")),
            r"unknown key 'temperature_C'.*one of temperature_K",
        ),
        (lambda t: [t.update({k: v[:9]}) for k, v in t.items()], r"altitude_km: 9 levels; expected at least 10"),
        (lambda t: [t.update({k: v[:40]}) for k, v in t.items()], r"altitude_km: ends at 48 km; expected .*60 km"),
        (lambda t: [t.update({k: v[1:]}) for k, v in t.items()], r"altitude_km: is 1; expected 0, the ground"),
        (
            lambda t: [t.update({k: v[:10] + v[20:]}) for k, v in t.items()],
            r"altitude_km: 20 follows 9; expected .*at most 10 km",
        ),
    ],
)
def test_refusals(written: Callable[..., Path], edit: Callable[[dict[str, Any]], Any], message: str) -> None:
    table = columns()
    edit(table)
    with pytest.raises(UserError, match=rf"air\.csv: .*{message}"):
        read_profile(written(table))


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("", "a.csv", "the file is empty"),
        ("altitude_km,temperature_K\n", "a.csv", "line 1: missing: pressure_Pa"),
        ("altitude_km,temperature_K,pressure_Pa,ozone_ppmv\n1,2\n", "a.csv", "line 2: 2 fields; expected 4"),
        ("altitude_km,altitude_km\n", "a.csv", "altitude_km is there more than once"),
        ("{", "a.json", "not JSON"),
        ("[1]", "a.json", "not a profile"),
        ('{"altitude_km": 3}', "a.json", "missing: temperature_K"),
        (EMPTY % "3", "a.json", "altitude_km: is no list"),
        (EMPTY % "[0]", "a.json", "temperature_K: has 0 values; expected 1"),
        (EMPTY % "[true]", "a.json", "altitude_km, level 1: is true"),
    ],
)
def test_files_that_are_no_profile(written: Callable[..., Path], text: str, name: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        read_profile(written(text, name))


def test_a_scene_with_a_profile_of_its_own(written: Callable[..., Path]) -> None:
    # A file's name means nothing, not even a climate's.
    path = written(columns("us_standard"), "tropical.csv")
    vis = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 2}
    tir = {"name": "tir", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}

    def model(**atmosphere: Any) -> Any:
        air = {"aerosol": "none"} | atmosphere
        return optical_model(scene(atmosphere=air), camera(vis, tir), base_dir=path.parent)

    mine, standard = model(profile_file=path.name), model(profile="us_standard")
    low = slice(0, 291)
    for a, b in zip(mine.nodes, standard.nodes, strict=True):
        np.testing.assert_allclose(a.extinction_per_m[low], b.extinction_per_m[low], rtol=1e-6)
    # The nearest climate is the standard's own, so that all gases come back. What differs is where the levels are: by
    # the kilometre in the file, with 27.5 km between them in the climate, and the step of absorption at 16.5 km.
    (a,), (b,) = mine.thermal, standard.thermal
    away = low.stop > np.arange(1001)
    away &= np.abs(a.altitude_m - 16_500.0) > 500.0
    for own, table, tolerance in zip(a.columns(), b.columns(), (0.05, 0.01), strict=True):
        np.testing.assert_allclose(own[..., away], table[..., away], rtol=tolerance)
        assert np.median(np.abs(own[..., away] / table[..., away] - 1)) < 1e-3


def test_gases_of_its_own(written: Callable[..., Path]) -> None:
    table = columns("tropical")
    own = {"water_vapour_ppmv": 5.0, "carbon_dioxide_ppmv": 700.0, "nitrous_oxide_ppmv": 0.0, "methane_ppmv": 3.0}
    found = read_profile(written(table | {key: [value] * len(KM) for key, value in own.items()}))
    shares = [found.number_density_h2o, found.number_density_co2, found.number_density_n2o, found.number_density_ch4]
    for share, ppmv in zip(shares, own.values(), strict=True):
        np.testing.assert_allclose(share / found.number_density_air, 1e-6 * ppmv, atol=1e-20)


def test_missing_gases_are_those_of_the_nearest_climate(written: Callable[..., Path]) -> None:
    for name in ("tropical", "subarctic_winter"):
        found, own = read_profile(written(columns(name)), co2_ppm=840.0), profile(name)
        low = found.altitude_m <= 25e3
        z = found.altitude_m[low]
        for key in ("h2o", "n2o", "ch4", "hno3"):
            expected = getattr(own.at(z), f"number_density_{key}")
            np.testing.assert_allclose(getattr(found, f"number_density_{key}")[low], expected, rtol=2e-3)
        co2 = found.number_density_co2[low] / found.number_density_air[low]
        np.testing.assert_allclose(co2, 840e-6, rtol=1e-3)


def test_carbon_dioxide_of_two_kinds(written: Callable[..., Path]) -> None:
    path = written(columns() | {"carbon_dioxide_ppmv": [400.0] * len(KM)})
    with pytest.raises(UserError, match=r"carbon_dioxide_ppmv: .* the scene asks for 500 ppm"):
        read_profile(path, co2_ppm=500.0)


@pytest.mark.parametrize("value", [-1.0, math.nan])
def test_gases_out_of_range(written: Callable[..., Path], value: float) -> None:
    with pytest.raises(UserError, match=r"line 5, column methane_ppmv: .* 0 or more"):
        read_profile(written(columns() | {"methane_ppmv": [1.8] * 3 + [value] + [1.8] * (len(KM) - 4)}))
