"""The results of a design, frame by frame, as arrays; and draws of the conditions for intervals.

Intervals come from drawing the *clusters* of conditions anew with replacement (the cluster bootstrap: A. C. Davison and
D. V. Hinkley, *Bootstrap Methods and their Application*, 1997, section 3.8): a condition drawn alone is a cluster of
its own, the samples of one flight are one together. All designs share the draws, as they share the conditions, so that
differences of designs are drawn in pairs. The draws come from a hash of the study's name and seed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome
from horizonval.scoring.row import Row
from horizonval.spec.expand import seed_of

BoolArray = NDArray[np.bool_]

DRAWS = 1000
CONFIDENCE = 0.95
ARCSEC_PER_DEG = 3600.0
NOT_MADE = "not_made"
SUN_DECIDES = (Outcome.VALID, Outcome.SUN_GLARE, Outcome.SATURATED)
"""Expected outcomes of frames in which the Sun's place decides: not those without a limb or in the dark."""


@dataclass(frozen=True)
class Sample:
    """A design's frames in the order of ``keys``; shape (n,) throughout.

    Attributes
    ----------
    keys : tuple of str
        Condition, and band where there are several: equal keys of two designs are a pair.
    cluster : ndarray of int
        Index of the condition's cluster.
    claimed, due, false : ndarray of bool
        An answer; a frame that must be answered (borderline ones are not among them); a claim that is false.
    error_deg, roll_deg, pitch_deg : ndarray
        Errors of claims, NaN elsewhere.
    sun_deg : ndarray
        The Sun's angle from the boresight where it is in sight and decides, NaN elsewhere.
    right : ndarray of bool
        A claim that is not false.
    outcome : tuple of str
        What was reported; ``not_made`` for a frame that could not be made.
    """

    keys: tuple[str, ...]
    cluster: NDArray[np.int64]
    claimed: BoolArray
    due: BoolArray
    false: BoolArray
    error_deg: FloatArray
    roll_deg: FloatArray
    pitch_deg: FloatArray
    sun_deg: FloatArray
    right: BoolArray
    outcome: tuple[str, ...]

    @property
    def n(self) -> int:
        return len(self.keys)

    def within(self, error_deg: float) -> BoolArray:
        """Return which frames were answered with at most this error."""
        return self.claimed & (np.nan_to_num(self.error_deg, nan=np.inf) <= error_deg)


def sample_of(rows: Mapping[str, Row], cluster_of: Mapping[str, int]) -> Sample:
    """Return the sample of rows of results.

    Parameters
    ----------
    rows : mapping
        Rows of results by key.
    cluster_of : mapping
        Index of the cluster of every key.
    """
    keys = tuple(sorted(rows))
    ordered = [rows[key] for key in keys]

    def flags(values: Sequence[bool]) -> BoolArray:
        return np.array(values, dtype=np.bool_)

    def degrees(values: Sequence[float | None]) -> FloatArray:
        return np.array([np.nan if value is None else value for value in values]) / ARCSEC_PER_DEG

    sun = [
        row.sun_boresight_deg
        if row.sun_boresight_deg is not None and (row.sun_visible_fraction or 0.0) > 0.0 and row.expected in SUN_DECIDES
        else np.nan
        for row in ordered
    ]
    return Sample(
        keys,
        np.array([cluster_of[key] for key in keys], dtype=np.int64),
        flags([row.is_claim for row in ordered]),
        flags([row.is_due for row in ordered]),
        flags([row.false_valid for row in ordered]),
        degrees([row.nadir_error_arcsec for row in ordered]),
        degrees([row.roll_error_arcsec for row in ordered]),
        degrees([row.pitch_error_arcsec for row in ordered]),
        np.array(sun, dtype=np.float64),
        flags([row.is_right for row in ordered]),
        tuple(row.status if row.epoch_utc is not None else NOT_MADE for row in ordered),
    )


def cluster_draws(clusters: int, name: str, seed: int, draws: int = DRAWS) -> FloatArray:
    """Return how often each cluster is drawn, shape (1 + draws, clusters); the first line is the sample itself."""
    random = np.random.default_rng(np.random.SeedSequence(seed_of("study bootstrap", name, seed)))
    counts = random.multinomial(clusters, np.full(clusters, 1.0 / clusters), size=draws)
    return np.concatenate([np.ones((1, clusters)), counts.astype(np.float64)])


def interval_of(values: FloatArray) -> list[float] | None:
    """Return the middle 95 % of drawn values, ``None`` where fewer than 95 % of the draws have any.

    The first value is the estimate and takes no part.
    """
    drawn = values[1:]
    known = drawn[np.isfinite(drawn)]
    if known.size < CONFIDENCE * drawn.size or known.size == 0:
        return None
    low, high = np.percentile(known, [50.0 * (1.0 - CONFIDENCE), 50.0 * (1.0 + CONFIDENCE)])
    return [float(low), float(high)]
