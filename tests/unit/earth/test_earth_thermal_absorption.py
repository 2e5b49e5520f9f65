from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from earth_forms import black_body_band

from horizonval.core.arrays import FloatArray
from horizonval.earth.gases import afgl
from horizonval.earth.spectral import planck
from horizonval.earth.spectral import thermal_absorption as ta
from horizonval.spec.camera import Band


def published() -> dict[str, Any]:
    """Return the published tables of the six climates, which the product's map was taken from."""
    with np.load(Path(__file__).parents[2] / "data" / "thermal_ck.npz", allow_pickle=False) as file:
        return {name: np.array(file[name]) for name in file.files}


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
    assert source(points, kelvin).sum() == pytest.approx(float(black_body_band(lo, hi, kelvin)), rel=1e-9)


def test_classes_keep_their_share_of_the_band() -> None:
    # Of a flat spectrum, every class gets its weight: 1e-7, but for band 6 (820 to 980 cm-1), see the module.
    edges = [500, 630, 700, 820, 980, 1080, 1180, 1390]
    for k, (low, high) in enumerate(pairwise(edges)):
        points = ta.g_points(band(lo_um=1e4 / high, hi_um=1e4 / low))
        share = points.weight_per_cm.sum(axis=1) / (high - low)
        weight = np.asarray(published()["g_weight"], dtype=np.float64)
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


def test_absorption_stands_in_the_order_of_the_classes() -> None:
    points, z = ta.g_points(band(lo_um=14.0, hi_um=16.3)), afgl.levels_m()
    found = np.exp(points.ln_absorption(afgl.blended([{"tropical": 1.0}], z)))
    table = published()
    i = [str(name) for name in table["atmosphere"]].index("tropical")
    # 16 g points of the bands 3 to 5, the first of the table, one after the other.
    expected = table["absorption_per_m"][i, :3].astype(np.float64).transpose(0, 2, 1).reshape(48, -1)
    level = table["altitude_m"].astype(np.float64)
    shared = np.flatnonzero(np.isin(level, z) & (np.abs(level - 16_880.0) > 150.0) & (level < 75e3))
    assert found.shape == (48, 1, len(z))
    np.testing.assert_allclose(found[:, 0, np.searchsorted(z, level[shared])], expected[:, shared], rtol=1e-6)


@pytest.mark.parametrize("ppm", [280.0, 375.0, 560.0])
def test_more_carbon_dioxide(ppm: float) -> None:
    points, z = ta.g_points(band(lo_um=1e4 / 700, hi_um=1e4 / 630)), afgl.levels_m()
    here, table = (np.exp(points.ln_absorption(afgl.state("us_standard", z, p))) for p in (ppm, 420.0))
    # Between 20 and 60 km the band 630 to 700 cm-1 is CO2 but for some ozone in its weak classes: k is in proportion.
    chosen = (z >= 20e3) & (z <= 60e3)
    beside = np.abs(here / table * 420 / ppm - 1)[:, chosen].max(axis=1)
    assert beside[8:].max() < 1e-3
    assert 1e-3 < beside[:8].max() < 0.5
