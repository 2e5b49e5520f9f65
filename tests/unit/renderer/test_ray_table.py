"""Tables on patches as good as their tolerance, whatever was seen before; the plane of rays that they lie in."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.renderer.backend import activate

activate()
import mitsuba as mi  # noqa: E402

from horizonval.renderer.kernel.frame_geometry import RayCoordinates  # noqa: E402
from horizonval.renderer.planet import Planet  # noqa: E402
from horizonval.renderer.types import constant  # noqa: E402
from horizonval.renderer.view_table.ray_table import PACKET, Knots, RayPlane, RayTable  # noqa: E402
from horizonval.renderer.view_table.stations import StationPlace, look_at_stations  # noqa: E402

TOLERANCE = 1e-3


def _table(function, quantities: int = 4) -> RayTable:
    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        return np.stack([(k + 1.0) * function(x, azimuth) for k in range(quantities)], axis=1)

    return RayTable(values, quantities, allowed=lambda v: TOLERANCE * np.maximum(np.abs(v), 0.1))


def _looked(table: RayTable, x: FloatArray, azimuth: FloatArray) -> FloatArray:
    places = mi.Float64(x), mi.Float64(azimuth)
    table.cover(*places)
    return np.stack([np.array(v) for v in table.look(*places, [0])], axis=1)


def _draws(count: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(20)
    return rng.random(count), rng.uniform(-7.0, 7.0, count)


def _smooth(x: FloatArray, azimuth: FloatArray) -> FloatArray:
    return 1.0 + np.exp(-5.0 * x) * np.cos(2.0 * azimuth) + x**3


def _kinked(x: FloatArray, azimuth: FloatArray) -> FloatArray:
    return 1.0 + np.maximum(np.cos(azimuth) - x, 0.0)


def _jumping(x: FloatArray, azimuth: FloatArray) -> FloatArray:
    return np.where(np.cos(azimuth) > x, 1.0, 2.0)


def test_a_smooth_function_is_less_than_a_tenth_of_the_tolerance_off() -> None:
    table = _table(_smooth)
    x, azimuth = _draws(20_000)
    assert np.abs(_looked(table, x, azimuth)[:, 0] / _smooth(x, azimuth) - 1.0).max() < TOLERANCE / 10.0


def test_a_kink_is_within_the_tolerance_in_small_patches() -> None:
    table = _table(_kinked)
    x, azimuth = _draws(20_000)
    assert np.abs(_looked(table, x, azimuth)[:, 0] / _kinked(x, azimuth) - 1.0).max() < TOLERANCE
    assert table.patches > 2 * _patches_of(_smooth)


def _patches_of(function, count: int = 2000) -> int:
    table = _table(function)
    _looked(table, *_draws(count))
    return table.patches


def test_edges_of_the_axes_belong_to_the_outermost_patches() -> None:
    table = _table(_smooth)
    x = np.array([0.0, 1.0, 1.0, 0.0, 1.2, -0.1])
    azimuth = np.array([0.0, 2.0 * math.pi, -math.pi, math.pi, 0.5, 0.5])
    inside = np.clip(x, 0.0, 1.0)
    assert _looked(table, x, azimuth)[:, 0] == pytest.approx(_smooth(inside, azimuth), rel=1e-4)


@pytest.mark.parametrize("function", [_smooth, _kinked, _jumping])
def test_what_is_read_does_not_depend_on_what_was_seen_before(function) -> None:
    x, azimuth = _draws(3000)
    whole = _looked(_table(function), x, azimuth)
    grown = _table(function)
    for part in np.array_split(np.random.default_rng(1).permutation(len(x)), 7):
        assert np.array_equal(_looked(grown, x[part], azimuth[part]), whole[part])
    assert grown.patches == _patches_of(function, 3000)


def test_patches_are_made_where_rays_fall_and_nowhere_else() -> None:
    table = _table(_smooth)
    _looked(table, np.full(100, 0.3), np.linspace(0.1, 0.2, 100))
    assert table.patches == 1
    before = table.rays
    _looked(table, np.full(100, 0.3), np.linspace(0.1, 0.2, 100))
    assert table.rays == before
    _looked(table, np.full(100, 0.9), np.linspace(3.1, 3.2, 100))
    assert table.patches > 1


def test_packets_may_be_chosen_ray_by_ray() -> None:
    table = _table(_smooth, quantities=12)
    x, azimuth = _draws(50)
    _looked(table, x, azimuth)
    packet = np.arange(50) % 3
    values = table.look(mi.Float64(x), mi.Float64(azimuth), [mi.UInt32(packet)])
    expected = (4.0 * packet + 1.0) * _smooth(x, azimuth)
    assert np.array(values[0]) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("mirrored", [False, True])
def test_even_knots_are_of_fourth_order_and_mirror_the_meridian(mirrored: bool) -> None:
    x, azimuth = _draws(5000)
    errors = []
    for patches in (1, 2):
        knots = Knots(patches, patches if mirrored else 2 * patches, mirrored=mirrored)
        table = RayTable(lambda x, azimuth: (1.0 + x**4 + x * np.cos(azimuth))[:, None], 1, knots)
        found = np.array(table.covered(mi.Float64(x), mi.Float64(azimuth))[0])
        errors.append(np.abs(found - 1.0 - x**4 - x * np.cos(azimuth)).max())
    assert errors[0] < 1e-3
    assert errors[1] < errors[0] / 10.0
    if mirrored:
        both = [np.array(table.covered(mi.Float64(x), mi.Float64(sign * azimuth))[0]) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(*both, rtol=1e-13)


def test_stations_along_a_ray_up_to_the_first_and_the_last() -> None:
    stations = np.arange(10.0)

    def values(x: FloatArray, azimuth: FloatArray) -> FloatArray:
        p, q = np.add.outer(x, stations**2), np.add.outer(0.0 * azimuth, 5.0 - stations)
        return np.stack([p, q, p, q], axis=-1).reshape(len(x), -1)

    table = RayTable(values, PACKET * len(stations), Knots(1, 1))
    number = np.array([-0.9, 0.0, 0.45, 2.7, 4.5, 8.55, 9.0, 13.5])
    places = mi.Float64(np.full(8, 0.25)), mi.Float64(np.linspace(-3.0, 3.0, 8))
    table.cover(*places)
    station = StationPlace.at(mi.Float64(number), constant(0.0), constant(9.0))
    p, q, *_ = look_at_stations(table, *places, station, 1, [0])
    place = np.clip(number, 0.0, 9.0)
    assert np.array(p) == pytest.approx(0.25 + place**2, rel=1e-12)
    assert np.array(q) == pytest.approx(5.0 - place, rel=1e-12)


@pytest.mark.parametrize("to_ground", [True, False])
@pytest.mark.parametrize(
    "origin", [[4.0e6, 3.0e6, 5.2e6], [0.0, 0.0, 7.5e6], [3.0e7, 2.0e7, -1.5e7], [6.4e6, 0.0, 0.0]]
)
def test_rays_are_found_again_at_their_places(origin: list[float], to_ground: bool) -> None:
    plane = RayPlane(RayCoordinates.of(Planet(6_378_137.0, 6_356_752.3), np.array(origin), 1e5), to_ground)
    rng = np.random.default_rng(3)
    x, azimuth = rng.random(2000), rng.uniform(-np.pi, np.pi, 2000)
    found, turned = plane.place(plane.camera, plane.directions(x, azimuth))
    # heights of 1e-7 m, the rounding of distances as long as this, over a limb of 1e5 m, in the worst camera
    np.testing.assert_allclose(np.array(found), x, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(np.array(turned), azimuth, rtol=0.0, atol=1e-9)
