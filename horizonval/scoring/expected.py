"""Expected outcome of a frame, from its truth alone.

The exact horizon is sampled evenly around the Earth and projected into the image
(:mod:`horizonval.scoring.horizon_view`). A sample is *usable* if

* it is in view, far enough from the image's rim for its profile to be read,
* the Sun is high enough over it, and its signal exceeds the camera's noise, also under the Sun's veil,
* it is not saturated (:mod:`horizonval.scoring.limb_signal`; thermal bands need no Sun).

Samples are *enough* if their arc is long and bent enough, and if they determine the nadir: the standard deviation of a
cone through them, from the scatter of single points and from all that makes the limb no circle
(:mod:`horizonval.earth.limb_heights`), must be below a limit.

The tests are made in this order, and the first that leaves too few samples names the outcome: ``no_limb``,
``short_arc``, ``sun_glare`` (solar bands, the Sun's disc in view), ``dark``, ``sun_glare`` (veil), ``saturated``; else
``valid``.

**Borderline.** The tests are also made with stricter and with more lenient thresholds
(:mod:`horizonval.scoring.limits`). A frame that is valid by one set and not by another is borderline: neither a claim
nor a refusal counts against an estimator. So is a frame with the Sun in view whose limb would do otherwise. A false
claim counts everywhere.

**Heads** (``needs = "heads"``, :func:`expected_of_heads`). A head need not determine the nadir by itself. A camera must
show an arc as long as a single camera's, straight or not. A linear array must be crossed by the limb with some pixels
to spare at both ends, to know the levels of the step; in thermal bands by the infrared horizon of the truth, which in
carbon dioxide lies 40 km above the ground. The Sun's disc in a thermal linear array looks like a step that saturates:
``sun_glare``, and borderline where the limb would do otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome
from horizonval.earth.limb_heights import (
    CLOUD_RELIEF_SOLAR,
    CLOUD_RELIEF_THERMAL,
    SOLAR_RELIEF,
    THERMAL_RELIEF,
    Relief,
    systematic_covariance,
)
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.horizon import fit_cone, signed_limb_angle
from horizonval.geometry.rotation import off_axis_angle, tangent_basis
from horizonval.scoring import limits
from horizonval.scoring.horizon_view import (
    HorizonView,
    extent,
    horizon_view,
    inside_image,
    moon_in_frame,
    seen_in_image,
    sun_in_frame,
    usable_margin_px,
)
from horizonval.scoring.limb_signal import LimbSignal, limb_signal
from horizonval.scoring.limits import Thresholds
from horizonval.spec.camera import Band, CameraSpec
from horizonval.truth.infrared_horizon import curve_cam

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Expected:
    """Expected outcome of one band of a frame, and what it follows from.

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
        Share of that length that is sunlit (1 in thermal bands); None without horizon in view.
    sun_in_frame : bool
        Any visible part of the Sun's disc inside the image.
    sun_limb_distance_deg : float
        From the Sun's centre to the nearest point of the horizon; negative in front of or behind the Earth.
    sun_zenith_deg : float
        At the point below the satellite.
    borderline : bool
        Close to a threshold: neither answer is counted against an estimator.
    usable_arc_px : float
        Length of the usable limb.
    limb_snr : float or None
        Median signal-to-noise ratio of the limb in view, the Sun's veil included, at most 1e6; None without limb.
    veil_fraction : float
        Largest veil on the limb in view, as a share of full scale.
    determined_deg : float or None
        Standard deviation, in its worst direction, of the nadir that the usable limb determines; None if it does not.
    moon_in_frame : bool
    """

    outcome: Outcome
    horizon_fraction_in_view: float
    horizon_arc_px: float
    horizon_sagitta_px: float
    lit_fraction: float | None
    sun_in_frame: bool
    sun_limb_distance_deg: float
    sun_zenith_deg: float
    borderline: bool = False
    usable_arc_px: float = 0.0
    limb_snr: float | None = None
    veil_fraction: float = 0.0
    determined_deg: float | None = None
    moon_in_frame: bool = False


@dataclass(frozen=True)
class Examined:
    """Expected outcome of one band of a frame, with the horizon (the infrared one for a linear head) and its signal."""

    camera: CameraModel
    view: HorizonView
    signal: LimbSignal
    expected: Expected


def expected_outcome(
    truth: FrameTruth, band: str | None = None, *, needs: Literal["image", "pose", "heads"] = "image"
) -> Expected:
    """Return what an estimator should report for one band of a frame; parameters and errors as :func:`examine`."""
    return examine(truth, band, needs=needs).expected


def examine(
    truth: FrameTruth, band: str | None = None, *, needs: Literal["image", "pose", "heads"] = "image"
) -> Examined:
    """Return the expected outcome of one band of a frame, with the horizon and its signal.

    Parameters
    ----------
    truth : FrameTruth
    band : str, optional
        Name of the band; the camera's first one by default.
    needs : {"image", "pose", "heads"}, optional
        ``Estimator.needs``: a method that is given the pose can always answer; a method of several heads needs an arc
        from each camera and a crossing from each linear array.

    Raises
    ------
    UserError
        The camera has no such band.
    """
    spec, camera = truth.camera_spec, truth.camera_model
    chosen = _band(spec, band)
    view = horizon_view(truth, camera)
    if needs == "heads" and _linear(camera) and chosen.name in truth.infrared_horizon:
        view = _infrared_view(truth, camera, chosen.name, view)
    signal = limb_signal(truth, spec, chosen, camera, view)
    scene = _Scene(truth, camera, chosen.kind == "solar", view, signal, sun_in_frame(camera, truth), needs == "heads")
    outcome = _decide(scene, limits.NOMINAL)
    others = {_decide(scene, thresholds) is Outcome.VALID for thresholds in (limits.STRICT, limits.LENIENT)}
    borderline = others != {outcome is Outcome.VALID}
    if outcome is Outcome.SUN_GLARE and scene.sun:
        borderline = _decide(replace(scene, sun=False), limits.LENIENT) is Outcome.VALID
    if needs == "pose":
        outcome, borderline = Outcome.VALID, False

    lit = _lit(scene, limits.NOMINAL)
    usable = _usable(scene, limits.NOMINAL)
    rho = truth.angular_radius_rad
    arc_px, sagitta_px = extent(camera, view.uv, view.in_view, rho)
    lit_px, _ = extent(camera, view.uv, lit, rho)
    determined = _determined_rad(scene, usable)
    seen = view.in_view
    up_cam = -np.array(truth.nadir_geodetic_cam)
    ellipsoid = truth.ellipsoid
    expected = Expected(
        outcome=outcome,
        horizon_fraction_in_view=float(seen.mean()),
        horizon_arc_px=arc_px,
        horizon_sagitta_px=sagitta_px,
        lit_fraction=lit_px / arc_px if arc_px > 0 else None,
        sun_in_frame=scene.sun,
        sun_limb_distance_deg=-math.degrees(float(signed_limb_angle(truth.sun_itrs, truth.r_itrs, ellipsoid))),
        sun_zenith_deg=math.degrees(math.acos(max(-1.0, min(1.0, float(up_cam @ np.array(truth.sun_cam)))))),
        borderline=borderline,
        usable_arc_px=extent(camera, view.uv, usable, rho)[0],
        limb_snr=min(float(np.median(signal.seen[seen])), 1e6) if seen.any() else None,
        veil_fraction=float(signal.veil_filling[seen].max()) if seen.any() else 0.0,
        determined_deg=math.degrees(determined) if math.isfinite(determined) else None,
        moon_in_frame=moon_in_frame(camera, truth),
    )
    return Examined(camera, view, signal, expected)


def expected_of_heads(heads: Sequence[Expected]) -> Expected:
    """Return the expected outcome of a method that uses several heads.

    It is the outcome of the first head that lacks an arc or crossing. The frame is borderline if any head is and no
    other head makes the outcome certain. Sun and Moon are in the frame of any head. Other figures are the first head's.
    """
    whole = replace(
        heads[0],
        sun_in_frame=any(head.sun_in_frame for head in heads),
        moon_in_frame=any(head.moon_in_frame for head in heads),
    )
    failed = [head for head in heads if head.outcome is not Outcome.VALID]
    if not failed:
        return replace(whole, borderline=any(head.borderline for head in heads))
    certain = [head for head in failed if not head.borderline]
    return replace(whole, outcome=(certain or failed)[0].outcome, borderline=not certain)


@dataclass(frozen=True)
class _Scene:
    truth: FrameTruth
    camera: CameraModel
    solar: bool
    view: HorizonView
    signal: LimbSignal
    sun: bool
    one_of_several: bool
    determined_rad: dict[bytes, float] = field(default_factory=dict)
    """Results by set of samples: most thresholds select the same ones."""

    @property
    def crossing_only(self) -> bool:
        return self.one_of_several and _linear(self.camera)


def _decide(scene: _Scene, thresholds: Thresholds) -> Outcome:
    seen = _in_reach(scene, thresholds)
    if not scene.view.in_view.any():
        return Outcome.NO_LIMB
    if not _enough(scene, seen, thresholds):
        return Outcome.SHORT_ARC
    if (scene.solar or scene.crossing_only) and scene.sun:
        return Outcome.SUN_GLARE
    lit = seen & _lit(scene, thresholds) & (scene.signal.lit >= thresholds.snr)
    if not _enough(scene, lit, thresholds):
        return Outcome.DARK
    clear = lit & (scene.signal.seen >= thresholds.snr) & (scene.signal.veil_filling <= thresholds.veil)
    if not _enough(scene, clear, thresholds):
        return Outcome.SUN_GLARE
    return Outcome.VALID if _enough(scene, _usable(scene, thresholds), thresholds) else Outcome.SATURATED


def _usable(scene: _Scene, thresholds: Thresholds) -> BoolArray:
    signal = scene.signal
    return np.asarray(
        _in_reach(scene, thresholds)
        & _lit(scene, thresholds)
        & (signal.seen >= thresholds.snr)
        & (signal.veil_filling <= thresholds.veil)
        & (signal.filling <= thresholds.filling)
    )


def _linear(camera: CameraModel) -> bool:
    return min(camera.width, camera.height) <= limits.LINEAR_PX


def _infrared_view(truth: FrameTruth, camera: CameraModel, band: str, hard: HorizonView) -> HorizonView:
    """Return the view with the infrared horizon in place of the ground's; thermal bands do not ask for the Sun."""
    los, _ = curve_cam(truth, band, len(hard.in_view))
    uv, _ = project(camera, los)
    return replace(hard, los_cam=los, uv=uv, in_view=seen_in_image(truth, camera, los, uv))


def _in_reach(scene: _Scene, thresholds: Thresholds) -> BoolArray:
    camera, uv = scene.camera, scene.view.uv
    if not scene.crossing_only:
        return scene.view.in_view & inside_image(camera, uv, usable_margin_px(camera))
    along, length = (uv[:, 0], camera.width) if camera.width >= camera.height else (uv[:, 1], camera.height)
    # Comparisons with NaN, the mark of a direction without an image, are False.
    spared = (along >= thresholds.row_px - 0.5) & (along <= length - 0.5 - thresholds.row_px)
    return np.asarray(scene.view.in_view & spared)


def _lit(scene: _Scene, thresholds: Thresholds) -> BoolArray:
    if not scene.solar:
        return scene.view.in_view
    return scene.view.in_view & (scene.view.cos_zenith >= math.cos(thresholds.lit_zenith_rad))


def _enough(scene: _Scene, member: BoolArray, thresholds: Thresholds) -> bool:
    if scene.crossing_only:
        return bool(member.any())
    arc_px, sagitta_px = extent(scene.camera, scene.view.uv, member, scene.truth.angular_radius_rad)
    shortest = thresholds.arc_fraction * min(scene.camera.width, scene.camera.height)
    if arc_px < shortest:
        return False
    if scene.one_of_several:
        return True
    if sagitta_px < limits.MIN_ARC_SAGITTA_PX:
        return False
    return _determined_rad(scene, member) <= thresholds.determined_rad


def _determined_rad(scene: _Scene, member: BoolArray) -> float:
    """Return the standard deviation of the nadir, worst direction, that samples determine; infinite if they do not."""
    key = member.tobytes()
    if key not in scene.determined_rad:
        scene.determined_rad[key] = _work_out_determined_rad(scene, member)
    return scene.determined_rad[key]


def _work_out_determined_rad(scene: _Scene, member: BoolArray) -> float:
    los = scene.view.los_cam[member]
    if len(los) < 8:
        return math.inf
    los = los[:: max(1, len(los) // limits.DETERMINED_SAMPLES)]
    cone = fit_cone(los)
    rho = float(off_axis_angle(los, cone.axis_cam).mean())
    arc_px, _ = extent(scene.camera, scene.view.uv, member, scene.truth.angular_radius_rad)
    across = los @ tangent_basis(cone.axis_cam)
    jacobian = np.column_stack([across / np.linalg.norm(across, axis=1)[:, None], np.ones(len(los))])
    truth = scene.truth
    try:
        covariance = systematic_covariance(
            los,
            cone.axis_cam,
            rho,
            flattening=truth.ellipsoid.flattening,
            reliefs=_reliefs(scene, rho),
            earth_radius_m=truth.ellipsoid_a_m,
        )
        information = np.linalg.inv(jacobian.T @ jacobian)
    except np.linalg.LinAlgError:
        return math.inf
    point = limits.POINT_SIGMA_PX / min(scene.camera.fx, scene.camera.fy)
    covariance = covariance + point**2 * len(los) / max(arc_px, 1.0) * information
    sigma = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    return sigma if math.isfinite(sigma) else math.inf


def _reliefs(scene: _Scene, rho_rad: float) -> tuple[Relief, ...]:
    # Also where the scene has no air: no sensor can know that.
    reliefs: tuple[Relief, ...] = SOLAR_RELIEF if scene.solar else THERMAL_RELIEF
    clouds = scene.truth.scene.get("clouds")
    if clouds is not None and clouds.get("cover", "climate") != 0:
        relief = CLOUD_RELIEF_SOLAR if scene.solar else CLOUD_RELIEF_THERMAL
        to_limb_m = scene.truth.ellipsoid_a_m / math.tan(rho_rad)
        texture_m = limits.CLOUD_TEXTURE_PX * to_limb_m / min(scene.camera.fx, scene.camera.fy)
        reliefs = (*reliefs, relief, Relief(texture_m, relief.correlation_rad))
    return reliefs


def _band(spec: CameraSpec, name: str | None) -> Band:
    bands = {band.name: band for band in spec.band}
    if not bands:
        raise UserError("the frame's camera has no bands", where="band", expected="at least one [[band]]")
    chosen = name if name is not None else spec.band[0].name
    if chosen not in bands:
        raise UserError(f"no band {chosen!r}", where="band", expected=f"one of {sorted(bands)}")
    return bands[chosen]


def exclusion_angle_deg(angle_deg: Sequence[float], right: Sequence[bool]) -> float | None:
    """Return the smallest Sun angle from which on every answer is right [deg]; None if the widest one is wrong.

    Angles are from the boresight. One wrong or refused frame farther out moves the angle there: a mission cannot avoid
    single frames. Several frames may share an angle.
    """
    wrong = [angle for angle, good in zip(angle_deg, right, strict=True) if not good]
    widest_wrong = max(wrong, default=-1.0)
    return min((angle for angle in angle_deg if angle > widest_wrong), default=None)
