"""The range over plausible benches: what the stated sizes make, if every one may be twice as large or half.

The published text gives no sizes of its rig's imperfections, and ours were not chosen blind, so that one figure at the
stated sizes proves nothing. To first order a bench's error at the tilt t is the sum of what its imperfections do,

    e(t) = sum_i s_i f_i m_i(t),

with the main effects ``m_i`` of the two-level design at the stated sizes (:mod:`horizonval.systems.b.rig.design`),
signs ``s_i`` that nobody knows and factors ``f_i`` spread evenly in their logarithm over [1/2, 2]. No frame is rendered
again.

The paper's word for its figure may mean two things, which differ by a factor of several for errors that are mostly
constant: the root of the mean square of the error, and its standard deviation about the bench's own mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.systems.b.rig import design
from horizonval.systems.b.rig.runs import BenchRun

FACTOR = 2.0
DRAWS = 20_000
RANGE_PERCENT = (5.0, 95.0)


@dataclass(frozen=True)
class Benches:
    """Root mean square and standard deviation [deg] of every drawn bench over its tilts, shape (draws,)."""

    rms_deg: FloatArray
    deviation_deg: FloatArray


def plausible_benches(whole: BenchRun, floor_deg: float, rng: np.random.Generator) -> Benches:
    """Draw benches; ``floor_deg`` is the scatter of a bench without imperfections, added to both as a square."""
    effects = design.main_effects(whole.error_deg)
    factors = FACTOR ** rng.uniform(-1.0, 1.0, (DRAWS, len(effects)))
    signs = rng.choice([-1.0, 1.0], factors.shape)
    error = (signs * factors) @ effects
    return Benches(np.sqrt(np.mean(error**2, axis=1) + floor_deg**2), np.sqrt(np.var(error, axis=1) + floor_deg**2))


def own_deviation_deg(run: BenchRun) -> float:
    """Return the scatter of the published error about each bench's own mean, root mean square over the benches."""
    return float(np.sqrt(np.nanmean(np.nanvar(run.error_deg, axis=1))))


def percentile_of(values: FloatArray, figure: float) -> float:
    """Return the share [%] of values below a figure."""
    return 100.0 * float(np.mean(values < figure))
