"""What the experiment measured, and what its numbers make together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from horizonval.systems.b.rig import runs
from horizonval.systems.b.rig.runs import MOUNTING, BenchRun


@dataclass(frozen=True)
class RigResults:
    """Everything measured.

    Attributes
    ----------
    whole, perfect : BenchRun
        With all imperfections, and with none.
    alone : dict of BenchRun
        With one imperfection each.
    order : tuple of str
        Imperfections by their own RMS, the largest first.
    after : dict of BenchRun
        By the imperfection that was switched off last.
    soft, sharp : BenchRun
        Panel pixels and frame noise behind the camera's lens, and behind one that blurs less.
    """

    whole: BenchRun
    perfect: BenchRun
    alone: Mapping[str, BenchRun]
    order: tuple[str, ...]
    after: Mapping[str, BenchRun]
    soft: BenchRun
    sharp: BenchRun

    def families(self) -> dict[str, float]:
        """Return the shares of three families in the sum of squares of the single imperfections, the floor taken off.

        ``mounting`` of camera and panel, ``accelerometer``, and ``light``: panel pixels, backlight, frame noise.
        """
        excess = {name: max(self._excess(name), 0.0) for name in self.alone}
        total = sum(excess.values())
        reference = (*(name for name in MOUNTING if name.startswith("accelerometer")), runs.REFERENCE_NOISE)
        light = (runs.PIXELS, runs.BACKLIGHT, runs.FRAME_NOISE)
        shares = {
            "accelerometer": sum(excess[name] for name in reference) / total,
            "light": sum(excess[name] for name in light) / total,
        }
        return shares | {"mounting": 1.0 - sum(shares.values())}

    def causes(self) -> dict[str, float]:
        """Return the share of every cause in the sum of squares, the floor taken off."""
        excess = {name: max(self._excess(name), 0.0) for name in self.order}
        total = sum(excess.values())
        return {name: value / total for name, value in excess.items()}

    def switched_off_below(self, limit_deg: float) -> int:
        """Return how many imperfections, the largest first, must go for the RMS to stay below a limit.

        One more than there are where it never does.
        """
        above = [k for k, name in enumerate(self.order) if self.after[name].rms_deg >= limit_deg]
        return above[-1] + 2 if above else 1

    def root_sum_square_deg(self) -> float:
        """Return the RMS that independent imperfections of their single sizes would have together."""
        return math.sqrt(self.perfect.rms_deg**2 + sum(self._excess(name) for name in self.alone))

    def _excess(self, name: str) -> float:
        """Return what an imperfection adds to the mean square [deg2]; noise may make it negative."""
        return self.alone[name].rms_deg ** 2 - self.perfect.rms_deg**2
