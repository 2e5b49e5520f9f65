"""What a study concludes: measures, shares, effects, expressions and choices."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from horizonval.core.errors import UserError
from horizonval.scoring.expected import exclusion_angle_deg
from horizonval.scoring.requirements import effective_size, proportion, verdict_of
from horizonval.spec.requirement import Requirement
from horizonval.studies.trade.conclude import cheapest
from horizonval.studies.trade.cost import is_tie, price_of, read_expression
from horizonval.studies.trade.effects import compare, effects_of, front
from horizonval.studies.trade.sample import (
    bias_and_noise,
    cluster_draws,
    exclusion_angle,
    measures_of,
    quantile,
    rms,
)

RANDOM = np.random.default_rng(2)
N = 40
VALUES, OTHERS = RANDOM.gamma(2.0, size=N), RANDOM.normal(size=N)
WEIGHTS = np.vstack([np.ones(N), RANDOM.integers(0, 4, size=(6, N))]).astype(float)


@pytest.mark.parametrize("line", range(len(WEIGHTS)))
def test_weights_are_copies(line):
    copies = WEIGHTS[line].astype(int)
    x, y = np.repeat(VALUES, copies), np.repeat(OTHERS, copies)
    assert rms(VALUES, WEIGHTS)[line] == pytest.approx(math.sqrt(np.mean(x**2)), rel=1e-12)
    for q in (0.0, 0.5, 0.95, 0.997, 1.0):
        assert quantile(VALUES, WEIGHTS, q)[line] == pytest.approx(np.quantile(x, q), rel=1e-12)
    bias, noise = bias_and_noise(VALUES, OTHERS, WEIGHTS)
    assert bias[line] == pytest.approx(math.hypot(x.mean(), y.mean()), rel=1e-9)
    assert noise[line] == pytest.approx(math.sqrt(x.var(ddof=1) + y.var(ddof=1)), rel=1e-9)


@pytest.mark.parametrize("line", range(len(WEIGHTS)))
def test_the_exclusion_angle_is_that_of_scoring(line):
    angle, right = RANDOM.uniform(0, 90, N), RANDOM.random(N) < 0.7
    there = WEIGHTS[line] > 0
    expected = exclusion_angle_deg(angle[there].tolist(), right[there].tolist())
    found = exclusion_angle(angle, right, WEIGHTS)[line]
    assert found == expected or (expected is None and math.isnan(found))


def test_bias_and_noise_make_the_rms(make_sample):
    sample = make_sample(VALUES / 100)
    found = measures_of(sample, cluster_draws(N, "s", 0), 0.05)
    n = N
    whole = found["bias_deg"]["value"] ** 2 + found["noise_deg"]["value"] ** 2 * (n - 1) / n
    assert found["rms_deg"]["value"] ** 2 == pytest.approx(whole, rel=1e-9)


def test_refusals_have_no_error_but_count_as_misses(make_sample):
    found = measures_of(make_sample([0.01, 0.02, np.nan, 0.9, 0.03, 0.04]), cluster_draws(6, "s", 0), 0.05)
    assert (found["n"], found["claims"], found["rms_deg"]["n"]) == (6, 5, 5)
    assert (found["availability"]["n"], found["within"]["n"], found["within"]["of"]) == (5, 4, 6)
    assert (found["false_valid"]["n"], found["false_valid"]["of"]) == (1, 5)


def test_the_interval_of_the_mean_square_holds_the_truth():
    # The bootstrap of 40 frames against the known root mean square of what they are drawn from.
    random = np.random.default_rng(11)
    draws = cluster_draws(40, "s", 0, draws=400)
    hits = 0
    for _ in range(200):
        low, high = np.percentile(rms(random.normal(size=40), draws)[1:], [2.5, 97.5])
        hits += low <= 1.0 <= high
    # Percentiles of a bootstrap of 40 hold some 92 % in place of 95 %; 170 is four standard deviations below.
    assert hits >= 170


def test_three_sigma_is_open_at_the_top_until_there_are_enough(make_sample):
    few, enough = (
        measures_of(make_sample(np.linspace(0.001, 0.4, n)), cluster_draws(n, "s", 0, draws=20), 0.05)
        for n in (1227, 1228)
    )
    assert few["three_sigma_deg"]["interval"][1] is None
    assert enough["three_sigma_deg"]["interval"][1] == pytest.approx(0.4)
    assert few["three_sigma_deg"]["value"] == pytest.approx(0.001 + 0.399 * 0.997)


def test_too_few_frames_have_no_interval(make_sample):
    found = measures_of(make_sample([0.01, 0.02, 0.03, 0.04]), cluster_draws(4, "s", 0), 0.05)
    assert found["rms_deg"]["interval"] is None
    assert found["within"]["interval"][0] == pytest.approx(0.025 ** (1 / 4))


def test_draws_follow_from_name_and_seed():
    a, b, c = cluster_draws(7, "s", 0), cluster_draws(7, "s", 0), cluster_draws(7, "s", 1)
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)
    assert np.all(a.sum(axis=1) == 7)
    assert np.all(a[0] == 1)


@pytest.mark.parametrize(("k", "n"), [(0, 12), (12, 12), (5, 12), (199, 200)])
def test_independent_frames_have_the_exact_interval(k, n):
    found = proportion(np.arange(n) < k, np.arange(n))
    exact = stats.binomtest(k, n).proportion_ci(0.95, "exact")
    assert found["interval"] == pytest.approx([exact.low, exact.high], abs=1e-12)
    lower = stats.binomtest(k, n, alternative="greater").proportion_ci(0.95, "exact").low
    upper = stats.binomtest(k, n, alternative="less").proportion_ci(0.95, "exact").high
    assert (found["lower"], found["upper"]) == pytest.approx((lower, upper), abs=1e-12)
    assert (found["n"], found["of"], found["rate"]) == (k, n, k / n)


def test_whole_flights_count_once():
    # Two flights answered all, two nothing: by hand, variance = 4/3 * 4 * 2.5^2 / 20^2 = 1/12, worth (1/4)/(1/12) = 3.
    flags = np.repeat([True, True, False, False], 5)
    cluster = np.repeat(np.arange(4), 5)
    assert effective_size(flags, cluster) == pytest.approx(3.0)
    few, many = proportion(flags, cluster), proportion(flags, np.arange(20))
    assert few["interval"][0] < many["interval"][0]
    assert few["interval"][1] > many["interval"][1]


def test_the_interval_covers_the_truth_along_flights():
    # A flight is good or bad as a whole nine times of ten: taken as independent they would miss far more often.
    random = np.random.default_rng(5)
    truth, hits, naive = 0.7, 0, 0
    cluster = np.repeat(np.arange(30), 6)
    for _ in range(200):
        flight = np.repeat(random.random(30) < truth, 6)
        own = random.random(180) < truth
        flags = np.where(random.random(180) < 0.9, flight, own)
        low, high = proportion(flags, cluster)["interval"]
        hits += low <= truth <= high
        low, high = proportion(flags, np.arange(180))["interval"]
        naive += low <= truth <= high
    assert hits >= 184  # 95 % of 200, less three standard deviations of a count (3.1 each)
    assert naive < 150


FRAMES = 8
DRAWS = cluster_draws(FRAMES, "s", 0, draws=200)


def designs(make_sample, logs, scatter=0.0):
    """One design for each entry of a table of mean log10 errors, frames scattered about it alike for all."""
    random = np.random.default_rng(0)
    common = random.normal(0, 0.3, FRAMES)
    found = []
    for index in np.ndindex(logs.shape):
        noise = random.normal(0, scatter, FRAMES)
        settings = {axis: level for axis, level in zip("abc", index, strict=False)}
        error = 10.0 ** (logs[index] + common - common.mean() + noise - noise.mean())
        found.append(("-".join(map(str, index)), settings, make_sample(error)))
    return found


def test_two_axes_by_hand(make_sample):
    # Rows 0, 1 and columns 0, 1 of -2, -1.8 / -1.4, -0.8: effects 0.4 and 0.2, interaction 0.1; squares 4 times each.
    found = effects_of(designs(make_sample, np.array([[-2.0, -1.8], [-1.4, -0.8]])), DRAWS)
    squares = {"a": 0.4**2, "b": 0.2**2, "a-b": 0.1**2}
    shares = {"-".join(term["axes"]): term["share"]["value"] for term in found["terms"]}
    assert shares == pytest.approx({key: value / 0.21 for key, value in squares.items()}, rel=1e-9)
    assert [term["dof"] for term in found["terms"]] == [1, 1, 1]
    factors = [line["factor"] for line in found["levels"]["a"]]
    assert factors == pytest.approx([10**-0.4, 10**0.4], rel=1e-9)
    assert (found["basis"], found["n"], found["complete"]) == ("common", FRAMES, True)


def test_a_full_grid_adds_up(make_sample):
    logs = np.random.default_rng(4).normal(-1, 0.5, (3, 2, 4))
    found = effects_of(designs(make_sample, logs), DRAWS)
    shares = {"-".join(term["axes"]): term["share"]["value"] for term in found["terms"]}
    assert sum(shares.values()) == pytest.approx(1.0)
    # A main effect is the variance of the means of its levels.
    for axis, others in (("a", (1, 2)), ("b", (0, 2)), ("c", (0, 1))):
        assert shares[axis] == pytest.approx(logs.mean(axis=others).var() / logs.var(), rel=1e-9)
    means = logs.mean(axis=2)
    pair = means - means.mean(axis=0) - means.mean(axis=1, keepdims=True) + means.mean()
    assert shares["a-b"] == pytest.approx((pair**2).mean() / logs.var(), rel=1e-9)
    assert {"-".join(t["axes"]): t["dof"] for t in found["terms"]} == {
        "a": 2, "b": 1, "c": 3, "a-b": 2, "a-c": 6, "b-c": 3, "remainder": 6,
    }  # fmt: skip


def test_what_frames_have_in_common_takes_no_part(make_sample):
    logs = np.array([[-2.0, -1.8], [-1.4, -0.8]])
    found = effects_of(designs(make_sample, logs), DRAWS)
    for term in found["terms"]:
        low, high = term["share"]["interval"]
        assert high - low < 1e-9
    scattered = effects_of(designs(make_sample, logs, scatter=0.3), DRAWS)
    low, high = scattered["terms"][0]["share"]["interval"]
    assert high - low > 0.01


def test_gaps_and_silent_designs(make_sample):
    logs = np.random.default_rng(7).normal(-1, 0.5, (2, 3))
    grid = designs(make_sample, logs)
    name, settings, _ = grid[-1]
    grid[-1] = (name, settings, make_sample([np.nan] * FRAMES))
    found = effects_of(grid, DRAWS)
    assert (found["left_out"], found["complete"], found["designs"]) == ([name], False, 5)


def test_who_stands_in_the_way_is_left_out(make_sample):
    # One of four answers other frames than the rest: without it they have six in common; of three it would be too many.
    error = np.full(FRAMES, 0.1)
    others = [
        (f"d{i}", {"a": i}, make_sample(np.where(np.arange(FRAMES) < 6, (1 + i) * error, np.nan))) for i in range(3)
    ]
    odd = ("odd", {"a": 3}, make_sample(np.where(np.arange(FRAMES) > 3, error, np.nan)))
    found = effects_of([*others, odd], DRAWS)
    assert (found["basis"], found["n"], found["left_out"]) == ("common", 6, ["odd"])
    found = effects_of([*others[:2], odd], DRAWS)
    assert (found["basis"], found["n"], found["left_out"]) == ("own", 4, [])


def test_type_two_against_one_factor_at_a_time(make_sample):
    # Two axes without interaction, one corner missing: what is left is exact, whatever is missing.
    logs = np.array([[-2.0, -1.7, -1.1], [-1.6, -1.3, -0.7]])
    grid = designs(make_sample, logs)[:-1]
    found = effects_of(grid, DRAWS)
    factors = {key: [line["factor"] for line in lines] for key, lines in found["levels"].items()}
    assert factors["a"] == pytest.approx([10**-0.2, 10**0.2])
    for (_, first), (_, second) in itertools.pairwise(enumerate(factors["b"])):
        assert second > first


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("mass_g", 120.0),
        ("mass_g + 20 * power_w - 1", 129.0),
        ("-mass_g ** 2 / 2", -7200.0),
        ("max(mass_g, power_w, 500) + min(1, 2)", 501.0),
        ("sqrt(abs(-4)) * (mass_g)", 240.0),
        (" 1e3 ", 1000.0),
        ("mass_g / (power_w - 0.5)", None),
        ("9 ** 9 ** 9", None),
        ("sqrt(-mass_g)", None),
        ("(-mass_g) ** 0.5", None),
    ],
)
def test_arithmetic(text, value):
    found = read_expression(text, {"mass_g": None, "power_w": None}, "x").value({"mass_g": 120.0, "power_w": 0.5})
    assert found == (None if value is None else pytest.approx(value))


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "mass_g.real", "mass_g[0]", "[1, 2]", "lambda: 1", "mass_g if 1 else 2",
        "mass_g < 2", "'mass_g'", "True", "print(1)", "min()", "sqrt(1, 2)", "max(key=1)", "min(*mass_g)", "mass_g +",
        "a := 1", "1e999", "1" * 400, "(" * 250 + "1" + ")" * 250, "x" * 501, "", "mass_g; 1", "\0",
    ],
)  # fmt: skip
def test_what_is_no_arithmetic_is_refused_in_one_line(text):
    with pytest.raises(UserError) as e:
        read_expression(text, {"mass_g": None}, "s.toml: study.cheapest_by")
    line = e.value.line()
    assert "s.toml: study.cheapest_by" in line
    assert "\n" not in line


def column(value, half=None):
    interval = None if half is None else [value - half, value + half]
    return {"value": value, "interval": interval, "uncertain": half is not None}


def test_uncertainties_are_carried_through_and_added_in_squares():
    price = read_expression("2 * a + b + c", dict.fromkeys("abc"), "x")
    found = price_of(price, {"a": column(10.0, 1.5), "b": column(5.0, 4.0), "c": column(100.0)})
    assert found == {"value": 125.0, "interval": [pytest.approx(120.0), pytest.approx(130.0)], "known": True}
    exact = price_of(price, {name: column(1.0) for name in "abc"})
    assert exact == {"value": 4.0, "interval": None, "known": True}
    few = {"value": 1.0, "interval": None, "uncertain": True}
    assert price_of(price, {"a": few, "b": column(1.0), "c": column(1.0)})["known"] is False
    assert price_of(price, {"a": few | {"value": None}, "b": few, "c": few})["value"] is None


def test_ties():
    def price(value, half=None):
        return {"value": value, "interval": None if half is None else [value - half, value + half], "known": True}

    assert is_tie(price(0.1 + 0.2), price(0.3))
    assert not is_tie(price(1.0), price(1.001))
    # Only the halves that face each other count: 0.3 and 0.4 make 0.5.
    assert is_tie(price(1.0, 0.3), price(1.49, 0.4))
    assert is_tie(price(1.49, 0.4), price(1.0, 0.3))
    assert not is_tie(price(1.0, 0.3), price(1.51, 0.4))
    assert is_tie(price(None), price(None))
    assert not is_tie(price(None), price(1.0))


def test_a_front_is_what_nobody_beats():
    points = np.random.default_rng(1).integers(0, 6, (40, 2)).tolist()
    found = front(points)
    for point, kept in zip(points, found, strict=True):
        beaten = any(all(a <= b for a, b in zip(other, point, strict=True)) and other != point for other in points)
        assert kept != beaten
    assert any(found)
    assert not all(found)


def share(k, n):
    return proportion(np.arange(n) < k, np.arange(n))


def ask(shares, prices=None, availability=0.9):
    required = Requirement(id="R", error_deg=0.05, availability=availability)
    designs = []
    for name, (k, n) in shares.items():
        found = {"axis": "nadir", "verdict": verdict_of(share(k, n), availability), **share(k, n)}
        judged = [{"id": "R", "verdict": found["verdict"], "evidence": [found]}]
        designs.append({"name": name, "judged": judged, "misses": {"dark": {"n": n - k, "due": 0}}})
    prices = prices or {name: float(i) for i, name in enumerate(shares)}
    full = {
        name: price if isinstance(price, dict) else {"value": price, "interval": None, "known": True}
        for name, price in prices.items()
    }
    return cheapest(designs, [required], "pixel_rate", full)


def test_the_cheapest_that_meets_and_what_is_open():
    found = ask({"bad": (10, 100), "good": (100, 100), "dear": (100, 100)})
    assert (found["cheapest"], found["meets"], found["fails"]) == ("good", ["good", "dear"], ["bad"])
    assert "good (100 of 100" in found["text"]
    assert ask({"maybe": (19, 20), "good": (100, 100), "later": (19, 20)})["cheapest"] == "good"
    small = ask({"a": (20, 20), "b": (10, 20)}, availability=0.99)
    assert (small["cheapest"], small["candidate"], small["needed"]) == (None, "a", 299)
    assert ask({"a": (100, 100), "b": (100, 100)}, {"a": None, "b": 5.0})["meets"] == ["b", "a"]


def test_none_meets():
    found = ask({"a": (10, 100), "b": (40, 100)})
    assert (found["cheapest"], found["candidate"], found["closest"]) == (None, None, "b")
    assert found["misses"]["a"] == {"dark": {"n": 90, "due": 0}}
    alike = ask({"a": (40, 100), "b": (40, 100), "c": (1, 100)}, {"a": 2.0, "b": 1.0, "c": 0.0})
    assert (alike["closest"], alike["tied_closest"]) == ("a", ["a", "b"])


def test_equal_costs_are_ties():
    both = ask({"a": (100, 100), "b": (100, 100), "dear": (100, 100)}, {"a": 5.0, "b": 5.0, "dear": 6.0})
    assert both["tied"] == ["a", "b"]
    maybe = ask({"a": (20, 20), "b": (20, 20)}, {"a": 5.0, "b": 5.0}, availability=0.99)
    assert maybe["tied_candidates"] == ["a", "b"]


def test_a_cost_with_an_uncertainty_ties_what_it_does_not_tell_apart():
    def price(value, half):
        return {"value": value, "interval": [value - half, value + half], "known": True}

    shares = {"a": (100, 100), "b": (100, 100), "c": (100, 100)}
    found = ask(shares, {"a": price(1.0, 0.2), "b": price(1.25, 0.2), "c": price(1.4, 0.2)})
    # Half widths of 0.2 and 0.2 tell differences above 0.28 apart.
    assert found["tied"] == ["a", "b"]
    unknown = {"value": 9.0, "interval": None, "known": False}
    assert ask(shares, {"a": price(1.0, 0.2), "b": unknown, "c": price(2.0, 0.2)})["tied"] == ["a", "b"]


def test_pairs_lose_what_the_frames_have_in_common(make_sample):
    random = np.random.default_rng(3)
    frame = 10 ** random.normal(-1.5, 0.5, 60)
    a, b = make_sample(frame), make_sample(frame * 1.1)
    draws = cluster_draws(60, "s", 0)
    found = compare(a, b, draws, 0.05)
    assert found["typical_ratio"]["value"] == pytest.approx(1.1)
    low, high = found["typical_ratio"]["interval"]
    assert high - low < 1e-9
    assert found["correlation"] == pytest.approx(1.0)
    # The same frames in another order are no pairs: the interval is as wide as their scatter.
    other = compare(a, make_sample(random.permutation(frame) * 1.1), draws, 0.05)["typical_ratio"]["interval"]
    assert other[1] / other[0] > 1.3
    assert found["mean_difference_deg"]["value"] == pytest.approx(0.1 * frame.mean())


def test_mcnemar_counts_frames_of_one_alone(make_sample):
    a = make_sample([0.01] * 10 + [np.nan] * 8 + [0.01] * 2)
    b = make_sample([0.01] * 18 + [0.2, np.nan])
    found = compare(a, b, cluster_draws(20, "s", 0), 0.05)
    assert (found["n"], found["both"]) == (20, 11)
    answered, within = found["answered"], found["within"]
    assert (answered["only_a"], answered["only_b"], within["only_a"], within["only_b"]) == (1, 8, 2, 8)
    assert answered["p"] == pytest.approx(stats.binomtest(8, 9).pvalue)
    assert answered["difference"] == pytest.approx(7 / 20)
