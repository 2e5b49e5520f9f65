"""What the Sun makes of a sunlit limb's height, for a method whose limb stands at one height: added to what it claims.

Towards the terminator the limb rises, and a method that takes it for even is tilted by it. Where the Sun's direction is
known the heights are (:mod:`horizonval.estimation.limb.model.sunlit`), and so is the tilt that they make of a cone: the
whole of it is one standard deviation of the model's error, with that of the table's own patterns. Where it is not known
every Sun that lights the whole arc is taken for equally likely.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from horizonval.core.outcome import Outcome
from horizonval.core.refusal import Refusal
from horizonval.estimation.guard import guard_limits as limits
from horizonval.estimation.guard.limb_model import blur_of
from horizonval.estimation.limb.model.height_perturbation import cone_perturbation, unknown_sun_covariance
from horizonval.estimation.limb.model.sunlit import sunlit_limb
from horizonval.estimation.observation import Fit, Observation
from horizonval.geometry.camera import unproject
from horizonval.geometry.directions import off_axis_angle, tangent_basis


def with_uneven_light(fit: Fit, observation: Observation) -> Fit | Refusal:
    """Return a fit whose model error has the uneven height of a sunlit limb, or why there is too little lit limb.

    Parameters
    ----------
    fit : Fit
        Of a method that takes a sunlit limb for even; its points lie along the limb.
    observation : Observation
    """
    if observation.band_kind != "solar":
        return fit
    axis = np.asarray(fit.nadir_cam)
    los = unproject(observation.camera, fit.points)
    los = los[np.isfinite(los).all(axis=1)]
    rho = float(off_axis_angle(los, axis).mean()) if len(los) else 0.0
    radius = observation.prior.sphere_radius_m
    try:
        blur = blur_of(los, axis, observation)
        if observation.sun_cam is None:
            covariance = unknown_sun_covariance(los, axis, rho, blur, radius, observation.band_um)
        else:
            sigma = observation.prior.sun_sigma_rad
            sun_sigma = limits.SUN_SIGMA_RAD if sigma is None else sigma
            limb = sunlit_limb(los, axis, rho, observation.sun_cam, blur, sun_sigma, observation.band_um)
            lit = np.isfinite(limb.height_m)
            rise = limb.height_m[lit] - limb.height_m[lit].mean() if lit.any() else limb.height_m[lit]
            moved = cone_perturbation(los[lit], axis, rho, np.vstack([rise, limb.patterns_m[:, lit]]), radius)
            covariance = moved.T @ moved
    except np.linalg.LinAlgError:
        return Refusal(Outcome.DARK, "the limb that the Sun lights does not determine a cone", fit.points)
    basis = tangent_basis(axis)
    own = np.zeros((3, 3)) if fit.systematic_nadir_cam is None else fit.systematic_nadir_cam
    return replace(fit, systematic_nadir_cam=own + basis @ covariance[:2, :2] @ basis.T)
