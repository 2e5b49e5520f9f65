r"""How high the limb stands along its arc, and how that may differ from what is known: for the relief of a fit.

From the shipped profiles of the band (:mod:`.band_heights`), where the limb is and as the Sun stands there::

    height(phi) = mean(phi) + sum over modes of  p_k(phi) g_k(phi)

with functions ``g_k`` of variance 1, alike at two places as :mod:`.alike` has it. What is not known of the Sun is in
it, too: the error of a Sun sensor as two patterns more, and where there is none every Sun that lights the whole arc,
all alike likely. The same where a thermal band's place is not known: of all latitudes and months the spread is one
number for the whole arc, and what changes along it is the relief that was measured
(:mod:`horizonval.earth.limb_heights`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief
from horizonval.estimation.likelihood.height.alike import correlations
from horizonval.estimation.likelihood.height.band_heights import BandHeights, EdgeHeights
from horizonval.estimation.likelihood.height.limb_places import ArcPlaces
from horizonval.geometry.rotation import fibonacci_sphere, tangent_basis

SUN_SIGMA_RAD = math.radians(0.5)
"""Of a coarse Sun sensor, right to a degree."""
SUNS = 64
"""Evenly over the sphere, for one that is not known."""
LATITUDES, MONTHS = 19, 12
"""Of a place that is not known."""


@dataclass(frozen=True)
class UnevenLimb:
    """What is known of a band's limb.

    Attributes
    ----------
    heights : BandHeights
    sun_cam : ndarray, shape (3,), or None
        Of a sunlit band.
    sun_sigma_rad : float
        Of each of its two angles.
    month : float or None
        Of a thermal band whose place is known by the pose; None where it is not.
    thermal : bool
    reliefs : tuple of Relief
        What changes along the limb of an unknown place.
    typical_m : float or None
        The height that departures are from, which then has a prior of its own; None for the mean along the arc.
    """

    heights: BandHeights
    sun_cam: FloatArray | None
    sun_sigma_rad: float
    month: float | None
    thermal: bool
    reliefs: tuple[Relief, ...] = ()
    typical_m: float | None = None

    def along(self, places: ArcPlaces, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the heights [m], shape (n,), and their covariance [m^2], shape (n, n).

        Parameters
        ----------
        places : ArcPlaces
        azimuth : ndarray, shape (n,)
            About the nadir [rad].
        """
        if self.thermal:
            mean, covariance = self._thermal(places, azimuth)
        else:
            mean, covariance = self._sunlit(places)
        if self.typical_m is not None:
            return mean - self.typical_m, covariance
        level = np.eye(len(mean)) - 1.0 / len(mean)
        return level @ mean, level @ covariance @ level

    def _thermal(self, places: ArcPlaces, azimuth: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self.month is not None:
            latitude = np.arcsin(np.clip((places.up_cam @ places.cam_from_itrs)[:, 2], -1.0, 1.0))
            edge = self.heights.at(places.pixel_m, latitude, np.full(len(latitude), self.month))
            return edge.mean_m, _covariance(edge, places)
        # The mean over the sphere: latitudes whose sines are even.
        latitude = np.repeat(np.arcsin(np.linspace(-1.0, 1.0, LATITUDES)), MONTHS)
        month = np.tile(np.arange(1.0, MONTHS + 1.0), LATITUDES)
        edge = self.heights.at(np.full(len(month), np.median(places.pixel_m)), latitude, month)
        variance = float(np.var(edge.mean_m) + np.mean((edge.patterns_m**2).sum(axis=0)))
        apart = np.abs(azimuth[:, None] - azimuth[None, :])
        apart = np.minimum(apart, 2.0 * np.pi - apart)
        covariance = np.full((len(azimuth), len(azimuth)), variance)
        for relief in self.reliefs:
            covariance += relief.sigma_m**2 * np.exp(-0.5 * (apart / relief.correlation_rad) ** 2)
        return np.full(len(azimuth), float(edge.mean_m.mean())), covariance

    def _sunlit(self, places: ArcPlaces) -> tuple[FloatArray, FloatArray]:
        if self.sun_cam is not None:
            edge = self._under(places, self.sun_cam)
            covariance = _covariance(edge, places)
            for across in tangent_basis(self.sun_cam).T:
                moved = self.sun_cam + self.sun_sigma_rad * across
                change = self._under(places, moved / np.linalg.norm(moved)).mean_m - edge.mean_m
                covariance += np.outer(change, change)
            return edge.mean_m, covariance
        suns = fibonacci_sphere(SUNS)
        lit = (suns @ places.up_cam.T >= 0.0).all(axis=1)
        suns = suns[lit] if lit.any() else places.up_cam.mean(axis=0)[None]
        edges = [self._under(places, sun / np.linalg.norm(sun)) for sun in suns]
        heights = np.array([edge.mean_m for edge in edges])
        mean = heights.mean(axis=0)
        spread = (heights - mean).T @ (heights - mean) / len(heights)
        return mean, spread + np.mean([_covariance(edge, places) for edge in edges], axis=0)

    def _under(self, places: ArcPlaces, sun_cam: FloatArray) -> EdgeHeights:
        cosine = np.clip(places.up_cam @ sun_cam, -1.0, 1.0)
        level = sun_cam - cosine[:, None] * places.up_cam
        length = np.maximum(np.linalg.norm(level, axis=1), 1e-9)
        ahead = np.einsum("ij,ij->i", level, places.los_cam) / length
        return self.heights.at(places.pixel_m, np.arccos(cosine), np.arccos(np.clip(ahead, -1.0, 1.0)))


def _covariance(edge: EdgeHeights, places: ArcPlaces) -> FloatArray:
    """Return what the patterns make of the heights [m^2], shape (n, n)."""
    alike = correlations(edge.correlation_rad, places.up_cam, places.cam_from_itrs[:, 2])
    return np.asarray(np.einsum("ki,kj,kij->ij", edge.patterns_m, edge.patterns_m, alike))
