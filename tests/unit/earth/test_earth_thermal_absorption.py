from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.atmosphere.profiles import profile
from horizonval.earth.spectral import planck
from horizonval.earth.spectral import thermal_absorption as ta
from horizonval.earth.tables import npz
from horizonval.spec.sensor.camera import Band


def band(**values: Any) -> Band:
    return Band.model_validate({"name": "tir", "kind": "thermal", **values})


def strong_share(points: ta.GPoints) -> float:
    sources = source(points, 250.0)
    return float(sources[8:].sum() / sources.sum())


def source(points: ta.GPoints, kelvin: float) -> FloatArray:
    return points.weight_per_cm @ planck.radiance_per_wavenumber(points.wavenumber_per_cm, kelvin)


@pytest.mark.parametrize(
    ("lo", "hi", "groups"), [(14.0, 16.3, 3), (8.0, 14.0, 5), (14.5, 15.5, 1), (10.3, 12.1, 1), (7.2, 20.0, 7)]
)
@pytest.mark.parametrize("kelvin", [180.0, 288.15])
def test_sources_add_up_to_the_black_body(lo: float, hi: float, groups: int, kelvin: float) -> None:
    points = ta.g_points(band(lo_um=lo, hi_um=hi))
    assert len(points.name) == 16 * groups
    # Planck by its own series. 1e-9: what is left of rows that are scaled to fill their bins is rounding.
    assert source(points, kelvin).sum() == pytest.approx(float(planck.band_radiance(lo, hi, kelvin)), rel=1e-9)


def test_classes_keep_their_share_of_the_band() -> None:
    # Of a flat spectrum, every class gets its weight: 1e-7, but for band 6 (820 to 980 cm-1), see the module.
    edges = [500, 630, 700, 820, 980, 1080, 1180, 1390]
    for k, (low, high) in enumerate(pairwise(edges)):
        points = ta.g_points(band(lo_um=1e4 / high, hi_um=1e4 / low))
        share = points.weight_per_cm.sum(axis=1) / (high - low)
        weight = np.asarray(npz("thermal_ck.npz")["g_weight"], dtype=np.float64)
        assert np.abs(share / weight - 1).max() < (5e-3 if k == 3 else 1.5e-7)


def test_response_table_weighs_the_source() -> None:
    triangle = band(wavelength_um=[14.0, 15.0, 16.0], response=[0.0, 0.5, 0.0])
    wavelength = np.linspace(14, 16, 40_001)
    response = 1 - np.abs(wavelength - 15)
    expected = np.trapezoid(response * planck.radiance_per_um(wavelength, 250.0), wavelength)
    # Trapezoids of 5e-5 um: 1e-9.
    assert source(ta.g_points(triangle), 250.0).sum() == pytest.approx(expected, rel=1e-8)


def test_cut_band_weighs_g_points_by_the_map() -> None:
    # 613 to 630 cm-1 holds the strongest lines of the band 500 to 630: its strong classes weigh more there than in the
    # whole band, as the published map has it.
    cut = ta.g_points(band(lo_um=1e4 / 630, hi_um=16.3))
    whole = ta.g_points(band(lo_um=1e4 / 630, hi_um=20.0))
    assert strong_share(cut) > 2 * strong_share(whole)


def test_absorption_is_that_of_the_table() -> None:
    points = ta.g_points(band(lo_um=14.0, hi_um=16.3))
    table = npz("thermal_ck.npz")
    i = ta.climates().index("tropical")
    for ppm, key in ((420.0, "absorption_per_m"), (330.0, "absorption_co2_330ppm_per_m")):
        found = points.ln_absorption({"tropical": 1.0}, ppm)
        # 16 g points of the bands 3 to 5, the first of the table, one after the other.
        expected = np.log(np.asarray(table[key][i, :3], dtype=np.float64)).transpose(0, 2, 1).reshape(48, -1)
        np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("ppm", [280.0, 375.0, 560.0])
def test_carbon_dioxide_between_and_beyond_the_tables(ppm: float) -> None:
    points = ta.g_points(band(lo_um=1e4 / 700, hi_um=1e4 / 630))
    here, table = (np.exp(points.ln_absorption({"us_standard": 1.0}, p)) for p in (ppm, 420.0))
    # Between 20 and 60 km the band 630 to 700 cm-1 is CO2 but for some ozone in its weak classes: k is in proportion.
    z = ta.levels_m()
    chosen = (z >= 20e3) & (z <= 60e3)
    beside = np.abs(here / table * 420 / ppm - 1)[:, chosen].max(axis=1)
    assert beside[8:].max() < 1e-3
    assert 1e-3 < beside[:8].max() < 0.05
    more = points.ln_absorption({"us_standard": 1.0}, ppm * 1.001) - points.ln_absorption({"us_standard": 1.0}, ppm)
    assert more.max() < 1.4e-3
    if not 330 < ppm < 420:
        assert (more >= 0).all()
        assert more.max() <= np.log(1.001) * (1 + 1e-9)


def test_blend_is_linear_in_the_logarithm() -> None:
    points = ta.g_points(band(lo_um=14.0, hi_um=16.3))
    cold, warm = (points.ln_absorption({f"subarctic_{s}": 1.0}) for s in ("winter", "summer"))
    blend = points.ln_absorption({"subarctic_winter": 0.25, "subarctic_summer": 0.75})
    np.testing.assert_allclose(blend, 0.25 * cold + 0.75 * warm, atol=1e-12)


def test_names_and_wavelengths() -> None:
    points = ta.g_points(band(lo_um=14.0, hi_um=16.3))
    assert points.name[0] == "rrtmg3g01"
    assert points.name[-1] == "rrtmg5g16"
    assert 1e4 / 630 < points.wavelength_um[0] < 16.3
    assert 14.0 < points.wavelength_um[-1] < 1e4 / 700


@pytest.mark.parametrize(("lo", "hi"), [(7.0, 9.0), (15.0, 20.1), (3.0, 30.0)])
def test_outside_the_tables(lo: float, hi: float) -> None:
    with pytest.raises(UserError) as error:
        ta.g_points(band(lo_um=lo, hi_um=hi), where="camera.toml: band[0]")
    assert "camera.toml: band[0]: thermal band 'tir'" in str(error.value)
    assert "within 7.195 to 20 um" in str(error.value)


def test_the_whole_range_is_inside() -> None:
    assert len(ta.g_points(band(lo_um=1e4 / 1390, hi_um=20.0)).name) == 112


def test_temperature_is_that_of_the_profile() -> None:
    z = np.arange(0.0, 100_001.0, 1000.0)
    for climate in ta.climates():
        difference = np.abs(ta.temperature_k(climate, z) - profile(climate).at(z).temperature_k)
        # Both sample the AFGL levels, some of which lie between kilometres; above 70 km one of them by 2 km.
        assert difference[z <= 70e3].max() < 0.2
        assert difference.max() < 1.5
