"""A row of a night: what one estimator made of one replicate of an image, with what gates group by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from horizonval.core.outcome import Outcome
from horizonval.scoring.row import Score

DIGITS = 4
"""Of arc seconds that are kept: 1e-4 arcsec, 3e-8 deg."""
ERRORS = ("nadir_error_arcsec", "roll_error_arcsec", "pitch_error_arcsec")


@dataclass(frozen=True, kw_only=True)
class ReplicateRow:
    """One estimator on one image of a night; the fields are the columns of a baseline, in its order.

    Attributes
    ----------
    scene, band : str
    replicate : int
        Which draw of the noise.
    estimator : str
    image : str
        Digest of the image's digital numbers.
    status, reason, false_valid, nadir_error_arcsec, roll_error_arcsec, pitch_error_arcsec
        As in :class:`horizonval.scoring.row.Score`; the errors to :data:`DIGITS`.
    table : str
        The suite's table that the scene comes from: its stratum.
    due : bool
        Whether the image should give an attitude, and clearly so.
    bound_arcsec : float or None
        What the limb in the frame allows any method (:mod:`horizonval.scoring.bound`); None where it says nothing.
    """

    scene: str
    band: str
    replicate: int
    estimator: str
    image: str
    status: str
    reason: str | None
    false_valid: bool
    nadir_error_arcsec: float | None
    roll_error_arcsec: float | None
    pitch_error_arcsec: float | None
    table: str = ""
    due: bool = False
    bound_arcsec: float | None = None

    @classmethod
    def of(cls, score: Score, **about: Any) -> ReplicateRow:
        """Return the row of a score; ``about`` are the fields that a score has not."""
        return cls(
            status=score.status,
            reason=score.reason,
            false_valid=score.false_valid,
            nadir_error_arcsec=_rounded(score.nadir_error_arcsec),
            roll_error_arcsec=_rounded(score.roll_error_arcsec),
            pitch_error_arcsec=_rounded(score.pitch_error_arcsec),
            **about,
        )

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> ReplicateRow:
        """Rebuild from :meth:`to_dict`; raises ``TypeError`` for a missing or foreign key."""
        return cls(**data)

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)

    @property
    def key(self) -> tuple[str, str, int, str]:
        """What a row of one night has in common with its partner of another."""
        return self.scene, self.band, self.replicate, self.estimator

    @property
    def error_over_bound(self) -> float | None:
        """Nadir error of a claim over what the limb allows."""
        if self.nadir_error_arcsec is None or not self.bound_arcsec:
            return None
        return self.nadir_error_arcsec / self.bound_arcsec

    @property
    def is_claim(self) -> bool:
        """Whether an attitude was claimed."""
        return self.status == Outcome.VALID


COLUMNS = tuple(field.name for field in fields(ReplicateRow))


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), DIGITS)
