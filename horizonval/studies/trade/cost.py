"""What a design costs, by the study's own expression; and the processor time of an estimate on the machine that ran it.

Seconds are kept apart from what is reproducible. They have an uncertainty, which an expression that uses them has too:
designs whose costs it does not tell apart are tied.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scipy import stats

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.store.folder import intact_json
from horizonval.studies.trade import expression
from horizonval.studies.trade.expression import Expression
from horizonval.studies.trade.sample import CONFIDENCE
from horizonval.suites.units.scored import PROCESSOR

FILE = "study-costs.json"
SECONDS = "processor_s"
EXACT = ("pixel_rate", "pixels", "width", "height", "heads")
MEASURES = ("bias_deg", "noise_deg", "rms_deg", "p95_deg", "three_sigma_deg", "exclusion_deg")
SHARES = ("availability", "answered_due", "false_valid", "within")
COLUMNS = (*EXACT, SECONDS, *MEASURES, *SHARES)
"""What an expression may use of every design, beside the numbers of its file."""


def read_price(text: str, costs: Mapping[str, float], where: str) -> Expression:
    """Return the expression of what a design costs.

    Parameters
    ----------
    text : str
    costs : mapping
        The numbers that the file gives of a design; all designs have the same names.
    where : str
        File and key, or the option, for errors.

    Raises
    ------
    UserError
        It is no expression, or uses a name that is no column; a number of the file is named as a column.
    """
    if both := sorted(set(costs) & set(COLUMNS)):
        raise UserError(f"a cost is named {both[0]!r}, as a column is", where=where, fix="rename it")
    return expression.read(text, dict.fromkeys((*costs, *COLUMNS)), where)


def is_timed(price: Expression) -> bool:
    """Whether a price hangs on processor time, and so on the machine."""
    return SECONDS in price.names


def columns_of(design: Mapping[str, Any], seconds: JsonObject) -> dict[str, JsonObject]:
    """Return the columns of a design of ``study.json``: ``{value, interval, uncertain}`` by name."""
    exact = {name: design[name] for name in EXACT} | dict(design["costs"])
    measured = {SECONDS: seconds} | {name: design[name] for name in MEASURES}
    shares = {name: {"value": design[name]["rate"], "interval": design[name]["interval"]} for name in SHARES}
    return {name: {"value": value, "interval": None, "uncertain": False} for name, value in exact.items()} | {
        name: {
            "value": column["value"],
            "interval": None if None in (column["interval"] or [None]) else column["interval"],
            "uncertain": True,
        }
        for name, column in (measured | shares).items()
    }


def price_of(expression: Expression, columns: Mapping[str, JsonObject]) -> JsonObject:
    """Return what a design costs.

    Parameters
    ----------
    expression : Expression
    columns : mapping
        By name ``{value, interval, uncertain}``: ``interval`` None where nothing is uncertain, or it is not known.

    Returns
    -------
    dict
        ``value``; ``interval``, of each column's interval carried through alone, added in squares; ``known``: whether
        the uncertainty is known, or there is none. Without a value None, None and True.
    """
    values = {name: columns[name]["value"] for name in expression.names}
    middle = None if None in values.values() else expression.value(values)
    if middle is None:
        return {"value": None, "interval": None, "known": True}
    below = above = 0.0
    known, uncertain = True, False
    for name in sorted(expression.names):
        if not columns[name]["uncertain"]:
            continue
        interval = columns[name]["interval"]
        ends = [None] if interval is None else [expression.value(values | {name: end}) for end in interval]
        if None in ends:
            known = False
            continue
        steps = [end - middle for end in ends if end is not None]
        below += min(0.0, *steps) ** 2
        above += max(0.0, *steps) ** 2
        uncertain = True
    interval = [middle - math.sqrt(below), middle + math.sqrt(above)] if uncertain and known else None
    return {"value": middle, "interval": interval, "known": known}


def is_tie(a: JsonObject, b: JsonObject) -> bool:
    """Whether two costs are not told apart: equal but for rounding, or no further apart than their uncertainties.

    The half widths that face each other are added in squares: the interval of the difference of independent costs.
    """
    if a["value"] is None or b["value"] is None:
        return a["value"] is b["value"]
    low, high = sorted((a, b), key=lambda price: price["value"])
    if not (low["known"] and high["known"]):
        return True
    up = low["interval"][1] - low["value"] if low["interval"] else 0.0
    down = high["value"] - high["interval"][0] if high["interval"] else 0.0
    gap = high["value"] - low["value"]
    return bool(gap <= math.hypot(up, down) or math.isclose(low["value"], high["value"], rel_tol=1e-9))


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
