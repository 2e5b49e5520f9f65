"""States that contradict themselves: velocities against positions, and motion against the axes.

**Axes.** In axes that turn with the Earth a satellite has the accelerations of Coriolis and of the centrifugal force
beyond the pull of the Earth. If the second differences of positions that are said to be inertial show them, or those of
Earth-fixed positions show their opposite, the axes are the other ones.

**Velocities** are the rates of change of the positions.

Between two states h apart the mean velocity is known twice: from the positions, and from the velocities by the
corrected trapezoidal rule (Euler and Maclaurin), with the pull of the Earth as the acceleration a::

    (r1 - r0) / h = (v0 + v1) / 2 - (h / 12) (a1 - a0) + O(h^4)

The difference of the two may be as large as

* the rule's remainder, R w^5 h^4 / 720 for a circle of radius R and rate w, times 120 for a perigee between the states;
* somewhat more than half of a lasting step of velocity, since a manoeuvre may lie between the states: what the
  velocities change by beyond the pull, over this interval and the one before *and* over this and the next;
* four times the noise, the median change of the difference from interval to interval: a wrong unit, sign or frame
  changes it slowly, rounded or measured positions do not;
* 3 m/s, more than a Kepler ellipse's velocity lacks of a drifting one's.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations, product

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
LARGEST_NOISE_M, LARGEST_ROUNDING_M_S = 1000.0, 5.0
"""Of positions and of velocities: what is given in whole kilometres, and to 0.01 km/s."""
SPEEDS_M_S = (1.0, 20e3)
"""Least and greatest speed, among the stars."""
_FEWEST_FOR_NOISE = 5
_MATCH = 0.03
"""Relative difference up to which a hypothesis explains a velocity."""

States = tuple[FloatArray, FloatArray]


def check_axes(axes: Axes, seconds: FloatArray, r_gcrs: FloatArray, where: str) -> None:
    """Refuse positions (m, 3) that move as Earth-fixed ones in inertial axes, or the reverse."""
    if len(seconds) < 3:
        return
    stride = max(1, min(round(SPAN_S / float(np.median(np.diff(seconds)))), (len(seconds) - 1) // 2))
    before, here, after = (slice(0, -2 * stride), slice(stride, -stride), slice(2 * stride, None))
    h0, h1 = seconds[here] - seconds[before], seconds[after] - seconds[here]
    pull = -GM_M3_PER_S2 * r_gcrs / np.linalg.norm(r_gcrs, axis=1, keepdims=True) ** 3
    rate = np.sqrt(np.linalg.norm(pull, axis=1) / np.linalg.norm(r_gcrs, axis=1))[here]
    even = (np.abs(h1 - h0) < 1e-3 * h0) & (rate * h0 < 1.0) & (h0 >= SHORTEST_S)
    if not even.any():
        return
    r0, r, r1 = (r_gcrs[part][even] for part in (before, here, after))
    h = h0[even][:, None]
    # Numerov's rule: the mean of the pull over the three instants, so that the steps may be long.
    mean_pull = (pull[before] + 10.0 * pull[here] + pull[after])[even] / 12.0
    beyond = (r1 - 2.0 * r + r0) / h**2 - mean_pull
    v = (r1 - r0) / (2.0 * h)
    size = float(np.median(np.linalg.norm(beyond, axis=1)))
    turning = np.array([0.0, 0.0, EARTH_RATE_RAD_S if axes != "itrs" else -EARTH_RATE_RAD_S])
    expected = -2.0 * np.cross(turning, v) - np.cross(turning, np.cross(turning, r))
    if float(np.median(np.linalg.norm(beyond - expected, axis=1))) < 0.3 * size:
        moves, named = ("Earth-fixed", "inertial") if axes != "itrs" else ("inertial", "Earth-fixed")
        raise UserError(
            f"the states move as in {moves} axes, but are said to be {named}",
            where=where,
            expected=f"{named} states",
            fix="name the axes of the states",
        )


def check(
    axes: Axes,
    given: tuple[FloatArray, FloatArray, FloatArray],
    gcrs: States,
    gaps: NDArray[np.bool_],
    place: Callable[[int], str],
) -> None:
    """Refuse velocities that contradict the positions, naming the first state and the likely cause.

    ``given``: times (m,), positions and velocities (m, 3) along ``axes``; ``gcrs``: the same states along
    inertial axes. Intervals (m - 1,) that are gaps are left out. ``place``: name of a state, by its index.
    """
    off, allowed = _difference(given[0], *gcrs)
    wrong = (np.linalg.norm(off, axis=1) > allowed) & ~gaps
    if not wrong.any():
        _check_speed(gcrs[1], place)
        return
    first = int(np.flatnonzero(wrong)[0])
    whole = bool(wrong[~gaps].mean() > 0.5)
    # The state that two wrong intervals share is the wrong one.
    state = first if whole or (first == 0 and not wrong[1:2].any()) else first + 1
    raise UserError(
        f"the velocity is {np.linalg.norm(off[first]) / 1e3:.3g} km/s off the rate of change of the positions: "
        + (_cause(axes, given, wrong) or "another unit, satellite or instant, or a wrong digit?"),
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
    """Return the difference of the mean velocities of each interval, (m - 1, 3), and how large it may be [m/s]."""
    h = np.diff(seconds)[:, None]
    distance = np.linalg.norm(r, axis=1, keepdims=True)
    pull = -GM_M3_PER_S2 * r / distance**3
    off = np.diff(r, axis=0) / h - (v[1:] + v[:-1]) / 2.0 + h / 12.0 * np.diff(pull, axis=0)
    gained = np.concatenate([np.zeros((1, 3)), np.cumsum(h * (pull[1:] + pull[:-1]) / 2.0, axis=0)])
    beyond = v - gained
    h, lowest = h[:, 0], np.minimum(distance[1:], distance[:-1])[:, 0]
    if len(seconds) == 2:
        step = np.linalg.norm(np.diff(beyond, axis=0), axis=1)
    else:
        wide = np.linalg.norm(beyond[2:] - beyond[:-2], axis=1)
        step = np.minimum(np.append(wide, wide[-1]), np.insert(wide, 0, wide[0]))
    rate = np.sqrt(GM_M3_PER_S2 / lowest**3)
    noise = 4.0 * (LARGEST_NOISE_M / h + LARGEST_ROUNDING_M_S)
    if len(seconds) >= _FEWEST_FOR_NOISE:
        noise = np.minimum(noise, 4.0 * float(np.median(np.linalg.norm(np.diff(off, n=2, axis=0), axis=1))))
    remainder = 120.0 / 720.0 * lowest * rate * (rate * h) ** 4
    return off, FLOOR_M_S + STEP_SHARE * np.minimum(step, LARGEST_STEP_M_S) + noise + np.minimum(
        remainder, LARGEST_STEP_M_S
    )


def _cause(axes: Axes, given: tuple[FloatArray, FloatArray, FloatArray], wrong: NDArray[np.bool_]) -> str:
    """Return what the velocities of wrong intervals look like; empty where nothing explains them."""
    seconds, r, v = (x for x in given)
    h = np.diff(seconds)[:, None]
    middle, found = (r[1:] + r[:-1])[wrong] / 2.0, (v[1:] + v[:-1])[wrong] / 2.0
    slope = (np.diff(r, axis=0) / h)[wrong]
    spin = np.cross([0.0, 0.0, EARTH_RATE_RAD_S], middle)
    size = float(np.median(np.linalg.norm(slope, axis=1)))
    if float(np.median(np.linalg.norm(found, axis=1))) < 1e-6 * size:
        return "it is zero"
    guesses: list[tuple[str, FloatArray]] = [
        ("it looks like m/s in place of km/s", found / 1e3),
        ("it looks like a thousandth of km/s", found * 1e3),
        ("it looks like km/h in place of km/s", found / 3600.0),
        ("its sign looks reversed", -found),
    ]
    if axes == "itrs":
        guesses.append(("it looks inertial, in Earth-fixed columns", found - spin))
    else:
        guesses.append(("it looks relative to the turning Earth, in inertial columns", found + spin))
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            guesses.append(("its components look swapped or reversed", found[:, order] * signs))
    off = [float(np.median(np.linalg.norm(guess - slope, axis=1))) for _, guess in guesses]
    best = int(np.argmin(off))
    # Velocities as they are come again as one of the orders.
    plain = float(np.median(np.linalg.norm(found - slope, axis=1)))
    return guesses[best][0] if off[best] < min(_MATCH * max(size, 1.0), 0.3 * plain) else ""
