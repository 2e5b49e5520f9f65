"""What should come of a frame, from its truth alone.

A refusal is right or wrong only against what was in view. The exact horizon is sampled evenly around the Earth and
projected into the image; in solar bands a point of it is lit where the Sun stands above the local horizon,

    cos(zenith) = up . sun >= cos(LIT_MAX_SOLAR_ZENITH),

with ``up`` the ellipsoid's normal at the tangent point; in thermal bands all of it shines. The first of these that
holds is expected: ``no_limb`` (no horizon in view), ``short_arc`` (too little of it, or too straight),
``sun_glare`` (solar bands, the Sun's disc in view), ``dark`` (too little of it lit), else ``valid``.

Neglected: clouds, saturation and the Sun outside the image. They are properties of the radiance or of the detector and
not of the geometry; an estimator that refuses because of them counts as unavailable, which is what its user sees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from horizonval.errors import UserError
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import Camera, camera_from_spec, project
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.horizon import horizon_cam, signed_limb_angle, tangency_points
from horizonval.outcome import Outcome
from horizonval.scoring import limits
from horizonval.spec.camera import CameraSpec

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_STEPS_ACROSS_FIELD = 1000
"""Samples of the horizon per field of view, the narrower side: lengths are right to 0.2 %."""
_SAMPLES_MIN, _SAMPLES_MAX = 21600, 400_000


@dataclass(frozen=True)
class Expected:
    """Expected outcome of one band of a frame, and the geometry it follows from.

    Attributes
    ----------
    outcome : Outcome
    horizon_fraction_in_view : float
        Share of the horizon's whole circle, by azimuth about the nadir, that falls into the image.
    horizon_arc_px : float
        Its length in the image.
    horizon_sagitta_px : float
        How far the arc in view deviates from a great circle (a straight line in an undistorted image).
    lit_fraction : float or None
        Share of that length which is lit (1 in thermal bands); ``None`` without horizon in view.
    lit_arc_px, lit_sagitta_px : float
        As above, of the lit part.
    sun_in_frame : bool
        Any visible part of the Sun's disc inside the image.
    sun_limb_distance_deg : float
        From the Sun's centre to the nearest point of the horizon; negative in front of or behind the Earth.
    sun_zenith_deg : float
        At the point below the satellite.
    """

    outcome: Outcome
    horizon_fraction_in_view: float
    horizon_arc_px: float
    horizon_sagitta_px: float
    lit_fraction: float | None
    lit_arc_px: float
    lit_sagitta_px: float
    sun_in_frame: bool
    sun_limb_distance_deg: float
    sun_zenith_deg: float


def expected_outcome(
    truth: FrameTruth, band: str | None = None, *, needs: Literal["image", "pose"] = "image"
) -> Expected:
    """Return what an estimator should report for one band of a frame.

    Parameters
    ----------
    truth : FrameTruth
    band : str, optional
        Name of the band; the camera's first one by default.
    needs : {"image", "pose"}, optional
        ``Estimator.needs``: a method that is given the pose can always answer.

    Raises
    ------
    UserError
        The camera has no such band.
    """
    spec = CameraSpec.model_validate(truth.camera)
    camera = camera_from_spec(spec.camera)
    solar = _is_solar(spec, band)
    ellipsoid = Ellipsoid(truth.ellipsoid_a_m, truth.ellipsoid_b_m)
    samples = _samples(camera)
    uv, _ = project(camera, horizon_cam(truth.r_itrs, truth.q_cam_from_itrs, ellipsoid, samples))
    in_view = _inside(camera, uv)
    lit = in_view
    if solar:
        lit = in_view & (_cos_solar_zenith(truth, ellipsoid, samples) >= math.cos(_LIT_LIMIT))

    arc_px, sagitta_px = _extent(camera, uv, in_view, truth.angular_radius_rad)
    lit_px, lit_sagitta_px = _extent(camera, uv, lit, truth.angular_radius_rad)
    sun_in_frame = _sun_in_frame(camera, truth)
    enough = limits.MIN_ARC_FRACTION_OF_IMAGE * min(camera.width, camera.height)

    if needs == "pose":
        outcome = Outcome.VALID
    elif not in_view.any():
        outcome = Outcome.NO_LIMB
    elif arc_px < enough or sagitta_px < limits.MIN_ARC_SAGITTA_PX:
        outcome = Outcome.SHORT_ARC
    elif solar and sun_in_frame:
        outcome = Outcome.SUN_GLARE
    elif lit_px < enough or lit_sagitta_px < limits.MIN_ARC_SAGITTA_PX:
        outcome = Outcome.DARK
    else:
        outcome = Outcome.VALID

    up_cam = -np.array(truth.nadir_geodetic_cam)
    return Expected(
        outcome=outcome,
        horizon_fraction_in_view=float(in_view.mean()),
        horizon_arc_px=arc_px,
        horizon_sagitta_px=sagitta_px,
        lit_fraction=lit_px / arc_px if arc_px > 0 else None,
        lit_arc_px=lit_px,
        lit_sagitta_px=lit_sagitta_px,
        sun_in_frame=sun_in_frame,
        sun_limb_distance_deg=-math.degrees(float(signed_limb_angle(truth.sun_itrs, truth.r_itrs, ellipsoid))),
        sun_zenith_deg=math.degrees(math.acos(max(-1.0, min(1.0, float(up_cam @ np.array(truth.sun_cam)))))),
    )


_LIT_LIMIT = math.radians(limits.LIT_MAX_SOLAR_ZENITH_DEG)


def _is_solar(spec: CameraSpec, name: str | None) -> bool:
    bands = {band.name: band.kind for band in spec.band}
    if not bands:
        raise UserError("the frame's camera has no bands", where="band", expected="at least one [[band]]")
    chosen = name if name is not None else spec.band[0].name
    if chosen not in bands:
        raise UserError(f"no band {chosen!r}", where="band", expected=f"one of {sorted(bands)}")
    return bands[chosen] == "solar"


def _inside(camera: Camera, uv: FloatArray) -> BoolArray:
    # Comparisons with NaN, the mark of a direction without an image, are False.
    inside: BoolArray = (
        (uv[..., 0] >= -0.5)
        & (uv[..., 0] <= camera.width - 0.5)
        & (uv[..., 1] >= -0.5)
        & (uv[..., 1] <= camera.height - 0.5)
    )
    return inside


def _samples(camera: Camera) -> int:
    field = min(camera.width / camera.fx, camera.height / camera.fy)
    return int(min(max(_STEPS_ACROSS_FIELD * math.tau / field, _SAMPLES_MIN), _SAMPLES_MAX))


def _cos_solar_zenith(truth: FrameTruth, ellipsoid: Ellipsoid, samples: int) -> FloatArray:
    points = tangency_points(truth.r_itrs, ellipsoid, np.arange(samples) * (math.tau / samples))
    # The gradient of (x/a)^2 + (y/a)^2 + (z/b)^2: the points lie on the surface.
    normal = points / ellipsoid.axes_m**2
    cosines: FloatArray = normal @ np.array(truth.sun_itrs) / np.linalg.norm(normal, axis=-1)
    return cosines


def _extent(camera: Camera, uv: FloatArray, member: BoolArray, angular_radius_rad: float) -> tuple[float, float]:
    """Length [px] of the members of a closed curve, and the sagitta [px] of the circle's part that they span.

    The great circle through two points of a circle of angular radius ``rho``, ``2 h`` of azimuth apart, passes the
    middle at the polar angle ``atan(tan(rho) cos(h))``; the sagitta is the difference to ``rho``. The span is the
    circle less its largest gap: two far ends determine a circle as well as the arc between them.
    """
    n = len(member)
    if not member.any():
        return 0.0, 0.0
    pair = member & np.roll(member, -1)
    steps = np.linalg.norm(np.roll(uv, -1, axis=0) - uv, axis=-1)
    where = np.flatnonzero(member)
    gaps = np.diff(np.append(where, where[0] + n))
    half = math.pi * (1 - float(gaps.max()) / n) if len(where) > 1 else 0.0
    # From a half circle on the chord's middle crosses to the nadir and beyond: nothing straight about it.
    polar = math.atan(math.tan(angular_radius_rad) * math.cos(min(half, math.pi / 2)))
    return float(steps[pair].sum()), (angular_radius_rad - polar) * min(camera.fx, camera.fy)


def _sun_in_frame(camera: Camera, truth: FrameTruth) -> bool:
    if truth.sun_visible_fraction <= 0:
        return False
    centre = np.array(truth.sun_cam)
    across = np.cross(centre, np.eye(3)[int(np.argmin(np.abs(centre)))])
    across /= np.linalg.norm(across)
    angle = np.linspace(0, math.tau, 64, endpoint=False)[:, None]
    ring = np.cos(angle) * across + np.sin(angle) * np.cross(centre, across)
    radius = truth.sun_angular_radius_rad
    disc = np.concatenate([centre[None, :], math.cos(radius) * centre + math.sin(radius) * ring])
    return bool(_inside(camera, project(camera, disc)[0]).any())
