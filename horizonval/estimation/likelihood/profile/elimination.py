r"""A step of the fit's unknowns, with those of the air eliminated first.

With the normal matrix in blocks of the shared unknowns and of the unit unknowns of the air, priors in both, and
``A = L L^T`` (Cholesky)::

    N = [[S, M], [M^T, A]],        C_s = (S - M A^-1 M^T)^-1,        C_a = A^-1 + A^-1 M^T C_s M A^-1

``C_s`` is the covariance of the shared unknowns, ``S^-1`` what it would be if the air were known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.fit import scaled_inverse


@dataclass(frozen=True)
class ProfileStep:
    """A step, and what is known of the shared unknowns.

    Attributes
    ----------
    step : ndarray, shape (s + k,)
        Shared unknowns, then those of the air.
    gained : float
        By how much the squares over variances should be less after it.
    covariance, known : ndarray, shape (s, s)
        Of the shared unknowns; as it is, and as it would be if the air were known.
    air_open : float
        Trace of the covariance of the air's unknowns: of so many of them nothing is determined.
    """

    step: FloatArray
    gained: float
    covariance: FloatArray
    known: FloatArray
    root: FloatArray
    by_shared: FloatArray

    @property
    def air_open(self) -> float:
        inverse = solve_triangular(self.root, np.eye(len(self.root)), lower=True, check_finite=False)
        through = inverse.T @ self.by_shared
        return float(np.sum(inverse**2)) + float(np.sum((through @ self.covariance) * through))


def step_without_air(
    shared: FloatArray, right: FloatArray, mixed: FloatArray, air: FloatArray, right_air: FloatArray
) -> ProfileStep:
    """Solve the equations of a step.

    Parameters
    ----------
    shared : ndarray, shape (s, s)
        With priors.
    right : ndarray, shape (s,)
    mixed : ndarray, shape (s, k)
    air : ndarray, shape (k, k)
        Without the priors of the air's unit unknowns, which are added; written over.
    right_air : ndarray, shape (k,)
        With the pull of their priors.

    Raises
    ------
    numpy.linalg.LinAlgError
        No solution, or unknowns that nothing determines.
    """
    if not (np.isfinite(shared).all() and np.isfinite(right).all() and np.isfinite(air).all()):
        raise np.linalg.LinAlgError("the fit's equations have no solution")
    count = len(shared)
    # A unit normal unknown of the air has the information 1.
    air[np.diag_indices(len(air))] += 1.0
    root = cholesky(air, lower=True, overwrite_a=True, check_finite=False)
    half = solve_triangular(root, np.concatenate([mixed, right_air[None]]).T, lower=True, check_finite=False)
    by_shared, half_air = half[:, :count], half[:, count]
    covariance = scaled_inverse(shared - by_shared.T @ by_shared)
    of_shared = covariance @ (right - by_shared.T @ half_air)
    of_air = solve_triangular(root, half_air - by_shared @ of_shared, lower=True, trans=1, check_finite=False)
    return ProfileStep(
        step=np.concatenate([of_shared, of_air]),
        gained=float(right @ of_shared + right_air @ of_air),
        covariance=covariance,
        known=scaled_inverse(shared),
        root=root,
        by_shared=by_shared,
    )
