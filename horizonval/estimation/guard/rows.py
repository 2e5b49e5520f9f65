"""Rows of linear arrays: where each crosses the limb, and whether it is one limb.

A row crosses the limb once and shows neither curvature nor length. Each row is tested for:

* saturation: the Sun's disc is a step far larger than the limb's;
* a single edge: levelled to 0 in space and 1 on the Earth the row stays low outside the limb and high within;
* direction: its bright side lies towards the nadir of the answer.

All rows together (three unknowns, four crossings) must lie on one cone. Because the Earth is an ellipsoid with poles
anywhere, the crossings must fit an ellipsoid with *some* direction of the poles, given noise and relief. With ``w = W^T
r`` the residuals of the cone in the directions that it leaves free (``W^T J = 0``) ::

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
from horizonval.estimation.limb.crossing import row_noise, sub_pixel_crossing
from horizonval.estimation.limb.locate import SATURATED_SHARE
from horizonval.estimation.limb.picture import ROSE_SIGMAS
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import unproject
from horizonval.geometry.rotation import off_axis_angle, tangent_basis


@dataclass(frozen=True)
class RowLimb:
    """A row's crossing.

    ``los_cam``: shape (3,), line of sight to it; ``sigma_rad``: its standard deviation along the row;
    ``to_bright_cam``: shape (3,), vector along the row towards the bright side.
    """

    los_cam: FloatArray
    sigma_rad: float
    to_bright_cam: FloatArray

    def bright_side_down(self, nadir_cam: FloatArray) -> bool:
        """Return whether the bright side is the one nearer a nadir."""
        return float(self.to_bright_cam @ nadir_cam) > 0.0


def is_row(observation: Observation) -> bool:
    """Return whether an image is a linear array's: 16 pixels or fewer are too narrow for a profile across them."""
    return min(np.shape(observation.image), default=0) <= 16 and np.ndim(observation.image) == 2


def row_limb(head: Observation) -> RowLimb | Refusal:
    """Return where a head's row crosses the limb, or why it need not be the limb."""
    image = np.asarray(head.image, dtype=np.float64)
    v = image.shape[0] // 2
    row, crossing = image[v], sub_pixel_crossing(image[v])
    column = 0.5 * len(row) if isinstance(crossing, Refusal) else crossing.column
    at = int(np.clip(round(column), 1, len(row) - 1))
    bright_left = bool(np.median(row[:at]) > np.median(row[at:]))
    full = np.inf if head.full_scale is None else head.full_scale
    saturated = np.flatnonzero(row >= SATURATED_SHARE * full)
    if len(saturated):
        within = saturated < column if bright_left else saturated > column
        if not isinstance(crossing, Refusal) and within.all() and len(saturated) > 0.5 * np.sum(row > 0.5 * full):
            return Refusal(Outcome.SATURATED, f"{len(saturated)} px of the Earth are saturated")
        return Refusal(Outcome.SUN_GLARE, f"{len(saturated)} px are saturated, as by the Sun")
    if isinstance(crossing, Refusal):
        return crossing
    # Falling from the Earth to space.
    line, fall = (row, column) if bright_left else (row[::-1], len(row) - 1 - column)
    if reason := _second_edge(line, fall, crossing.width_px, row_noise(row, round(column))):
        return Refusal(Outcome.AMBIGUOUS, reason)
    columns = np.array([column - 0.5, column, column + 0.5])
    left, los, right = unproject(head.camera, np.column_stack([columns, np.full(3, float(v))]))
    along = left - right if bright_left else right - left
    return RowLimb(los, crossing.sigma_px * float(np.linalg.norm(along)), along)


def _second_edge(line: FloatArray, column: float, width_px: float, noise: float) -> str | None:
    """Return where a line that falls at a column leaves the levels of its one edge."""
    # A plateau bends over within four widths of the edge.
    reach = max(10.0, 4.0 * width_px)
    inside, outside = line[: max(int(column - reach), 0)], line[int(np.ceil(column + reach)) :]
    if min(len(inside), len(outside)) < 4:
        return None
    space = float(np.median(outside))
    step = float(np.median(inside)) - space
    if step <= 0.0:
        return "the row is no darker beyond the limb than within"
    # A Gaussian of one pixel, narrower than any object, leaves this much of the noise of single pixels.
    noise *= ROSE_SIGMAS * (2.0 * np.sqrt(np.pi)) ** -0.5 / step
    within, beyond = (gaussian_filter1d((part - space) / step, 1.0, mode="nearest") for part in (inside, outside))
    # Carbon dioxide's disc is 0.9 to 1.1 of its plateau and space 0.01; half of the step is another edge.
    if beyond.max() > 0.1 + noise:
        return f"beyond the limb the row rises to {beyond.max():.0%} of its step"
    if within.min() < 0.6 - noise:
        return f"within the limb the row falls to {within.min():.0%} of its step"
    if within.max() > 1.5 + noise:
        return f"within the limb the row rises to {within.max():.0%} of its step"
    return None


def misfit(los: FloatArray, axis: FloatArray, rho_rad: float, noise_rad: FloatArray, seen: Observation) -> float:
    """Return the probability that crossings miss one cone by as much as they do, at the direction of the poles that
    suits them best; 1 where three crossings or fewer leave nothing to ask.

    ``los``: shape (n, 3); ``axis``: shape (3,); ``rho_rad``: cone through the crossings; ``noise_rad``: shape (n,),
    standard deviations of the crossings across the limb; ``seen``: for the planet and the band.
    """
    across = los @ tangent_basis(axis)
    across /= np.linalg.norm(across, axis=1)[:, None]
    free = null_space(np.column_stack([across, np.ones(len(los))]).T)
    if not free.shape[1]:
        return 1.0
    relief = relief_covariance(
        across, rho_rad, reliefs(seen.band_kind, seen.prior.limb_relief_m), seen.prior.sphere_radius_m
    )
    covariance = np.diag(noise_rad**2) + relief
    w = free.T @ (off_axis_angle(los, axis) - rho_rad)
    left = w[:, None] - free.T @ oblate_limbs(across, rho_rad, seen.prior.flattening)
    squares = np.einsum("ij,ij->j", left, np.linalg.solve(free.T @ covariance @ free, left))
    return float(chi2.sf(squares.min(), free.shape[1]))
