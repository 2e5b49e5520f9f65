"""Effects of the axes against sums of squares by hand."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from horizonval.studies.trade.effects import effects_of
from horizonval.studies.trade.sample import cluster_draws

N = 8
DRAWS = cluster_draws(N, "s", 0, draws=200)


def designs(make_sample, logs, scatter=0.0):
    """One design for each entry of a table of mean log10 errors, frames scattered about it alike for all."""
    random = np.random.default_rng(0)
    common = random.normal(0, 0.3, N)
    found = []
    for index in np.ndindex(logs.shape):
        noise = random.normal(0, scatter, N)
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
    assert (found["basis"], found["n"], found["complete"]) == ("common", N, True)


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


def test_an_easy_frame_favours_none(make_sample):
    # The second design refuses the four frames on which both would be bad: on the others they are alike.
    error = np.array([0.01] * 6 + [1.0] * 2)
    bold, shy = make_sample(error), make_sample(np.where(error > 0.1, np.nan, 1.001 * error))
    found = effects_of([("x", {"a": 0}, bold), ("y", {"a": 1}, shy)], DRAWS)
    assert (found["basis"], found["n"]) == ("common", 6)
    factors = [line["factor"] for line in found["levels"]["a"]]
    assert factors == pytest.approx([1 / 1.001**0.5, 1.001**0.5], rel=1e-9)


def test_gaps_and_silent_designs(make_sample):
    logs = np.random.default_rng(7).normal(-1, 0.5, (2, 3))
    grid = designs(make_sample, logs)
    name, settings, _ = grid[-1]
    grid[-1] = (name, settings, make_sample([np.nan] * N))
    found = effects_of(grid, DRAWS)
    assert (found["left_out"], found["complete"], found["designs"]) == ([name], False, 5)


def test_who_stands_in_the_way_is_left_out(make_sample):
    # One of four answers other frames than the rest: without it they have six in common; of three it would be too many.
    error = np.full(N, 0.1)
    others = [(f"d{i}", {"a": i}, make_sample(np.where(np.arange(N) < 6, (1 + i) * error, np.nan))) for i in range(3)]
    odd = ("odd", {"a": 3}, make_sample(np.where(np.arange(N) > 3, error, np.nan)))
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
