"""Video-vertical: the local vertical from the horizon's arcs in two perpendicular cameras.

After Belokonov, Lomaka and others (Samara, about 2015; IFAC-PapersOnLine 2016). The axes of both cameras lie in the
plane across the satellite's longitudinal axis. Per image: Canny edges, horizon arc, circle through it, end points of
the arc. The vector that joins the end points is perpendicular to the vertical; the cross product of the two cameras'
vectors is the vertical, and its angle to the longitudinal axis is the output.

**Which vector.** Every line of sight to a spherical horizon makes the angle rho with the nadir n, so that for *any* two
of them, or means of some, ``(u1 - u2) . n = cos rho - cos rho = 0``, whatever the camera's turn. An end of the arc is
therefore the mean over its last pixels, which rounds less than one pixel does. The circle separates the arc from what
is attached to it, orders its pixels, and its centre says on which side the Earth lies. :class:`ChordEnds` has the other
readings of the text: end points in the image plane are perpendicular to n only if both lie equally far from the
principal point, and points of the circle leave the horizon, which is a conic. Single end pixels come to the published
model error.

**Uncertainty.** With the chords ``c1``, ``c2`` the vertical solves ``c . n = 0``, so that an error ``e`` of ``c . n``
moves it by ``-pinv([c1; c2]) e``. Each ``e`` is the difference of two ends' errors across the horizon. Their variance
and correlation length are measured on all pixels of both arcs, as departures from the cone about the vertical.

Spherical Earth. A limb whose ends are lit differently, and the ellipsoid, bias the result by more than these departures
show. No image is refused for what it shows: see :mod:`horizonval.estimation.limb.arc`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.light import PIXEL_VARIANCE
from horizonval.estimation.lens_error import View, los_body, with_lens_error
from horizonval.estimation.limb.arc import Arc, find_arc, fit_circle
from horizonval.estimation.limb.cone import SLOW_PX, cone_uncertainty
from horizonval.estimation.observation import Estimator, Fit, Observation, fit_of_nadir
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle

PIXEL_SIGMA_PX = float(np.sqrt(PIXEL_VARIANCE))
"""Standard deviation of a position rounded to whole pixels."""
END_PIXELS = 8
"""Pixels that make an end of the arc: a third of the shortest arc there is."""


class ChordEnds(StrEnum):
    """Readings of "the vector that joins the end points of the arc"."""

    SIGHT = "mean lines of sight to the arc's last pixels"
    PIXEL = "lines of sight to the arc's two end pixels"
    CIRCLE = "lines of sight to the fitted circle's end points"
    PLANE = "end points in the image plane"


def chord(arc: Arc, camera: CameraModel, ends: ChordEnds = ChordEnds.SIGHT) -> FloatArray:
    """Return the vector in camera axes, shape (3,), that joins an arc's end points."""
    if ends is ChordEnds.SIGHT:
        first, last = (unproject(camera, uv).mean(axis=0) for uv in (arc.uv[:END_PIXELS], arc.uv[-END_PIXELS:]))
        return np.asarray(last - first)
    uv = arc.uv[[0, -1]]
    if ends is not ChordEnds.PIXEL:
        uv = arc.circle.nearest(uv)
    if ends is ChordEnds.PLANE:
        across = (uv[1] - uv[0]) / (camera.fx, camera.fy)
        return np.array([across[0], across[1], 0.0])
    los = unproject(camera, uv)
    return np.asarray(los[1] - los[0])


def vertical(chords_body: FloatArray) -> FloatArray | None:
    """Return the unit vector, shape (3,), across two chords, shape (2, 3); None where they are parallel or none."""
    across = np.cross(chords_body[0], chords_body[1])
    length = float(np.linalg.norm(across))
    lengths = float(np.prod(np.linalg.norm(chords_body, axis=1)))
    # Below this sine of the angle between the chords their cross product is noise.
    if not np.isfinite(length) or length <= 1e-3 * lengths:
        return None
    return np.asarray(across / length)


def solve(observation: Observation, ends: ChordEnds = ChordEnds.SIGHT) -> Fit | Refusal:
    """Estimate the nadir from the images of two heads, with one of the readings of the end points."""
    if len(observation.heads) != 2:
        return Refusal(Outcome.BAD_INPUT, f"{len(observation.heads)} heads; the method has two")
    arcs: list[Arc] = []
    for name, head in observation.heads.items():
        if np.shape(head.image) != (head.camera.height, head.camera.width):
            return Refusal(Outcome.BAD_INPUT, f"head {name}: the image is not of its camera's size")
        found = find_arc(head.image, head.full_scale)
        if isinstance(found, Refusal):
            return found.of_head(name)
        arcs.append(found)
    return fit_arcs(arcs, list(observation.heads.values()), ends)


def from_heads(points: Mapping[str, FloatArray], observation: Observation) -> Fit | Refusal:
    """Return the vertical from sub-pixel limb points (n, 2), by head, of another search."""
    if len(points) != 2 or any(len(uv) < 2 * END_PIXELS for uv in points.values()):
        return Refusal(Outcome.BAD_INPUT, f"the method needs {2 * END_PIXELS} points in each of two heads")
    arcs = []
    for name, uv in points.items():
        circle = fit_circle(uv)
        if circle is None:
            return Refusal(Outcome.SHORT_ARC, f"head {name}: the limb is straight: it has no circle")
        arcs.append(Arc(uv[np.argsort(circle.along(uv), kind="stable")], circle))
    heads = [observation.heads[name] for name in points]
    return fit_arcs(arcs, heads, sub_pixel=True)


def fit_arcs(
    arcs: list[Arc], heads: list[Observation], ends: ChordEnds = ChordEnds.SIGHT, *, sub_pixel: bool = False
) -> Fit | Refusal:
    """Return the vertical of two arcs from any search.

    ``sub_pixel``: scatter is taken about each arc's own cone; about the vertical's it would be mostly the vertical's
    error.
    """
    seen = [(arc, head.camera, _cam_from_body(head)) for arc, head in zip(arcs, heads, strict=True)]
    chords = np.array([chord(arc, camera, ends) @ turn for arc, camera, turn in seen])
    nadir = vertical(chords)
    if nadir is None:
        return Refusal(Outcome.SHORT_ARC, "the two chords are parallel: they span no plane", arcs[0].uv)
    earthwards = float(sum(_towards_centre(arc, camera) @ turn @ nadir for arc, camera, turn in seen))
    if not np.isfinite(earthwards) or earthwards == 0.0:
        return Refusal(Outcome.AMBIGUOUS, "the arcs do not tell on which side the Earth lies", arcs[0].uv)
    nadir = np.copysign(1.0, earthwards) * nadir
    los = [unproject(camera, arc.uv) @ turn for arc, camera, turn in seen]
    angles = [off_axis_angle(one, nadir) for one in los]
    rho = float(np.mean([angle.mean() for angle in angles]))
    about = [(nadir, rho)] * len(los)
    if sub_pixel:
        axes = [fit_cone(one).axis_cam for one in los]
        about = [(axis, float(off_axis_angle(one, axis).mean())) for one, axis in zip(los, axes, strict=True)]
    # In pixels, not angles: off the axis a pixel is a smaller angle, and that is where the ends are.
    scales = [_px_per_rad(arc, camera, turn @ nadir) for arc, camera, turn in seen]
    off_px = [
        (off_axis_angle(one, axis) - radius) * scale
        for one, (axis, radius), scale in zip(los, about, scales, strict=True)
    ]
    variance_px = max(float(np.mean(np.concatenate(off_px) ** 2)), 0.0 if sub_pixel else PIXEL_SIGMA_PX**2)
    if ends is ChordEnds.SIGHT:
        length = max(_correlated_pixels(one, *cone) for one, cone in zip(los, about, strict=True))
        variance_px *= min(1.0, length / END_PIXELS)
    first = seen[0][2]
    to_nadir_cam = first @ np.linalg.pinv(chords) * np.sin(rho)
    of_one_px = (to_nadir_cam * [float(np.sum(scale[[0, -1]] ** -2.0)) for scale in scales]) @ to_nadir_cam.T
    return fit_of_nadir(
        heads[0],
        first @ nadir,
        variance_px * of_one_px,
        rho,
        points=arcs[0].uv,
        residuals_rad=angles[0] - rho,
        # Slow errors are one over an end: its pixels do not average them out, and their scatter does not show them.
        systematic_nadir_cam=SLOW_PX**2 * of_one_px if sub_pixel else None,
    )


def _cam_from_body(head: Observation) -> FloatArray:
    return Rotation.from_quat(head.q_cam_from_body).as_matrix()


def _correlated_pixels(los: FloatArray, nadir: FloatArray, rho_rad: float) -> float:
    """Return over how many neighbours along an arc the departures from the cone are one."""
    try:
        return cone_uncertainty(los, nadir, rho_rad).correlation_length
    except np.linalg.LinAlgError:
        return float(END_PIXELS)


def _px_per_rad(arc: Arc, camera: CameraModel, nadir_cam: FloatArray) -> FloatArray:
    """Return by how many pixels each of an arc's points moves per radian towards the nadir, shape (n,)."""
    los = unproject(camera, arc.uv)
    towards = nadir_cam - (los @ nadir_cam)[:, None] * los
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    step = 1e-5
    moved, _ = project(camera, los + step * towards)
    return np.asarray(np.hypot(*(moved - arc.uv).T) / step)


def _towards_centre(arc: Arc, camera: CameraModel) -> FloatArray:
    """Return how the line of sight to the arc's middle turns one pixel towards the circle's centre, shape (3,)."""
    middle = arc.uv[len(arc.uv) // 2]
    inwards = arc.circle.centre - middle
    los = unproject(camera, np.array([middle, middle + inwards / np.hypot(*inwards)]))
    return np.asarray(los[1] - los[0])


def axis_of(views: Sequence[View]) -> FloatArray:
    """Return the vertical across the chords of two arcs, over the cosine of the angle that it makes with them."""
    arcs = [los_body(head, uv) for head, uv in views]
    found = vertical(np.array([arc[-1] - arc[0] for arc in arcs if len(arc)])) if all(map(len, arcs)) else None
    if found is None:
        raise np.linalg.LinAlgError("the chords span no plane")
    return np.asarray(found / np.mean(np.concatenate(arcs) @ found))


ESTIMATOR = Estimator(
    name="video-vertical",
    title="Local vertical from two perpendicular cameras (Belokonov and others 2016)",
    run=with_lens_error(solve, axis_of),
    estimates="geocentric",
    needs="heads",
    from_heads=from_heads,
)
