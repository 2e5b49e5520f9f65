"""Air that varies over the globe, in sunlight: which scenes have it, the plugin's text, tables and kernels."""

from __future__ import annotations

from typing import Any

import emission_models
import numpy as np
import pytest

import horizonval as hv
from horizonval.earth.optical import optical_model
from horizonval.renderer.backend import activate
from horizonval.spec.scene import SceneSpec

activate()
from horizonval.renderer.frame import render_frame  # noqa: E402

CAMERA = emission_models.camera({"name": "b", "kind": "solar", "lo_um": 0.45, "hi_um": 0.65, "nodes": 2}, pixels=24)


def _scene(atmosphere: dict[str, Any], latitude_deg: float = 40.0, **render: Any) -> SceneSpec:
    return emission_models.scene(
        platform={"altitude_km": 500.0, "latitude_deg": latitude_deg, "epoch_utc": "2026-01-15T12:00:00Z"},
        sun={"zenith_deg": 60.0, "azimuth_deg": 60.0},
        atmosphere=atmosphere,
        render={"orders": "single"} | render,
    )


CLIMATES = {"profile": "by_latitude_month"}
WEATHER = {"profile": "weather", "seed": 4}


def test_the_column_below_the_camera_is_no_different() -> None:
    """Rows are 0.01 of the sine of latitude apart: between two of them climates change by less than 3 %."""
    model = optical_model(_scene(CLIMATES), CAMERA)
    assert model.columns is not None
    node = model.nodes[0]
    here = np.argmin(np.abs(model.columns.sin_latitude - np.sin(np.radians(40.0))))
    own = np.interp(model.columns.altitude_m, model.altitude_m, node.extinction_per_m)
    assert np.abs(node.more_extinction_per_m[here] / own).max() < 0.03
    assert np.abs(node.more_extinction_per_m / own).max() > 0.1


@pytest.mark.parametrize(
    "atmosphere", [{"profile": "tropical"}, CLIMATES | {"latitude_deg": 45.0}, {"profile": "weather:ec2008-12"}]
)
def test_one_column_serves_where_air_is_the_same(atmosphere: dict[str, Any]) -> None:
    model = optical_model(_scene(atmosphere), CAMERA)
    assert model.columns is None
    assert model.nodes[0].more_extinction_per_m.size == 0


@pytest.mark.parametrize("atmosphere", [CLIMATES, pytest.param(WEATHER, marks=pytest.mark.slow)], ids=["rows", "map"])
def test_tables_are_the_march(atmosphere: dict[str, Any]) -> None:
    table, march = (
        render_frame(_scene(atmosphere, method=method, nodes=nodes), CAMERA).radiance["b"]
        for method, nodes in (("table", 128), ("march", 512))
    )
    bright = march > 1e-3 * march.max()
    assert table[bright] == pytest.approx(march[bright], rel=1e-3)


SMALL = {"width": 24, "height": 24}


def _frame(profile: str, sun_zenith_deg: float, *, refraction: bool) -> np.ndarray:
    camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera=SMALL)
    scene = hv.Scene(
        camera=camera,
        altitude_km=500,
        mount_roll_deg=65,
        sun={"zenith_deg": sun_zenith_deg, "azimuth_deg": 90.0},
        atmosphere={"profile": profile, "refraction": refraction},
        render={"orders": "single", "subsamples": 1, "nodes": 48},
    )
    return np.asarray(hv.render(scene).radiance["vis"])


def _by_refraction(profile: str, sun_zenith_deg: float) -> float:
    """Return what refraction changes, median of bright pixels."""
    seen, straight = (_frame(profile, sun_zenith_deg, refraction=refraction) for refraction in (True, False))
    assert np.isfinite(seen).all()
    assert (seen >= 0.0).all()
    bright = straight > 0.1 * straight.max()
    return float(np.median(np.abs(seen[bright] / straight[bright] - 1.0)))


@pytest.mark.parametrize(
    ("state", "sun_zenith_deg"),
    [
        ("ec2008-59", 89.5),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (("ec2008-16", 89.5), ("ec2008-59", 50.0))),
    ],
)
def test_states_with_strong_inversions(state: str, sun_zenith_deg: float) -> None:
    """Refraction changes their light about as much as that of smoother air: bending at the ground differs by a half."""
    changed, of_smooth = (_by_refraction(name, sun_zenith_deg) for name in (f"weather:{state}", "us_standard"))
    assert of_smooth / 1.5 < changed < 1.5 * of_smooth
