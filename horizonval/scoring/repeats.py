"""Consistency where only noise acts: one frame, many draws of the detector's noise.

``nees_nadir`` of a row (:mod:`horizonval.scoring.errors`) has all errors in it, those of atmosphere and oblateness too,
over the covariance of noise alone, and ``nees_nadir_total`` has the same errors over all that is claimed. Neither says
whether the *noise* part is honest. Fits of the same frame that differ in nothing but the noise do: their scatter about
their own mean is noise alone, whatever they are all off by. With N draws the deviation from the mean has the share
(N - 1) / N of one draw's covariance, hence

    nees_i = N / (N - 1)  (n_i - mean n)^T C_i^-1 (n_i - mean n)

in the plane across the mean nadir: 2 on average for an honest covariance C_i.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.observation import Fit
from horizonval.geometry.directions import tangent_basis
from horizonval.scoring import limits


def noise_nees(fits: Sequence[Fit]) -> FloatArray:
    """Return the normalised error squared of every draw by its ``covariance_nadir_cam``, 2 degrees of freedom.

    Parameters
    ----------
    fits : sequence of Fit
        Of one frame, N >= 2.

    Raises
    ------
    ValueError
        With fewer than two.
    """
    if len(fits) < 2:
        raise ValueError(f"{len(fits)} draws have no scatter; at least 2 are needed")
    off, covariances = _across_mean(fits)
    squares = np.einsum("ij,ij->i", off, np.linalg.solve(covariances, off[..., None])[..., 0])
    return np.asarray(squares * len(fits) / (len(fits) - 1))


def mean_noise_nees(fits: Sequence[Fit]) -> float | None:
    """Return the mean of :func:`noise_nees`, ``None`` where the fits say nothing of their noise.

    That is with fewer than two of them, and where a claim is not finite or of a direction known perfectly.
    """
    if len(fits) < 2 or not all(np.isfinite(fit.nadir_cam).all() for fit in fits):
        return None
    _, covariances = _across_mean(fits)
    if not np.isfinite(covariances).all():
        return None
    smaller, larger = np.linalg.eigvalsh((covariances + covariances.swapaxes(1, 2)) / 2).T
    if not (smaller > limits.SHARPEST * larger).all():
        return None
    mean = float(noise_nees(fits).mean())
    return mean if np.isfinite(mean) else None


def _across_mean(fits: Sequence[Fit]) -> tuple[FloatArray, FloatArray]:
    """Deviations from the mean nadir, shape (n, 2), and covariances, shape (n, 2, 2), in the plane across it."""
    nadirs = np.array([fit.nadir_cam for fit in fits], dtype=np.float64)
    mean = nadirs.mean(axis=0)
    basis = tangent_basis(mean / np.linalg.norm(mean))
    covariances = np.array([basis.T @ fit.covariance_nadir_cam @ basis for fit in fits], dtype=np.float64)
    return (nadirs - mean) @ basis, covariances
