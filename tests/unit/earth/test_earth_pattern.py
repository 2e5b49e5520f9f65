"""The clouds of the Earth: how many there are where and when, how thick and how high, and that a seed fixes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from earth_forms import is_land, scene
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds import earth_pattern, relief
from horizonval.earth.clouds.climatology import cloud_kinds
from horizonval.earth.clouds.earth_pattern import BASE_M, Coarse, kept_coarse_map, stirred
from horizonval.earth.clouds.relief import CloudField


def _field(seed: int = 3, month: int = 6, cover: float | None = None) -> CloudField:
    return CloudField(cover, 17e3, 5e3, 300e3, seed, 0.8, "earth", month)


def _unit(latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
    a, b = np.radians(latitude_deg), np.radians(longitude_deg)
    return np.stack([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a)], axis=-1)


@pytest.fixture(scope="module")
def places() -> FloatArray:
    """Unit vectors, even over the globe, turned away from those that calibrate the field."""
    return Rotation.from_rotvec([0.3, -1.1, 0.7]).apply(earth_pattern.even_points(600_000))


def _by_month() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    latitude, longitude = np.meshgrid(np.arange(-89.5, 90.0), np.arange(-179.5, 180.0), indexing="ij")
    fraction = np.stack([cloud_kinds(latitude, longitude, month).fraction for month in range(1, 13)])
    return latitude, longitude, np.cos(np.radians(latitude)), fraction


def test_climatology_has_the_published_means() -> None:
    """0.67 of the globe, 0.72 of the sea, 0.55 of the land (King et al. 2013), 0.02; they are given to 0.01."""
    latitude, longitude, area, fraction = _by_month()
    land, year = is_land(latitude, longitude), fraction.mean(axis=0)
    assert np.average(year, weights=area) == pytest.approx(0.67, abs=0.01)
    assert np.average(year, weights=area * ~land) == pytest.approx(0.72, abs=0.02)
    assert np.average(year, weights=area * land) == pytest.approx(0.55, abs=0.025)
    assert earth_pattern.climatological_cover(6) == pytest.approx(np.average(fraction[5], weights=area), abs=1e-3)


def test_climatology_knows_belts_deserts_decks_and_seasons() -> None:
    _, _, _, fraction = _by_month()
    zonal = fraction.mean(axis=2)
    assert zonal[:, 30].min() > 0.8
    assert zonal[:, 25:36].mean() > 0.85
    north = np.argmax(fraction[:, 80:110, 30:60].mean(axis=2), axis=1)
    assert north[7] > north[1]

    def at(latitude: float, longitude: float, month: int) -> float:
        return float(cloud_kinds(np.array([latitude]), np.array([longitude]), month).fraction[0])

    assert at(23.0, 10.0, 6) < 0.25
    assert at(22.0, 46.0, 1) < 0.25
    assert at(-25.0, 132.0, 7) < 0.35
    assert at(-15.0, -85.0, 10) > at(-15.0, -85.0, 4) > 0.7
    assert at(25.0, -125.0, 7) > 0.75
    assert at(-15.0, 5.0, 10) > 0.75


@pytest.mark.slow
def test_the_global_share_is_exact(places: FloatArray) -> None:
    """1e-3 rms over seeds and covers, and 2e-3 each: what two sets of points, 50 km and more apart, can differ by."""
    errors = []
    for seed, cover in ((3, None), (4, 0.15), (5, 0.5), (6, 0.8)):
        wanted = earth_pattern.climatological_cover(6) if cover is None else cover
        errors.append(float(np.mean(relief.top_m(_field(seed, cover=cover), places) > BASE_M)) - wanted)
    assert np.sqrt(np.mean(np.square(errors))) < 1e-3
    assert np.abs(errors).max() < 2e-3
    assert np.all(relief.top_m(_field(cover=1.0), places[::10]) > BASE_M)


@pytest.mark.slow
def test_zonal_means_are_those_of_the_climatology(places: FloatArray) -> None:
    """In belts of ten degrees, over eight seeds: within four standard errors, by the scatter among seeds, and 0.01.

    0.03 of all belts together, by area. The caps beyond 80 degrees have two or three weather systems each.
    """
    some = places[::20]
    latitude, longitude = np.degrees(np.arcsin(some[:, 2])), np.degrees(np.arctan2(some[:, 1], some[:, 0]))
    expected = cloud_kinds(latitude, longitude, 1).fraction
    belt = np.floor((latitude + 90.0) / 10.0).astype(int)
    count = np.bincount(belt)
    cloudy = [np.bincount(belt, relief.top_m(_field(seed, 1), some) > BASE_M) / count for seed in range(8)]
    difference = np.mean(cloudy, axis=0) - np.bincount(belt, expected) / count
    standard_error = np.std(cloudy, axis=0, ddof=1) / np.sqrt(8.0)
    assert np.all((np.abs(difference) < 4.0 * standard_error + 0.01)[1:-1])
    assert np.sqrt(np.average(difference**2, weights=count)) < 0.03


def test_optical_thickness_has_the_published_shares(places: FloatArray) -> None:
    """ISCCP: 0.53 of clouds thinner than 3.6, 0.91 than 23; 0.03. Albedo by the two-stream formula of those is 0.32
    and 0.75. The mean albedo of all clouds is a third, which with the fraction makes 0.2 of the planet's 0.29.
    """
    places, field = places[::4], _field()
    albedo, top = relief.albedo(field, places), relief.top_m(field, places)
    cloudy = top > BASE_M
    assert np.array_equal(cloudy, albedo > 0.0)
    assert np.mean(albedo[cloudy] < 0.319) == pytest.approx(0.53, abs=0.03)
    assert np.mean(albedo[cloudy] < 0.749) == pytest.approx(0.91, abs=0.03)
    assert albedo.max() == 0.8


def test_tops_by_kind(places: FloatArray) -> None:
    """Low, middle and high clouds (680 and 440 hPa: 3.2 and 6.5 km) are 0.40, 0.28, 0.32 in ISCCP, thin cirrus
    included, which are layers of their own here: within 0.13 (0.12 found), none missing. Decks lie low,
    towers reach 15 km.
    """
    places = places[::4]
    top, latitude = relief.top_m(_field(), places), np.degrees(np.arcsin(places[:, 2]))
    cloudy = top > BASE_M
    shares = [np.mean((top[cloudy] > a) & (top[cloudy] <= b)) for a, b in ((0, 3.2e3), (3.2e3, 6.5e3), (6.5e3, 2e4))]
    assert shares == pytest.approx([0.40, 0.28, 0.32], abs=0.13)
    assert np.all(top <= relief.tropopause_m(latitude) + 1e-6)
    assert top[np.abs(latitude) < 15.0].max() > 15e3
    longitude = np.degrees(np.arctan2(places[:, 1], places[:, 0]))
    deck = cloudy & (np.abs(latitude + 15.0) < 4.0) & (np.abs(longitude + 85.0) < 4.0)
    assert deck.sum() > 100
    assert np.quantile(top[deck], 0.9) < 2e3


def test_highest_tops_can_be_lowered(places: FloatArray) -> None:
    low = CloudField(None, 4e3, 2e3, 300e3, 3, 0.8, "earth", 6)
    top = relief.top_m(low, places[:20_000])
    assert top.max() == 4e3
    assert np.array_equal(top > BASE_M, relief.top_m(_field(), places[:20_000]) > BASE_M)


def test_a_seed_and_a_month_fix_the_clouds(places: FloatArray) -> None:
    few = places[:20_000]
    first = relief.top_m(_field(), few)
    kept_coarse_map.cache_clear()
    assert np.array_equal(first, relief.top_m(_field(), few))
    depth, other = (earth_pattern.depth_at(_field(seed).coarse(), seed, few)[0] for seed in (3, 4))
    assert abs(np.corrcoef(depth, other)[0, 1]) < 0.15
    january = relief.top_m(_field(month=1), few)
    assert 0.02 < np.mean((first > BASE_M) != (january > BASE_M)) < 0.3


def test_a_map_is_found_again_on_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And not another's, nor a damaged one, nor more of them than are kept."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(earth_pattern, "KEPT", 2)
    monkeypatch.setattr(earth_pattern, "CALIBRATION_POINTS", 20_000)
    made: list[int] = []
    original = earth_pattern.coarse_map

    def counted(seed: int, month: int, cover: float | None) -> Coarse:
        made.append(seed)
        return original(seed, month, cover)

    monkeypatch.setattr(earth_pattern, "coarse_map", counted)

    def found(seed: int) -> Coarse:
        kept_coarse_map.cache_clear()
        return kept_coarse_map(seed, 6, None)

    first, again = found(3), found(3)
    assert made == [3]
    assert again.values.tobytes() == first.values.tobytes()
    assert again.rank.tobytes() == first.rank.tobytes()
    assert (again.lowest, again.highest) == (first.lowest, first.highest)
    assert not again.values.flags.writeable

    (file,) = (tmp_path / "horizonval" / "clouds").iterdir()
    file.write_bytes(file.read_bytes()[:-1000])
    assert found(3).values.tobytes() == first.values.tobytes()
    assert found(4).values.tobytes() != first.values.tobytes()
    assert made == [3, 3, 4]
    found(5)
    assert len(list(file.parent.iterdir())) == 2


def test_poles_and_the_date_line_have_no_seam() -> None:
    """Over 10 m the tops change by no more there than elsewhere."""
    rng = np.random.default_rng(np.random.SeedSequence(5))
    latitude, longitude = rng.uniform(-80.0, 80.0, 4000), rng.uniform(-179.0, 179.0, 4000)
    step = 5e-5

    def depth(latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
        return earth_pattern.depth_at(_field().coarse(), 3, _unit(latitude_deg, longitude_deg))[0]

    inland = np.abs(depth(latitude, longitude + step) - depth(latitude, longitude - step))
    line = np.abs(depth(latitude, np.full(4000, 180.0 - step)) - depth(latitude, np.full(4000, -180.0 + step)))
    assert line.max() < 3.0 * inland.max()
    assert line.mean() < 2.0 * inland.mean()
    for pole in (90.0, -90.0):
        around = depth(np.full(400, pole - np.sign(pole) * step), rng.uniform(-180.0, 180.0, 400))
        assert np.ptp(around) < 3.0 * inland.max()


def test_stirring_keeps_areas() -> None:
    """Whirls are turns, ring by ring: a patch's image has its area. 2 % of a triangle of 1 km, by differences."""
    p = earth_pattern.even_points(3000)
    side = np.cross(p, [0.3, 0.5, -0.8])
    side /= np.linalg.norm(side, axis=1)[:, None]
    other = np.cross(p, side)
    step = 1e-6
    moved = [stirred(q / np.linalg.norm(q, axis=1)[:, None], 7)[0] for q in (p, p + step * side, p + step * other)]
    area = np.linalg.norm(np.cross(moved[1] - moved[0], moved[2] - moved[0]), axis=1) / step**2
    assert np.linalg.norm(moved[0], axis=1) == pytest.approx(1.0, abs=1e-12)
    assert np.median(np.abs(area - 1.0)) < 1e-3
    assert np.quantile(np.abs(area - 1.0), 0.99) < 0.02


def test_storm_tracks_are_drawn_out_from_west_to_east(places: FloatArray) -> None:
    """Clouds 600 km apart along a parallel are more alike than along a meridian, away from cyclones or not."""
    few = places[(np.abs(np.degrees(np.arcsin(places[:, 2]))) > 40.0)][:40_000]
    few = few[np.abs(few[:, 2]) < np.sin(np.radians(60.0))]
    latitude, longitude = np.degrees(np.arcsin(few[:, 2])), np.degrees(np.arctan2(few[:, 1], few[:, 0]))
    apart = np.degrees(600.0 / 6371.0)

    def alike(north: FloatArray | float, east: FloatArray | float) -> float:
        values = []
        for seed in (3, 4, 5):
            one, two = (
                earth_pattern.depth_at(_field(seed).coarse(), seed, p)[0]
                for p in (few, _unit(latitude + north, longitude + east))
            )
            values.append(np.corrcoef(one, two)[0, 1])
        return float(np.mean(values))

    assert alike(0.0, apart / np.cos(np.radians(latitude))) > 1.3 * alike(apart, 0.0)


def test_clouds_of_a_scene_are_those_of_its_month() -> None:
    for month in (3, 7):
        platform = {"altitude_km": 500.0, "epoch_utc": f"2026-{month:02}-01"}
        field = relief.cloud_field(scene(clouds={}, platform=platform))
        assert field is not None
        assert field == CloudField(None, 17e3, field.mean_top_m, 300e3, field.seed, 0.8, "earth", month)
