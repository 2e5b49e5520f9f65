"""Statistics of a night against published examples, and steps of its history."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from horizonval.studies.regression import history
from horizonval.studies.regression.history import pieces
from horizonval.studies.regression.statistics import (
    ALPHA,
    Estimate,
    Verdict,
    decide,
    holm,
    independent_difference,
    newcombe_interval,
)


@pytest.mark.parametrize(
    ("p", "adjusted"),
    [
        # Example of pingouin's documentation.
        ([0.50, 0.003, 0.32, 0.054, 0.0003], [0.64, 0.012, 0.64, 0.162, 0.0015]),
        # Example of stdlib's padjust.
        ([0.319, 0.201, 0.4, 0.374, 0.113], [0.957, 0.804, 0.957, 0.957, 0.565]),
        ([], []),
        ([1.0, 1.0], [1.0, 1.0]),
    ],
)
def test_holm_as_published(p, adjusted):
    assert holm(p) == pytest.approx(adjusted)


def test_holm_is_the_step_down_procedure():
    rng = np.random.default_rng(3)
    for _ in range(50):
        p = rng.uniform(0, 0.1, rng.integers(1, 12))
        rejected = set()
        for k, i in enumerate(np.argsort(p)):
            if p[i] > 0.05 / (len(p) - k):
                break
            rejected.add(int(i))
        assert {i for i, value in enumerate(holm(list(p))) if value <= 0.05} == rejected
    with pytest.raises(ValueError, match="between 0 and 1"):
        holm([0.1, math.nan])


def test_newcombe_interval_as_published():
    """Newcombe, Statistics in Medicine 17, 873 (1998), table II, method 10."""
    cases = {
        (56, 70, 48, 80): (0.0524, 0.3339),
        (9, 10, 3, 10): (0.1705, 0.8090),
        (10, 10, 0, 10): (0.6075, 1.0000),
        (5, 56, 0, 29): (-0.0381, 0.1926),
    }
    for (k1, n1, k2, n2), expected in cases.items():
        assert newcombe_interval(k1, n1, k2, n2, 0.95) == pytest.approx(expected, abs=6e-5)


def test_independent_difference_is_welchs_test():
    rng = np.random.default_rng(2)
    a, b = rng.normal(1, 2, 30), rng.normal(0, 1, 20)
    found = independent_difference(list(a), list(range(30)), list(b), list(range(20)))
    test = stats.ttest_ind(a, b, equal_var=False, alternative="greater")
    assert found is not None
    assert (found.value, found.p_worse) == pytest.approx((a.mean() - b.mean(), test.pvalue))
    assert found.lower95 == pytest.approx(test.confidence_interval(0.95).low)


NILE = [
    1120, 1160, 963, 1210, 1160, 1160, 813, 1230, 1370, 1140, 995, 935, 1110, 994, 1020, 960, 1180, 799, 958, 1140,
    1100, 1210, 1150, 1250, 1260, 1220, 1030, 1100, 774, 840, 874, 694, 940, 833, 701, 916, 692, 1020, 1050, 969, 831,
    726, 456, 824, 702, 1120, 1100, 832, 764, 821, 768, 845, 864, 862, 698, 845, 744, 796, 1040, 759, 781, 865, 845,
    944, 984, 897, 822, 1010, 771, 676, 649, 846, 812, 742, 801, 1040, 860, 874, 848, 890, 744, 749, 838, 1050, 918,
    986, 797, 923, 975, 815, 1020, 906, 901, 1170, 912, 746, 919, 718, 714, 740,
]  # fmt: skip


def test_the_nile_fell_after_1898():
    """Annual flow of the Nile 1871 to 1970: the best known change point (G. W. Cobb, Biometrika 65, 243, 1978)."""
    found = pieces(NILE)
    assert [(1871 + p.start, 1871 + p.stop - 1) for p in found] == [(1871, 1898), (1899, 1970)]


def test_steps_are_the_best_of_all_partitions():
    """Two pieces by brute force; a single outlier is no step; noise has hardly any."""
    rng = np.random.default_rng(4)
    y = np.r_[rng.normal(0, 1, 22), rng.normal(3, 1, 18)]
    costs = {k: sum(np.abs(p - np.median(p)).sum() for p in (y[:k], y[k:])) for k in range(4, 37)}
    assert [p.start for p in pieces(y)] == [0, min(costs, key=lambda k: costs[k])]
    flat = np.ones(60)
    flat[30] = 50.0
    assert len(pieces(flat)) == 1
    assert len(pieces([3.25] * 60)) == 1
    false = sum(len(pieces(np.random.default_rng(s).normal(size=60))) > 1 for s in range(30))
    assert false <= 2
    assert pieces([]) == []
    assert len(pieces([1.0, 5.0])) == 1


def estimate(value, error, p_worse, p_better=0.5):
    t95, t99 = 1.66 * error, 2.37 * error
    return Estimate(value, value - t95, value + t95, value - t99, value + t99, p_worse, p_better, 100, 50)


def test_four_verdicts_and_none_merged():
    estimates = [
        estimate(0.1, 0.2, 0.3),
        estimate(2.0, 0.2, 1e-9),
        estimate(-2.0, 0.2, 1.0, 1e-9),
        estimate(0.5, 1.0, 0.3),
        None,
        # Certain, but half of what matters: passes.
        estimate(0.4, 0.01, 1e-12),
        # Certain and inside the margin, above its half: must not pass bit by bit.
        estimate(0.8, 0.01, 1e-12),
    ]
    found = [v for v, _ in decide(estimates, [1.0] * 7)]
    expected = [Verdict.PASS, Verdict.FAIL, Verdict.IMPROVED, Verdict.INCONCLUSIVE, Verdict.INCONCLUSIVE]
    assert found == [*expected, Verdict.PASS, Verdict.FAIL]


def test_holm_protects_a_night_of_many_gates():
    """p = 0.004 fails alone and not among ten; a p that survives the adjustment fails among ten."""
    weak, strong = estimate(2.0, 0.7, 0.004), estimate(2.0, 0.2, 0.0005)
    calm = [estimate(0.0, 0.2, 0.5)] * 9
    assert decide([weak], [1.0])[0][0] is Verdict.FAIL
    assert decide([weak, *calm], [1.0] * 10)[0][0] is Verdict.INCONCLUSIVE
    assert decide([strong, *calm], [1.0] * 10)[0] == (Verdict.FAIL, pytest.approx(0.005))
    assert decide([strong, *calm], [1.0] * 10, looks=3)[0][0] is Verdict.INCONCLUSIVE
    assert ALPHA == 0.01


def night(label, value, verdict="PASS"):
    level = {"value": value, "unit": "arcsec", "n": 384}
    return {
        "night": label,
        "environment": {"version": "0.1.0+abc", "commit": None},
        "verdict": verdict,
        "complete": True,
        "levels": {"fixed method: median nadir error": level},
    }


def labels(n):
    return [f"2026-{1 + i // 28:02d}-{1 + i % 28:02d}" for i in range(n)]


def test_a_night_done_again_replaces_the_first(tmp_path):
    path = tmp_path / history.FILE
    for label in ("2026-11-02", "2026-11-01", "2026-11-02"):
        history.append(path, night(label, 1.0))
    history.append(path, night("2026-11-02", 7.0))
    for line in ('{"night": "x", "verdict": "PASS", "levels": {"a": 1}}', '["x"]', '{"torn'):
        path.write_text(path.read_text() + line + "\n")
    found = history.read(path)
    assert [line["night"] for line in found] == ["2026-11-01", "2026-11-02"]
    assert history.series(found)["fixed method: median nadir error"]["values"] == [1.0, 7.0]


def test_a_step_is_found_in_its_night_and_60_nights_are_shown(tmp_path):
    path = tmp_path / history.FILE
    noise = np.random.default_rng(5).normal(0, 2.0, 70)
    names = labels(70)
    for i, label in enumerate(names):
        history.append(path, night(label, 400 + noise[i] + (15.0 if i >= 50 else 0.0)))
    found = history.read(path)
    assert [line["night"] for line in found] == names[10:]
    (step,) = history.steps_of(found)
    assert step["night"] == names[50]
    assert abs(step["after"] - step["before"] - 15.0) < 2.0
    assert history.steps_of(found[:35]) == []
