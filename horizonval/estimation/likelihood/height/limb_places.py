"""Places along the limb, at which its height is asked for, and what answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from horizonval.core.arrays import FloatArray


@dataclass(frozen=True)
class ArcPlaces:
    """Places along the limb.

    Attributes
    ----------
    los_cam : ndarray, shape (n, 3)
        Unit lines of sight.
    up_cam : ndarray, shape (n, 3)
        Verticals there.
    cam_from_itrs : ndarray, shape (3, 3)
    pixel_m : ndarray, shape (n,)
        Of height in a pixel.
    """

    los_cam: FloatArray
    up_cam: FloatArray
    cam_from_itrs: FloatArray
    pixel_m: FloatArray


class LimbHeights(Protocol):
    """What is known of the limb's height along it; :class:`.uneven_limb.UnevenLimb` is."""

    def along(self, places: ArcPlaces, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the heights above the pose's [m], shape (n,), and their covariance [m^2], shape (n, n).

        Parameters
        ----------
        places : ArcPlaces
        azimuth : ndarray, shape (n,)
            About the nadir [rad].
        """
