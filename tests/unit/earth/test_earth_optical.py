"""Optical models of bands against sums of their own; the sky over the ground against closed forms."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from earth_forms import black_body_band, camera, model_of, rayleigh_air, scene, thermal
from scipy.special import expn

from horizonval.core.errors import UserError
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.gases import rayleigh
from horizonval.earth.optical import OpticalModel, node_counts, optical_model
from horizonval.earth.spectral import bands, sunlight

VIS = {"name": "vis", "kind": "solar", "lo_um": 0.45, "hi_um": 0.65, "nodes": 4}
TIR = {"name": "tir", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}
QE = {
    "name": "qe",
    "kind": "solar",
    "wavelength_um": [0.4, 0.5, 0.55, 0.7, 0.75],
    "response": [0.0, 0.5, 0.55, 0.2, 0.1],
    "nodes": 5,
}


def band_sum(model: OpticalModel, band: str, values: list[float]) -> float:
    return sum(n.weight * v for n, v in zip(model.nodes, values, strict=True) if n.band == band)


def test_bands_keep_the_cameras_order() -> None:
    model = optical_model(scene(), camera(TIR, VIS))
    assert model.bands == ("tir", "vis")
    # 14.0 to 16.3 um touches three bands of 16 g points.
    assert list(node_counts(model).items()) == [("tir", 48), ("vis", 4)]
    assert optical_model(scene(), camera(VIS)).emission is None


def test_solar_nodes_carry_the_band() -> None:
    model = optical_model(scene(), camera(VIS))
    assert sum(n.weight for n in model.nodes) == pytest.approx(0.2, rel=1e-12)
    assert {n.solar_irradiance for n in model.nodes} == {model.nodes[0].solar_irradiance}
    # Photon weighting changes the mean over a band of 20 % half width by a few per cent of the spectrum's slope.
    mean = sunlight.band_irradiance(0.45, 0.65) / 0.2
    assert model.nodes[0].solar_irradiance == pytest.approx(mean, rel=0.01)
    assert all(n.molecular_cos2 == rayleigh.cos2(n.wavelength_um) for n in model.nodes)


def test_electrons_are_counted_exactly() -> None:
    """Band radiance times lambda_ref / (h c) is the number of photons that the response turns into electrons."""
    model = optical_model(scene(), camera(QE))
    band = camera(QE).band[0]
    electrons = band_sum(model, "qe", [n.solar_irradiance for n in model.nodes]) * bands.reference_wavelength_um(band)
    knots = np.unique(np.concatenate([np.linspace(0.4, 0.75, 35_001), sunlight.table_um()]))
    knots = knots[(knots >= 0.4) & (knots <= 0.75)]
    direct = np.trapezoid(bands.response(band, knots) * knots * sunlight.irradiance(knots), knots)
    # Trapezoids of 10 nm / 1000 on parabolas: 1e-8.
    assert electrons == pytest.approx(direct, rel=1e-7)


@pytest.mark.parametrize(("nodes", "tolerance"), [(4, 1e-3), (8, 3e-4)])
def test_few_nodes_stand_for_the_band(nodes: int, tolerance: float) -> None:
    """A slant path through Rayleigh and the Chappuis band, optical depth 1 to 4."""

    def transmitted(n: int) -> float:
        model = optical_model(scene(), camera({**VIS, "nodes": n}))
        depth = [np.trapezoid(node.extinction_per_m, model.altitude_m) for node in model.nodes]
        scattered = [np.trapezoid(node.scattering_per_m, model.altitude_m) for node in model.nodes]
        values = [s / d * (1 - np.exp(-20 * d)) for s, d in zip(scattered, depth, strict=True)]
        return band_sum(model, "vis", values)

    assert transmitted(nodes) == pytest.approx(transmitted(64), rel=tolerance)


def test_sun_distance() -> None:
    near, far = optical_model(scene(), camera(VIS, TIR), 0.98), optical_model(scene(), camera(VIS, TIR), 1.02)
    ratio = near.nodes[0].solar_irradiance / far.nodes[0].solar_irradiance
    assert ratio == pytest.approx((1.02 / 0.98) ** 2, rel=1e-12)
    for a, b in zip(near.nodes, far.nodes, strict=True):
        assert a.sun_radiance == pytest.approx(b.sun_radiance, rel=1e-12)
        # bit by bit: what is tabulated for an air is found again by content, on whatever day
        assert (a.wavelength_um, a.weight, a.molecular_cos2) == (b.wavelength_um, b.weight, b.molecular_cos2)
        np.testing.assert_array_equal(a.extinction_per_m, b.extinction_per_m)
    np.testing.assert_array_equal(near.thermal[0].sun_radiance, far.thermal[0].sun_radiance)


def test_ozone_is_an_option() -> None:
    clean = {"aerosol": "none", "gases_in_sunlight": False}
    with_ozone = optical_model(scene(atmosphere=clean), camera(VIS))
    without = optical_model(scene(atmosphere=clean | {"ozone": False}), camera(VIS))
    for a, b in zip(with_ozone.nodes, without.nodes, strict=True):
        np.testing.assert_array_equal(b.extinction_per_m, b.scattering_per_m)
        np.testing.assert_array_equal(a.scattering_per_m, b.scattering_per_m)
    vertical = [np.trapezoid(n.extinction_per_m - n.scattering_per_m, with_ozone.altitude_m) for n in with_ozone.nodes]
    # 345 Dobson units at 5.0e-21 cm2, the Chappuis band's peak, give 0.046; a third of it averages over 450 to 650 nm.
    assert 0.03 < max(vertical) < 0.05
    assert 0.0 <= min(vertical) < 0.01


def test_band_across_the_end_of_the_ozone_table() -> None:
    model = optical_model(
        scene(atmosphere={"aerosol": "none", "gases_in_sunlight": False}), camera({**VIS, "lo_um": 0.7, "hi_um": 1.1})
    )
    for n in model.nodes:
        assert (n.extinction_per_m >= n.scattering_per_m).all()
    vertical = [np.trapezoid(n.extinction_per_m - n.scattering_per_m, model.altitude_m) for n in model.nodes]
    # 0.006 to 0.008 from 720 to 700 nm, 0.002 at 820 nm; the smoothing leaves a trace beyond 1 um.
    assert 0.005 < vertical[0] < 0.007
    assert vertical[-1] < 0.0002


def test_thermal_bands_emit_like_their_levels() -> None:
    (band,) = optical_model(scene(), camera(TIR)).thermal
    _, source = band.columns()
    total = source.sum(axis=0)[0]
    # Planck of the band at the level's temperature: AFGL US standard, 288.2 K at the ground, 216.7 K at 15 km.
    assert total[0] == pytest.approx(float(black_body_band(14.0, 16.3, 288.2)), rel=1e-6)
    assert total[150] == pytest.approx(float(black_body_band(14.0, 16.3, 216.7)), rel=1e-6)
    # The Sun's disc at 15 um: brightness temperature 4400 to 5000 K.
    sun = band.sun_radiance.sum()
    assert black_body_band(14.0, 16.3, 4000.0) < sun < black_body_band(14.0, 16.3, 5800.0)


def test_carbon_dioxide_raises_the_absorption() -> None:
    (low,), (high,) = (optical_model(scene(atmosphere={"co2_ppm": ppm}), camera(TIR)).thermal for ppm in (330.0, 420.0))
    # The strong half of the classes of 14.3 to 15.9 um (the second 16) is CO2 alone at 30 km.
    strong = slice(24, 32)
    ratio = (high.extinction_at([30e3]) / low.extinction_at([30e3]))[strong]
    np.testing.assert_allclose(ratio, 420 / 330, rtol=1e-3)


def test_no_atmosphere() -> None:
    model = optical_model(scene(atmosphere={"profile": "none"}), camera(VIS, TIR))
    assert [n.band for n in model.nodes] == ["vis"]
    assert not any(n.extinction_per_m.any() for n in model.nodes)
    (empty,) = model.thermal
    assert empty.count == 1
    assert empty.columns()[0].max() * model.top_m < 1e-200
    full = optical_model(scene(atmosphere={"profile": "us76"}), camera(VIS, TIR))
    # A white ground seen through nothing has the same band radiance, however many nodes carry it.
    for key in ("solar_irradiance", "sun_radiance"):
        bare = band_sum(model, "vis", [getattr(n, key) for n in model.nodes])
        assert bare == pytest.approx(band_sum(full, "vis", [getattr(n, key) for n in full.nodes]), rel=1e-12)
    # The same integral of the same spectrum by two quadratures; the Sun's is jagged, Planck's is not.
    assert empty.sun_radiance.sum() == pytest.approx(full.thermal[0].sun_radiance.sum(), rel=1e-5)
    assert empty.source(288.15).sum() == pytest.approx(full.thermal[0].source(288.15).sum(), rel=1e-9)
    assert model.emission is not None
    assert model.emission.land_k == (288.15, 288.15)


def test_bare_earth_has_a_few_wavelengths() -> None:
    model = optical_model(scene(atmosphere={"profile": "none"}, surface={"kind": "earth"}), camera(TIR))
    (band,) = model.thermal
    assert band.count == 4
    assert (np.diff(band.wavelength_um) > 0.4).all()
    assert band.source(250.0).sum() == pytest.approx(float(black_body_band(14.0, 16.3, 250.0)), rel=1e-9)


def file_content() -> dict[str, Any]:
    data = rayleigh_air("us76", [550.0, 15_000.0], with_ozone=False)
    data["bands"][0]["name"], data["bands"][1]["name"] = "vis", "tir"
    data["bands"][0]["phase"] = {"henyey_greenstein": 0.5}
    data["bands"][1]["absorption_per_m"] = (1e-4 * np.exp(-np.array(data["altitude_km"]) / 7)).tolist()
    return data


def test_atmosphere_file_beside_the_scene(tmp_path: Path) -> None:
    data = file_content()
    (tmp_path / "air.json").write_text(json.dumps(data))
    model = optical_model(scene(atmosphere={"file": "air.json"}), camera(TIR, VIS), base_dir=tmp_path)
    (solar,), (thermal,) = model.nodes, model.thermal
    assert model.bands == ("tir", "vis")
    assert (solar.asymmetry == 0.5).all()
    assert solar.wavelength_um == pytest.approx(0.55)
    assert solar.weight == pytest.approx(0.2)
    z_km = np.array(data["altitude_km"])
    expected = np.interp(model.altitude_m / 1e3, z_km, data["bands"][0]["scattering_per_m"])
    np.testing.assert_allclose(solar.scattering_per_m, expected, rtol=1e-12)
    temperature = np.interp(model.altitude_m / 1e3, z_km, data["temperature_K"])
    assert np.abs(np.diff(temperature)).max() <= 0.1 + 1e-9
    extinction, source = thermal.columns()
    assert extinction.shape == (1, 1, len(model.altitude_m))
    np.testing.assert_allclose(source[0, 0], black_body_band(14.0, 16.3, temperature), rtol=1e-8)
    absorption = np.interp(model.altitude_m / 1e3, z_km, data["bands"][1]["absorption_per_m"])
    np.testing.assert_allclose(extinction[0, 0], absorption, rtol=1e-12)
    assert model.emission is not None
    assert model.emission.land_k[0] == pytest.approx(288.15, abs=1e-4)


def test_file_without_the_cameras_band(tmp_path: Path) -> None:
    (tmp_path / "air.json").write_text(json.dumps(file_content()))
    with pytest.raises(UserError, match=r"air\.json: bands: no band 'red'.*the file has tir, vis"):
        optical_model(scene(atmosphere={"file": "air.json"}), camera({**VIS, "name": "red"}), base_dir=tmp_path)


@pytest.mark.parametrize(
    ("tables", "band", "message"),
    [
        ({}, {**VIS, "lo_um": 0.27}, r"cam.toml: band\[0\]: .*0.28 um or more.*atmosphere.ozone = false"),
        (
            {"atmosphere": {"aerosol": "none", "ozone": False}},
            {**VIS, "lo_um": 0.2},
            r"cam.toml: band\[0\]: .*within 0.25 to 20 um",
        ),
        ({"atmosphere": {"profile": "none"}}, {**TIR, "hi_um": 30.0}, r"cam.toml: band\[0\]: .*within 0.25 to 20 um"),
        ({}, {**TIR, "hi_um": 30.0}, r"cam.toml: band\[0\]: .*7.195 to 20 um"),
        (
            {"atmosphere": {"profile": "tropics"}},
            VIS,
            "unknown atmosphere profile 'tropics'; expected one of tropical,",
        ),
        ({"atmosphere": {"profile": "non"}}, VIS, "expected one of none,"),
    ],
)
def test_refusals(tables: dict[str, Any], band: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        optical_model(scene(**tables), camera(band))


RADIUS_M = 6_371_000.0


def grey(depth: float, kelvin: Any) -> EmittingBand:
    z = np.linspace(0.0, 10e3, 101)
    return EmittingBand(
        name="t",
        wavelength_um=np.array([10.0]),
        altitude_m=z,
        sin_latitude=np.zeros(1),
        level_m=z,
        ln_extinction=np.full((1, 1, 101), np.log(depth / 10e3)),
        temperature_k=np.broadcast_to(kelvin, (1, 101)).astype(float),
        source_wavenumber_per_cm=np.array([1000.0]),
        source_weight_per_cm=np.ones((1, 1)),
        sun_radiance=np.zeros(1),
    )


@pytest.mark.parametrize("depth", [1e-9, 1e-3, 0.3, 2.0, 40.0, 5000.0])
def test_isothermal_slab(depth: float) -> None:
    band = grey(depth, 250.0)
    # The diffuse emissivity of a slab, 1 - 2 E_3; thin ones cancel to 1e-16 absolute.
    expected = band.source(250.0)[0] * (1 - 2 * expn(3, depth))
    assert float(band.sky_irradiance()[0, 0]) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_source_linear_in_depth() -> None:
    band = grey(3.0, np.linspace(300.0, 200.0, 101))
    z, source = band.altitude_m, band.columns()[1][0, 0]
    # The integral of S 2 E_2 by a fine rule; S is smooth and 100 layers follow it.
    tau = np.linspace(0.0, 3.0, 200_001)
    expected = np.trapezoid(np.interp(tau, z * 3e-4, source) * 2 * expn(2, tau), tau)
    assert float(band.sky_irradiance()[0, 0]) == pytest.approx(expected, rel=1e-6)


def spherical_sky(band: EmittingBand) -> Any:
    """Return twice the integral of L(mu) mu dmu over straight rays from the ground, layers of 5 to 50 m."""
    z = np.concatenate([np.arange(0.0, 2e3, 5.0), np.arange(2e3, 100_001.0, 50.0)])
    extinction, source = ([np.interp(z, band.altitude_m, row) for row in c[:, 0]] for c in band.columns())
    k, s = np.array(extinction), np.array(source)
    x, w = np.polynomial.legendre.leggauss(16)
    total = np.zeros(band.count)
    for mu, weight in zip((x + 1) / 2, w / 2, strict=True):
        path = np.sqrt((RADIUS_M * mu) ** 2 + 2 * RADIUS_M * z + z * z) - RADIUS_M * mu
        depth = np.cumsum(0.5 * (k[:, 1:] + k[:, :-1]) * np.diff(path), axis=1)
        passed = np.exp(-np.concatenate([np.zeros((band.count, 1)), depth], axis=1))
        total += 2 * weight * mu * np.sum((passed[:, :-1] - passed[:, 1:]) * 0.5 * (s[:, 1:] + s[:, :-1]), axis=1)
    return total


@pytest.mark.parametrize("climate", ["tropical", "subarctic_winter"])
@pytest.mark.parametrize(("lo", "hi"), [(14.0, 16.3), (8.0, 14.0), (10.5, 12.5)])
def test_round_earth(climate: str, lo: float, hi: float) -> None:
    (band,) = model_of(thermal(lo, hi), atmosphere={"profile": climate}).thermal
    ground = band.source(band.temperature_k[0, 0])
    error = (band.sky_irradiance()[:, 0] - spherical_sky(band)) / ground
    # As the docstring says: what a plane Earth has too much, of the ground's own source.
    assert np.abs(error).max() < 1.5e-3
    assert abs(error @ ground / ground.sum()) < 5e-4


@pytest.mark.parametrize("ground_m", [0.0, 40.0, 1000.0, 2890.0])
def test_a_column_begins_at_its_ground(ground_m: float) -> None:
    band = replace(grey(0.5, 250.0), ground_m=np.array([ground_m]))
    ((column,),) = band.extinction_at(np.arange(0.0, 10001.0, 250.0))
    # 0.5 over 10 km, cut off at the ground: cells of 250 m, those at the ends half as thick
    assert np.trapezoid(column, dx=250.0) == pytest.approx(0.5 * (1.0 - ground_m / 10e3), rel=1e-9)
    assert (column[np.arange(0.0, 10001.0, 250.0) < ground_m - 125.0] == 0.0).all()
    sky = float(band.sky_irradiance()[0, 0])
    assert sky == pytest.approx(band.source(250.0)[0] * (1 - 2 * expn(3, 0.5 * (1.0 - ground_m / 10e3))), rel=1e-3)
