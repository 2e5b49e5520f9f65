"""All gates of a night, decided together because their p-values are adjusted together; as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from horizonval.spec.suite import TWO_SIDED
from horizonval.studies.regression.statistics.decide import decide
from horizonval.studies.regression.statistics.gates import Measured

MOST_NAMED = 12
"""Scenes of a gate that are named; ``n_scenes`` counts all that changed."""


def judge(measured: Sequence[tuple[str, Measured]], looks: int = 1) -> list[dict[str, Any]]:
    """Return every gate with its verdict.

    Parameters
    ----------
    measured : sequence of (str, Measured)
        What each was compared with (``accepted``, ``release``), and what was found.
    looks : int
        See :func:`horizonval.studies.regression.statistics.decide.decide`.
    """
    decided = decide(
        [one.estimate for _, one in measured],
        [one.gate.margin for _, one in measured],
        [one.gate.metric in TWO_SIDED for _, one in measured],
        looks,
    )
    return [
        {
            "against": name,
            "name": one.gate.name,
            "lane": one.gate.lane,
            "metric": one.gate.metric,
            "margin": one.gate.margin,
            "unit": one.gate.unit,
            "reason": one.gate.reason,
            "two_sided": one.gate.metric in TWO_SIDED,
            "paired": one.paired,
            "verdict": str(verdict),
            "p_adjusted": p,
            "estimate": None if one.estimate is None else one.estimate.to_dict(),
            "scenes": list(one.scenes[:MOST_NAMED]),
            "n_scenes": len(one.scenes),
        }
        for (name, one), (verdict, p) in zip(measured, decided, strict=True)
    ]
