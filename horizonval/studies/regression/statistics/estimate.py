"""What a gate knows about a difference: how large it is, how sure that is, how likely chance alone would do it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

PASS_CONFIDENCE = 0.95
FAIL_CONFIDENCE = 0.99


@dataclass(frozen=True)
class Estimate:
    """A difference "now minus baseline", positive where now is worse, in the gate's unit.

    Attributes
    ----------
    value : float
    lower95, upper95 : float
        One-sided 95 % bounds: what PASS needs.
    lower99, upper99 : float
        One-sided 99 % bounds: what FAIL and IMPROVED need.
    p_worse, p_better : float
        One-sided p-values of "no difference" against worse and against better.
    n : int
        Pairs (or values of the present night, where there are no pairs).
    clusters : int
        Independent ones among them: scenes.
    """

    value: float
    lower95: float
    upper95: float
    lower99: float
    upper99: float
    p_worse: float
    p_better: float
    n: int
    clusters: int

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; bounds that are infinite (too little data) as None."""
        return {key: value if abs(value) != float("inf") else None for key, value in asdict(self).items()}


def exact(value: float, n: int, clusters: int) -> Estimate:
    """Return the estimate of a difference that is the same in every scene: there is no chance in it."""
    worse, better = (0.0 if value > 0 else 1.0), (0.0 if value < 0 else 1.0)
    return Estimate(value, value, value, value, value, worse, better, n, clusters)
