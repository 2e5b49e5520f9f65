"""Rows and table of the orbit: the shadowed segment, and the claim of an accuracy comparable with infrared."""

from __future__ import annotations

import numpy as np

from horizonval.systems.b.pair.applicability import LIMIT_DEG, PUBLISHED, rms
from horizonval.systems.b.pair.orbit import INFRARED, LINEAR, VISIBLE, Lap, errors_deg
from horizonval.systems.result import ComparisonRow, Table
from horizonval.systems.text import page_text

TEXT = page_text("B")


def in_shadow(orbit: Lap) -> np.ndarray:
    """Return which positions lie in the Earth's shadow."""
    return np.array(orbit.lit) < 0.5


def orbit_rows(orbit: Lap) -> list[ComparisonRow]:
    """Return the rows of the shadowed segment and of the comparison with infrared."""
    dark = in_shadow(orbit)
    visible = errors_deg(orbit.by_sensor[VISIBLE])
    infrared = errors_deg(orbit.by_sensor[INFRARED])
    linear = errors_deg(orbit.by_sensor[LINEAR])
    asked = errors_deg(orbit.by_sensor[VISIBLE], by_search=True)
    both = np.isfinite(asked) & np.isfinite(infrared)
    claims = {key: figure.value for key, figure in PUBLISHED.figures.items()}
    return [
        TEXT.row(
            "shadow",
            float(np.mean(np.isnan(visible[dark]))),
            claims["shadow"],
            limit=1.0,
            at_least=True,
            dark=int(dark.sum()),
            positions=len(dark),
        ),
        TEXT.row("lit", _wrong(visible[~dark]), answered=_share(asked[~dark]), wrong=_wrong(asked[~dark])),
        TEXT.row(
            "visible",
            rms(asked),
            claims["infrared"],
            answered=int(np.isfinite(asked).sum()),
            positions=len(asked),
            infrared=rms(infrared[both]),
        ),
        TEXT.row("infrared", rms(infrared), answered=_share(infrared)),
        TEXT.row("linear", rms(linear), answered=_share(linear)),
    ]


def verdict(orbit: Lap) -> dict[str, float]:
    """Return what decides the claim that the visible vertical is as accurate as an infrared one.

    ``comparable``: whether the visible pair's rms, with the search that asks, is within twice that of the infrared one.
    """
    asked = errors_deg(orbit.by_sensor[VISIBLE], by_search=True)
    longest_edge = errors_deg(orbit.by_sensor[VISIBLE])
    infrared = errors_deg(orbit.by_sensor[INFRARED])
    return {
        "comparable": rms(asked) / rms(infrared) <= 2.0,
        "visible_deg": rms(asked),
        "infrared_deg": rms(infrared),
        "answered": _share(asked),
        "infrared_answered": _share(infrared),
        "claimed": _share(longest_edge),
        "wrong": _wrong(longest_edge),
    }


def orbit_table(orbit: Lap) -> Table:
    """Return the table of all sensors on the orbit."""
    dark = in_shadow(orbit)
    lines = []
    for sensor, found in orbit.by_sensor.items():
        for by_search in (False, True):
            if by_search and sensor == LINEAR:
                continue
            error = errors_deg(found, by_search=by_search)
            median = float(np.nanmedian(error)) if np.isfinite(error).any() else None
            lines.append(
                (
                    f"{sensor}{', search that asks' if by_search else ''}",
                    _share(error[~dark]),
                    _share(error[dark]),
                    median,
                    rms(error) if median is not None else None,
                    _wrong(error),
                )
            )
    return TEXT.table("orbit", lines, positions=len(dark))


def _share(error: np.ndarray) -> float:
    return float(np.mean(np.isfinite(error))) if len(error) else 0.0


def _wrong(error: np.ndarray) -> float:
    claimed = error[np.isfinite(error)]
    return float(np.mean(claimed > LIMIT_DEG)) if len(claimed) else 0.0
