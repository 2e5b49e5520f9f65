"""Layers of thin cloud in frames: against Monte Carlo, the march, clear air, and the truth's own integral."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel
from horizonval.earth.optical import optical_model
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.renderer.backend import activate
from horizonval.truth.infrared_radiance import BandMedium, layer_edges_m, limb_radiances, ray_paths

activate()

from make_tables import CLOUD_TABLE, cloudy_columns  # noqa: E402
from reference_rays import limb_ray, vector  # noqa: E402
from table_and_march import (  # noqa: E402
    FINER,
    GREEN,
    MEDIAN,
    NODES,
    WORST,
    camera_of,
    compare,
    rendered,
    scene_of,
    table_errors,
)

from horizonval.renderer.rays import radiance_along_rays  # noqa: E402
from horizonval.renderer.scattering.shells import LAYERED, Quality  # noqa: E402

RADIUS_M = 6371e3
DEPTHS = (0.001, 0.01, 0.1, 0.3, 1.0)
CLEAN = {"aerosol": "none", "refraction": False}
WINDOW = {"name": "window", "kind": "thermal", "lo_um": 10.5, "hi_um": 12.5}
LIMB = camera_of(GREEN, width=96, height=8, fov_deg=2.4)
"""Columns cross the limb, from the ground to 60 km."""


def cirrus(optical_depth: float, base_km: float = 9.0, top_km: float = 11.0) -> dict[str, Any]:
    return {"kind": "cirrus", "optical_depth": optical_depth, "base_km": base_km, "top_km": top_km}


@cache
def rows(optical_depth: float) -> list[dict[str, float]]:
    with CLOUD_TABLE.open() as file:
        table = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    return [row for row in table if row["optical_depth"] == optical_depth]


def ray_of(row: dict[str, float]) -> tuple[float, ...]:
    return row["sun_zenith_deg"], row["azimuth_deg"], row["height_km"]


def along(model: OpticalModel, rays: list[tuple[float, ...]], quality: Quality | None) -> dict[str, FloatArray]:
    limbs = [limb_ray(*ray) for ray in rays]
    observer, direction, sun = (np.array([vector(limb, name) for limb in limbs]) for name in ("obs", "dir", "sun"))
    return radiance_along_rays(model, RADIUS_M, observer * 1e3, direction, sun, nodes=1024, scattering=quality)


@pytest.mark.parametrize("optical_depth", [0.3, 1.0])
def test_light_scattered_once_is_that_of_sharp_edges(optical_depth: float) -> None:
    """Ours has edges 200 m soft. The other is a quadrature in code that knows nothing of ours."""
    expected = np.array([r["single_per_sr"] for r in rows(optical_depth)])
    (ours,) = along(cloudy_columns(optical_depth), [ray_of(r) for r in rows(optical_depth)], None).values()
    np.testing.assert_allclose(ours, expected, rtol=0.01)


@cache
def every_order() -> tuple[list[tuple[float, ...]], dict[str, FloatArray]]:
    """Return the rays (Sun's zenith angle, azimuth, height) and our radiances by optical depth: solved together."""
    models = [cloudy_columns(depth) for depth in DEPTHS]
    nodes = tuple(replace(m.nodes[0], name=str(depth)) for m, depth in zip(models, DEPTHS, strict=True))
    rays = sorted({ray_of(row) for depth in DEPTHS for row in rows(depth)})
    return rays, along(replace(models[0], nodes=nodes), rays, LAYERED)


@pytest.mark.slow
@pytest.mark.parametrize("optical_depth", DEPTHS)
def test_limb_equals_monte_carlo(optical_depth: float) -> None:
    """Below, in and above the layer, the Sun 20 to 90 deg from the zenith; 2 % beside twice the noise."""
    rays, radiance = every_order()
    expected = np.array([r["radiance_per_sr"] for r in rows(optical_depth)])
    error = np.array([r["standard_error"] for r in rows(optical_depth)])
    ours = radiance[str(optical_depth)][[rays.index(ray_of(r)) for r in rows(optical_depth)]]
    off = np.abs(ours - expected)
    assert (off < 0.02 * expected + 2.0 * error).all()
    assert np.sqrt(np.mean((ours / expected - 1.0) ** 2)) < 0.012


def test_tables_equal_the_march_where_rays_end_on_clouds_in_and_below_a_layer() -> None:
    platform = {"latitude_deg": 10.0, "longitude_deg": -19.0}
    render = {"orders": "single"}
    layer = [cirrus(0.01, 15.0, 16.0)]
    scene = scene_of(
        50.0, off_nadir_deg=40.0, platform=platform, atmosphere=CLEAN, clouds={"seed": 3}, layer=layer, render=render
    )
    for found in table_errors(scene, camera_of(GREEN, width=32, height=32)):
        assert found.worst < WORST, found
        assert found.median < MEDIAN, found


@pytest.mark.parametrize("layer", [cirrus(0.1), cirrus(0.01, 15.5, 15.8), cirrus(1e-4, 82.0, 84.0)])
@pytest.mark.parametrize("sun_zenith_deg", [50.0, 85.0])
def test_tables_equal_the_march(layer: dict[str, Any], sun_zenith_deg: float) -> None:
    """Of light scattered once: the other orders come through the same steps and take a minute to solve."""
    scene = scene_of(sun_zenith_deg, layer=[layer], atmosphere=CLEAN, render={"orders": "single"})
    for found in table_errors(scene, LIMB):
        assert found.worst < WORST, str(found)
        assert found.median < MEDIAN, str(found)


def test_march_hardly_depends_on_its_steps() -> None:
    scene = scene_of(85.0, layer=[cirrus(0.01, 15.5, 15.8)], atmosphere=CLEAN, render={"orders": "single"})
    coarse, fine = (rendered(scene, LIMB, method="march", nodes=n) for n in (NODES, 4 * FINER * NODES))
    (found,) = compare(coarse, fine, LIMB)
    assert found.worst < 3e-3, str(found)


def test_layer_of_nothing_is_clear_air() -> None:
    clear = scene_of(50.0, atmosphere=CLEAN, render={"orders": "single"})
    layer = scene_of(50.0, atmosphere=CLEAN, render={"orders": "single"}, layer=[cirrus(1e-8)])
    (found,) = compare(rendered(layer, LIMB), rendered(clear, LIMB), LIMB)
    # the layer's edges cut the rays into other steps
    assert found.worst < 2e-4, str(found)


def test_truth_cuts_its_rays_at_the_edges_of_layers_up_to_the_top_of_the_air() -> None:
    model = optical_model(scene_of(50.0, layer=[cirrus(0.2, 9.03, 11.01)]), camera_of(WINDOW))
    band = model.thermal[0]
    np.testing.assert_allclose(layer_edges_m(band, band.altitude_m), 1e3 * np.arange(8.9, 11.25, 0.1))
    everywhere = replace(band, layer_per_m=np.ones_like(band.layer_per_m))
    np.testing.assert_array_equal(layer_edges_m(everywhere, band.altitude_m), band.altitude_m)


@pytest.mark.parametrize(
    "layer", [cirrus(0.1), {**cirrus(0.01, 15.5, 15.8), "kind": "subvisible_cirrus"}, {"kind": "thin_water"}]
)
def test_window_equals_the_truth(layer: dict[str, Any]) -> None:
    """The frame against the integral of the infrared truth, which cuts its paths at the layers' edges."""
    camera = camera_of(WINDOW, width=1500, height=2, fov_deg=1.2)
    scene = scene_of(50.0, layer=[layer], surface={"temperature_k": 280.0}, atmosphere=CLEAN)
    frame = rendered(scene, camera)
    height, radiance = frame.maps["tangent_height"][1].astype(float), frame.radiance["window"][1].astype(float)
    truth = frame.truth
    (band,) = optical_model(scene, camera).thermal
    limb = (height > 300.0) & (height < 40e3)
    order = np.argsort(height[limb])
    height, radiance = height[limb][order][::4], radiance[limb][order][::4]
    ellipsoid = Ellipsoid(truth.ellipsoid_a_m, truth.ellipsoid_b_m)
    paths = ray_paths(np.array(truth.r_itrs), ellipsoid, np.array([math.radians(77.0)]), height, 100e3)
    expected = limb_radiances([BandMedium(band)], paths)[0][0]
    assert np.median(np.abs(radiance / expected - 1.0)) < 3e-4
    # the edge has a slope that no table over height follows: its place is right to a tenth of a pixel of 300 m
    brightest = int(np.argmax(expected))
    for share in (0.1, 0.5):
        level = -share * expected[brightest]
        place, other = (np.interp(level, -v[brightest:], height[brightest:]) for v in (radiance, expected))
        assert place == pytest.approx(other, abs=30.0)
