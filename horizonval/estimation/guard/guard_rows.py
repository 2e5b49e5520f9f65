"""The guard for linear arrays: one row of pixels across the limb, one crossing from each head.

A row shows neither curvature nor a length of limb. What can be asked of it:

* nothing in it is saturated: the Sun's disc is a step far larger than the limb's;
* it has one edge. Levelled to 0 in space and 1 on the Earth it stays low beyond the limb, and high and of the limb's
  own size within: a second edge, a disc or a cloud that reaches half of the step leaves open which one is the limb;
* its bright side lies towards the nadir of the answer.

What can be asked of all rows together, three unknowns and four crossings: that they lie on one cone. The Earth is no
sphere, and its poles may lie anywhere: the crossings must fit an ellipsoid with *some* direction of the poles, to the
crossings' noise and the relief of the limb. With ``w = W^T r`` the residuals of the cone in the directions that it
leaves free (``W^T J = 0``) ::

    chi^2 = min over poles p of (w - w_p)^T C^-1 (w - w_p),      C = W^T (noise + relief) W
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import null_space
from scipy.ndimage import gaussian_filter1d
from scipy.stats import chi2

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import oblate_limbs, relief_covariance, reliefs
from horizonval.estimation.guard import guard_limits as limits
from horizonval.estimation.limb.crossing import Crossing, row_noise, sub_pixel_crossing
from horizonval.estimation.limb.model.trusted import SATURATED_SHARE
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import unproject
from horizonval.geometry.rotation import off_axis_angle, tangent_basis


@dataclass(frozen=True)
class RowLimb:
    """A row's crossing.

    Attributes
    ----------
    los_cam : ndarray, shape (3,)
        Line of sight to it.
    sigma_rad : float
        Its standard deviation along the row.
    to_bright_cam : ndarray, shape (3,)
        Vector along the row towards the bright side.
    """

    los_cam: FloatArray
    sigma_rad: float
    to_bright_cam: FloatArray

    def bright_side_down(self, nadir_cam: FloatArray) -> bool:
        """Return whether the bright side is the one nearer a nadir."""
        return float(self.to_bright_cam @ nadir_cam) > 0.0


def is_row(observation: Observation) -> bool:
    """Return whether an image is a linear array's: too narrow for a profile across it."""
    return min(np.shape(observation.image), default=0) <= limits.ROW_PX and np.ndim(observation.image) == 2


def row_limb(head: Observation) -> RowLimb | Refusal:
    """Return where a head's row crosses the limb, or why it need not be the limb."""
    image = np.asarray(head.image, dtype=np.float64)
    v = image.shape[0] // 2
    row = image[v]
    crossing = sub_pixel_crossing(row)
    bright_left = _bright_left(row, crossing)
    if head.full_scale is not None and (row >= SATURATED_SHARE * head.full_scale).any():
        return Refusal(*_saturation(row, crossing, bright_left, head.full_scale))
    if isinstance(crossing, Refusal):
        return crossing
    if reason := _second_edge(row, crossing, bright_left):
        return Refusal(Outcome.AMBIGUOUS, reason)
    columns = np.array([crossing.column - 0.5, crossing.column, crossing.column + 0.5])
    left, los, right = unproject(head.camera, np.column_stack([columns, np.full(3, float(v))]))
    along = left - right if bright_left else right - left
    return RowLimb(los, crossing.sigma_px * float(np.linalg.norm(along)), along)


def _bright_left(row: FloatArray, crossing: Crossing | Refusal) -> bool:
    middle = len(row) / 2 if isinstance(crossing, Refusal) else crossing.column
    at = int(np.clip(round(middle), 1, len(row) - 1))
    return bool(np.median(row[:at]) > np.median(row[at:]))


def _saturation(
    row: FloatArray, crossing: Crossing | Refusal, bright_left: bool, full_scale: float
) -> tuple[Outcome, str]:
    at = np.flatnonzero(row >= SATURATED_SHARE * full_scale)
    if isinstance(crossing, Crossing):
        within = at < crossing.column if bright_left else at > crossing.column
        if within.all() and len(at) > 0.5 * np.sum(row > 0.5 * full_scale):
            return Outcome.SATURATED, f"{len(at)} px of the Earth are saturated"
    return Outcome.SUN_GLARE, f"{len(at)} px are saturated, as by the Sun"


def _second_edge(row: FloatArray, crossing: Crossing, bright_left: bool) -> str | None:
    """Return where a row leaves the levels of its one edge."""
    line = row if bright_left else row[::-1]
    column = crossing.column if bright_left else len(row) - 1 - crossing.column
    # Falling from the Earth to space: everything from here on is put in these terms.
    reach = max(limits.ROW_NEAR_PX, limits.ROW_NEAR_WIDTHS * crossing.width_px)
    inside, outside = line[: max(int(column - reach), 0)], line[int(np.ceil(column + reach)) :]
    if min(len(inside), len(outside)) < limits.ROW_FEWEST_PX:
        return None
    space, earth = float(np.median(outside)), float(np.median(inside))
    step = earth - space
    if step <= 0.0:
        return "the row is no darker beyond the limb than within"
    # A Gaussian of that width leaves this much of the noise of single pixels.
    left_over = (2.0 * np.sqrt(np.pi) * limits.ROW_SMOOTHING_PX) ** -0.5
    noise = limits.ROW_SIGMAS * left_over * row_noise(row, round(crossing.column)) / step
    within, beyond = (
        gaussian_filter1d((part - space) / step, limits.ROW_SMOOTHING_PX, mode="nearest") for part in (inside, outside)
    )
    if beyond.max() > limits.ROW_SPACE_SHARE + noise:
        return f"beyond the limb the row rises to {beyond.max():.0%} of its step"
    if within.min() < limits.ROW_EARTH_SHARES[0] - noise:
        return f"within the limb the row falls to {within.min():.0%} of its step"
    if within.max() > limits.ROW_EARTH_SHARES[1] + noise:
        return f"within the limb the row rises to {within.max():.0%} of its step"
    return None


def misfit(los: FloatArray, axis: FloatArray, rho_rad: float, noise_rad: FloatArray, seen: Observation) -> float:
    """Return the probability that crossings miss one cone by as much as they do, at the direction of the poles that
    suits them best; 1 where three crossings or fewer leave nothing to ask.

    Parameters
    ----------
    los : ndarray, shape (n, 3)
    axis : ndarray, shape (3,)
    rho_rad : float
        Cone through the crossings.
    noise_rad : ndarray, shape (n,)
        Standard deviations of the crossings across the limb.
    seen : Observation
        For the planet and the band.
    """
    across = los @ tangent_basis(axis)
    across /= np.linalg.norm(across, axis=1)[:, None]
    free = null_space(np.column_stack([across, np.ones(len(los))]).T)
    if not free.shape[1]:
        return 1.0
    relief = relief_covariance(across, rho_rad, reliefs(seen.band_kind), seen.prior.sphere_radius_m)
    covariance = np.diag(noise_rad**2) + relief
    w = free.T @ (off_axis_angle(los, axis) - rho_rad)
    left = w[:, None] - free.T @ oblate_limbs(across, rho_rad, seen.prior.flattening)
    squares = np.einsum("ij,ij->j", left, np.linalg.solve(free.T @ covariance @ free, left))
    return float(chi2.sf(squares.min(), free.shape[1]))
