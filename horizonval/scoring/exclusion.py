"""The exclusion angle: how far from the boresight the Sun must stay.

It is the smallest tested angle from which on *every* frame was answered rightly, with a claim that is not false. One
wrong or refused frame further out moves it there, because a mission cannot fly round single frames.
"""

from __future__ import annotations

from collections.abc import Sequence


def exclusion_angle_deg(angle_deg: Sequence[float], right: Sequence[bool]) -> float | None:
    """Return the smallest angle from which on every answer is right; None if the widest one is wrong already.

    Parameters
    ----------
    angle_deg : sequence of float
        Of the Sun from the boresight; several frames may share one.
    right : sequence of bool
    """
    wrong = [angle for angle, good in zip(angle_deg, right, strict=True) if not good]
    widest_wrong = max(wrong, default=-1.0)
    return min((angle for angle in angle_deg if angle > widest_wrong), default=None)
