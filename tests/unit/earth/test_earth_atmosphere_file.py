import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from earth_forms import rayleigh_air

from horizonval.core.errors import UserError
from horizonval.earth import atmosphere_file as af
from horizonval.earth.spectral import planck


def content() -> dict[str, Any]:
    return {
        "note": "by hand",
        "planet_radius_km": 6371.0,
        "top_km": 100.0,
        "altitude_km": [0.0, 10.0, 11.0, 100.0],
        "temperature_K": [288.0, 220.0, 220.05, 200],
        "bands": [
            {
                "name": "a",
                "wavelength_nm": 15000,
                "scattering_per_m": [1e-5, 1e-6, 1e-6, 0],
                "absorption_per_m": [2e-5, 2e-6, 1e-6, 1e-9],
                "phase": "isotropic",
            }
        ],
        "surface": {"albedo": 0.3, "temperature_K": 290.0, "emissivity": 0.9},
    }


def changed(path: str, value: Any) -> dict[str, Any]:
    data: Any = copy.deepcopy(content())
    *way, last = [int(p) if p.isdigit() else p for p in path.split("/")]
    target = data
    for step in way:
        target = target[step]
    if value is KeyError:
        del target[last]
    else:
        target[last] = value
    return data


def particles(**changes: Any) -> dict[str, Any]:
    """A band with particles in it."""
    return content()["bands"][0] | {"particle_scattering_per_m": [3e-5, 1e-6, 0, 0], "asymmetry": 0.7, **changes}


@pytest.mark.parametrize(
    ("path", "value", "key", "message"),
    [
        ("altitude_km/2", 10.0, "altitude_km[2]", "expected rising altitudes"),
        ("altitude_km/0", 1.0, "altitude_km[0]", "expected 0, the ground"),
        ("altitude_km", [0.0], "altitude_km", "at least 2"),
        ("altitude_km/1", float("nan"), "altitude_km[1]", "finite"),
        ("temperature_K/1", 0.0, "temperature_K[1]", "greater than 0"),
        ("temperature_K", [288.0, 220.0], "temperature_K", "has 2 values; expected 4"),
        ("temperature_K/0", "288", "temperature_K[0]", 'is "288"; expected number'),
        ("bands/0/scattering_per_m/3", -1e-9, "bands[0].scattering_per_m[3]", "greater than or equal to 0"),
        ("bands/0/absorption_per_m/0", float("inf"), "bands[0].absorption_per_m[0]", "finite"),
        ("bands/0/absorption_per_m", [0.0], "bands[0].absorption_per_m", "has 1 values; expected 4"),
        ("bands/0/phase", "mie", "bands[0].phase", '"rayleigh", "isotropic" or {"henyey_greenstein": g}'),
        ("bands/0/phase", {"henyey_greenstein": 1.0}, "bands[0].phase", "-1 < g < 1"),
        ("bands/0/asymmetry", 0.5, "bands[0].particle_scattering_per_m", "missing"),
        ("bands/0/particle_scattering_per_m", [0.0] * 4, "bands[0].asymmetry", "missing"),
        ("bands/0", particles(particle_scattering_per_m=[0.0]), "bands[0].particle_scattering_per_m", "has 1 values"),
        ("bands/0", particles(asymmetry=1.0), "bands[0].asymmetry", "less than 1"),
        ("bands/0", particles(asymmetry=-1.0), "bands[0].asymmetry", "greater than -1"),
        (
            "bands/0",
            particles(phase={"henyey_greenstein": 0.3}),
            "bands[0].phase",
            'expected "rayleigh" or "isotropic"',
        ),
        ("bands/0/colour", "red", "bands[0].colour", "unknown key"),
        ("bands", [], "bands", "at least 1"),
        ("bands", [content()["bands"][0]] * 2, "bands[1].name", "'a' is used twice"),
        ("top_km", 99.0, "top_km", "expected 100 or more"),
        ("top_km", 10**400, "top_km", "expected"),
        ("planet_radius_km", 0.0, "planet_radius_km", "greater than 0"),
        ("planet_radius_km", KeyError, "planet_radius_km", "missing"),
        ("surface/albedo", 1.5, "surface.albedo", "less than or equal to 1"),
        ("surface", KeyError, "surface", "missing"),
        ("sky", 1, "sky", "unknown key"),
    ],
)
def test_refusals_name_file_key_and_what_was_expected(path: str, value: Any, key: str, message: str) -> None:
    with pytest.raises(UserError) as error:
        af.parse_atmosphere(changed(path, value), "air.json")
    assert str(error.value).startswith(f"air.json: {key}: ")
    assert message in str(error.value)


def test_particles_beside_molecules_scatter_sunlight_alone() -> None:
    file = af.parse_atmosphere(changed("bands/0", particles(phase="rayleigh")), "air.json")
    (node,) = af.file_model(file, thermal=False).nodes
    assert node.molecular_cos2 == 0.75
    np.testing.assert_array_equal(node.molecular_per_m, [1e-5, 1e-6, 1e-6, 0])
    np.testing.assert_array_equal(node.particle_per_m, [3e-5, 1e-6, 0, 0])
    np.testing.assert_array_equal(node.asymmetry, [0.7] * 4)
    np.testing.assert_allclose(node.extinction_per_m, [6e-5, 4e-6, 2e-6, 1e-9])
    with_them, without = (
        af.file_model(af.parse_atmosphere(data, "air.json"), thermal=True).thermal[0]
        for data in (changed("bands/0", particles()), content())
    )
    np.testing.assert_array_equal(with_them.ln_extinction, without.ln_extinction)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b'{"note": ', "not JSON: .* at line 1, column"),
        (b"\xff\xfe\x00", "not text"),
        (b"", "not JSON"),
        (b"[" * 200_000, "not an atmosphere file|not JSON"),
        (b"3", "not an atmosphere file"),
        (b"{}", "not an atmosphere file"),
    ],
)
def test_damaged_files(tmp_path: Path, text: bytes, message: str) -> None:
    path = tmp_path / "air.json"
    path.write_bytes(text)
    with pytest.raises(UserError, match=message):
        af.read_atmosphere(path)


def test_solar_columns_are_the_files_own(tmp_path: Path) -> None:
    (tmp_path / "air.json").write_text(json.dumps(content()))
    file = af.read_atmosphere(tmp_path / "air.json")
    model = af.file_model(file, thermal=False)
    np.testing.assert_array_equal(model.altitude_m, [0, 10e3, 11e3, 100e3])
    (node,) = model.nodes
    np.testing.assert_array_equal(node.scattering_per_m, [1e-5, 1e-6, 1e-6, 0])
    np.testing.assert_allclose(node.extinction_per_m, [3e-5, 3e-6, 2e-6, 1e-9])
    assert (node.name, node.band, node.weight, node.molecular_cos2) == ("a", "a", 1.0, 0.0)
    assert (node.solar_irradiance, node.sun_radiance, model.thermal) == (1.0, 0.0, ())
    assert (model.albedo, file.planet_radius_m) == (0.3, 6371e3)


def test_thermal_grid_is_refined_and_keeps_the_nodes() -> None:
    file = af.parse_atmosphere(content(), "air.json")
    model = af.file_model(file, thermal=True)
    z = model.altitude_m
    assert {0.0, 10e3, 11e3, 100e3} <= set(z.tolist())
    assert (np.diff(z) > 0).all()
    # 68 K, 0.05 K and 20.05 K in steps of at most 0.1 K.
    assert len(z) == 680 + 1 + 201 + 1
    (band,) = model.thermal
    extinction, source = (values[0, 0] for values in band.columns())
    absorption = np.interp(z, [0, 10e3, 11e3, 100e3], [2e-5, 2e-6, 1e-6, 1e-9])
    np.testing.assert_allclose(extinction, absorption, rtol=1e-12)
    assert source[0] == pytest.approx(float(planck.radiance_per_um(15.0, 288.0)))
    assert model.emission is not None
    assert (model.emission.land_k[0], model.emission.emissivity) == (290.0, 0.9)
    # Between its nodes the source is linear; Planck's function of the linear temperature is met to 5e-7 at 200 K.
    middle = (z[1:] + z[:-1]) / 2
    exact = planck.radiance_per_um(
        15.0, np.interp(middle, np.array(content()["altitude_km"]) * 1e3, [288, 220, 220.05, 200])
    )
    np.testing.assert_allclose((source[1:] + source[:-1]) / 2, exact, rtol=5e-7)


def test_vacuum_between_last_node_and_top() -> None:
    model = af.file_model(af.parse_atmosphere(changed("top_km", 120.0), "air.json"), thermal=False)
    assert model.top_m == model.altitude_m[-1] == 100e3


def test_henyey_greenstein() -> None:
    file = af.parse_atmosphere(changed("bands/0/phase", {"henyey_greenstein": -0.25}), "air.json")
    (node,) = af.file_model(file, thermal=False).nodes
    assert (node.asymmetry == -0.25).all()
    assert not node.molecular_per_m.any()
    np.testing.assert_array_equal(node.particle_per_m, [1e-5, 1e-6, 1e-6, 0])


def test_shipped_example_is_what_its_note_says() -> None:
    shipped = json.loads((Path(__file__).parents[3] / "scenes" / "atmospheres" / "us76.json").read_text())
    made = rayleigh_air("us76", [450.0, 550.0, 850.0])
    for a, b in zip(shipped["bands"], made["bands"], strict=True):
        assert a["name"] == b["name"]
        np.testing.assert_allclose(a["scattering_per_m"], b["scattering_per_m"], rtol=1e-10)
        np.testing.assert_allclose(a["absorption_per_m"], b["absorption_per_m"], rtol=1e-10)
    np.testing.assert_allclose(shipped["temperature_K"], made["temperature_K"], rtol=1e-12)
