"""Masks against cases that need no formula."""

from __future__ import annotations

import numpy as np

from horizonval.frame import Hit
from horizonval.store.attributes import earth_mask, saturated_mask, sunlit_mask


def maps(hit: list[int], zenith: list[float], height: list[float]) -> dict[str, np.ndarray]:
    rows = {"hit": hit, "solar_zenith": zenith, "tangent_height": height}
    return {name: np.array([values], np.float32) for name, values in rows.items()}


def test_the_sun_sets_later_the_higher_one_is(make_truth):
    """From 100 km the horizon dips 10.05 deg on a sphere of 6371 km (cos = 6371 / 6471)."""
    hit = [Hit.SURFACE, Hit.SURFACE, Hit.ATMOSPHERE, Hit.ATMOSPHERE, Hit.ATMOSPHERE, Hit.CLOUD]
    values = maps(hit, [89.9, 90.1, 90.1, 100.0, 100.1, 10.0], [-9e4, -9e4, 0.0, 1e5, 1e5, -5e4])
    np.testing.assert_array_equal(sunlit_mask(values, make_truth()), [[1, 0, 0, 1, 0, 1]])
    np.testing.assert_array_equal(earth_mask(values), [[1, 1, 0, 0, 0, 1]])


def test_the_sky_is_neither_earth_nor_lit(make_truth):
    values = maps([Hit.SPACE, Hit.SUN, Hit.MOON], [10.0] * 3, [np.inf, 2e5, 3e5])
    assert not sunlit_mask(values, make_truth()).any()
    assert not earth_mask(values).any()


def test_saturation_is_the_converters_end():
    np.testing.assert_array_equal(saturated_mask(np.array([[0, 1022, 1023]], np.uint16), 1023), [[0, 0, 1]])
