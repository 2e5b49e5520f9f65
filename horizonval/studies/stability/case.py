"""One case of the study as a file holds it: the profiles of one band in one month, as plain data and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.spec.stability import StabilityBand, StabilitySpec
from horizonval.studies.stability.profiles import Profiles

_DIGITS = 8


@dataclass(frozen=True)
class StabilityCase:
    """One band in one month of a study."""

    spec: StabilitySpec
    band: StabilityBand
    month: int

    @property
    def name(self) -> str:
        """What its file is called."""
        return f"{self.band.name}-{self.month:02d}"

    @property
    def key(self) -> tuple[str, int]:
        return self.band.name, self.month


def cases_of(spec: StabilitySpec) -> list[StabilityCase]:
    """Return the cases of a study, band by band."""
    return [StabilityCase(spec, band, month) for band in spec.band for month in spec.months]


def to_plain(profiles: Profiles) -> dict[str, Any]:
    """Return profiles as plain data; radiances keep eight digits."""
    return {
        "height_m": _rounded(profiles.height_m),
        "orbit": [[_rounded(head) for head in position] for position in profiles.orbit],
        "parallels": [_rounded(row) for row in profiles.parallels],
    }


def from_plain(data: Mapping[str, Any]) -> Profiles:
    """Return the profiles that :func:`to_plain` wrote.

    Raises
    ------
    KeyError, TypeError, ValueError
        The data are not such profiles.
    """
    height, orbit, parallels = (np.array(data[key], dtype=np.float64) for key in ("height_m", "orbit", "parallels"))
    n = len(height)
    if orbit.ndim != 3 or orbit.shape[1:] != (4, n) or parallels.ndim != 2 or parallels.shape[1] != n:
        raise ValueError("shapes that do not fit")
    return Profiles(height, orbit, parallels)


def _rounded(values: FloatArray) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in values]
