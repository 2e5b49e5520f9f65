"""From the bench's runs to rows, tables and figures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from horizonval.systems.b.rig import bench, experiment, figures, film, runs
from horizonval.systems.b.rig.runs import (
    IMPERFECTIONS,
    BenchRun,
    RigResults,
    own_deviation_deg,
    percentile_of,
    plausible_benches,
)

TILTS = np.array([-20.0, 0.0, 20.0])


def run(error_deg):
    """Sixteen benches that err by this much, half of them to the left."""
    side = np.where(np.arange(16) % 2, 1.0, -1.0)[:, None]
    reference = np.broadcast_to(TILTS, (16, 3))
    return BenchRun(TILTS, reference + side * error_deg, reference)


def results(sizes):
    alone = dict(zip(IMPERFECTIONS, (run(math.hypot(0.05, size)) for size in sizes), strict=True))
    order = tuple(sorted(IMPERFECTIONS, key=lambda name: -alone[name].rms_deg))
    whole = run(math.sqrt(0.05**2 + sum(size**2 for size in sizes)))
    after = {name: run(0.05) for name in order}
    return RigResults(whole, run(0.05), alone, order, after, run(0.05), run(0.05))


SIZES = [0.3, 0.2, 0.0, 0.1, 0.2, 0.25, 0.35, 0.3, 0.3, 0.0, 0.0, 0.0, 0.0]


def test_a_run_counts_lost_frames_and_leaves_those_without_an_answer_out_of_its_rms():
    whole = run(0.3)
    estimated = whole.estimated_deg.copy()
    estimated[0, 0], estimated[1, 2] = math.nan, 177.0
    broken = BenchRun(TILTS, estimated, whole.reference_deg)
    assert broken.lost == pytest.approx(2 / 48, abs=1e-12)
    assert broken.answered == pytest.approx(47 / 48, abs=1e-12)
    estimated[1, 2] = 20.3
    assert BenchRun(TILTS, estimated, whole.reference_deg).rms_deg == pytest.approx(0.3, abs=1e-9)


def test_independent_imperfections_add_up_and_their_shares_make_the_whole():
    made = results(SIZES)
    assert made.root_sum_square_deg() == pytest.approx(made.whole.rms_deg, abs=1e-9)
    family = made.families()
    assert sum(family.values()) == pytest.approx(1.0, abs=1e-12)
    total = sum(size**2 for size in SIZES)
    # the accelerometer's are the two of 0.3 deg beside each other
    assert family["accelerometer"] == pytest.approx(2 * 0.3**2 / total, abs=1e-9)
    assert family["light"] == pytest.approx(0.0, abs=1e-9)


def test_rows_have_names_of_their_own_and_bars_that_can_be_missed():
    made = results(SIZES)
    kept = {row.name: row.holds for row in rows_of(made)}
    rough = replace(made, after={name: run(0.2) for name in made.order}, whole=run(1.0))
    assert len(kept) == len(rows_of(made)) == 10 + len(IMPERFECTIONS)
    assert [v for v in kept.values() if v is not None] == [True] * 2
    assert [row.holds for row in rows_of(rough) if row.holds is not None] == [False] * 2


def rows_of(made):
    return experiment.rig_rows(made, np.random.default_rng(0))


def test_the_range_over_plausible_benches_follows_the_sizes():
    """One effect of 0.4 deg, the same at all tilts: half to twice of it as root mean square, none of it as scatter."""
    sign = bench.signs()[:, 0]
    reference = np.broadcast_to(TILTS, (16, 3))
    benches = plausible_benches(
        BenchRun(TILTS, reference + 0.4 * sign[:, None], reference), 0.0, np.random.default_rng(1)
    )
    low, high = np.percentile(benches.rms_deg, [0.0, 100.0])
    assert (low, high) == pytest.approx((0.2, 0.8), rel=1e-3)
    assert np.abs(benches.deviation_deg).max() < 1e-9
    assert percentile_of(benches.rms_deg, 0.4) == pytest.approx(50.0, abs=2.0)
    assert own_deviation_deg(run(0.3)) == pytest.approx(0.0, abs=1e-9)


def test_the_film_rests_at_five_tilts_and_a_mean_of_samples_is_late_in_motion():
    assert film.length_s() == pytest.approx(5 * 5.0 + 40.0)
    assert film.tilt_at(np.array([-1.0, 4.9, 10.0, 15.1, film.length_s()])) == pytest.approx([-20, -20, -15, -10, 20])
    rng = np.random.default_rng(2)
    resting = np.mean([film.reading_deg(3.0, 0.0, 0.0, rng) for _ in range(50)])
    moving = np.mean([film.reading_deg(10.0, 0.0, 0.0, rng) for _ in range(50)])
    assert resting == pytest.approx(-20.0, abs=0.02)
    # 63 of 100 samples are half a sample less than the module's closed form
    assert moving == pytest.approx(-15.0 - 0.315, abs=0.02)


def test_imperfections_are_counted_until_the_rms_stays_below_a_limit():
    made = results(SIZES)
    assert made.switched_off_below(0.1) == 1
    late = replace(made, after={name: run(0.2 if k == 4 else 0.05) for k, name in enumerate(made.order)})
    assert late.switched_off_below(0.1) == 6
    assert replace(made, after={name: run(0.2) for name in made.order}).switched_off_below(0.1) == len(made.order) + 1


def test_tables_name_every_imperfection_and_every_error_once():
    made = results(SIZES)
    ablation, sensitivity = runs.ablation_table(made), runs.sensitivity_table(made.whole)
    assert sorted(row[0] for row in ablation.rows[1:]) == sorted(IMPERFECTIONS)
    assert all(len(row) == len(table.columns) for table in (ablation, sensitivity) for row in table.rows)
    assert {runs.PIXELS, runs.BACKLIGHT} < {row[0] for row in ablation.rows}


def test_the_figures_can_be_drawn():
    made = results(SIZES)
    assert len(figures.errors(made.whole, made.perfect).axes[0].lines) == 17
    assert len(figures.ablation(made, 0.752, 0.038).axes) == 2
