"""Every threshold that scoring uses, in one place, each with its reason.

Changing one changes what "available", "false valid" and "expected" mean, hence the accepted baselines: treat a change
as a change of the product, not as tuning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

NADIR_ERROR_LIMIT_RAD = math.radians(0.5)
"""A claimed nadir further off than this is false whatever uncertainty it claims.

Small-satellite Earth sensors are specified to 0.25 deg (NASA state of the art of small spacecraft, guidance chapter);
twice that is of no use to anyone who asked for a horizon sensor.
"""

SIGMA_LIMIT = 5.0
"""A claimed nadir whose Mahalanobis distance from the truth exceeds this many sigma is false, too.

For two Gaussian degrees of freedom chance alone does that in exp(-25/2), 4 frames of a million.
"""

SIGMA_TEST_FLOOR_RAD = math.radians(0.1)
"""Below this error the sigma test is not applied.

Limb methods state the noise of their points, arcseconds at best, while the soft edge of the atmosphere shifts all of
them together by 0.03 to 0.1 deg. That known bias is measured by the error and by the normalised error squared; calling
every such frame a false claim would drown the claims that are dangerous. 0.1 deg is the coarse end of what Earth
horizon sensors are required to deliver (0.03 to 0.1 deg).
"""

DEFAULT_SIGMA_RAD = SIGMA_TEST_FLOOR_RAD / SIGMA_LIMIT
"""Standard deviation, in each of the two directions, by which a claim without a usable covariance is judged: 72 arcsec.

It is the largest with which such a claim is false wherever the sigma test applies. A larger one would make it worth
while to claim nothing; with this one a claim without uncertainty is false whenever it would be with some uncertainty.
"""


@dataclass(frozen=True)
class ClaimLimits:
    """A claim is false beyond ``nadir_error_rad``, or beyond :data:`SIGMA_LIMIT` and above ``sigma_floor_rad``."""

    nadir_error_rad: float
    sigma_floor_rad: float


CONE_LIMITS = ClaimLimits(NADIR_ERROR_LIMIT_RAD, SIGMA_TEST_FLOOR_RAD)
"""Of methods that fit a cone to points, and of all that state nothing else."""
LIKELIHOOD_LIMITS = ClaimLimits(math.radians(0.25), 0.0)
"""Of fits of the pixels' likelihood. They model the limb's height, its relief and the Earth's flattening, and claim
what is left of them: nothing excuses them from the test of their own sigma. 0.25 deg is what small-satellite Earth
sensors are specified to."""


def claim_limits(claim: Literal["cone", "likelihood"]) -> ClaimLimits:
    """Return the limits by which a claim is judged, of the kind that its method states (``Estimator.claim``)."""
    return LIKELIHOOD_LIMITS if claim == "likelihood" else CONE_LIMITS


SMALLEST_SIGMA_RAD = 1e-15
SHARPEST = 1e-15
"""A covariance with a standard deviation below the former, or one variance below so much of the other, claims a
direction to be known perfectly: float64 resolves neither. That is no statistic."""

ASYMMETRY = 1e-6
"""Of the largest element: a matrix whose halves differ by more is no covariance. Rounding to float32 leaves 1e-7."""

ROLL_DEFINED_MIN_COS_PITCH = math.sin(math.radians(1.0))
"""Within 1 deg of pitch = +-90 deg roll is not determined by the nadir, and its error is left empty."""


ACCEPT_RAD = NADIR_ERROR_LIMIT_RAD / 2.5
"""Largest bound of the nadir, root mean square, with which a frame must be answered: 0.2 deg. An honest sensor that is
less sure than the limit of a false claim over 2.5 should not claim."""


@dataclass(frozen=True)
class Thresholds:
    """One set of thresholds of the expected outcome (:mod:`horizonval.scoring.expected`).

    Attributes
    ----------
    arc_fraction : float
        Shortest usable arc, as a share of the image's shorter side. A limb search needs an unbroken stretch.
    lit_zenith_rad : float
        Sun's zenith angle up to which the limb is lit. Beyond 90 deg its lowest sunlit layer rises (6 km at 92.5 deg,
        35 km at 96 deg) and the edge no longer stands at one height.
    snr : float
        Signal-to-noise ratio of a single pixel's step at the limb. Five is Rose's criterion for telling a feature from
        noise (A. Rose, *Vision: Human and Electronic*, 1973).
    veil : float
        Sun's veil at the limb over full scale. A veil of more than this takes the room that the limb's signal needs.
    filling : float
        Brightest thing at the limb with veil, over full scale. A clipped profile no longer shows where the limb is.
    accept_factor : float
        Largest bound of the nadir over the accepted one (``prior.accept_deg``, else :data:`ACCEPT_RAD`).
    row_px : float
        Pixels that a linear array must have to either side of the limb that crosses it, to know both levels of the
        step. The infrared limb falls from a plateau to space over some eight.
    """

    arc_fraction: float
    lit_zenith_rad: float
    snr: float
    veil: float
    filling: float
    accept_factor: float
    row_px: float


NOMINAL = Thresholds(
    arc_fraction=0.25,
    lit_zenith_rad=math.radians(90.0),
    snr=5.0,
    veil=0.6,
    filling=1.0,
    accept_factor=1.0,
    row_px=6.0,
)
STRICT = Thresholds(
    arc_fraction=0.35,
    lit_zenith_rad=math.radians(81.0),
    snr=10.0,
    veil=0.3,
    filling=0.8,
    accept_factor=0.75,
    row_px=12.0,
)
"""What every sensor worth the name must answer. Radiances are known from a table to 30 % (by a factor of three in
twilight), a search loses the ends of an arc, and the scatter of single points differs from method to method."""
LENIENT = Thresholds(
    arc_fraction=0.2,
    lit_zenith_rad=math.radians(97.0),
    snr=1.5,
    veil=1.0,
    filling=1.4,
    accept_factor=2.0,
    row_px=3.0,
)
"""What no sensor should answer: beyond even these a refusal is the only right outcome."""

RIM_PX = 10.0
RIM_FULL_AT_PX = 256.0
"""Width of the rim in which no limb can be followed: a profile across it needs so many pixels to both sides. Smaller
images have narrower windows in proportion."""

LINEAR_PX = 16
"""An image whose shorter side has no more pixels is a linear array: it shows a crossing, never an arc."""

EDGE_SIGMA_PX = math.sqrt(2.0 * math.sqrt(math.pi) * 0.7)
"""Standard deviation of a step's position from one pixel of its length, times the signal-to-noise ratio of a pixel:
``sqrt(2 sqrt(pi) b)`` of a Gaussian edge of b = 0.7 px, whose squared slope is summed across it."""
EDGE_FLOOR_PX = 0.01
"""Least standard deviation of the same: what blur and brightness of the limb, both unknown, leave of it."""
LARGEST_SNR = 1e6
"""Signal-to-noise ratio of a camera without noise, as it is reported."""
BOUND_SAMPLES = 240

ALBEDO_OF_THE_EARTH, ALBEDO_OF_SNOW, ALBEDO_OF_CLOUDS = 0.3, 0.8, 0.8
ALBEDO_OF_ICE_SHEETS, ICE_SHEETS_FROM_DEG = 0.98, 60.0
"""Firn's in visible light, and the latitude poleward of which it lies (the southern tip of Greenland)."""
COLDEST_LIMB_K = 220.0
