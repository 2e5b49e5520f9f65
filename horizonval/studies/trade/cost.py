"""What an estimate costs: seconds of processor time on the machine that ran it, apart from what is reproducible."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from scipy import stats

from horizonval.core.json_types import JsonObject
from horizonval.store.folder import intact_json
from horizonval.studies.trade.sample import CONFIDENCE
from horizonval.suites.units.scored import PROCESSOR

FILE = "study-costs.json"


def read_timings(folder: Path) -> dict[str, dict[str, float]]:
    """Return the seconds of every stage by case, those of all shards together."""
    timings: dict[str, dict[str, float]] = {}
    for path in sorted(folder.glob("timings*.json")):
        for case, stages in ((intact_json(path) or {}).get("cases") or {}).items():
            timings[case] = stages
    return timings


def cost_of(
    frames: Iterable[tuple[str, int]], estimator: str, timings: Mapping[str, Mapping[str, float]]
) -> JsonObject:
    """Return the mean processor time of an estimate.

    Parameters
    ----------
    frames : iterable of (case, bands)
        Cases and how many images of each the estimator saw one after the other.
    estimator : str
    timings : mapping

    Returns
    -------
    dict
        ``value`` [s], ``interval`` (Student's, of the mean), ``n`` (frames whose time is known).
    """
    seconds = [
        stages[PROCESSOR + estimator] / bands
        for case, bands in frames
        if PROCESSOR + estimator in (stages := timings.get(case, {}))
    ]
    return mean_of(seconds)


def mean_of(values: Sequence[float]) -> JsonObject:
    """Return a mean with Student's interval."""
    n = len(values)
    if n == 0:
        return {"value": None, "interval": None, "n": 0}
    mean = math.fsum(values) / n
    if n < 3:
        return {"value": mean, "interval": None, "n": n}
    error = math.sqrt(math.fsum((x - mean) ** 2 for x in values) / (n - 1) / n)
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, n - 1)) * error
    return {"value": mean, "interval": [max(mean - half, 0.0), mean + half], "n": n}


def all_stages(timings: Mapping[str, Mapping[str, float]]) -> float:
    """Return the seconds of the clock that all frames took together, in all processes."""
    return math.fsum(
        spent for stages in timings.values() for stage, spent in stages.items() if not stage.startswith(PROCESSOR)
    )
