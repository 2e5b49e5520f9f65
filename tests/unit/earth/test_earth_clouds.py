"""The relief of cloud tops: how much it covers, how high it rises, and that a seed is a relief."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.earth.clouds import relief
from horizonval.earth.clouds.relief import BASE_M, CloudField
from horizonval.spec.scene import SceneSpec


def _field(**changes):
    values = {"cover": 0.4, "top_m": 12e3, "mean_top_m": 5e3, "scale_m": 300e3, "seed": 11, "albedo": 0.8}
    return CloudField(**(values | changes))


@pytest.fixture(scope="module")
def places():
    """Unit vectors, even over the globe, drawn by chance: not the points that calibrate the field."""
    v = np.random.default_rng(np.random.SeedSequence(9)).normal(size=(100_000, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


@pytest.mark.parametrize("cover", [0.05, 0.4, 0.9])
@pytest.mark.parametrize("scale_m", [10e3, 300e3, 3000e3])
def test_cover_is_the_share_of_the_globe(places, cover, scale_m):
    """1 %: twice what two samples of 100 000 places differ by, and then some."""
    top = relief.top_m(_field(cover=cover, scale_m=scale_m), places)
    assert np.mean(top > BASE_M) == pytest.approx(cover, abs=0.01)


def test_tops_stay_below_the_tropopause_and_have_their_mean(places):
    field = _field(top_m=16e3, mean_top_m=6e3, cover=0.7)
    latitude = np.degrees(np.arcsin(places[:, 2]))
    top = relief.top_m(field, places)
    assert np.all(top <= np.minimum(field.top_m, relief.tropopause_m(latitude)) + 1e-6)
    low = (top > BASE_M) & (np.abs(latitude) < 15.0)
    assert top[low].mean() == pytest.approx(6e3, rel=0.02)
    assert top[low].max() > 15.5e3
    assert top[np.abs(latitude) > 70].max() < 9.1e3


def test_tropopause():
    assert relief.tropopause_m([0.0, 40.0, -40.0, 90.0]) == pytest.approx([17e3, 13e3, 13e3, 9e3], abs=10.0)


def test_a_seed_is_a_relief(places):
    few = places[:2000]
    first = relief.top_m(_field(), few)
    relief.rank_table.cache_clear()
    assert np.array_equal(first, relief.top_m(_field(), few))
    other = relief.top_m(_field(seed=12), few)
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.1


def test_structure_from_the_scale_down_to_three_kilometres():
    """Neighbours 200 m apart are alike, 3 km apart less so, beyond the scale not at all."""
    field = _field(cover=1.0, scale_m=100e3)
    rng = np.random.default_rng(np.random.SeedSequence(2))
    p = rng.normal(size=(4000, 3))
    p /= np.linalg.norm(p, axis=1)[:, None]
    q = np.cross(p, rng.normal(size=(4000, 3)))
    q /= np.linalg.norm(q, axis=1)[:, None]

    def correlation(distance_m):
        a = distance_m / relief.EARTH_RADIUS_M
        return np.corrcoef(relief.numpy_noise(p, field), relief.numpy_noise(np.cos(a) * p + np.sin(a) * q, field))[0, 1]

    assert correlation(200.0) > 0.99
    assert 0.5 < correlation(3e3) < 0.95
    assert abs(correlation(300e3)) < 0.1


def test_clouds_of_a_scene():
    def field(**tables):
        base = {"camera": {"file": "c"}, "platform": {"altitude_km": 500.0}}
        return relief.cloud_field(SceneSpec.model_validate(base | tables))

    assert field() is None
    assert field(clouds={"cover": 0.0}) is None
    named = field(clouds={"cover": 0.5}, scene={"name": "a"})
    assert named == field(clouds={"cover": 0.5}, scene={"name": "a"}, platform={"altitude_km": 700.0})
    assert named.seed != field(clouds={"cover": 0.5}, scene={"name": "b"}).seed
    assert named.seed != field(clouds={"cover": 0.5}, scene={"name": "a", "seed": 1}).seed
    assert field(clouds={"cover": 0.5, "seed": 3}).seed == 3
