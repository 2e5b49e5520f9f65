r"""The pose, and the air, that make the pixels of the limb's whole profile most probable: Gauss-Newton.

A pixel whose ray passes at the height ``h`` (:mod:`.ray_height`), between two nodes of azimuth, is ::

    I = b + g l P_s(h - H + c (s^2 + 1/12)) + noise,        P = mean + sum_k a_k f_k

with the profiles of :mod:`.air`, blurred by ``s`` and a lens as sharp as ``q`` (:mod:`.blurred`), linear between the
nodes, and ``l`` the light that the pixel gets of a radiance. ``c (s^2 + 1/12)`` is what a blur of lens and pixel makes
of a bent limb. Unknown are a turn of the camera (3), its position (3), a lift ``H`` of all air, the logarithms of the
blur and of the gain ``g``, ``q``, the background ``b``, and the unit unknowns ``z`` behind the coefficients ``a``.
Every prior is rows of the same equations::

    step = (J^T W J + P)^-1 (J^T W residuals + P (m - now)),        C = (J^T W J + P)^-1

``C`` is what is claimed; of it the part of the first unknowns alone, ``(J_1^T W J_1 + P_1)^-1``, is what it would be if
the air were known. Air that is none of the ensemble's strains its unknowns: the sum of their squares is in the mean as
many as the pixels determine, ``tr(1 - C_z)``. Where it is more by two of its own standard deviations the air's part of
``C`` is larger by the ratio of the two (Birge's, as in :mod:`..fit`). On 128 thermal frames of other air, clouds and
thin clouds errors squared over what is claimed were 1.4 where the ratio was below 1, and 3 to 10 above; the rule was
made after seeing that.

Where the converter's floor cuts noise off, what a pixel shows in the mean is not ``I``: see :mod:`.floor`. The noise is
that of :mod:`.noise`. Where neighbouring residuals are alike, what they show counts less by how much more
their sums over squares scatter than independent ones would, of the size of squares where that is most.

**Neglected.** That residuals may be alike over more than the largest square.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.fit import SCATTERED
from horizonval.estimation.likelihood.knowledge import LimbPose
from horizonval.estimation.likelihood.profile.air import NodeAir
from horizonval.estimation.likelihood.profile.knowledge import ProfileFit, ProfileKnowledge
from horizonval.estimation.likelihood.profile.model import POSE, Guess, ProfileModel, Seen
from horizonval.estimation.likelihood.profile.search import ProfileSearch, explained
from horizonval.geometry.camera import CameraModel


def fit_profile(
    image: FloatArray,
    camera: CameraModel,
    start: LimbPose,
    knowledge: ProfileKnowledge,
) -> ProfileFit:
    """Fit the limb's profile near a pose that is right to some kilometres of height at the limb.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Grey levels, linear in radiance; NaN where a pixel tells nothing.
    camera : CameraModel
    start : LimbPose
    knowledge : ProfileKnowledge

    Raises
    ------
    numpy.linalg.LinAlgError
        Too little limb in view, no light where it should be, or no convergence.
    """
    found = ProfileSearch(image, camera, start, knowledge).run()
    look, now = found.look, found.now
    uv, off = by_sector(found.model, look, now, found.inverse_variance)
    growth, growth_sigma = found.growth()
    of_air = (found.covariance - found.known)[:POSE, :POSE] * strained(*found.strain())
    return ProfileFit(
        pose=found.pose,
        blur_px=now.blur,
        gain=now.gain,
        background=now.background,
        covariance=found.known[:POSE, :POSE] + of_air,
        relief_covariance=of_air,
        improbable=improbable(found.model.air, now.air),
        explained=explained(found.model, look, found.noise),
        uv=uv,
        residuals_rad=off,
        steps=np.array(found.steps),
        growth=growth,
        growth_sigma=growth_sigma,
    )


def strained(squares: float, determined: float) -> float:
    """Return by how much unit unknowns scatter more than they should, 1 where chance may do so.

    Parameters
    ----------
    squares : float
        Their sum.
    determined : float
        How many of them are determined: the mean of ``squares``, whose variance is twice as much.
    """
    ratio = squares / max(determined, 1e-300)
    return ratio if determined > 0.0 and ratio > 1.0 + SCATTERED * np.sqrt(2.0 / determined) else 1.0


def improbable(air: NodeAir, unknowns: FloatArray) -> float:
    """Return the largest coefficient of any function of the air in its own standard deviations."""
    sizes = [float(np.sqrt((wave**2).sum(axis=1).max())) for wave in air.waves]
    largest = np.abs(air.coefficients(unknowns)[:, 1:]).max(axis=0)
    return float(np.max(largest / np.array(sizes)))


def by_sector(
    model: ProfileModel, look: Seen, now: Guess, inverse_variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a place on the limb for every sector, and by how much its pixels would have the limb farther in [rad]."""
    near = model.near
    # The lift lowers all distances across the limb alike.
    per_rad = -now.gain * near.light * look.kept * look.changes[0] * model.by_pose[6] * near.ray.distance_m
    weights = inverse_variance * per_rad
    uv, off = [], []
    for first, last in pairwise(near.starts):
        here = slice(first, last)
        information = float(weights[here] @ per_rad[here])
        off.append(-float(weights[here] @ look.residuals[here]) / information if information > 0.0 else 0.0)
        nearest = first + int(np.argmin(np.abs(near.ray.height_m[here])))
        uv.append([near.pixels.columns[nearest], near.pixels.rows[nearest]])
    return np.array(uv, dtype=float), np.array(off)
