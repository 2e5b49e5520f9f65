"""From where the horizon lies in every profile to the nadir and its covariance, by least squares with priors.

A profile at azimuth ``a`` whose horizon lies ``d`` outside of where it was thought to be is a row::

    d = t1 cos a + t2 sin a + r + q1 cos 2a + q2 sin 2a,    t: tilt of the nadir,  r: of the radius,  q: of the shape

``r`` is the height of the limb's light that profiles do not tell, and of a known altitude its error; unknown without
one. ``q`` and a second tilt, which no image tells from the first, are what the shape of the horizon and the air along
it are off by. What all of them are, in kilometres at the limb, was measured on the frames of the training.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Model:
    """Standard deviations of what is not known of a limb: [km] at its distance, each component.

    ``spread``: by what the variance of profiles is larger than they say, since neighbours err together.
    """

    spread: float
    tilt_km: float
    shape_km: float
    height_km: float

    def numbers(self) -> np.ndarray:
        """Return them in their order, shape (4,)."""
        return np.array(astuple(self))


def rows_of(azimuth_rad: np.ndarray) -> np.ndarray:
    """Return the rows of profiles, shape (n, 5)."""
    a = azimuth_rad
    return np.stack([np.cos(a), np.sin(a), np.ones_like(a), np.cos(2.0 * a), np.sin(2.0 * a)], axis=-1)


def solve(
    normal: np.ndarray, right: np.ndarray, model: Model, limb_km: ArrayLike, radius_sigma_rad: ArrayLike
) -> tuple[np.ndarray, np.ndarray]:
    """Return the five unknowns [rad] and their covariance [rad^2], of one image or of many along the first axis.

    Parameters
    ----------
    normal, right : ndarray, shape (..., 5, 5) and (..., 5)
        Normal equations of the rows.
    model : Model
    limb_km : array_like, shape (...)
        Distance to the limb.
    radius_sigma_rad : array_like, shape (...)
        Of the radius beside the limb's own height: what the altitude is not known to.
    """
    limb = np.asarray(limb_km, float)
    height = np.hypot(model.height_km / limb, np.asarray(radius_sigma_rad, float))
    shape = model.shape_km / limb
    none = np.zeros_like(limb)
    precision = np.stack([none, none, 1.0 / height**2, 1.0 / shape**2, 1.0 / shape**2], axis=-1)
    total = normal / model.spread + precision[..., None] * np.eye(5)
    covariance = np.linalg.inv(total)
    unknowns = (covariance @ (right / model.spread)[..., None])[..., 0]
    tilt = np.zeros((5, 5))
    tilt[0, 0] = tilt[1, 1] = 1.0
    return unknowns, covariance + ((model.tilt_km / limb) ** 2)[..., None, None] * tilt
