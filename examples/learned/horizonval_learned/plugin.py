"""The estimator with its weights, which are read at import and not at the first image."""

from __future__ import annotations

from functools import partial

import horizonval as hv
from horizonval_learned.estimator import run
from horizonval_learned.network import load

ESTIMATOR = hv.Estimator(
    "learned-limb", "A small network on profiles of the limb, one fit", partial(run, network=load())
)
