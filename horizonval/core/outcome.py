"""What can come of asking an estimator for an attitude: one enum, used everywhere."""

from __future__ import annotations

from enum import StrEnum


class Outcome(StrEnum):
    """Outcome of one estimator on one image, reported (by the estimator) or expected (from truth alone).

    ``crashed`` is never expected, and never right: what was asked gave no answer that can be read.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.estimate("image.exr", "altitude-free").status is hv.Outcome.VALID
    True
    """

    VALID = "valid"
    NO_LIMB = "no_limb"
    SHORT_ARC = "short_arc"
    AMBIGUOUS = "ambiguous"
    SUN_GLARE = "sun_glare"
    DARK = "dark"
    SATURATED = "saturated"
    NOT_CONVERGED = "not_converged"
    BAD_INPUT = "bad_input"
    CRASHED = "crashed"
