"""Requirements on a sensor, as suites and studies state them in ``[[requirement]]``."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model, Name, Positive, unit

Share = Annotated[float, Field(gt=0, lt=1), unit("1")]
LATENCY_SHARE = 0.95
"""Default share of estimates that must keep a latency."""
WORDS = {"nadir": "the nadir", "roll": "roll", "pitch": "pitch", "each": "roll and pitch each"}


class Requirement(Model):
    """A share of frames that must keep a limit, shown with a confidence.

    | given | the frames counted | of |
    |---|---|---|
    | `error_deg` and `availability` | answers within the error; a refusal is a miss | all frames |
    | `error_deg` and `n_sigma` or `quantile` | answers within the error | all answers |
    | `availability` alone | answers | all frames |
    | `false_claims` | answers that are not false | all answers |
    | `latency_s` | estimates within the processor time | all timed frames |
    """

    id: Name
    """Identifier, such as the number in the requirements document."""
    text: str = ""
    """The requirement in words, for the page."""
    error_deg: Positive | None = None
    """Largest error."""
    axis: Literal["nadir", "roll", "pitch", "each"] = "nadir"
    """What the error is: the angle between claimed and true nadir, roll, pitch, or roll and pitch judged separately."""
    n_sigma: Annotated[float, Field(gt=0, le=6), unit("1")] | None = None
    """The share of answers within the error: a normal distribution has it within n sigma, 3 means 99.73 %."""
    quantile: Share | None = None
    """The share of answers within the error, or of estimates within the latency (0.95 by default)."""
    availability: Share | None = None
    """The share of all frames with an answer; with `error_deg`, with an answer within the error."""
    false_claims: Share | None = None
    """Largest share of false claims among all answers."""
    latency_s: Positive | None = None
    """Largest processor time of an estimate, on the machine that runs the frames."""
    confidence: Annotated[float, Field(ge=0.5, lt=1), unit("1")] = 0.95
    """Confidence, one-sided, of a requirement that is met or not met."""

    @model_validator(mode="after")
    def _one_limit(self) -> Requirement:
        shares = [key for key in ("n_sigma", "quantile", "availability") if getattr(self, key) is not None]
        limits = [key for key in ("error_deg", "false_claims", "latency_s") if getattr(self, key) is not None]
        if len(limits) > 1 or not (limits or shares == ["availability"]):
            raise ValueError("give one of error_deg, availability, false_claims and latency_s")
        if limits == ["error_deg"] and len(shares) != 1:
            raise ValueError("error_deg needs one of n_sigma, quantile and availability")
        if limits == ["false_claims"] and shares:
            raise ValueError(f"false_claims is a share already; take {shares[0]} out")
        if limits == ["latency_s"] and set(shares) - {"quantile"}:
            raise ValueError(f"latency_s goes with quantile, not with {shares[0]}")
        if self.axis != "nadir" and self.error_deg is None:
            raise ValueError("axis goes with error_deg")
        return self

    @property
    def share(self) -> float:
        """The share of the counted frames that must keep the limit."""
        if self.false_claims is not None:
            return 1.0 - self.false_claims
        if self.n_sigma is not None:
            return math.erf(self.n_sigma / math.sqrt(2.0))
        return self.availability or self.quantile or LATENCY_SHARE

    @property
    def in_words(self) -> str:
        """The requirement as a phrase, such as ``0.05 deg in 99 % of all conditions``."""
        percent = f"{100.0 * self.share:.6g} %"
        if self.false_claims is not None:
            return f"at most {100.0 * self.false_claims:.6g} % of all answers false"
        if self.latency_s is not None:
            return f"{percent} of all estimates within {self.latency_s:g} s of processor time"
        if self.error_deg is None:
            return f"an answer in {percent} of all conditions"
        what = "" if self.axis == "nadir" else f"{WORDS[self.axis]} "
        if self.availability is not None:
            return f"{what}{self.error_deg:g} deg in {percent} of all conditions"
        level = f"{self.n_sigma:g} sigma" if self.n_sigma is not None else percent
        return f"{what}{self.error_deg:g} deg at {level} of all answers"

    @property
    def counted(self) -> str:
        """What the frames that keep the limit are, such as ``frames within 0.05 deg``."""
        if self.error_deg is not None:
            return f"{'answers' if self.availability is None else 'frames'} within {self.error_deg:g} deg"
        if self.latency_s is not None:
            return f"estimates within {self.latency_s:g} s"
        return "frames answered" if self.false_claims is None else "answers not false"
