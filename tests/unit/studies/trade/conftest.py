"""Samples made by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from horizonval.studies.trade.sample import Sample


@pytest.fixture
def make_sample() -> Callable[..., Sample]:
    """Build a sample from nadir errors [deg], NaN for a refusal; half of each error in roll, the rest in pitch."""

    def build(error_deg: Sequence[float], cluster: Sequence[int] | None = None) -> Sample:
        error = np.asarray(error_deg, dtype=np.float64)
        n = len(error)
        claimed = np.isfinite(error)
        return Sample(
            keys=tuple(f"{i:03d}" for i in range(n)),
            cluster=np.arange(n) if cluster is None else np.asarray(cluster),
            claimed=claimed,
            due=np.ones(n, dtype=bool),
            false=np.nan_to_num(error, nan=0.0) > 0.5,
            error_deg=error,
            roll_deg=0.6 * error,
            pitch_deg=0.8 * error,
            seconds=np.full(n, 0.1),
            sun_deg=np.linspace(10.0, 90.0, n),
            right=claimed & ~(np.nan_to_num(error, nan=1.0) > 0.5),
            outcome=tuple("valid" if claim else "dark" for claim in claimed),
        )

    return build
