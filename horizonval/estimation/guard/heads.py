"""The guard for several heads: images of limb arcs, and rows of linear arrays.

**Rows.** A row crosses the limb once and shows neither curvature nor length. Each row is tested for:

* saturation: the Sun's disc is a step far larger than the limb's;
* a single edge: levelled to 0 in space and 1 on the Earth the row stays low outside the limb and high within;
* direction: its bright side lies towards the nadir of the answer.

All rows together (three unknowns, four crossings) must lie on one cone. Because the Earth is an ellipsoid with poles
anywhere, the crossings must fit an ellipsoid with *some* direction of the poles, given noise and relief. With ``w = W^T
r`` the residuals of the cone in the directions that it leaves free (``W^T J = 0``) ::

    chi^2 = min over poles p of (w - w_p)^T C^-1 (w - w_p),      C = W^T (noise + relief) W

**Images.** Every head must show its limb, and all limbs must lie on one cone. Methods differ in their input:

* *arcs* (``Estimator.from_heads``): the limb is found and its points selected in every head's image as in a single
  image, except that all heads together must determine the nadir. The method gets the selected points;
* *rows*: the method answers, and every row is tested as above;
* *images of any other method*: the method answers first. Its nadir and angular radius predict a limb in every head's
  image; points along it are moved to the steepest position, and most of them must find one near by, all bright on the
  same side.

The points of all heads must then lie on one cone to the scatter of a limb. Its axis must be well determined and must
agree with the method's nadir within the uncertainty of both. A Sun, a Moon or a terminator in one head does not lie on
the cone through the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import limb_height_m, oblate_limbs, relief_covariance, reliefs, systematic_covariance
from horizonval.estimation.guard import limits
from horizonval.estimation.guard.sunlit import sun_angles
from horizonval.estimation.guard.three_tests import SeenLimb, doubted
from horizonval.estimation.limb.cone import arc_order, cone_uncertainty, limb_directions
from horizonval.estimation.limb.crossing import Crossing, row_noise, sub_pixel_crossing
from horizonval.estimation.limb.finder import find_limb_and_picture, largest_rho_rad
from horizonval.estimation.limb.picture import MEDIAN_TO_SIGMA, Picture
from horizonval.estimation.limb.steepest import to_steepest
from horizonval.estimation.limb.trusted import SATURATED_SHARE, faded, read_sides, restless, saturated
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.geometry.camera import project, unproject
from horizonval.geometry.horizon import fit_cone
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


MOVED_RAD = 1e-4
"""How far the limb is moved to see what a method makes of it: a hundredth of a pixel and more, a hundredth of rho."""


def run_heads(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    """Run a method of several heads and believe it only if every head's image shows its limb."""
    heads = observation.heads
    if heads and all(is_row(head) for head in heads.values()):
        return _run_rows(estimator, observation)
    if heads and estimator.from_heads is not None:
        return _run_arcs(estimator, observation)
    return _run_images(estimator, observation)


@dataclass(frozen=True)
class _Limb:
    """The limb of all heads in the first head's axes, and the cone through it.

    ``noise``, ``systematic``: covariances (3, 3) [rad^2] of (axis along the basis, half-angle).
    """

    axis: FloatArray
    basis: FloatArray
    rho_rad: float
    noise: FloatArray
    systematic: FloatArray


def _run_rows(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    rows: dict[str, RowLimb] = {}
    for name, head in observation.heads.items():
        found = row_limb(head)
        if isinstance(found, Refusal):
            return found.of_head(name)
        rows[name] = found
    result = estimator.run(observation)
    if isinstance(result, Refusal):
        return result
    turns = _turns(observation)
    down = {name: row.bright_side_down(turns[name].apply(result.nadir_cam)) for name, row in rows.items()}
    # If the band is unknown, the Earth may be the darker side, in all heads.
    wanted = observation.band_kind is not None or 2 * sum(down.values()) >= len(down)
    for name, one in down.items():
        if one != wanted:
            return Refusal(Outcome.NO_LIMB, f"head {name}: the bright side lies away from the Earth", result.points)
    los = np.array([turns[name].inv().apply(row.los_cam) for name, row in rows.items()])
    sigma = np.array([row.sigma_rad for row in rows.values()])
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    if misfit(los, cone.axis_cam, rho, sigma, observation) < limits.MISFIT_CHANCE:
        return Refusal(Outcome.AMBIGUOUS, "the crossings of the heads do not lie on one limb", result.points)
    basis = tangent_basis(cone.axis_cam)
    across = los @ basis
    across /= np.linalg.norm(across, axis=1)[:, None]
    gain = np.linalg.pinv(np.column_stack([across, np.ones(len(los))]))
    systematic = _systematic(los, cone.axis_cam, rho, observation, estimator.estimates)
    if systematic is None:
        return Refusal(Outcome.SHORT_ARC, "the heads' crossings do not determine a cone", result.points)
    limb = _Limb(cone.axis_cam, basis, rho, (gain * sigma**2) @ gain.T, systematic)
    return _confirmed(result, limb, observation, systematic[:2, :2])


def _run_arcs(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    assert estimator.from_heads is not None
    seen: dict[str, FloatArray] = {}
    for name, head in observation.heads.items():
        found = _arc_in_head(head)
        if isinstance(found, Refusal):
            return found.of_head(name)
        seen[name] = found
    limb = _limb_of(seen, observation, estimator.estimates)
    if isinstance(limb, Refusal):
        return limb
    points = {name: project(observation.heads[name].camera, los)[0] for name, los in seen.items()}
    result = estimator.from_heads(points, observation)
    if isinstance(result, Refusal):
        return result
    systematic = _of_method(estimator, result, seen, limb, observation)
    if systematic is None:
        return Refusal(Outcome.NOT_CONVERGED, "the method jumps where the limb is moved a little", result.points)
    return _tested(_confirmed(result, limb, observation, systematic), limb, observation)


def _run_images(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    result = estimator.run(observation)
    if isinstance(result, Refusal):
        return result
    rho = _angular_radius(result, observation)
    seen: dict[str, FloatArray] = {}
    for name, turn in _turns(observation).items():
        found = _limb_near(observation.heads[name], turn.apply(result.nadir_cam), rho)
        if isinstance(found, Refusal):
            return replace(found.of_head(name), points=result.points)
        seen[name] = found
    limb = _limb_of(seen, observation, estimator.estimates)
    if isinstance(limb, Refusal):
        return limb
    return _tested(_confirmed(result, limb, observation, limb.systematic[:2, :2]), limb, observation)


def _tested(result: Fit | Refusal, limb: _Limb, observation: Observation) -> Fit | Refusal:
    """Return a fit whose limb the pixels of every head bear out (:mod:`.three_tests`)."""
    if isinstance(result, Refusal):
        return result
    variance = float(limb.noise[2, 2] + limb.systematic[2, 2])
    for name, turn in _turns(observation).items():
        matrix = turn.as_matrix()
        own = replace(
            result,
            nadir_cam=matrix @ result.nadir_cam,
            covariance_nadir_cam=matrix @ result.total_covariance_nadir_cam @ matrix.T,
            systematic_nadir_cam=None,
        )
        refusal = doubted(own, observation.heads[name], SeenLimb(matrix @ limb.axis, limb.rho_rad, variance))
        if refusal is not None:
            return replace(refusal.of_head(name), points=result.points)
    return result


def _turns(observation: Observation) -> dict[str, Rotation]:
    """Return the turns from the axes of the first head to those of each one, by way of the body."""
    first = Rotation.from_quat(next(iter(observation.heads.values())).q_cam_from_body)
    return {name: Rotation.from_quat(head.q_cam_from_body) * first.inv() for name, head in observation.heads.items()}


def _angular_radius(fit: Fit, observation: Observation) -> float:
    if fit.angular_radius_rad is not None:
        return float(fit.angular_radius_rad)
    # One point of every head, in the heads' order: the angle between nadir and points is the radius.
    heads = zip(fit.points, observation.heads.values(), _turns(observation).values(), strict=False)
    angles = [
        off_axis_angle(unproject(head.camera, point[None, :]), turn.apply(fit.nadir_cam))[0]
        for point, head, turn in heads
    ]
    return float(np.mean(angles)) if angles else float("nan")


def _arc_in_head(head: Observation) -> FloatArray | Refusal:
    """Return lines of sight to a head's limb in its own axes, shape (n, 3), or why there is none to trust."""
    searched = find_limb_and_picture(head.image, head.camera, head.full_scale, head.prior)
    if isinstance(searched, Refusal):
        return searched
    found, picture = searched
    axis = fit_cone(found.los_cam).axis_cam
    sides = read_sides(picture, head.camera, found.los_cam, axis)
    bright_inside = bool(np.median(sides.inner - sides.outer) > 0.0)
    if head.band_kind is not None and not bright_inside:
        return Refusal(Outcome.NO_LIMB, "the limb has its bright side in space", found.uv)
    los, kept = to_steepest(picture.grey, head.camera, found.los_cam, axis, bright_inside)
    uv = found.uv[kept]
    if len(los) < limits.FEWEST_POINTS:
        return Refusal(Outcome.SHORT_ARC, f"{len(los)} limb points have their profile in view", uv)
    axis = fit_cone(los).axis_cam
    sides = read_sides(picture, head.camera, los, axis)
    tests = {Outcome.DARK: faded(sides), Outcome.SUN_GLARE: restless(sides)}
    if head.sun_cam is not None and head.band_kind == "solar":
        tests[Outcome.DARK] |= sun_angles(los, axis, head.sun_cam)[0] > limits.HEAD_LOWEST_SUN_RAD
    if head.full_scale is not None:
        tests[Outcome.SATURATED] = saturated(sides, head.full_scale)
    bad = np.any(list(tests.values()), axis=0)
    worst = max(tests, key=lambda outcome: int(tests[outcome].sum()))
    los = _without_outliers(los[~bad], head)
    shortest = limits.HEAD_ARC_SHARE * min(head.camera.width, head.camera.height)
    length = float(np.linalg.norm(np.ptp(project(head.camera, los)[0], axis=0))) if len(los) else 0.0
    if len(los) < limits.FEWEST_POINTS or length < shortest:
        status = worst if bad.mean() > limits.MUCH_LOST else Outcome.SHORT_ARC
        return Refusal(status, f"{length:.0f} px of limb are to be trusted, {shortest:.0f} are needed", uv)
    return los[arc_order(los, fit_cone(los).axis_cam)]


def _without_outliers(los: FloatArray, head: Observation) -> FloatArray:
    smallest = limits.SMALLEST_TRIM_PX / max(head.camera.fx, head.camera.fy)
    for _ in range(limits.TRIMS):
        if len(los) < limits.FEWEST_POINTS:
            break
        off = off_axis_angle(los, fit_cone(los).axis_cam)
        off = np.abs(off - np.median(off))
        good = off <= max(limits.TRIM_SIGMAS * MEDIAN_TO_SIGMA * float(np.median(off)), smallest)
        if good.all():
            break
        los = los[good]
    return los


def _limb_near(head: Observation, nadir_cam: FloatArray, rho_rad: float) -> FloatArray | Refusal:
    """Return the limb's lines of sight in a head's own axes, shape (n, 3), near a cone, or why there is none."""
    if not np.isfinite(rho_rad):
        return Refusal(Outcome.NOT_CONVERGED, "the answer has no angular radius")
    picture = Picture(head.image, head.full_scale)
    los = limb_directions(head.camera, nadir_cam, rho_rad, limits.HEAD_RIM_PX)
    if len(los) < limits.FEWEST_POINTS:
        return Refusal(Outcome.SHORT_ARC, f"{len(los)} px of the answer's limb are in view")
    sides = read_sides(picture, head.camera, los, nadir_cam)
    bright_inside = bool(np.median(sides.inner - sides.outer) > 0.0)
    if head.band_kind is not None and not bright_inside:
        return Refusal(Outcome.NO_LIMB, "the answer's limb has its bright side in space")
    moved, _ = to_steepest(picture.grey, head.camera, los, nadir_cam, bright_inside)
    if len(moved) < limits.FEWEST_POINTS:
        return Refusal(Outcome.NO_LIMB, "there is no edge along the answer's limb")
    sides = read_sides(picture, head.camera, moved, nadir_cam)
    bad = restless(sides)
    if head.full_scale is not None:
        bad = bad | saturated(sides, head.full_scale)
    off = off_axis_angle(moved, nadir_cam)
    bad = bad | (np.abs(off - np.median(off)) > limits.HEAD_SCATTER_PX / max(head.camera.fx, head.camera.fy))
    if np.mean(~bad) * len(moved) < limits.HEAD_LIMB_SHARE * len(los):
        return Refusal(Outcome.NO_LIMB, f"{np.mean(~bad) * len(moved) / len(los):.0%} of the answer's limb is an edge")
    return moved[~bad]


def _limb_of(seen: Mapping[str, FloatArray], observation: Observation, estimates: str) -> _Limb | Refusal:
    """Return the cone through the limbs of all heads, by name in the heads' own axes, or why there is none."""
    turns = _turns(observation)
    los = np.concatenate([turns[name].inv().apply(one) for name, one in seen.items()])
    cone = fit_cone(los)
    off = off_axis_angle(los, cone.axis_cam)
    rho = float(off.mean())
    camera = observation.camera
    missed, allowed = float(off.std()), limits.HEADS_MISFIT_PX / max(camera.fx, camera.fy) + limits.HEADS_MISFIT_RAD
    if missed > allowed:
        return Refusal(Outcome.AMBIGUOUS, f"the limbs of the heads miss one cone by {np.degrees(missed):.2f} deg")
    systematic = _systematic(los, cone.axis_cam, rho, observation, estimates)
    try:
        noise = cone_uncertainty(los, cone.axis_cam, rho)
    except np.linalg.LinAlgError:
        systematic = None
    if systematic is None:
        return Refusal(Outcome.SHORT_ARC, "the heads' limbs do not determine a cone")
    return _Limb(cone.axis_cam, noise.basis, rho, noise.covariance, systematic)


def _systematic(
    los: FloatArray,
    axis: FloatArray,
    rho: float,
    observation: Observation,
    estimates: str,
    gain: FloatArray | None = None,
) -> FloatArray | None:
    try:
        return systematic_covariance(
            los,
            axis,
            rho,
            flattening=observation.prior.flattening,
            reliefs=reliefs(observation.band_kind, observation.prior.limb_relief_m),
            earth_radius_m=observation.prior.sphere_radius_m,
            estimates="geodetic" if estimates == "geodetic" else "geocentric",
            gain=gain,
        )
    except np.linalg.LinAlgError:
        return None


def _of_method(
    estimator: Estimator, fit: Fit, seen: Mapping[str, FloatArray], limb: _Limb, observation: Observation
) -> FloatArray | None:
    """Return the covariance (2, 2) of a method's nadir from oblateness and relief, in the limb's basis.

    A method may weigh its points differently from a cone fit. The limb is therefore raised at one place of each arc
    after another, falling to zero at the next place, and the method runs again each time.
    """
    assert estimator.from_heads is not None
    turns = _turns(observation)
    knots: list[FloatArray] = []
    gain: list[FloatArray] = []
    for name, los in seen.items():
        axis = turns[name].apply(limb.axis)
        places = np.linspace(0.0, len(los) - 1.0, limits.HEAD_KNOTS)
        for place in places:
            hat = np.clip(1.0 - np.abs(np.arange(len(los)) - place) / (places[1] - places[0]), 0.0, None)
            inwards = axis - los * (los @ axis)[:, None]
            moved = los - MOVED_RAD * hat[:, None] * inwards / np.linalg.norm(inwards, axis=1)[:, None]
            points = {
                other: project(observation.heads[other].camera, moved if other == name else one)[0]
                for other, one in seen.items()
            }
            again = estimator.from_heads(points, observation)
            if isinstance(again, Refusal):
                return None
            knots.append(turns[name].inv().apply(los[round(place)]))
            gain.append((again.nadir_cam - fit.nadir_cam) @ limb.basis / MOVED_RAD)
    moves = np.vstack([np.array(gain).T, np.zeros(len(gain))])
    systematic = _systematic(np.array(knots), limb.axis, limb.rho_rad, observation, estimator.estimates, moves)
    return None if systematic is None else systematic[:2, :2]


def _confirmed(fit: Fit, limb: _Limb, observation: Observation, systematic: FloatArray) -> Fit | Refusal:
    """Return the fit with its model error, ``systematic`` (2, 2), if the limb of all heads bears it out."""
    basis, rho = limb.basis, limb.rho_rad
    if not limits.SMALLEST_RHO_RAD <= rho <= largest_rho_rad(observation.prior):
        return Refusal(Outcome.NO_LIMB, f"a disc of {np.degrees(rho):.2f} deg is no orbit's horizon", fit.points)
    of_points = 0.0 if fit.systematic_nadir_cam is None else fit.systematic_nadir_cam
    confirmed = replace(fit, systematic_nadir_cam=of_points + basis @ systematic @ basis.T)
    apart = basis.T @ (np.asarray(fit.nadir_cam) - limb.axis)
    # Few points bend with the limb's shape otherwise than many do: the model's error counts, too.
    spread = basis.T @ confirmed.total_covariance_nadir_cam @ basis + limb.noise[:2, :2]
    floor = limits.AGREEMENT_FLOOR_RAD**2 * np.eye(2)
    if fit.nadir_cam @ limb.axis < 0 or apart @ np.linalg.solve(spread + floor, apart) > limits.AGREEMENT**2:
        angle = float(np.degrees(np.arccos(np.clip(fit.nadir_cam @ limb.axis, -1, 1))))
        return Refusal(
            Outcome.AMBIGUOUS, f"the answer lies {angle:.2f} deg from the cone through all heads", fit.points
        )
    total = basis.T @ confirmed.total_covariance_nadir_cam @ basis
    sigma = float(np.sqrt(np.linalg.eigvalsh(total)[-1]))
    if not sigma <= limits.LARGEST_SIGMA_RAD:
        return Refusal(Outcome.SHORT_ARC, f"the heads determine the nadir to {np.degrees(sigma):.2f} deg", fit.points)
    predicted = observation.prior.angular_radius
    if predicted is not None:
        radius = observation.prior.sphere_radius_m
        expected, of_altitude = predicted
        low, high = (h * np.tan(expected) / radius for h in limb_height_m(observation.band_kind))
        slack = limits.AGREEMENT * float(np.sqrt(limb.noise[2, 2] + limb.systematic[2, 2] + of_altitude))
        if not low - slack <= rho - expected <= high + slack:
            off = np.degrees(rho - expected)
            return Refusal(
                Outcome.AMBIGUOUS, f"the angular radius is {off:+.2f} deg from that of the known altitude", fit.points
            )
    return confirmed
