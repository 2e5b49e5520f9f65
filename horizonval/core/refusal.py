"""What is given back where no answer is: one type, whatever refused."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome


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
