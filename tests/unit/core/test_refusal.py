"""One type for every answer that is withheld, false where a fit is true."""

from __future__ import annotations

import pickle

import numpy as np

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Fit


def test_a_refusal_is_false_and_a_fit_is_true():
    assert not Refusal(Outcome.NO_LIMB, "nothing there")
    assert Fit(np.array([0.0, 0.0, 1.0]), np.eye(3), 0.0, 0.0)


def test_a_refusal_of_one_head_names_it_and_keeps_the_rest():
    refusal = Refusal(Outcome.SHORT_ARC, "few points", np.ones((3, 2)))
    named = refusal.of_head("left")
    assert (named.status, named.reason) == (Outcome.SHORT_ARC, "head left: few points")
    assert named.points is refusal.points


def test_a_refusal_survives_the_way_between_processes():
    returned = pickle.loads(pickle.dumps(Refusal(Outcome.DARK, "night")))
    assert (returned.status, returned.reason, returned.points.shape) == (Outcome.DARK, "night", (0, 2))
