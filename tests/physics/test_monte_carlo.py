"""The reference Monte Carlo itself, against quadrature, other codes' tables and its own invariances."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import monte_carlo
import numpy as np
import pytest
from brute_force import single_scatter
from make_tables import aerosol_atmosphere as atmosphere
from reference_rays import limb_ray, vector

DATA = Path(__file__).parents[1] / "data"
RNG = np.random.default_rng(5)
pytestmark = pytest.mark.slow


def rows_of(name: str) -> list[dict[str, str]]:
    with (DATA / name).open() as file:
        return list(csv.DictReader(file))


def answer(air: monte_carlo.Air, row: dict[str, Any], paths: int, plan: Any = None) -> monte_carlo.Answer:
    seed = monte_carlo.seed_of("test", vector(row, "obs"), vector(row, "dir"), vector(row, "sun"))
    return monte_carlo.radiance(air, vector(row, "obs"), vector(row, "dir"), vector(row, "sun"), paths, seed, plan)


@pytest.fixture(scope="module")
def rayleigh() -> monte_carlo.Air:
    return monte_carlo.read_air(DATA / "atm_rayleigh.json", "550nm")


@pytest.fixture(scope="module")
def haze() -> monte_carlo.Air:
    data = atmosphere("haze")
    return monte_carlo.air_of(data, data["bands"][0])


def test_first_order_equals_another_code_by_day(rayleigh: monte_carlo.Air) -> None:
    """0.05 %; the table is good to 0.02 %."""
    for row in rows_of("rayleigh_limb_sasktran2.csv")[::7]:
        if float(row["sza_deg"]) < 80:
            exact = answer(rayleigh, row, 64).single_exact
            assert exact == pytest.approx(float(row["ss_550nm"]), rel=5e-4)


def test_first_order_equals_brute_force_in_dark_rays(rayleigh: monte_carlo.Air) -> None:
    """0.05 % at the terminator, sunward, where tables of others have steps."""
    for height in (0.25, 4.0, -1.0, -100.0):
        row = limb_ray(90.0, 0.0, height)
        expected = single_scatter(
            rayleigh.z * 1e3,
            rayleigh.extinction * 1e-3,
            6371e3,
            0.3,
            vector(row, "obs") * 1e3,
            vector(row, "dir"),
            vector(row, "sun"),
        )
        assert answer(rayleigh, row, 64).single_exact == pytest.approx(expected, rel=5e-4)


def test_first_order_drawn_equals_first_order_integrated(rayleigh: monte_carlo.Air, haze: monte_carlo.Air) -> None:
    """The drawn single scattering has the quadrature as its mean: normal z values over 24 rays."""
    z = []
    for air in (rayleigh, haze):
        for sza, azimuth, height in [(s, a, h) for s in (60, 90) for a in (0, 180) for h in (10, 30, -10)]:
            one = answer(air, limb_ray(sza, azimuth, height), 6400)
            if one.single_exact > 1e-6:
                z.append((one.single - one.single_exact) / one.single_se)
    assert len(z) >= 20
    assert np.abs(z).max() < 4.0
    assert np.sqrt(np.mean(np.square(z))) < 1.6


def test_totals_equal_an_earlier_monte_carlo(rayleigh: monte_carlo.Air) -> None:
    """60 rays at Sun zenith 20, 60 and 90: 4 joint standard errors each, and no common bias above 0.3 %.

    The earlier table's rays share one seed, so its errors are not independent of each other.
    """
    deviations = []
    for row in rows_of("rayleigh_limb_montecarlo_550nm.csv"):
        ours = answer(rayleigh, row, 12800)
        expected, se = float(row["mc_total_per_sr"]), float(row["mc_total_se"])
        assert abs(ours.total - expected) < 4.0 * np.hypot(se, ours.multiple_se) + 1e-3 * expected
        deviations.append(ours.total / expected - 1.0)
    assert abs(np.median(deviations)) < 3e-3


def test_totals_by_day_equal_successive_orders(rayleigh: monte_carlo.Air) -> None:
    """1 % and 3 standard errors up to 70 km tangent height, Sun zenith 20 and 60."""
    rows = [r for r in rows_of("rayleigh_limb_sasktran2.csv") if float(r["sza_deg"]) < 80]
    for row in [r for r in rows if float(r["tangent_km"]) in (2.0, 10.0, 30.0, 50.0, -1.0, -100.0)]:
        ours = answer(rayleigh, row, 12800)
        expected = float(row["ms_so_550nm"])
        assert abs(ours.total - expected) < 1e-2 * expected + 3.0 * ours.multiple_se


@pytest.mark.parametrize(
    ("sza", "azimuth", "height", "expected", "se_percent"),
    [
        (92, 0, 1, 5.964e-4, 0.32),
        (92, 90, 1, 7.516e-3, 0.08),
        (95, 0, -100, 4.658e-5, 0.81),
        (95, 0, -10, 4.376e-5, 0.39),
        (95, 0, 1, 7.740e-5, 0.13),
        (95, 90, -100, 1.471e-4, 0.12),
        (95, 90, 10, 3.463e-4, 0.27),
        (100, 0, 20, 1.680e-4, 0.05),
        (100, 90, 20, 1.674e-6, 0.94),
        (104, 0, 10, 2.381e-6, 0.23),
        (108, 180, 10, 1.265e-7, 0.76),
    ],
)
def test_twilight_equals_an_earlier_monte_carlo(
    rayleigh: monte_carlo.Air, sza: float, azimuth: float, height: float, expected: float, se_percent: float
) -> None:
    """4 joint standard errors, six orders of magnitude of darkness."""
    ours = answer(rayleigh, limb_ray(sza, azimuth, height), 64_000)
    assert abs(ours.total - expected) < 4.0 * np.hypot(ours.multiple_se, expected * se_percent / 100)
    assert ours.multiple_se < 0.15 * ours.total


@pytest.mark.parametrize("ray", [(60, 0, 10), (60, 180, -10), (85, 0, 20), (90, 90, 10)])
def test_the_answer_does_not_depend_on_how_paths_are_drawn(haze: monte_carlo.Air, ray: tuple[float, ...]) -> None:
    plain, guided = (
        answer(haze, limb_ray(*ray), 64_000, plan)
        for plan in (monte_carlo.Plan(), monte_carlo.Plan(0.6, 0.5, weight_roulette=False))
    )
    assert abs(plain.total - guided.total) < 4.0 * np.hypot(plain.multiple_se, guided.multiple_se)


def test_ellipsoid_with_equal_axes_is_the_sphere(rayleigh: monte_carlo.Air) -> None:
    """0.1 mm of flattening: the other way of walking gives the same single scatter to 2e-5, and the same total."""
    oblate = monte_carlo.read_air(DATA / "atm_rayleigh.json", "550nm", axes_km=(6371.0, 6371.0 - 1e-7))
    for ray in ((60, 0, 10), (85, 90, 2), (60, 180, -10)):
        a, b = (answer(air, limb_ray(*ray), 6400, monte_carlo.Plan()) for air in (rayleigh, oblate))
        assert a.single_exact == pytest.approx(b.single_exact, rel=2e-5)
        assert abs(a.total - b.total) < 4.0 * np.hypot(a.multiple_se, b.multiple_se)


def test_heights_and_verticals_of_the_ellipsoid() -> None:
    air = monte_carlo.read_air(DATA / "atm_rayleigh.json", "550nm", axes_km=(6378.137, 6356.752314245))
    rng = np.random.default_rng(1)
    e2 = 1.0 - (air.b / air.a) ** 2
    for latitude, longitude, h in rng.uniform([-1.57, -3.1, -5.0], [1.57, 3.1, 600.0], (200, 3)):
        up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
        n = air.a / np.sqrt(1.0 - e2 * up[2] ** 2)
        point = np.array([(n + h) * up[0], (n + h) * up[1], (n * (1.0 - e2) + h) * up[2]])
        assert monte_carlo._height(air, *point) == pytest.approx(h, abs=1e-8)
        np.testing.assert_allclose(monte_carlo._up(air, point), up, atol=1e-8)


def test_white_ground_under_white_air_loses_no_light() -> None:
    """Under a uniform sky every ray brings the sky's radiance: the mean of 4 pi L over all places of the Sun is 1."""
    data = atmosphere("haze")
    band = data["bands"][0] | {"absorption_per_m": [0.0] * len(data["altitude_km"])}
    air = monte_carlo.air_of(data | {"surface": data["surface"] | {"albedo": 1.0}}, band)
    n = 300
    z = (2.0 * np.arange(n) + 1.0) / n - 1.0
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(n)
    suns = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
    row = limb_ray(0.0, 0.0, -100.0)
    total = 0.0
    for i, sun in enumerate(suns):
        seed = monte_carlo.seed_of("white", i)
        one = monte_carlo.radiance(air, vector(row, "obs"), vector(row, "dir"), sun, 640, seed, monte_carlo.Plan())
        total += 4.0 * np.pi * one.total / n
    assert total == pytest.approx(1.0, abs=1e-2)


def test_equal_squares_are_a_uniform_ground(rayleigh: monte_carlo.Air) -> None:
    """The same paths meet the same albedo: the same number."""
    row = limb_ray(60, 0, -100)
    squares = rayleigh._replace(ground=monte_carlo.chequered(300.0, 0.3, 0.3))
    assert answer(squares, row, 640).total == answer(rayleigh, row, 640).total


def test_squares_lie_where_they_should() -> None:
    ground = monte_carlo.chequered(500.0, 1.0, 0.0)
    sides = np.pi * 6371.0 / len(ground.columns)
    assert sides == pytest.approx(500.0, rel=0.02)
    assert 2 * np.pi * 6371.0 / ground.columns[len(ground.columns) // 2] == pytest.approx(500.0, rel=0.02)
    assert ground.albedo.mean() == 0.5
    one = monte_carlo.sampled(lambda latitude, longitude: (latitude > 0.0) * 1.0, 500.0)
    air = monte_carlo.read_air(DATA / "atm_rayleigh.json", "550nm")._replace(ground=one)
    for z in (-0.9, -0.1, 0.1, 0.9):
        up = np.array([np.sqrt(1.0 - z * z), 0.0, z])
        assert monte_carlo._albedo(air, up) == float(z > 0.0)


def test_along_the_border_of_two_halves_is_their_mean(rayleigh: monte_carlo.Air) -> None:
    """A limb ray along the border under an overhead Sun, but for light that meets the ground twice (0.1 % here)."""
    row = limb_ray(0, 0, 10)
    grounds = (monte_carlo.halves(0.6, 0.0), monte_carlo.uniform(0.0), monte_carlo.uniform(0.6))
    border, dark, bright = (answer(rayleigh._replace(ground=g), row, 25_600) for g in grounds)
    expected, se = 0.5 * (dark.multiple + bright.multiple), np.hypot(border.multiple_se, bright.multiple_se)
    assert bright.multiple > 1.5 * dark.multiple
    assert abs(border.multiple - expected) < 4.0 * se + 1e-3 * border.total


def test_two_species_are_their_sum(haze: monte_carlo.Air) -> None:
    row = limb_ray(60, 0, 10)
    parts = [(share * haze.particles[0], haze.g[0]) for share in (0.3, 0.7)]
    absorption = haze.extinction - haze.molecules - haze.particles[0]
    split = monte_carlo.make_air(haze.z, haze.molecules, absorption, parts, cos2=haze.cos2, ground=haze.ground)
    one, two = answer(haze, row, 25_600), answer(split, row, 25_600)
    assert two.single_exact == pytest.approx(one.single_exact, rel=1e-12)
    assert abs(two.multiple - one.multiple) < 4.0 * np.hypot(one.multiple_se, two.multiple_se)


def test_depolarised_light_is_drawn_as_its_phase_function() -> None:
    """The second moment of the cosine: 1/3 + 4 c / 45, over 2e5 draws to 3 standard errors."""
    for cos2 in (0.0, 0.7, 0.75):
        drawn = [monte_carlo._molecular_cosine(cos2, RNG) ** 2 for _ in range(200_000)]
        assert np.mean(drawn) == pytest.approx(1.0 / 3.0 + 4.0 * cos2 / 45.0, abs=3.0 * 0.31 / np.sqrt(200_000))


def test_haze_in_twilight_is_the_same_by_two_seeds(haze: monte_carlo.Air) -> None:
    """Sun 7 deg below the horizon: 4 joint standard errors."""
    row = limb_ray(97, 90, 10)
    vectors = (vector(row, "obs"), vector(row, "dir"), vector(row, "sun"))
    a, b = (monte_carlo.radiance(haze, *vectors, 64_000, monte_carlo.seed_of("haze", n)) for n in (1, 2))
    assert abs(a.total - b.total) < 4.0 * np.hypot(a.multiple_se, b.multiple_se)
    assert a.multiple_se < 0.15 * a.total
