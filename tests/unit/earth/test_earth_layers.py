"""Layers of thin cloud: their columns, optics and climate, and what a scene may say of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from horizonval.core.errors import UserError
from horizonval.earth.atmosphere.air import AirChange, air_of
from horizonval.earth.clouds import layers
from horizonval.earth.clouds.layers import LayerGaps, ThinLayer, layers_of, merged_bands
from horizonval.spec.scene import SceneSpec

GRID_M = np.linspace(0.0, 100e3, 1001)
KINDS = sorted(layers.KINDS)


def scene(*layers: dict[str, Any], latitude_deg: float = 37.0, month: int = 7, **tables: Any) -> SceneSpec:
    platform = {"altitude_km": 500.0, "latitude_deg": latitude_deg, "epoch_utc": f"2026-{month:02}-15T12:00:00Z"}
    return SceneSpec.model_validate({"camera": {"file": "x"}, "platform": platform, "layer": list(layers), **tables})


@pytest.mark.parametrize(("base_m", "top_m"), [(9000.0, 11_000.0), (15_030.0, 15_230.0), (82_345.0, 84_020.0)])
@pytest.mark.parametrize("raised_m", [0.0, 37.0])
def test_columns_keep_optical_depth_and_mean_height(base_m, top_m, raised_m):
    layer = ThinLayer(base_m, top_m, 0.3 / (top_m - base_m), "ice 30")
    column = layer.column(GRID_M, raised_m)
    assert np.trapezoid(column, GRID_M) == pytest.approx(0.3, rel=1e-6)
    middle = np.trapezoid(column * GRID_M, GRID_M) / 0.3
    assert middle == pytest.approx(0.5 * (base_m + top_m) + raised_m, abs=0.5)
    outside = (base_m + raised_m - 100.0 >= GRID_M) | (top_m + raised_m + 100.0 <= GRID_M)
    assert not column[outside].any()


def test_columns_are_nothing_beyond_their_layer():
    """To the last bit, under any tropopause: what looks for a layer's edges looks for the first node that has none."""
    for latitude_deg in np.linspace(-90.0, 90.0, 181):
        base_m, top_m = layers.heights_m(scene({"kind": "cirrus"}).layer[0], float(latitude_deg))
        inside = GRID_M[ThinLayer(base_m, top_m, 1e-4, "ice 30").column(GRID_M) != 0.0]
        assert base_m - 100.0 < inside[0] <= base_m + 100.0
        assert top_m - 100.0 <= inside[-1] < top_m + 100.0


def test_air_scatters_by_its_layers_whatever_its_dust():
    clear, cloudy = (air_of(scene(*layers)) for layers in ((), ({"kind": "cirrus", "base_km": 9, "top_km": 11},)))
    added = cloudy.aerosol.at(0.55)[0] - (clear.aerosol.at(0.55)[0] if clear.aerosol.kinds else 0.0)
    assert np.trapezoid(added, GRID_M) == pytest.approx(0.2, rel=1e-6)
    assert cloudy.aerosol.at(0.55)[2][100] == pytest.approx(0.7988, abs=0.005)
    changed = air_of(scene({"kind": "cirrus"}), change=AirChange(dustier=1.0))
    assert np.trapezoid(changed.aerosol.extinction_550_per_m[-1], GRID_M) == pytest.approx(0.2, rel=1e-6)


def test_optics_of_large_and_of_the_finest_particles():
    """Both are near geometric optics, where extinction is twice the cross section and absorption once."""
    for kind in ("ice 30", "ice 50", "water 10"):
        assert 0.4 < layers.infrared_absorption(kind, [11.0])[0] < 0.56
    extinction, _, g = layers.sunlit("ice 0.02", [0.45, 0.9])
    assert np.log(extinction[0] / extinction[1]) / np.log(2.0) == pytest.approx(4.0, abs=0.15)
    assert (g < 0.05).all()
    assert not layers.infrared_absorption("ice 0.05", [11.0]).any()


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_has_a_layer_of_its_own(kind):
    (layer,) = layers_of(scene({"kind": kind}))
    assert layer.top_m - layer.base_m >= 400.0
    depth = layer.extinction_550_per_m * (layer.top_m - layer.base_m)
    assert depth == pytest.approx(layers.KINDS[kind].optical_depth)
    if kind != "noctilucent":
        layers.sunlit(layer.particle, [0.45, 1.0])


def test_cirrus_follows_the_tropopause():
    tops = [layers_of(scene({"kind": "cirrus"}, latitude_deg=v))[0].top_m for v in (0.0, 40.0, 80.0)]
    np.testing.assert_allclose(tops, [15_500.0, 11_500.0, 7500.0], atol=30.0)


def test_cover_spreads_the_particles():
    (whole,) = layers_of(scene({"kind": "cirrus"}))
    (half,) = layers_of(scene({"kind": "cirrus", "cover": 0.5}))
    assert half.extinction_550_per_m == 0.5 * whole.extinction_550_per_m
    assert layers_of(scene({"kind": "cirrus", "cover": 0.0})) == ()


def test_occurrence_means_over_the_globe():
    latitude = np.degrees(np.arcsin(np.linspace(-0.999, 0.999, 1001)))

    def mean(kind: str) -> float:
        return float(np.mean([[layers.occurrence(kind, v, m) for v in latitude[::10]] for m in range(1, 13)]))

    # Sassen, Wang and Liu (2008): 16.7 % of the globe, from 10 to 35 %
    assert mean("cirrus") == pytest.approx(0.167, abs=0.02)
    assert 0.1 < mean("subvisible_cirrus") < 0.25


@pytest.mark.parametrize("month", range(1, 13))
def test_polar_clouds_keep_their_seasons(month):
    at = {v: layers.occurrence("polar_stratospheric", v, month) for v in (-80.0, -50.0, 80.0)}
    assert at[-50.0] == 0.0
    assert (at[-80.0] > 0.4) == (month in (6, 7, 8, 9))
    assert (at[80.0] > 0.0) == (month in (11, 12, 1, 2, 3))
    assert (layers.occurrence("noctilucent", 80.0, month) > 0.5) == (month in (6, 7))
    assert layers.occurrence("noctilucent", 50.0, month) == 0.0


def test_climate_decides_the_cover():
    (layer,) = layers_of(scene({"kind": "noctilucent", "occurrence": "climate"}, latitude_deg=80.0, month=7))
    assert layer.extinction_550_per_m * 2000.0 == pytest.approx(0.8e-4)
    assert layers_of(scene({"kind": "noctilucent", "occurrence": "climate"}, latitude_deg=80.0, month=1)) == ()


@pytest.mark.parametrize(
    ("layer", "message"),
    [
        ({"kind": "fog"}, "Input should be"),
        ({"kind": "cirrus", "base_km": 9, "top_km": 9.1}, "at least 0.2 km above base_km"),
        ({"kind": "cirrus", "optical_depth": -1}, "greater than or equal to 0"),
        ({"kind": "cirrus", "cover": 0.5, "occurrence": "climate"}, "leave one of them out"),
        ({"kind": "thin_water", "occurrence": "climate"}, "does not know thin_water"),
        ({"kind": "cirrus", "effective_radius_um": 3}, "10 or more, or 0.2 or less"),
        ({"kind": "thin_water", "effective_radius_um": 40}, "4 to 30"),
        ({"kind": "cirrus", "cover": 0.4, "seed": 5}, "scale_km"),
    ],
)
def test_mistakes_are_named(layer, message):
    with pytest.raises(ValidationError, match=message):
        scene(layer)


def test_refusals_and_merged_bands():
    with pytest.raises(ValidationError, match="needs air with a profile"):
        scene({"kind": "cirrus"}, atmosphere={"profile": "none"})
    with pytest.raises(UserError, match="no optical properties of thin cloud"):
        layers.sunlit("ice 30", [1.3])
    assert merged_bands([(9e3, 11e3), (10.9e3, 12e3), (15e3, 16e3)], 100.0) == [(8.9e3, 12.1e3), (14.9e3, 16.1e3)]


def test_layers_have_gaps_where_a_scale_is_given():
    even, broken, full = layers_of(
        scene(
            {"kind": "cirrus", "cover": 0.4},
            {"kind": "cirrus", "cover": 0.4, "scale_km": 50.0, "seed": 5},
            {"kind": "cirrus", "scale_km": 50.0},
        )
    )
    assert even.gaps is None
    assert full.gaps is None
    assert broken.gaps == LayerGaps(0.4, 50e3, 5)
    assert broken.extinction_550_per_m == even.extinction_550_per_m
    drawn = [layer.gaps for layer in layers_of(scene(*[{"kind": "cirrus", "cover": 0.4, "scale_km": 50.0}] * 2))]
    assert None not in drawn
    assert drawn[0] != drawn[1]
