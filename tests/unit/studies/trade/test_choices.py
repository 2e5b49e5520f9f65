"""Fronts, pairs and the cheapest design."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from horizonval.spec.suite import Requirement
from horizonval.studies.trade.conclude import cheapest, frames_needed, verdict_of
from horizonval.studies.trade.effects import compare, front
from horizonval.studies.trade.sample import cluster_draws, proportion


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


def test_ninety_nine_per_cent_takes_299_frames():
    assert frames_needed(0.99) == 299
    assert verdict_of(share(299, 299), 0.99) == "meets"
    assert verdict_of(share(298, 298), 0.99) == "open"
    assert verdict_of(share(180, 200), 0.99) == "fails"
    assert verdict_of(share(0, 0), 0.99) == "open"


def ask(shares, prices=None, availability=0.9):
    designs = [
        {"name": name, "within": share(*found), "misses": {"dark": {"n": found[1] - found[0], "due": 0}}}
        for name, found in shares.items()
    ]
    prices = prices or {name: float(i) for i, name in enumerate(shares)}
    full = {
        name: price if isinstance(price, dict) else {"value": price, "interval": None, "known": True}
        for name, price in prices.items()
    }
    return cheapest(designs, Requirement(error_deg=0.05, availability=availability), "pixel_rate", full)


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
