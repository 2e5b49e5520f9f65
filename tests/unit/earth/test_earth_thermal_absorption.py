from typing import Any

import numpy as np
import pytest

from horizonval.earth import planck
from horizonval.earth import thermal_absorption as ta
from horizonval.earth.profiles import profile
from horizonval.errors import UserError
from horizonval.spec.camera import Band


def band(**values: Any) -> Band:
    return Band.model_validate({"name": "tir", "kind": "thermal", **values})


Z = np.array([0.0, 20e3, 20.25e3, 20.5e3, 100e3])


def total(points: list[ta.GPoint], kelvin: float) -> float:
    return float(sum(p.source(kelvin) for p in points))


@pytest.mark.parametrize(("lo", "hi", "groups"), [(14.0, 16.3, 3), (8.0, 14.0, 5), (14.5, 15.5, 1), (7.2, 20.0, 7)])
@pytest.mark.parametrize("kelvin", [200.0, 288.15])
def test_sources_add_up_to_the_black_body(lo: float, hi: float, groups: int, kelvin: float) -> None:
    points = ta.g_points("us_standard", band(lo_um=lo, hi_um=hi), Z)
    assert len(points) == 16 * groups
    # The map's rows add up to their bins within 0.5 %; Planck at the centres of 10 cm-1 bins is good to 2e-4.
    assert total(points, kelvin) == pytest.approx(float(planck.band_radiance(lo, hi, kelvin)), rel=2e-3)


def test_response_table_weighs_the_source() -> None:
    triangle = band(wavelength_um=[14.0, 15.0, 16.0], response=[0.0, 0.5, 0.0])
    wavelength = np.linspace(14, 16, 4001)
    response = 1 - np.abs(wavelength - 15)
    expected = np.trapezoid(response * planck.radiance_per_um(wavelength, 250.0), wavelength)
    assert total(ta.g_points("us_standard", triangle, Z), 250.0) == pytest.approx(expected, rel=2e-3)


def test_cut_band_weighs_g_points_by_the_map() -> None:
    # 613 to 630 cm-1 holds the strongest lines of the band 500 to 630: its strong classes weigh more there than in the
    # whole band, as the published map has it.
    cut = ta.g_points("us_standard", band(lo_um=1e4 / 630, hi_um=16.3), Z)
    whole = ta.g_points("us_standard", band(lo_um=1e4 / 630, hi_um=20.0), Z)

    def strong_share(points: list[ta.GPoint]) -> float:
        sources = [float(p.source(250.0)) for p in points]
        return sum(sources[8:]) / sum(sources)

    assert strong_share(cut) > 2 * strong_share(whole)


def test_absorption_is_log_linear_between_levels() -> None:
    for point in ta.g_points("tropical", band(lo_um=14.0, hi_um=16.3), Z):
        k = point.absorption_per_m
        assert k[2] == pytest.approx(np.sqrt(k[1] * k[3]), rel=1e-12)
        assert (k > 0).all()


def test_names_and_wavelengths() -> None:
    points = ta.g_points("us_standard", band(lo_um=14.0, hi_um=16.3), Z)
    assert points[0].name == "rrtmg3g01"
    assert points[-1].name == "rrtmg5g16"
    assert 1e4 / 630 < points[0].wavelength_um < 16.3
    assert 14.0 < points[-1].wavelength_um < 1e4 / 700


@pytest.mark.parametrize(("lo", "hi"), [(7.0, 9.0), (15.0, 20.1), (3.0, 30.0)])
def test_outside_the_tables(lo: float, hi: float) -> None:
    with pytest.raises(UserError) as error:
        ta.g_points("us_standard", band(lo_um=lo, hi_um=hi), Z, where="camera.toml: band[0]")
    assert "camera.toml: band[0]: thermal band 'tir'" in str(error.value)
    assert "within 7.195 to 20 um" in str(error.value)


def test_the_whole_range_is_inside() -> None:
    assert len(ta.g_points("us_standard", band(lo_um=1e4 / 1390, hi_um=20.0), Z)) == 112


def test_temperature_is_that_of_the_profile() -> None:
    z = np.arange(0.0, 100_001.0, 1000.0)
    for climate in ta.climates():
        difference = np.abs(ta.temperature_k(climate, z) - profile(climate).at(z).temperature_k)
        # Both sample the AFGL levels, some of which lie between kilometres; above 70 km one of them by 2 km.
        assert difference[z <= 70e3].max() < 0.2
        assert difference.max() < 1.5
