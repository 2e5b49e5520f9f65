"""What every rival is handed: a picture of 8 bits, and an answer in the form that the product wants.

Peers read pictures of 8 bits. Theirs is made as a camera with an automatic gain makes it: the full scale in 256
levels, made brighter until all but a thousandth of the pixels are at level 230 or below, fourfold at most. Without a
gain the Earth of a thermal camera that reaches from 0 to 400 K has 60 levels, too few for any peer's own thresholds (it
was added when none of them saw an edge); with more it would make a picture of an empty sky's noise.
"""

from __future__ import annotations

import numpy as np

import horizonval as hv
from horizonval.geometry.frames import inverse, roll_pitch_of_nadir, rotate

SATURATED, BRIGHT, MOST_GAIN = 1e-3, 230.0, 4.0


def grey_8bit(observation: hv.Observation) -> np.ndarray:
    """Return the image in 256 levels; of an image without a known full scale the brightest pixel stands for it."""
    full_scale = observation.full_scale or max(float(observation.image.max()), 1.0)
    levels = observation.image * (255.0 / full_scale)
    bright = max(float(np.quantile(levels, 1.0 - SATURATED)), 1.0)
    gain = min(max(BRIGHT / bright, 1.0), MOST_GAIN)
    return np.clip(np.rint(levels * gain), 0, 255).astype(np.uint8)


def fit_of(
    observation: hv.Observation,
    nadir_cam: np.ndarray,
    points: np.ndarray,
    covariance: np.ndarray | None = None,
    rho_rad: float | None = None,
) -> hv.Fit:
    """Return the answer that a nadir means; no covariance claims no uncertainty."""
    nadir = nadir_cam / np.linalg.norm(nadir_cam)
    roll, pitch = roll_pitch_of_nadir(rotate(inverse(observation.q_cam_from_body), nadir))
    return hv.Fit(
        nadir_cam=nadir,
        covariance_nadir_cam=np.zeros((3, 3)) if covariance is None else covariance,
        roll_rad=float(roll),
        pitch_rad=float(pitch),
        angular_radius_rad=rho_rad,
        points=np.asarray(points, dtype=np.float64),
    )
