"""States that contradict themselves: positions against each other and the axes, and velocities against positions.

**Positions.** A single position that is off by e changes three second differences, in the ratio 1 : -2 : 1. A manoeuvre
changes two, which have the same sign.

**Axes.** In axes that turn with the Earth a satellite has the accelerations of Coriolis and of the centrifugal force
beyond the pull of the Earth. If the second differences of positions that are said to be inertial show them, or those of
Earth-fixed positions show their opposite, the axes are the other ones.

**Velocities** are the rates of change of the positions.

Between two states h apart the mean velocity is known twice: from the positions, and from the velocities by the
corrected trapezoidal rule (Euler and Maclaurin), with the pull of the Earth as the acceleration a::

    (r1 - r0) / h = (v0 + v1) / 2 - (h / 12) (a1 - a0) + O(h^4)

The difference of the two may be as large as

* the rule's remainder, R w^5 h^4 / 720 for a circle of radius R and rate w, and up to 120 times as much for a perigee
  between the states of an ellipse of eccentricity 1;
* somewhat more than half of a lasting step of velocity, since a manoeuvre may lie between the states: what the
  velocities change by beyond the pull, over this interval and the one before *and* over this and the next;
* four times the noise, the median change of the difference from interval to interval: a wrong unit, sign or frame
  changes it slowly, rounded or measured positions do not;
* 3 m/s, more than a Kepler ellipse's velocity lacks of a drifting one's.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.formats.attitude import Axes
from horizonval.geometry.orbit import EARTH_RATE_RAD_S, GM_M3_PER_S2

FLOOR_M_S, STEP_SHARE = 3.0, 0.6
LARGEST_STEP_M_S = 4000.0
"""Largest manoeuvre between two states."""
SPAN_S, SHORTEST_S = 120.0, 10.0
"""Time between positions whose second differences show the axes; below the second, rounding hides it."""
LARGEST_OUTLIER_M, OUTLIER_SUM = 6000.0, 0.3
"""Second difference of positions beyond which one of them is wrong, if three of them cancel to this share."""
LONGEST_RAD = 1.5
"""Longest interval whose velocities are compared, in the phase of a circular orbit as low."""
ROUNDING_M = 1.0
"""Change of positions that rounding may make."""
LARGEST_NOISE_M, LARGEST_ROUNDING_M_S = 1000.0, 5.0
"""Of positions and of velocities: what is given in whole kilometres, and to 0.01 km/s."""
SPEEDS_M_S = (1.0, 20e3)
"""Least and greatest speed, among the stars."""
_FEWEST_FOR_NOISE = 5
_MATCH = 0.03
"""Relative difference up to which a hypothesis explains a velocity."""

States = tuple[FloatArray, FloatArray]


def check_positions(
    axes: Axes, seconds: FloatArray, r_gcrs: FloatArray, where: str, place: Callable[[int], str]
) -> None:
    """Refuse positions (m, 3) of which one is wrong, or that move as in other axes."""
    steps = np.diff(seconds)
    speed = np.linalg.norm(np.diff(r_gcrs, axis=0), axis=1) / steps
    if (speed > SPEEDS_M_S[1]).any():
        k = int(np.argmax(speed > SPEEDS_M_S[1]))
        raise UserError(
            f"a position that {speed[k] / 1e3:.3g} km/s would reach from the one before",
            where=place(k + 1),
            expected=f"positions of one satellite, at most {SPEEDS_M_S[1] / 1e3:g} km/s fast",
        )
    if len(seconds) < 3:
        return
    beyond, r, _, use = _beyond_the_pull(seconds, r_gcrs, 1)
    if len(beyond) > 2:
        square = steps[1:, None] ** 2
        off = beyond * square
        size = np.linalg.norm(off, axis=1)
        lowest = np.linalg.norm(r, axis=1)
        # The remainder of Numerov's rule near the perigee of a long ellipse.
        remainder = 0.5 * lowest * (GM_M3_PER_S2 / lowest**3 * square[:, 0]) ** 3
        bound = LARGEST_OUTLIER_M + np.maximum.reduce([remainder[:-2], remainder[1:-1], remainder[2:]])
        cancelled = np.linalg.norm(off[:-2] + off[1:-1] + off[2:], axis=1) < OUTLIER_SUM * size[1:-1]
        wrong = use[:-2] & use[1:-1] & use[2:] & cancelled & (size[1:-1] > bound)
        if wrong.any():
            k = int(np.argmax(np.where(wrong, size[1:-1], 0.0)))
            raise UserError(
                f"a position {size[k + 1] / 2e3:.3g} km off the way through its neighbours",
                where=place(k + 2),
                expected="positions of one satellite, a wrong digit in none",
            )
    stride = max(1, min(round(SPAN_S / float(np.median(np.diff(seconds)))), (len(seconds) - 1) // 2))
    beyond, r, v, use = _beyond_the_pull(seconds, r_gcrs, stride)
    if not use.any():
        return
    beyond, r, v = beyond[use], r[use], v[use]
    turning = np.array([0.0, 0.0, EARTH_RATE_RAD_S if axes != "itrs" else -EARTH_RATE_RAD_S])
    expected = -2.0 * np.cross(turning, v) - np.cross(turning, np.cross(turning, r))
    if _median_norm(beyond - expected) < 0.3 * _median_norm(beyond):
        moves, named = ("Earth-fixed", "inertial") if axes != "itrs" else ("inertial", "Earth-fixed")
        raise UserError(
            f"the states move as in {moves} axes, but are said to be {named}",
            where=where,
            expected=f"{named} states",
            fix="name the axes of the states",
        )


def _beyond_the_pull(
    seconds: FloatArray, r: FloatArray, stride: int
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return accelerations beyond the pull of the Earth, their positions and velocities, and which can be used."""
    before, here, after = (slice(0, -2 * stride), slice(stride, -stride), slice(2 * stride, None))
    h0, h1 = seconds[here] - seconds[before], seconds[after] - seconds[here]
    pull = _pull(r)
    # Numerov's rule: the mean of the pull over the three instants, so that the steps may be long.
    mean_pull = (pull[before] + 10.0 * pull[here] + pull[after]) / 12.0
    h = h0[:, None]
    beyond = (r[after] - 2.0 * r[here] + r[before]) / h**2 - mean_pull
    rate = np.sqrt(np.linalg.norm(pull, axis=1) / np.linalg.norm(r, axis=1))[here]
    use = (np.abs(h1 - h0) < 1e-3 * h0) & (rate * h0 < 1.0) & (h0 >= SHORTEST_S)
    return beyond, r[here], (r[after] - r[before]) / (2.0 * h), use


def _pull(r: FloatArray) -> FloatArray:
    return np.asarray(-GM_M3_PER_S2 * r / np.linalg.norm(r, axis=1, keepdims=True) ** 3)


def _median_norm(vectors: FloatArray) -> float:
    return float(np.median(np.linalg.norm(vectors, axis=1)))


def check(
    axes: Axes,
    given: tuple[FloatArray, FloatArray, FloatArray],
    gcrs: States,
    place: Callable[[int], str],
) -> None:
    """Refuse velocities that contradict the positions, naming the first state and the likely cause.

    ``given``: times (m,), positions and velocities (m, 3) along ``axes``; ``gcrs``: the same states along
    inertial axes. ``place``: name of a state, by its index.
    """
    off, allowed = _difference(given[0], *gcrs)
    # A speed of 0 is never measured, however slow the motion along Earth-fixed axes.
    still = np.asarray(~given[2].any(axis=1))
    still = still[1:] & still[:-1] & (np.linalg.norm(np.diff(given[1], axis=0), axis=1) > ROUNDING_M)
    wrong = np.asarray((np.linalg.norm(off, axis=1) > allowed) | still)
    if not wrong.any():
        _check_speed(gcrs[1], place)
        return
    first = int(np.flatnonzero(wrong)[0])
    whole = bool(wrong[wrong | np.isfinite(allowed)].mean() > 0.5)
    # The state that two wrong intervals share is the wrong one.
    state = first if whole or (first == 0 and not wrong[1:2].any()) else first + 1
    raise UserError(
        f"the velocity is {np.linalg.norm(off[first]) / 1e3:.3g} km/s off the rate of change of the positions: "
        + (_cause(axes, given, wrong) or "another unit, order, satellite or instant, or a wrong digit?"),
        where=place(state),
        expected="velocities that fit the positions",
        fix="correct the velocities, or give a table of positions alone",
    )


def _check_speed(v_gcrs: FloatArray, place: Callable[[int], str]) -> None:
    """Refuse speeds that no satellite of the Earth has; in a gap they are all that is known."""
    speed = np.linalg.norm(v_gcrs, axis=1)
    wrong = np.flatnonzero((speed < SPEEDS_M_S[0]) | (speed > SPEEDS_M_S[1]))
    if len(wrong):
        raise UserError(
            f"a speed of {speed[wrong[0]] / 1e3:.3g} km/s",
            where=place(int(wrong[0])),
            expected=f"{SPEEDS_M_S[0] / 1e3:g} to {SPEEDS_M_S[1] / 1e3:g} km/s; are these kilometres a second?",
        )


def _difference(seconds: FloatArray, r: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the difference of the mean velocities, (m - 1, 3), and how large it may be [m/s]; infinite if unknown."""
    h = np.diff(seconds)[:, None]
    distance = np.linalg.norm(r, axis=1, keepdims=True)
    pull, along = _pull(r), np.sum(r * v, axis=1, keepdims=True)
    off = np.diff(r, axis=0) / h - (v[1:] + v[:-1]) / 2.0 + h / 12.0 * np.diff(pull, axis=0)
    jerk = -GM_M3_PER_S2 * (v - 3.0 * along / distance**2 * r) / distance**3
    gained = np.cumsum(h * (pull[1:] + pull[:-1]) / 2.0 - h**2 / 12.0 * np.diff(jerk, axis=0), axis=0)
    beyond = v - np.concatenate([np.zeros((1, 3)), gained])
    if len(seconds) == 2:
        step = np.linalg.norm(np.diff(beyond, axis=0), axis=1)
    else:
        wide = np.linalg.norm(beyond[2:] - beyond[:-2], axis=1)
        step = np.minimum(np.append(wide, wide[-1]), np.insert(wide, 0, wide[0]))
    h, lowest = h[:, 0], np.minimum(distance[1:], distance[:-1])[:, 0]
    noise = 4.0 * (LARGEST_NOISE_M / h + LARGEST_ROUNDING_M_S)
    if len(seconds) >= _FEWEST_FOR_NOISE:
        noise = np.minimum(noise, 4.0 * _median_norm(np.diff(off, n=2, axis=0)))
    # Length of the vector to the perigee.
    eccentricity = np.linalg.norm(np.cross(v, np.cross(r, v)) / GM_M3_PER_S2 - r / distance, axis=1)
    ellipse = 1.0 + 119.0 * np.minimum(np.maximum(eccentricity[1:], eccentricity[:-1]), 1.0)
    rate = np.sqrt(GM_M3_PER_S2 / lowest**3)
    remainder = ellipse / 720.0 * lowest * rate * (rate * h) ** 4
    step, remainder = (np.minimum(x, LARGEST_STEP_M_S) for x in (step, remainder))
    return off, np.where(rate * h < LONGEST_RAD, FLOOR_M_S + STEP_SHARE * step + noise + remainder, np.inf)


def _cause(axes: Axes, given: tuple[FloatArray, FloatArray, FloatArray], wrong: NDArray[np.bool_]) -> str:
    """Return what the velocities of wrong intervals look like; empty where nothing explains them."""
    seconds, r, v = given
    middle, found = (r[1:] + r[:-1])[wrong] / 2.0, (v[1:] + v[:-1])[wrong] / 2.0
    slope = (np.diff(r, axis=0) / np.diff(seconds)[:, None])[wrong]
    spin = np.cross([0.0, 0.0, EARTH_RATE_RAD_S], middle)
    size = _median_norm(slope)
    if _median_norm(found) < 1e-6 * size:
        return "it is zero"
    guesses = {
        "it looks like m/s in place of km/s": found / 1e3,
        "it looks like a thousandth of km/s": found * 1e3,
        "its sign looks reversed": -found,
        "it looks inertial, in Earth-fixed columns"
        if axes == "itrs"
        else "it looks relative to the turning Earth, in inertial columns": found - spin
        if axes == "itrs"
        else found + spin,
    }
    off = {text: _median_norm(guess - slope) for text, guess in guesses.items()}
    best = min(off, key=off.__getitem__)
    return best if off[best] < min(_MATCH * max(size, 1.0), 0.3 * _median_norm(found - slope)) else ""
