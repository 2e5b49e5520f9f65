"""Static infrared horizon sensor: four linear arrays across the horizon, a quarter turn apart.

After Cui and others, "Static infrared horizon sensor" (Shanghai Institute of Technical Physics, 2016). Heads A, B, C, D
look at the horizon at azimuths 45, 135, 225 and 315 deg; with their crossings in pixels, growing outwards::

    P = IFOV / (2 sqrt 2) (A + B - C - D),    R = IFOV / (2 sqrt 2) (A + D - B - C)

**Where the azimuths begin.** A small roll phi and pitch theta move the horizon of a head at azimuth a (from the
velocity x to the right y) by ``-theta cos a + phi sin a``. P is the pitch and R the roll, both with the published
signs, if a is the published azimuth plus 90 deg: it counts from the right of the track over the tail. Whatever the
mounting, :func:`published_axes` says in which axes P and R are pitch and roll.

**Two methods.** ``linear-heads-published``: whole-pixel crossings and the formula, which neglects second-order terms
(a few hundredths of a degree at 5 deg of roll and pitch). ``linear-heads``: sub-pixel crossings, and instead of the
formula the cone through the four lines of sight, whose axis is the nadir at any angle; it needs no altitude either.
The published pipeline does not ask whether there is a limb at all: it claims an attitude of whatever the rows hold, and
so does the bare method here. ``guarded-linear-heads-published`` asks.

Spherical Earth with a limb equally high all round: what differs between the heads (oblateness, 21 km between pole and
equator; colder and lower air towards the winter pole) goes into the nadir and is not in the claimed covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.lens_error import with_lens_error
from horizonval.estimation.limb.cone import cone_gain
from horizonval.estimation.limb.crossing import published_crossing, sub_pixel_crossing
from horizonval.estimation.observation import Estimator, Fit, Observation, fit_of_nadir
from horizonval.geometry.camera import unproject
from horizonval.geometry.frames import inverse, nadir_of_roll_pitch, rotate
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle, tangent_basis


@dataclass(frozen=True)
class HeadRow:
    """The row of one head: grey levels (n,), the image row it lies on, and how the head is turned in the body."""

    name: str
    row: FloatArray
    v: int
    observation: Observation

    def los_body(self, column: float) -> FloatArray:
        """Return the line of sight of a column in body axes, shape (3,)."""
        los = unproject(self.observation.camera, np.array([column, float(self.v)]))
        return rotate(inverse(self.observation.q_cam_from_body), los)

    def pixel_rad(self, column: float) -> float:
        """Return the angle of a pixel along the row."""
        return float(off_axis_angle(self.los_body(column - 0.5), self.los_body(column + 0.5)))


def head_rows(observation: Observation) -> list[HeadRow] | Refusal:
    """Return the rows of the four heads: the one row of a linear array, or of an image the row below its middle."""
    heads = observation.heads
    if len(heads) != 4:
        return Refusal(Outcome.BAD_INPUT, f"four heads are needed, the observation has {len(heads)}")
    rows = []
    for name, head in heads.items():
        image = np.asarray(head.image, dtype=np.float64)
        if image.ndim != 2 or image.shape[1] < 16 or not np.isfinite(image).all():
            return Refusal(Outcome.BAD_INPUT, f"head {name}: not a finite image of at least 16 columns")
        v = image.shape[0] // 2
        rows.append(HeadRow(name, image[v], v, head))
    return rows


def published_axes(rows: list[HeadRow]) -> float | Refusal:
    """Return the body azimuth [rad] of the axis R, normal to the pitch axis P.

    It is the first head's azimuth, turned back by 135 deg.
    """
    boresight = np.array([rotate(inverse(r.observation.q_cam_from_body), [0.0, 0.0, 1.0]) for r in rows])
    azimuth = np.arctan2(boresight[:, 1], boresight[:, 0])
    off = np.angle(np.exp(1j * (azimuth - azimuth[0] - np.arange(4) * (np.pi / 2))))
    if np.abs(off).max() > np.radians(1.0):
        return Refusal(Outcome.BAD_INPUT, "the published formula needs heads a quarter turn apart, in that order")
    return float(azimuth[0] - 0.75 * np.pi)


def published_angles(columns: FloatArray, ifov_rad: float) -> tuple[float, float]:
    """Return P and R [rad] from the crossings [pixels] of A, B, C and D, shape (4,)."""
    a, b, c, d = columns
    scale = ifov_rad / (2.0 * np.sqrt(2.0))
    return float(scale * (a + b - c - d)), float(scale * (a + d - b - c))


def run_published(observation: Observation) -> Fit | Refusal:
    """Estimate roll and pitch as published."""
    rows = head_rows(observation)
    if isinstance(rows, Refusal):
        return rows
    forward = published_axes(rows)
    if isinstance(forward, Refusal):
        return forward
    crossings = [published_crossing(r.row) for r in rows]
    columns = np.array([c.fine for c in crossings])
    ifov = float(np.mean([r.pixel_rad(c) for r, c in zip(rows, columns, strict=True)]))
    pitch, roll = published_angles(columns, ifov)
    nadir_body = Rotation.from_euler("z", forward).apply(nadir_of_roll_pitch(roll, pitch))
    sigma = np.array([c.sigma_px for c in crossings])
    # P and R each weigh the four crossings with +-IFOV / (2 sqrt 2).
    variance = ifov**2 / 8.0 * float(sigma @ sigma)
    # What the formula neglects is known on board: the cone through the same crossings neglects nothing.
    exact = fit_cone(np.array([r.los_body(c) for r, c in zip(rows, columns, strict=True)])).axis_cam
    variance += 0.5 * float(off_axis_angle(exact, nadir_body)) ** 2
    covariance_body = variance * (np.eye(3) - np.outer(nadir_body, nadir_body))
    return _fit(rows, columns, nadir_body, covariance_body)


def run(observation: Observation) -> Fit | Refusal:
    """Estimate the nadir from sub-pixel crossings and the cone through them."""
    rows = head_rows(observation)
    if isinstance(rows, Refusal):
        return rows
    crossings = []
    for row in rows:
        found = sub_pixel_crossing(row.row)
        if isinstance(found, Refusal):
            return found.of_head(row.name)
        crossings.append(found)
    return fit_crossings(rows, np.array([c.column for c in crossings]), np.array([c.sigma_px for c in crossings]))


def fit_crossings(rows: list[HeadRow], columns: FloatArray, sigma_px: FloatArray) -> Fit | Refusal:
    """Fit the cone through crossings, shape (4,), of given standard deviations [pixels], shape (4,)."""
    los = np.array([r.los_body(c) for r, c in zip(rows, columns, strict=True)])
    sigma = sigma_px * [r.pixel_rad(c) for r, c in zip(rows, columns, strict=True)]
    cone = fit_cone(los)
    rho = float(np.arctan2(np.mean(np.sin(off_axis_angle(los, cone.axis_cam))), cone.cos_rho))
    try:
        gain = cone_gain(los, cone.axis_cam)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, str(e))
    covariance = (gain * sigma**2) @ gain.T
    residual = off_axis_angle(los, cone.axis_cam) - rho
    # Latitude and oblateness take a tenth of a degree and six sigmas are no chance: more is another object.
    if np.abs(residual).sum() > max(np.radians(1.0), 6.0 * float(np.linalg.norm(sigma))):
        text = f"the four crossings miss one cone by {np.degrees(np.abs(residual).sum()):.2g} deg in sum"
        return Refusal(Outcome.AMBIGUOUS, text, _points(rows, columns))
    basis = tangent_basis(cone.axis_cam)
    covariance_body = basis @ covariance[:2, :2] @ basis.T
    return _fit(rows, columns, cone.axis_cam, covariance_body, rho, float(np.sqrt(covariance[2, 2])), residual)


def _fit(
    rows: list[HeadRow],
    columns: FloatArray,
    nadir_body: FloatArray,
    covariance_body: FloatArray,
    rho: float | None = None,
    sigma_rho: float | None = None,
    residual: FloatArray | None = None,
) -> Fit:
    turn = Rotation.from_quat(rows[0].observation.q_cam_from_body).as_matrix()
    return fit_of_nadir(
        rows[0].observation,
        turn @ nadir_body,
        turn @ covariance_body @ turn.T,
        rho,
        sigma_rho,
        points=_points(rows, columns),
        residuals_rad=residual,
    )


def _points(rows: list[HeadRow], columns: FloatArray) -> FloatArray:
    return np.column_stack([columns, [float(r.v) for r in rows]])


PUBLISHED = Estimator(
    name="linear-heads-published",
    title="Four linear infrared heads, whole-pixel crossings (Cui and others 2016)",
    run=run_published,
    estimates="geocentric",
    needs="heads",
)

ESTIMATOR = Estimator(
    name="linear-heads",
    title="Four linear infrared heads, sub-pixel crossings and exact cone",
    run=with_lens_error(run),
    estimates="geocentric",
    needs="heads",
)
