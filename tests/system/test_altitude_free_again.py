"""The altitude-free sensor's experiment, reduced: figures come from rendered frames and move with the seed."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from horizonval.core.json_types import JsonObject
from horizonval.systems.a import experiment as experiment
from horizonval.systems.a import rows as report
from horizonval.systems.a.bank import check, compare, conditions, grid, limb_length_px, measure, set_ups
from horizonval.systems.a.rows import bank_of, error_table, solver_table, steps_with_pixels
from horizonval.systems.task_cache import TaskCache

SMALL = (100, 200)


def _bank(cache: TaskCache) -> tuple[dict[str, JsonObject], dict[str, JsonObject]]:
    """3000 km, fields of 40 and 80 deg, two attitudes, at 100 and 200 pixels."""
    items = {
        name: item
        for name, item in grid(cache.seed, SMALL, (-30.0, 30.0)).items()
        if item["roll_deg"] > 0.0 and item["altitude_km"] == 3000.0 and item["fov_deg"] != 60.0
    }
    return items, cache.each("small bank", measure, items)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> TaskCache:
    return TaskCache(folder=tmp_path_factory.mktemp("altitude-free"), seed=1, workers=1)


def test_frames_of_the_grid_are_answered_and_better_with_more_pixels(cache: TaskCache) -> None:
    items, results = _bank(cache)
    assert len(items) == 2 * 4
    bank = bank_of(items, results)
    for name, result in results.items():
        whole, limb = result["clean"]["whole, newton"], result["clean"]["limb, newton"]
        pixel_arcsec = 3600.0 * items[name]["fov_deg"] / items[name]["pixels"]
        # a whole-pixel point is off by a third of a pixel, the mean of Canny's choices and of the ground's shading
        assert 0.1 * pixel_arcsec < whole["point_rms_arcsec"] < 0.8 * pixel_arcsec
        assert limb["point_rms_arcsec"] < 0.2 * whole["point_rms_arcsec"]
        assert max(result["clean"]["three-point start"]["updates"][3:], default=0.0) < 1e-6
    assert sum(steps_with_pixels(bank, "whole, newton")) > 1.0
    table = error_table(bank, "whole, newton")
    assert [row[:4] for row in table.rows] == [(3000.0, fov, pixels, 2) for fov in (40.0, 80.0) for pixels in SMALL]


def test_the_seed_moves_attitudes_noise_and_draws(cache: TaskCache) -> None:
    one, two = (next(iter(grid(seed, SMALL, (10.0,)).values())) for seed in (1, 2))
    assert one["roll_deg"] != two["roll_deg"]
    assert min(one["roll_deg"], two["roll_deg"]) >= 9.0
    assert max(one["roll_deg"], two["roll_deg"]) <= 10.0
    name = "6000 km, 80 deg, 50 px"
    frames = [measure(set_ups(seed)[name]) for seed in (1, 1, 2)]
    noisy = [frame["noisy"]["whole, newton"]["nadir_arcsec"] for frame in frames]
    assert noisy[0] == noisy[1] != noisy[2]
    assert frames[0]["clean"] == frames[2]["clean"]
    name = "rho 42.8 deg, arc 40 deg, noise 0.3 px"
    assert compare(conditions(1)[name])["newton_rms"] != compare(conditions(2)[name])["newton_rms"]


def test_conditions_have_a_fifth_of_the_width_of_horizon_in_view() -> None:
    """From 400 km the horizon stands 70.2 deg off nadir: no attitude brings it into a field of 40 deg."""
    items = grid(0, (50,))
    assert all(limb_length_px(item) >= 0.19 * 50 for item in items.values())
    assert not [i for i in items.values() if (i["altitude_km"], i["fov_deg"]) == (400.0, 40.0)]
    full = {"altitude_km": 6000.0, "fov_deg": 80.0, "pixels": 400, "roll_deg": 0.0, "pitch_deg": 0.0}
    # a circle of tan(31.0 deg) focal lengths
    assert limb_length_px(full) == pytest.approx(2 * 3.14159265 * 0.60069 * 200 / 0.8390996, rel=2e-3)


def test_the_image_generator_agrees_with_the_curve_and_with_a_stock_sphere() -> None:
    result = check(set_ups(0)["6000 km, 80 deg, 50 px"])
    assert result["edges"] > 40
    assert result["curve_max_px"] < 1e-4
    # 256 samples a pixel, a dozen edge pixels at most in a column
    assert result["stock_rms_px"] < 0.02
    assert abs(result["stock_mean_px"]) < 0.005


@pytest.mark.slow
def test_rows_tables_and_figures_come_of_a_small_run(cache: TaskCache, tmp_path: Path) -> None:
    items, results = _bank(cache)
    bank = bank_of(items, results)
    shown = cache.each("set-ups", measure, {"6000 km, 80 deg, 50 px": set_ups(1)["6000 km, 80 deg, 50 px"]})
    solvers = cache.each("solvers", compare, dict(list(conditions(1).items())[:4]))
    rows = [
        *report.set_up_rows(shown),
        *report.convergence_rows(shown, bank),
        *report.trend_rows(bank),
        *report.closed_form_rows(bank, solvers),
    ]
    assert len({row.name for row in rows}) == len(rows)
    assert len(solver_table(solvers).rows) == 4
    for draw in (
        partial(experiment.figures.draw_set_ups, shown),
        partial(experiment.figures.draw_convergence, next(iter(shown.values()))),
        partial(experiment.figures.draw_errors, bank),
    ):
        path = tmp_path / "figure.png"
        draw().savefig(path)
        assert path.stat().st_size > 10_000
