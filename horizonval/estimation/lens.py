"""What a data sheet says of a lens beside where it maps to: how its blur changes over the field, and its aperture."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from horizonval.core.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Lens:
    """What is told of a lens; without anything its blur is the same all over the field and its aperture wide.

    How soft it is on the whole is left to whoever looks at the image.

    Attributes
    ----------
    angles_rad : ndarray, shape (b,)
        From the axis, rising.
    ratios : ndarray, shape (b,)
        Of the blur there to their root mean square, without diffraction. Between two angles a point's light is shared
        out between both blurs.
    diffraction_px : float
        Mean wavelength times f-number; 0 where rings are no wider than the pixels show.
    """

    angles_rad: FloatArray = field(default_factory=lambda: np.zeros(1))
    ratios: FloatArray = field(default_factory=lambda: np.ones(1))
    diffraction_px: float = 0.0

    def shares(self, off_axis_rad: FloatArray) -> FloatArray:
        """Return the shares of the blurs at angles from the axis (m,), shape (b, m); beyond the ends that of the end.

        Between two angles they are linear in the angle.
        """
        return np.array([np.interp(off_axis_rad, self.angles_rad, one) for one in np.eye(len(self.angles_rad))])

    def in_wider_pixels(self, scale: int) -> Lens:
        """Return the same lens before pixels ``scale`` times as wide."""
        return replace(self, diffraction_px=self.diffraction_px / scale)
