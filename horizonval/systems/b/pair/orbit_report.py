"""Rows and table of the orbit: the shadowed segment, and the claim of an accuracy comparable with infrared."""

from __future__ import annotations

import numpy as np

from horizonval.systems.b.pair.applicability import LIMIT_DEG, rms
from horizonval.systems.b.pair.orbit import INFRARED, LINEAR, VISIBLE, Lap, errors_deg
from horizonval.systems.result import ComparisonRow, Table


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
    return [
        ComparisonRow(
            "shadowed segment: share of positions without a solution",
            "no solution",
            float(np.mean(np.isnan(visible[dark]))),
            "",
            f"{int(dark.sum())} of {len(dark)} positions lie in the shadow; no edge is long enough in their frames.",
            limit=1.0,
            at_least=True,
        ),
        ComparisonRow(
            "lit segment: share of claims wrong by more than 1 deg, longest edge",
            None,
            _wrong(visible[~dark]),
            "",
            f"The longest edge is the horizon's only where all of it is lit: {_share(asked[~dark]):.0%} of these "
            f"positions pass a search that asks, {_wrong(asked[~dark]):.0%} of those wrongly.",
        ),
        ComparisonRow(
            "visible pair: RMS on the orbit, horizons from the search that asks",
            "comparable with infrared",
            rms(asked),
            "deg",
            f"{int(np.isfinite(asked).sum())} of {len(asked)} positions answered; in the same ones the infrared pair "
            f"has {rms(infrared[both]):.3f} deg.",
        ),
        ComparisonRow(
            "infrared pair of the same field and pixels: RMS on the orbit",
            None,
            rms(infrared),
            "deg",
            f"{_share(infrared):.0%} of the positions answered, the shadow included; the same method on the limb of "
            "carbon dioxide.",
        ),
        ComparisonRow(
            "four linear infrared heads: RMS on the orbit",
            None,
            rms(linear),
            "deg",
            f"{_share(linear):.0%} of the positions answered; the cone through four sub-pixel crossings.",
        ),
    ]


def verdict(orbit: Lap) -> str:
    """Return a sentence on the claim that the visible vertical is as accurate as an infrared one."""
    asked = errors_deg(orbit.by_sensor[VISIBLE], by_search=True)
    bare = errors_deg(orbit.by_sensor[VISIBLE])
    infrared = errors_deg(orbit.by_sensor[INFRARED])
    ratio = rms(asked) / rms(infrared)
    word = "holds" if ratio <= 2.0 else "does not hold"
    return (
        f"The claim of an accuracy comparable with infrared {word} where the limb is lit and searched for with care "
        f"({rms(asked):.2f} against {rms(infrared):.2f} deg rms), but the visible pair answers {_share(asked):.0%} of "
        f"an orbit, the infrared one {_share(infrared):.0%}; as published, with the longest edge, the visible pair "
        f"claims {_share(bare):.0%}, {_wrong(bare):.0%} of that wrong by more than a degree."
    )


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
    return Table(
        "One orbit, in and out of the shadow",
        ("sensor", "answered, lit", "answered, shadow", "median [deg]", "rms [deg]", "share of claims above 1 deg"),
        tuple(lines),
        f"{len(dark)} positions, roll and pitch within 4 deg, any yaw, WGS84, against the geocentric nadir, without "
        "correction for the ellipsoid.",
    )


def _share(error: np.ndarray) -> float:
    return float(np.mean(np.isfinite(error))) if len(error) else 0.0


def _wrong(error: np.ndarray) -> float:
    claimed = error[np.isfinite(error)]
    return float(np.mean(claimed > LIMIT_DEG)) if len(claimed) else 0.0
