"""Orbit and attitude from SPICE kernels, read by ``spiceypy``: SPK, and CK with the clock and frame kernels it needs.

Geometric states of the spacecraft about the Earth in ``J2000``, which is taken for ``gcrs``; no light time. Kernels are
loaded for each question and unloaded after it: they are a state of the whole process.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError

LARGEST_BYTES = 4 * 1024**3


@dataclass(frozen=True)
class SpiceOrbit:
    """A spacecraft, by name or number, in kernels; ``body_axes`` names the frame of its attitude."""

    kernels: tuple[Path, ...]
    spacecraft: str
    epoch_utc: datetime
    body_axes: str | None = None

    def states(self, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions [m] and velocities [m/s] in ``gcrs``, shape (n, 3) each, at times (n,) after the epoch."""
        with _loaded(self.kernels) as spice:
            found = [
                spice.spkezr(self.spacecraft, et, "J2000", "NONE", "EARTH")[0] for et in self._times(spice, seconds)
            ]
        states = 1e3 * np.array(found)
        return states[:, :3], states[:, 3:]

    def body_from_gcrs(self, epoch_utc: datetime, seconds: FloatArray) -> FloatArray:
        """Return matrices, shape (n, 3, 3), at times (n,) after an epoch."""
        offset = (epoch_utc - self.epoch_utc).total_seconds()
        with _loaded(self.kernels) as spice:
            times = self._times(spice, np.asarray(seconds) + offset)
            return np.array([spice.pxform("J2000", self.body_axes, et) for et in times])

    def _times(self, spice: Any, seconds: FloatArray) -> list[float]:
        at = [self.epoch_utc + timedelta(seconds=float(t)) for t in seconds]
        return [
            spice.str2et(time.astimezone(UTC).replace(tzinfo=None).isoformat(timespec="microseconds")) for time in at
        ]


def span_of(kernels: Sequence[Path], spacecraft: str) -> tuple[datetime, datetime]:
    """Return first and last time of the spacecraft's states in the kernels, to whole microseconds within them."""
    with _loaded(kernels) as spice:
        number = spice.bods2c(spacecraft)
        window: Any = None
        for index in range(spice.ktotal("SPK")):
            path = spice.kdata(index, "SPK")[0]
            if number in list(spice.spkobj(path)):
                window = spice.spkcov(path, number) if window is None else spice.spkcov(path, number, window)
        if window is None or spice.wncard(window) == 0:
            raise UserError(f"no states of {spacecraft!r}", where=_names(kernels), expected="an SPK of the spacecraft")
        first, last = spice.wnfetd(window, 0)[0], spice.wnfetd(window, spice.wncard(window) - 1)[1]
        stamps = [spice.et2utc(et, "ISOC", 6) for et in (first, last)]
    ends = [datetime.fromisoformat(stamp).replace(tzinfo=UTC) for stamp in stamps]
    # The last digit is rounded, and may lie outside.
    return ends[0] + timedelta(microseconds=1), ends[1] - timedelta(microseconds=1)


@contextlib.contextmanager
def _loaded(kernels: Sequence[Path]) -> Iterator[Any]:
    """Load kernels, and turn what the library says of them into one line."""
    where = _names(kernels)
    try:
        import spiceypy
    except ImportError:
        raise UserError("spiceypy is not installed", where=where, fix='run `pip install "horizonval[spice]"`') from None
    for path in kernels:
        with files.open_file(path, expected="a SPICE kernel"):
            pass
    loaded: list[str] = []
    try:
        for path in kernels:
            spiceypy.furnsh(str(path))
            loaded.append(str(path))
        yield spiceypy
    except spiceypy.utils.exceptions.SpiceyError as error:
        short = " ".join(str(getattr(error, "short", "") or error).split())
        long = " ".join(str(getattr(error, "long", "") or "").split())
        raise UserError(f"SPICE: {short} {long}"[:300], where=where, expected="kernels that cover the orbit") from error
    finally:
        for name in loaded:
            spiceypy.unload(name)


def _names(kernels: Sequence[Path]) -> str:
    return ", ".join(str(path) for path in kernels)
