"""The horizon in a camera's view and its brightness, predicted from the truth of a frame.

Nothing is rendered: the horizon comes from :mod:`horizonval.scoring.horizon_view`, its radiance from
:mod:`horizonval.scoring.limb_signal`, the outcome from :mod:`horizonval.scoring.expected`, so that a check agrees with
the later score.

**Level** of a solar band: the largest radiance at the limb or some ten kilometres below it, with the Sun's veil, over
full scale above the black level. Where clouds or snow may be in view there are two: over ground of the Earth's albedo,
and over the brightest possible ground or cloud. The prediction is within 5 % of rendered limbs by day in clear air and
with the default haze, 30 % with clouds, and a factor of two in twilight: the accuracy of the table of
:mod:`horizonval.scoring.limb_signal`.

**Level** of a thermal band: the plateau of the truth's infrared horizon between the converter's ends, within 10 % in
clear air. The warmer ground below adds to a rendered limb, and the blur of the edge reduces it. Without the infrared
horizon there is no level.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from horizonval.api.check.findings import median, percent
from horizonval.core.outcome import Outcome
from horizonval.earth.spectral.planck import brightness_temperature_k
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.scoring import limits
from horizonval.scoring.bound import accept_rad
from horizonval.scoring.expected import Examined, Expected, examine
from horizonval.scoring.limb_signal import ground_and_air, limb_signal
from horizonval.sensor.detector.thermal import blackbody_radiance
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Cmos

Needs = Literal["image", "pose", "heads"]


@dataclass(frozen=True)
class LimbView:
    """One band of one frame, predicted without rendering.

    Attributes
    ----------
    expected : Expected
        The outcome that an estimator should report, with its reasons.
    shortest_px, accept_deg : float
        Shortest arc that an estimator needs, and the bound of the nadir that it needs.
    level, highest : float or None
        Over full scale along the limb in view: median without clouds and snow, and maximum with those that the scene
        can have. None without a limb, a detector or an infrared horizon.
    saturated_share : float
        Of the limb in view, with clouds and snow.
    patchy : bool
        Whether clouds or snow are possible.
    plateau_k : float or None
        Brightness temperature of a thermal limb.
    sun_outside_deg : float or None
        Angle of the Sun's centre outside the image; None for the Sun in the frame or behind the Earth.
    sun_visible_fraction : float
        0 in the Earth's shadow.
    exposure_s : float or None
        Fixed exposure; None for automatic and thermal ones.
    ray_spacing_m : float
        Distance of the rays of a pixel on the axis, at the limb.
    """

    band: Band
    expected: Expected
    shortest_px: float
    accept_deg: float
    sun_outside_deg: float | None
    sun_visible_fraction: float
    exposure_s: float | None
    ray_spacing_m: float
    level: float | None = None
    highest: float | None = None
    saturated_share: float = 0.0
    patchy: bool = False
    plateau_k: float | None = None

    @property
    def outcome(self) -> Outcome:
        """What an estimator should report."""
        return self.expected.outcome

    @property
    def arc_px(self) -> float:
        """Length in the image of the horizon in view."""
        return self.expected.horizon_arc_px

    @property
    def arc_deg(self) -> float:
        """Azimuth about the nadir of the horizon in view, of 360."""
        return 360.0 * self.expected.horizon_fraction_in_view

    @property
    def snr(self) -> float | None:
        """Signal-to-noise ratio of a pixel's step at the limb, median; at most 1e6."""
        return self.expected.limb_snr

    def line(self) -> str:
        """Return view and brightness of the frame as text."""
        parts = [
            f"{self.arc_deg:.0f} deg of horizon in view ({self.arc_px:.0f} px)" if self.arc_px else "no horizon in view"
        ]
        warmth = [] if self.plateau_k is None else [f"{self.plateau_k:.0f} K"]
        level = [] if self.level is None else [f"{percent(self.level)} of full scale"]
        if self.highest is not None and self.level is not None and self.highest > 1.05 * self.level:
            level = [f"{level[0]} (at most {percent(self.highest)})"]
        if warmth or level:
            parts.append(f"limb at {', '.join(warmth + level)}")
        if self.snr is not None:
            parts.append(f"SNR {self.snr:.3g}" if self.snr < 1e6 else "no noise")
        parts.append(f"expected: {self.outcome}" + (" (borderline)" if self.expected.borderline else ""))
        return ", ".join(parts)


def group_line(views: Sequence[LimbView], frames: int) -> str:
    """Return the view of a group's frames as text: medians, and the count of each outcome."""
    counts = Counter(str(view.outcome) for view in views)
    found = ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common())
    looked = f"{frames} frames" if len(views) == frames else f"{len(views)} of {frames} frames"
    parts = [f"{looked} ({found})"]
    arc, level, snr = (median(getattr(view, key) for view in views) for key in ("arc_deg", "level", "snr"))
    if arc:
        parts.append(f"{arc:.0f} deg of horizon")
    if level is not None:
        parts.append(f"limb at {percent(level)} of full scale")
    if snr is not None and snr < 1e6:
        parts.append(f"SNR {snr:.3g}")
    return ", ".join(parts) + (" (medians)" if len(parts) > 1 and len(views) > 1 else "")


def limb_views(truth: FrameTruth, camera: CameraSpec, needs: Needs = "image") -> list[LimbView]:
    """Return the predicted view of every band of a frame.

    Without an infrared horizon in the truth, thermal bands have no level, and a linear array among several heads is
    taken to see the ground's horizon. ``needs``: input of the estimators; see
    :func:`horizonval.scoring.expected.examine`.
    """
    return [_limb_view(truth, camera, band, needs) for band in camera.band]


def _limb_view(truth: FrameTruth, camera: CameraSpec, band: Band, needs: Needs) -> LimbView:
    found = examine(truth, band.name, needs=needs)
    model, detector, r_itrs = found.camera, camera.detector, np.array(truth.r_itrs)
    to_limb = math.sqrt(max(float(r_itrs @ r_itrs) - truth.ellipsoid.a_m**2, 0.0))
    fixed = isinstance(detector, Cmos) and detector.auto_exposure is None
    levels = _solar_levels if band.kind == "solar" else _thermal_levels
    return LimbView(
        band=band,
        expected=found.expected,
        shortest_px=limits.NOMINAL.arc_fraction * min(model.width, model.height),
        accept_deg=math.degrees(accept_rad(truth)),
        sun_outside_deg=None if found.expected.sun_in_frame else sun_outside_deg(model, truth),
        sun_visible_fraction=truth.sun_visible_fraction,
        exposure_s=detector.exposure_s if isinstance(detector, Cmos) and fixed else None,
        ray_spacing_m=to_limb / max(model.fx, model.fy) / int(truth.scene["render"]["subsamples"]),
        **levels(found, truth, camera, band),
    )


def _solar_levels(found: Examined, truth: FrameTruth, camera: CameraSpec, band: Band) -> dict[str, Any]:
    in_view = found.view.in_view
    if not in_view.any() or not isinstance(camera.detector, Cmos):
        return {}
    brightest = found.signal.filling[in_view]
    usual, plain = brightest, _plain_ground(truth.scene)
    if plain is not None:
        usual = limb_signal(replace(truth, scene=plain), camera, band, found.camera, found.view).filling[in_view]
    return {
        "level": float(np.median(usual)),
        "highest": float(brightest.max()),
        "saturated_share": float((brightest > 1.0).mean()),
        "patchy": plain is not None,
    }


def _thermal_levels(found: Examined, truth: FrameTruth, camera: CameraSpec, band: Band) -> dict[str, Any]:
    horizon, detector = truth.infrared_horizon.get(band.name), camera.detector
    if horizon is None or not horizon["plateau_radiance"]:
        return {}
    # Azimuths of the truth's plateau are about the nadir; it changes by a few per cent between them.
    plateau = np.array(horizon["plateau_radiance"])
    plateau_k = float(brightness_temperature_k(band, np.median(plateau)))
    if detector is None or isinstance(detector, Cmos) or not found.view.in_view.any():
        return {"plateau_k": plateau_k}
    low, high = (blackbody_radiance(band, end_k) for end_k in (detector.scene_min_k, detector.scene_max_k))
    level = (plateau - low) / (high - low)
    return {
        "level": float(np.median(level)),
        "highest": float(level.max()),
        "saturated_share": float((level > 1.0).mean()),
        "plateau_k": plateau_k,
    }


def _plain_ground(scene: dict[str, Any]) -> dict[str, Any] | None:
    """Return a scene with the Earth's mean albedo and no clouds; None if the given one is no brighter."""
    _, albedo, brightest = ground_and_air(scene)
    if brightest <= albedo:
        return None
    return {**scene, "surface": {"kind": "uniform", "albedo": albedo}, "clouds": None}


def sun_outside_deg(camera: CameraModel, truth: FrameTruth) -> float | None:
    """Return the angle from the Sun's centre to the nearest of 400 points of the image's outline; None behind the
    Earth.
    """
    if truth.sun_visible_fraction <= 0.0:
        return None
    s = np.linspace(0.0, 1.0, 100, endpoint=False)
    zero, one = np.zeros_like(s), np.ones_like(s)
    u = np.concatenate([s, one, 1.0 - s, zero]) * camera.width - 0.5
    v = np.concatenate([zero, s, one, 1.0 - s]) * camera.height - 0.5
    outline = unproject(camera, np.stack([u, v], axis=-1))
    cosine = outline @ np.array(truth.sun_cam)
    # Pixels beyond a lens's image circle have no direction.
    if not np.isfinite(cosine).any():
        place, has_image = project(camera, np.array(truth.sun_cam))
        return 0.0 if bool(has_image) and np.isfinite(place).all() else None
    return math.degrees(math.acos(max(-1.0, min(1.0, float(np.nanmax(cosine))))))
