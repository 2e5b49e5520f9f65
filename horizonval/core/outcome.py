"""What can come of asking an estimator for an attitude: one enum, and one type for an answer that is withheld."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Literal

import numpy as np

from horizonval.core.arrays import FloatArray


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


@dataclass(frozen=True)
class Refusal:
    """An answer withheld, and why: by a search for the limb, a guard, an estimator, or what runs one.

    A refusal is false, so that ``if fit:`` asks whether there is an answer.

    Attributes
    ----------
    status : Outcome
        Never ``valid``.
    reason : str
        One line for people.
    points : ndarray, shape (n, 2)
        Limb points found before the refusal, (column, row) [px]; empty where none were.
    output : str
        Of a crash: the last lines that were printed, and the traceback.

    Examples
    --------
    >>> import horizonval as hv
    >>> refusal = hv.Refusal(hv.Outcome.DARK, "no pixel is above the noise")
    >>> refusal
    <Refusal dark: no pixel is above the noise>
    >>> bool(refusal)
    False
    """

    status: Outcome
    reason: str
    points: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    output: str = ""

    def __repr__(self) -> str:
        return f"<Refusal {self.status}: {self.reason}>"

    def __bool__(self) -> Literal[False]:
        return False

    def of_head(self, name: str) -> Refusal:
        """Return the same refusal with the name of the head whose image it is about."""
        return replace(self, reason=f"head {name}: {self.reason}")
