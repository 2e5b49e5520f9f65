"""Statistics of a night against published examples, and steps of its history."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import optimize, stats

from horizonval.studies.regression import history
from horizonval.studies.regression.history import pieces
from horizonval.studies.regression.statistics import (
    ALPHA,
    Estimate,
    Verdict,
    decide,
    exact,
    holm,
    independent_difference,
    newcombe_interval,
    night_verdict,
    paired_difference,
    paired_loss,
    score_interval,
    sign_change_p,
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


@pytest.mark.parametrize(
    ("lost", "gained", "n", "confidence", "low", "high", "digits"),
    [
        # Airway reactivity before and after stem cell transplantation (Bentur 2009), in Fagerland, Lydersen and Laake,
        # Statistics in Medicine 33, 2850 (2014), table VI: asymptotic score.
        (1, 7, 21, 0.95, -0.517, -0.026, 3),
        # PropCIs::scoreci.mp in R, 48 and 41 of 549, 90 %.
        (48, 41, 549, 0.90, -0.0157, 0.0414, 4),
    ],
)
def test_score_interval_as_published(lost, gained, n, confidence, low, high, digits):
    assert score_interval(lost, gained, n, confidence) == pytest.approx((low, high), abs=0.5 * 10**-digits)


@pytest.mark.parametrize(("lost", "gained", "n"), [(12, 2, 50), (3, 0, 400), (0, 0, 480), (9, 11, 90), (40, 0, 40)])
def test_score_interval_by_its_definition(lost, gained, n):
    """At its ends the score statistic, with the variance maximised over the likelihood numerically, is z."""
    z = float(stats.norm.ppf(0.975))

    def statistic(delta):
        def minus_log_likelihood(q):
            cells = ((lost, q + delta), (gained, q), (n - lost - gained, 1 - 2 * q - delta))
            return -sum(count * math.log(max(p, 1e-300)) for count, p in cells if count)

        lowest, highest = max(0.0, -delta), (1 - delta) / 2
        q = optimize.minimize_scalar(
            minus_log_likelihood, bounds=(lowest, highest), method="bounded", options={"xatol": 1e-13}
        ).x
        return (lost - gained - n * delta) / math.sqrt(n * (2 * q + delta - delta**2))

    low, high = score_interval(lost, gained, n, 0.95)
    if low > -1 + 1e-9:
        assert statistic(low) == pytest.approx(z, rel=2e-4)
    if high < 1 - 1e-9:
        assert statistic(high) == pytest.approx(-z, rel=2e-4)


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


def test_sign_changes_of_single_frames_are_mcnemars_exact_test():
    # Two media for tubercle bacilli (Armitage and Berry 1994, p. 127): 12 and 2; two-sided P = 0.0129.
    assert 2 * sign_change_p([1] * 12 + [-1] * 2) == pytest.approx(0.0129, abs=5e-5)
    for lost, gained in ((0, 0), (1, 0), (5, 5), (10, 3), (2, 9)):
        expected = stats.binomtest(lost, lost + gained, alternative="greater").pvalue if lost + gained else 1.0
        assert sign_change_p([1] * lost + [-1] * gained) == pytest.approx(expected)


def test_sign_changes_of_clumps_count_scenes_not_frames():
    """Six frames lost in one scene are one piece of evidence; by brute force over all signs."""
    assert sign_change_p([6]) == 0.5
    net = [3, -1, 2, 2, 1]
    signs = np.array(np.meshgrid(*[[-1, 1]] * len(net))).reshape(len(net), -1)
    expected = np.mean(signs.T @ np.abs(net) >= sum(net))
    assert sign_change_p(net) == pytest.approx(expected)
    scattered = paired_loss([True] * 60, [i >= 6 for i in range(60)], list(range(60)))
    clumped = paired_loss([True] * 60, [i >= 6 for i in range(60)], [i // 6 for i in range(60)])
    assert scattered is not None
    assert clumped is not None
    assert scattered.value == clumped.value == pytest.approx(0.1)
    assert scattered.p_worse == pytest.approx(2.0**-6)
    assert clumped.p_worse == 0.5
    assert clumped.lower95 < scattered.lower95 < 0.1 < scattered.upper95 < clumped.upper95


def test_paired_difference_is_students_test_over_scenes():
    rng = np.random.default_rng(1)
    scenes = np.repeat(np.arange(12), 4)
    values = rng.normal(0.3, 1.0, 12)[scenes] + rng.normal(0, 0.2, 48)
    found = paired_difference(list(values), list(scenes))
    means = values.reshape(12, 4).mean(axis=1)
    test = stats.ttest_1samp(means, 0.0, alternative="greater")
    assert found is not None
    assert (found.value, found.p_worse) == pytest.approx((means.mean(), test.pvalue))
    assert found.lower95 == pytest.approx(test.confidence_interval(0.95).low)
    assert found.lower99 == pytest.approx(test.confidence_interval(0.99).low)
    assert (found.n, found.clusters) == (48, 12)
    assert paired_difference([1.0, 2.0], [0, 1]) is None
    same = paired_difference([0.5] * 6, list(range(6)))
    assert same == exact(0.5, 6, 6)


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
    found = [v for v, _ in decide(estimates, [1.0] * 7, [False] * 7)]
    expected = [Verdict.PASS, Verdict.FAIL, Verdict.IMPROVED, Verdict.INCONCLUSIVE, Verdict.INCONCLUSIVE]
    assert found == [*expected, Verdict.PASS, Verdict.FAIL]
    assert [v for v, _ in decide([estimates[2]], [1.0], [True])] == [Verdict.FAIL]
    assert [v for v, _ in decide([estimate(0.0, 0.9, 0.5)], [1.0], [True])] == [Verdict.INCONCLUSIVE]


def test_holm_protects_a_night_of_many_gates():
    """p = 0.004 fails alone and not among ten; a p that survives the adjustment fails among ten."""
    weak, strong = estimate(2.0, 0.7, 0.004), estimate(2.0, 0.2, 0.0005)
    calm = [estimate(0.0, 0.2, 0.5)] * 9
    assert decide([weak], [1.0], [False])[0][0] is Verdict.FAIL
    assert decide([weak, *calm], [1.0] * 10, [False] * 10)[0][0] is Verdict.INCONCLUSIVE
    assert decide([strong, *calm], [1.0] * 10, [False] * 10)[0] == (Verdict.FAIL, pytest.approx(0.005))
    assert decide([strong, *calm], [1.0] * 10, [False] * 10, looks=3)[0][0] is Verdict.INCONCLUSIVE
    assert ALPHA == 0.01


def test_the_night_is_its_worst_gate():
    v = Verdict
    assert night_verdict([v.PASS, v.IMPROVED, v.INCONCLUSIVE, v.FAIL]) is v.FAIL
    assert night_verdict([v.PASS, v.IMPROVED, v.INCONCLUSIVE]) is v.INCONCLUSIVE
    assert night_verdict([v.PASS, v.IMPROVED]) is v.IMPROVED
    assert night_verdict([v.PASS]) is v.PASS
    assert night_verdict([]) is v.INCONCLUSIVE


def night(label, value, verdict="PASS"):
    level = {"value": value, "unit": "arcsec", "n": 384}
    return {
        "night": label,
        "environment": {"version": "0.1.0+abc", "commit": None},
        "verdict": verdict,
        "complete": True,
        "gates": [],
        "levels": {"fixed method: median nadir error": level},
    }


def labels(n):
    return [f"2026-{1 + i // 28:02d}-{1 + i % 28:02d}" for i in range(n)]


def test_a_night_done_again_replaces_the_first(tmp_path):
    path = tmp_path / history.FILE
    for label in ("2026-11-02", "2026-11-01", "2026-11-02"):
        history.append(path, night(label, 1.0))
    history.append(path, night("2026-11-02", 7.0))
    path.write_text(path.read_text() + '{"torn')
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
