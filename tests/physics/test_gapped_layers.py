"""Gaps in thin cloud: the pattern's mean, frames against integrals over given gaps, and what an even layer stays.

The integrals are sums over pieces of 100 m along a ray, in float64, through columns times the pattern at every piece;
they know the air and the pattern, and nothing of how frames find them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds import layers
from horizonval.earth.clouds.earth_pattern import even_points, numpy_split
from horizonval.earth.clouds.layers import LayerGaps
from horizonval.earth.column import OpticalModel
from horizonval.earth.optical import optical_model
from horizonval.frame import RadianceFrame
from horizonval.geometry.camera import camera_from_spec, unproject
from horizonval.geometry.ellipsoid import Ellipsoid, geodetic_height, surface_normal
from horizonval.geometry.sun_and_moon import AU_M, sun_itrs
from horizonval.renderer.backend import activate

activate()

from scipy.spatial.transform import Rotation  # noqa: E402
from table_and_march import GREEN, camera_of, rendered, scene_of  # noqa: E402

from horizonval.spec.camera import CameraSpec  # noqa: E402
from horizonval.spec.scene import SceneSpec  # noqa: E402

CLEAN = {"aerosol": "none", "refraction": False}
WINDOW = {"name": "window", "kind": "thermal", "lo_um": 10.5, "hi_um": 12.5}
BROKEN = {"kind": "cirrus", "optical_depth": 0.3, "base_km": 9.0, "top_km": 11.0, "cover": 0.4, "scale_km": 100.0}
LIMB = camera_of(GREEN, WINDOW, width=96, height=12, fov_deg=2.4)
"""Columns cross the limb, from the ground to 60 km; rows look along it, 8 km apart."""
PIECE_M = 100.0


def scene(layer: dict[str, Any], **tables: Any) -> SceneSpec:
    return scene_of(50.0, **{"layer": [layer], "atmosphere": CLEAN, "render": {"orders": "single"}} | tables)


def pieces(
    frame: RadianceFrame, camera: CameraSpec, row: int, column: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return heights, normals and the direction of the line of sight of a pixel's centre, piece by piece."""
    truth = frame.truth
    ellipsoid = Ellipsoid(truth.ellipsoid_a_m, truth.ellipsoid_b_m)
    d_cam = unproject(camera_from_spec(camera.camera), np.array([[float(column), float(row)]]))[0]
    d = Rotation.from_quat(truth.q_cam_from_itrs).inv().apply(d_cam)
    o = np.array(truth.r_itrs)
    middle = -float(o @ d)
    t = np.arange(middle - 1.15e6, middle + 1.15e6, PIECE_M) + 0.5 * PIECE_M
    p = o + t[:, None] * d
    return geodetic_height(p, ellipsoid), surface_normal(p, ellipsoid), d


def cloudiness(gaps: LayerGaps, position: FloatArray) -> FloatArray:
    """Return f of :mod:`horizonval.earth.clouds.layers` at unit vectors, shape (n, 3)."""
    place = position[:, 0], position[:, 1], position[:, 2]
    n = layers.gap_noise(gaps, place, gaps.seed, numpy_split, lambda h: h.astype(np.float64))
    lowest, highest, rank = layers.rank_table(gaps)
    u = np.interp(n, np.linspace(lowest, highest, layers.RANK_STEPS + 1), rank)
    return np.clip((u - (1.0 - gaps.cover)) / gaps.softness + 0.5, 0.0, 1.0)


def cloud_per_mean(gaps: LayerGaps, normal: FloatArray) -> FloatArray:
    return cloudiness(gaps, normal) / gaps.cover


def window_radiance(model: OpticalModel, height: FloatArray, normal: FloatArray) -> float:
    (band,), (gaps,) = model.thermal, model.gaps
    assert gaps is not None
    extinction, source = (v[:, 0] for v in band.columns())
    excess = cloud_per_mean(gaps, normal) - 1.0

    def at(column: FloatArray) -> FloatArray:
        return np.stack([np.interp(height, band.altitude_m, v, right=0.0) for v in column])

    step = PIECE_M * np.maximum(at(extinction) + excess * at(band.each_layer_per_m[0]), 0.0)
    tau = np.cumsum(step, axis=1) - step
    return float(np.sum(at(source) * np.exp(-tau) * -np.expm1(-step)))


def green_radiance(
    model: OpticalModel,
    height: FloatArray,
    normal: FloatArray,
    d: FloatArray,
    sun: FloatArray,
    *,
    gaps_to_sun: bool = False,
) -> float:
    """Return light scattered once; towards the Sun through the mean layer, or through its gaps."""
    (node,), (gaps,) = model.nodes, model.gaps
    assert gaps is not None
    z, radius = model.altitude_m, 6371e3

    def at(column: FloatArray, h: FloatArray) -> FloatArray:
        return np.interp(h, z, column, right=0.0)

    share = cloud_per_mean(gaps, normal)
    layer = at(node.layer_per_m[0], height)
    k = at(node.extinction_per_m, height) + (share - 1.0) * layer
    cosine = float(d @ sun)
    g = node.layer_asymmetry[0]
    particles = (1.0 - g * g) / (1.0 + g * g - 2.0 * g * cosine) ** 1.5 / (4.0 * math.pi)
    c = node.molecular_cos2
    molecules = (1.0 - c / 3.0 + c * cosine**2) / (4.0 * math.pi)
    source = molecules * at(node.molecular_per_m, height) + particles * share * node.layer_albedo[0] * layer
    # towards the Sun over a sphere: 400 pieces, short where they begin
    edges = 1.5e6 * np.linspace(0.0, 1.0, 401) ** 3
    s, ds = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    mu = normal @ sun
    depth = np.zeros_like(height)
    where = np.nonzero((height > 0.0) & (height < 100e3))[0]
    for i in np.array_split(where, 20):
        r = radius + height[i, None]
        h = np.sqrt(r * r + 2.0 * r * mu[i, None] * s + s * s) - radius
        along = at(node.extinction_per_m, h)
        if gaps_to_sun:
            above = r[..., None] * normal[i, None, :] + s[:, None] * sun
            above /= np.linalg.norm(above, axis=-1, keepdims=True)
            through = cloud_per_mean(gaps, above.reshape(-1, 3)).reshape(h.shape)
            along = along + (through - 1.0) * at(node.layer_per_m[0], h)
        depth[i] = along @ ds
    lit = np.where(mu > 0.0, np.exp(-depth), 0.0)
    tau = PIECE_M * (np.cumsum(k) - 0.5 * k)
    return float(node.solar_irradiance * node.weight * np.sum(source * lit * np.exp(-tau)) * PIECE_M)


@pytest.mark.parametrize(("cover", "scale_km"), [(0.4, 100.0), (0.05, 300.0), (0.9, 1000.0)])
def test_mean_over_the_globe_is_the_cover(cover: float, scale_km: float) -> None:
    gaps = LayerGaps(cover, scale_km * 1e3, 7)
    f = cloudiness(gaps, even_points(60_000))
    assert f.min() < 1e-3
    assert f.max() == 1.0
    # 60 000 places, and as many cells as the globe has
    assert f.mean() == pytest.approx(cover, abs=0.01 if scale_km < 1000.0 else 0.03)


def test_edges_are_soft_over_a_sixth_of_the_scale() -> None:
    gaps = LayerGaps(0.5, 100e3, 3)
    angle = np.arange(0.0, 2.0 * math.pi, 0.5e3 / 6371e3)
    f = cloudiness(gaps, np.stack([np.cos(angle), np.sin(angle), 0.3 * np.ones_like(angle)], axis=-1) / 1.044)
    edge = (f > 0.0) & (f < 1.0)
    starts = np.count_nonzero(edge[1:] & ~edge[:-1])
    width_km = 0.5 * np.count_nonzero(edge) / starts
    assert 10.0 < width_km < 30.0


def test_frames_equal_the_integrals() -> None:
    """Pixels below, in and above the layer; light scattered once, and the thermal window."""
    s = scene(BROKEN, surface={"temperature_k": 280.0})
    frame = rendered(s, LIMB, subsamples=1)
    distance_au = float(np.linalg.norm(sun_itrs(s.platform.epoch_utc)[1])) / AU_M
    model = optical_model(s, LIMB, sun_distance_au=distance_au)
    sun = np.array(frame.truth.sun_itrs)
    heights = frame.maps["tangent_height"].astype(float)
    off = []
    for row in (1, 10):
        for height in (2e3, 7e3, 9.6e3, 10.4e3, 13e3):
            column = int(np.argmin(np.abs(heights[row] - height)))
            path = pieces(frame, LIMB, row, column)
            window = frame.radiance["window"][row, column] / window_radiance(model, *path[:2])
            green = frame.radiance["green"][row, column] / green_radiance(model, *path, sun)
            off.append((window - 1.0, green - 1.0))
    assert np.abs(off).max() < 3e-3
    assert np.median(np.abs(off)) < 5e-4


def test_both_kinds_of_bands_have_the_same_gaps() -> None:
    frame = rendered(scene(BROKEN), LIMB)
    even = rendered(scene({k: v for k, v in BROKEN.items() if k != "scale_km"}), LIMB)
    inside = np.abs(frame.maps["tangent_height"] - 9.5e3) < 1e3
    more = {band: (frame.radiance[band] - even.radiance[band])[inside] for band in ("green", "window")}
    assert np.ptp(frame.radiance["window"][inside]) > 0.1 * frame.radiance["window"][inside].mean()
    # more cloud is brighter in both, before space
    assert np.corrcoef(more["green"], more["window"])[0, 1] > 0.8


@pytest.mark.parametrize("layer", [{**BROKEN, "cover": 1.0}, {k: v for k, v in BROKEN.items() if k != "cover"}])
def test_full_cover_is_an_even_layer(layer: dict[str, Any]) -> None:
    even = {k: v for k, v in layer.items() if k != "scale_km"}
    for band in ("green", "window"):
        a, b = (rendered(scene(v), LIMB).radiance[band] for v in (layer, even))
        assert a.tobytes() == b.tobytes()


def test_seed_draws_the_gaps() -> None:
    a, b, c = (rendered(scene({**BROKEN, "seed": n}), LIMB).radiance["window"] for n in (1, 1, 2))
    assert a.tobytes() == b.tobytes()
    assert a.tobytes() != c.tobytes()
