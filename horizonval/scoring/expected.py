"""Expected outcome of a frame, from its truth alone.

The exact horizon is sampled evenly around the Earth and projected into the image
(:mod:`horizonval.scoring.horizon_view`). A sample is *usable* if

* it is in view, far enough from the image's rim for its profile to be read,
* the Sun is high enough over it, and its signal exceeds the camera's noise, also under the Sun's veil,
* it is not saturated (:mod:`horizonval.scoring.limb_signal`; thermal bands need no Sun).

Samples are *enough* if their arc is long enough. The tests are made in this order, and the first that leaves too few
samples names the outcome: ``no_limb``, ``short_arc``, ``sun_glare`` (solar bands, the Sun's disc in view), ``dark``,
``sun_glare`` (veil), ``saturated``.

A frame that passes them is ``valid`` if its *information* determines the nadir: the frame's bound under the scene's
``[prior]`` (:mod:`horizonval.scoring.bound`) must not exceed ``prior.accept_deg``, 0.2 deg by default. Otherwise the
outcome is ``dark`` where most of the limb in view is unlit, else ``short_arc``. What a method makes of the information
does not enter. Before there is an image, the bound is predicted from the usable samples
(:func:`horizonval.scoring.information.edge_information`).

**Borderline.** The tests are also made with stricter and with more lenient thresholds
(:mod:`horizonval.scoring.limits`). A frame that is valid by one set and not by another is borderline: neither a claim
nor a refusal counts against an estimator. So is a frame with the Sun in view whose limb would do otherwise. A false
claim counts everywhere.

**Heads** (``needs = "heads"``, :func:`expected_of_heads`). A head need not determine the nadir by itself, all of them
together must. A camera must show an arc as long as a single camera's. A linear array must be crossed by the limb with
some pixels to spare at both ends, to know the levels of the step; in thermal bands by the infrared horizon of the
truth, which in carbon dioxide lies 40 km above the ground. The Sun's disc in a thermal linear array looks like a step
that saturates: ``sun_glare``, and borderline where the limb would do otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome
from horizonval.earth.limb_heights import SOLAR_RELIEF, THERMAL_RELIEF
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.horizon import signed_limb_angle
from horizonval.scoring import limits
from horizonval.scoring.bound import NO_BOUND, Bound, accept_rad, bound_of
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
from horizonval.scoring.information import edge_information
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
    bound_deg : float or None
        Bound of the nadir that decided: of the image, or predicted from the usable limb; None if the nadir is not
        determined, or if an earlier test decided.
    moon_in_frame : bool
    """

    outcome: Outcome
    horizon_fraction_in_view: float
    horizon_arc_px: float
    lit_fraction: float | None
    sun_in_frame: bool
    sun_limb_distance_deg: float
    sun_zenith_deg: float
    borderline: bool = False
    usable_arc_px: float = 0.0
    limb_snr: float | None = None
    veil_fraction: float = 0.0
    bound_deg: float | None = None
    moon_in_frame: bool = False


@dataclass(frozen=True)
class Examined:
    """Expected outcome of one band of a frame, with the horizon (the infrared one for a linear head) and its signal."""

    camera: CameraModel
    view: HorizonView
    signal: LimbSignal
    expected: Expected


def expected_outcome(
    truth: FrameTruth,
    band: str | None = None,
    *,
    needs: Literal["image", "pose", "heads"] = "image",
    bound: Bound | None = None,
) -> Expected:
    """Return what an estimator should report for one band of a frame; parameters and errors as :func:`examine`."""
    return examine(truth, band, needs=needs, bound=bound).expected


def examine(
    truth: FrameTruth,
    band: str | None = None,
    *,
    needs: Literal["image", "pose", "heads"] = "image",
    bound: Bound | None = None,
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
    bound : Bound, optional
        Of the image. Without it the bound is predicted.

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
    scene = _Scene(truth, camera, chosen, view, signal, sun_in_frame(camera, truth), needs == "heads", bound)
    outcome = _decide(scene, limits.NOMINAL)
    others = {_decide(scene, thresholds) is Outcome.VALID for thresholds in (limits.STRICT, limits.LENIENT)}
    borderline = others != {outcome is Outcome.VALID}
    if outcome is Outcome.SUN_GLARE and scene.sun:
        borderline = _decide(replace(scene, sun=False), limits.LENIENT) is Outcome.VALID
    if needs == "pose":
        outcome, borderline = Outcome.VALID, False

    lit = _lit(scene, limits.NOMINAL)
    usable = _usable(scene, limits.NOMINAL)
    arc_px, lit_px = (extent(view.uv, member) for member in (view.in_view, lit))
    seen = view.in_view
    up_cam = -np.array(truth.nadir_geodetic_cam)
    ellipsoid = truth.ellipsoid
    expected = Expected(
        outcome=outcome,
        horizon_fraction_in_view=float(seen.mean()),
        horizon_arc_px=arc_px,
        lit_fraction=lit_px / arc_px if arc_px > 0 else None,
        sun_in_frame=scene.sun,
        sun_limb_distance_deg=-math.degrees(float(signed_limb_angle(truth.sun_itrs, truth.r_itrs, ellipsoid))),
        sun_zenith_deg=math.degrees(math.acos(max(-1.0, min(1.0, float(up_cam @ np.array(truth.sun_cam)))))),
        borderline=borderline,
        usable_arc_px=extent(view.uv, usable),
        limb_snr=min(float(np.median(signal.seen[seen])), limits.LARGEST_SNR) if seen.any() else None,
        veil_fraction=float(signal.veil_filling[seen].max()) if seen.any() else 0.0,
        bound_deg=None if scene.bound_rad is None else math.degrees(scene.bound_rad),
        moon_in_frame=moon_in_frame(camera, truth),
    )
    return Examined(camera, view, signal, expected)


def expected_of_heads(heads: Sequence[Expected], truth: FrameTruth, bound: Bound | None = None) -> Expected:
    """Return the expected outcome of a method that uses several heads.

    It is the outcome of the first head that lacks an arc or crossing, and ``short_arc`` where the bound of all of them
    does not meet what the scene accepts. The frame is borderline if any head is and no other head makes the outcome
    certain. Sun and Moon are in the frame of any head. Other figures are the first head's.

    ``truth``: that of any head. ``bound``: of all heads' images together; without it heads are taken to determine the
    nadir.
    """
    whole = replace(
        heads[0],
        sun_in_frame=any(head.sun_in_frame for head in heads),
        moon_in_frame=any(head.moon_in_frame for head in heads),
        bound_deg=None if bound is None or bound.known_rad is None else math.degrees(bound.known_rad),
    )
    failed = [head for head in heads if head.outcome is not Outcome.VALID]
    if failed:
        certain = [head for head in failed if not head.borderline]
        return replace(whole, outcome=(certain or failed)[0].outcome, borderline=not certain)
    borderline = any(head.borderline for head in heads)
    if bound is None:
        return replace(whole, borderline=borderline)
    met, strict, lenient = (
        _accepted(bound.known_rad, truth, one) for one in (limits.NOMINAL, limits.STRICT, limits.LENIENT)
    )
    outcome = Outcome.VALID if met else Outcome.SHORT_ARC
    return replace(whole, outcome=outcome, borderline=(borderline and lenient) or strict != lenient)


@dataclass(frozen=True)
class _Scene:
    truth: FrameTruth
    camera: CameraModel
    band: Band
    view: HorizonView
    signal: LimbSignal
    sun: bool
    one_of_several: bool
    bound: Bound | None

    @property
    def solar(self) -> bool:
        return self.band.kind == "solar"

    @property
    def crossing_only(self) -> bool:
        return self.one_of_several and _linear(self.camera)

    @cached_property
    def bound_rad(self) -> float | None:
        """Bound of the nadir: of the image, else predicted."""
        bound = _predicted(self) if self.bound is None else self.bound
        return bound.known_rad


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
    if not _enough(scene, _usable(scene, thresholds), thresholds):
        return Outcome.SATURATED
    if scene.one_of_several or _accepted(scene.bound_rad, scene.truth, thresholds):
        return Outcome.VALID
    return Outcome.DARK if lit.sum() < seen.sum() / 2 else Outcome.SHORT_ARC


def _accepted(bound_rad: float | None, truth: FrameTruth, thresholds: Thresholds) -> bool:
    """Whether a bound meets what the scene's prior accepts."""
    return bound_rad is not None and bound_rad <= thresholds.accept_factor * accept_rad(truth)


def _usable(scene: _Scene, thresholds: Thresholds) -> BoolArray:
    return _in_reach(scene, thresholds) & _informative(scene, thresholds)


def _informative(scene: _Scene, thresholds: Thresholds) -> BoolArray:
    """Whether samples are lit, above the noise and not saturated, also in the image's rim."""
    signal = scene.signal
    return np.asarray(
        _lit(scene, thresholds)
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
    arc_px = extent(scene.view.uv, member)
    return arc_px >= thresholds.arc_fraction * min(scene.camera.width, scene.camera.height)


def _predicted(scene: _Scene) -> Bound:
    """Return the bound of the samples that carry information; each represents a piece of the arc."""
    usable = _informative(scene, limits.NOMINAL)
    step = max(1, int(usable.sum()) // limits.BOUND_SAMPLES)
    uv = scene.view.uv[usable][::step]
    edge_px = np.hypot(limits.EDGE_SIGMA_PX / scene.signal.seen[usable][::step], limits.EDGE_FLOOR_PX)
    truth, arc_px = scene.truth, extent(scene.view.uv, usable)
    if not len(uv) or arc_px <= 0.0:
        return NO_BOUND
    information = edge_information(
        scene.camera,
        uv,
        edge_px * math.sqrt(len(uv) / arc_px),
        Rotation.from_quat(truth.q_cam_from_itrs).as_matrix(),
        np.array(truth.r_itrs),
        truth.ellipsoid,
        SOLAR_RELIEF if scene.solar else THERMAL_RELIEF,
        body_from_cam=Rotation.from_quat(truth.q_cam_from_body).inv().as_matrix(),
    )
    return bound_of(information, truth, scene.band.name)


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
