"""The error sources of a budget, and how each is switched off.

A source is switched off in the scene (another frame is rendered), in the detector, or in what estimators are given. All
draws are common: noise, calibration errors and errors of the prior are those of the frame with everything on. A
switched-off calibration or prior error is zero, and the estimator still assumes its standard deviation: the row holds
what the error does, not what knowing it would bring. Read and shot noise stay on, since estimators weigh pixels by
them; their row is the scatter of the answers over several draws.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from horizonval.estimation.prior import Prior
from horizonval.frame import FrameTruth
from horizonval.sensor.knowledge import calibration_of, errors_of
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import Cmos
from horizonval.spec.scene import SceneSpec

BIAS, FIELD, PIXEL, NOISE = "bias", "field spatial", "pixel spatial", "temporal noise"
"""Classes of ECSS-E-ST-60-20C: constant in a flight, varying slowly over the field of view, over a pixel, in time."""
NORMAL, EMPIRICAL = "normal", "empirical"
MOST_BITS = 16


@dataclass(frozen=True)
class Source:
    """An error source.

    ``error_class`` and ``distribution`` are those of the budget's row; an empirical distribution is that of the model
    (weather, clouds). ``scene``, ``camera``: functions that return the scene or camera without it. ``calibration``:
    fields of :class:`horizonval.sensor.knowledge.CalibrationErrors`; ``prior``: fields of the prior that become true.
    """

    name: str
    title: str
    error_class: str
    distribution: str
    scene: Callable[[SceneSpec], SceneSpec] | None = None
    camera: Callable[[CameraSpec], CameraSpec] | None = None
    calibration: tuple[str, ...] = ()
    prior: tuple[str, ...] = ()


def _changed(key: str, **values: Any) -> Callable[[SceneSpec], SceneSpec]:
    def change(scene: SceneSpec) -> SceneSpec:
        return scene.model_copy(update={key: getattr(scene, key).model_copy(update=values)})

    return change


def _without_weather(scene: SceneSpec) -> SceneSpec:
    """Return the scene in the climate of its latitude and month, where it has weather."""
    if not scene.atmosphere.profile.startswith("weather"):
        return scene
    return _changed("atmosphere", profile="by_latitude_month", warming_k=None)(scene)


def _on_even_ground(scene: SceneSpec) -> SceneSpec:
    """Return the scene on uniform ground, where its ground varies."""
    if scene.surface.kind == "uniform":
        return scene
    return scene.model_copy(update={"surface": type(scene.surface)()})


def _without_pattern(camera: CameraSpec) -> CameraSpec:
    keys = ("prnu", "dsnu_e", "hot_pixel_fraction") if isinstance(camera.detector, Cmos) else _THERMAL_PATTERN
    return _with_detector(camera, dict.fromkeys(keys, 0.0))


_THERMAL_PATTERN = ("responsivity_rms", "residue_k", "drift_k_per_min", "drift_pattern_k_per_min")


def _finely_converted(camera: CameraSpec) -> CameraSpec:
    """Return the camera with a converter of 16 bits over the same range."""
    detector = camera.detector
    if detector is None or detector.bits == MOST_BITS:
        return camera
    finer = (2**MOST_BITS - 1) / (2**detector.bits - 1)
    change: dict[str, Any] = {"bits": MOST_BITS}
    if isinstance(detector, Cmos):
        span = 2**detector.bits - 1 - detector.black_level_dn
        gain = detector.gain_e_per_dn or detector.full_well_e / span
        change |= {"gain_e_per_dn": gain / finer, "black_level_dn": detector.black_level_dn * finer}
    return _with_detector(camera, change)


def _with_detector(camera: CameraSpec, change: dict[str, Any]) -> CameraSpec:
    if camera.detector is None:
        return camera
    return camera.model_copy(update={"detector": camera.detector.model_copy(update=change)})


SOURCES = (
    Source("pattern", "fixed pattern", PIXEL, NORMAL, camera=_without_pattern),
    Source("quantisation", "quantisation", PIXEL, "uniform", camera=_finely_converted),
    Source("distortion", "distortion", FIELD, NORMAL, calibration=("distortion_px",)),
    Source("focal", "focal length and principal point", FIELD, NORMAL,
           calibration=("focal_length", "principal_point_px")),
    Source("mounting", "mounting", BIAS, NORMAL, calibration=("mounting_rad",)),
    Source("clock", "clock and time of exposure", BIAS, NORMAL, calibration=("clock_s", "exposure_offset_s")),
    Source("position", "position given to the method", NOISE, NORMAL, prior=("r_itrs", "altitude_m")),
    Source("attitude", "attitude given to the method", NOISE, NORMAL, prior=("q_cam_from_itrs",)),
    Source("weather", "air: weather", FIELD, EMPIRICAL, scene=_without_weather),
    Source("haze", "air: haze", FIELD, EMPIRICAL, scene=_changed("atmosphere", aerosol="none")),
    Source("thin_clouds", "thin clouds", FIELD, EMPIRICAL,
           scene=lambda scene: scene.model_copy(update={"layer": ()})),
    Source("clouds", "clouds", FIELD, EMPIRICAL, scene=lambda scene: scene.model_copy(update={"clouds": None})),
    Source("ground", "ground", FIELD, EMPIRICAL, scene=_on_even_ground),
    Source("shape", "planet's shape", FIELD, EMPIRICAL, scene=_changed("earth", shape="sphere")),
)  # fmt: skip
"""All sources but noise, in the order of the budget's rows. With all of them off the estimator's own error is left."""
BY_NAME = {source.name: source for source in SOURCES}


def sources_in(scene: SceneSpec, camera: CameraSpec, truth: FrameTruth) -> tuple[str, ...]:
    """Return the names of the sources that a frame has."""
    errors = errors_of(truth)
    sigmas = None if scene.prior is None else scene.prior
    found = []
    for source in SOURCES:
        there = source.scene is not None and source.scene(scene) != scene
        there |= source.camera is not None and source.camera(camera) != camera
        there |= any(np.any(getattr(errors, key)) for key in source.calibration)
        if sigmas is not None and source.prior:
            keys: dict[str, Any] = {
                "r_itrs": sigmas.position_sigma_km,
                "altitude_m": sigmas.altitude_sigma_km,
                "q_cam_from_itrs": sigmas.attitude_sigma_deg,
            }
            there |= any(keys[key] is not None for key in source.prior)
        if there:
            found.append(source.name)
    return tuple(found)


def scene_without(scene: SceneSpec, off: Iterable[str]) -> SceneSpec:
    """Return a scene without some sources; its draws do not change."""
    for name in off:
        change = BY_NAME[name].scene
        scene = scene if change is None else change(scene)
    return scene


def camera_without(camera: CameraSpec, off: Iterable[str]) -> CameraSpec:
    """Return a camera without some sources."""
    for name in off:
        change = BY_NAME[name].camera
        camera = camera if change is None else change(camera)
    return camera


def truth_without(truth: FrameTruth, off: Collection[str]) -> FrameTruth:
    """Return a truth whose scene states calibration errors that cancel the drawn ones of some sources."""
    fields = {key for name in off for key in BY_NAME[name].calibration}
    if not fields:
        return truth
    stated, drawn = calibration_of(truth), errors_of(truth)
    units: dict[str, tuple[str, float]] = {
        "distortion_px": ("distortion_error_px", 1.0),
        "focal_length": ("focal_length_error_percent", 100.0),
        "principal_point_px": ("principal_point_error_px", 1.0),
        "mounting_rad": ("mounting_error_deg", math.degrees(1.0)),
        "clock_s": ("clock_error_s", 1.0),
        "exposure_offset_s": ("exposure_offset_s", 1.0),
    }
    change: dict[str, Any] = {}
    for field in sorted(fields):
        key, factor = units[field]
        left = np.asarray(getattr(stated, key)) - factor * np.asarray(getattr(drawn, field))
        change[key] = tuple(left.tolist()) if left.ndim else float(left)
    table = stated.model_copy(update=change).model_dump(mode="json")
    return replace(truth, scene={**truth.scene, "calibration": table})


def prior_without(prior: Prior, truth: FrameTruth, off: Collection[str]) -> Prior:
    """Return a drawn prior with the true values of some sources; standard deviations stay."""
    true: dict[str, Any] = {
        "r_itrs": np.array(truth.r_itrs),
        "altitude_m": truth.altitude_m,
        "q_cam_from_itrs": np.array(truth.q_cam_from_itrs),
    }
    fields = {key for name in off for key in BY_NAME[name].prior if getattr(prior, key) is not None}
    return replace(prior, **{key: true[key] for key in fields}) if fields else prior
