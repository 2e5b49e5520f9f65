"""One view of both cameras: rendered, detected, estimated, and set beside the truth.

*Tilt of one camera* from the chord of its horizon: half of the two-camera method. The chord ``c`` between the sight
lines to the arc's ends is perpendicular to the vertical. A second camera would give a second such vector; on the bench,
where there is one camera, the boresight ``z`` is level instead, so that the vertical is ``n = c x z`` with the sign
that points to the circle's centre, and the tilt is its angle to the columns::

    t = atan2(n_x, n_y)

The arc and its chord are those of :mod:`horizonval.estimation.limb.arc` and
:mod:`horizonval.estimation.methods.video_vertical`.

*A frame without the Sun's own light* keeps what the Sun lights (ground, air, clouds). It loses what comes straight from
the disc: its image, hence that image's ghosts, scatter and spread, and what lens and baffle let in of a Sun outside
the frame.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.arc import Arc, find_arc, fit_circle
from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.methods.video_vertical import ESTIMATOR, ChordEnds, chord, fit_arcs, solve
from horizonval.estimation.observation import Fit, Observation
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.geometry.camera import CameraModel, pixel_grid, project, unproject
from horizonval.geometry.frames import inverse, rotate
from horizonval.geometry.horizon import fit_cone, horizon_cam
from horizonval.geometry.rotation import angle_between
from horizonval.renderer.frame import render_frame
from horizonval.scoring.errors import score
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec
from horizonval.suites.observation import observation_of_heads


def tilt_rad(image: FloatArray, camera: CameraModel, full_scale: float) -> float | None:
    """Return how far the camera is turned about its boresight, clockwise as it looks; None where it sees no arc."""
    arc = find_arc(image, full_scale)
    if isinstance(arc, Refusal):
        return None
    across = chord(arc, camera)
    down = np.array([-across[1], across[0]])
    if down @ (arc.circle.centre - arc.uv.mean(axis=0)) < 0.0:
        down = -down
    return math.atan2(down[0], down[1])


EDGE_PX = 1.5
"""Margin about the Sun's disc: half a diagonal of a pixel, and as much again for refraction."""


def without_sunlight(frame: RadianceFrame) -> RadianceFrame:
    """Return the frame without the Sun's disc, and without a Sun for stray light.

    Pixels that the disc may touch are interpolated linearly along their row: space, or the thin upper air.
    """
    touched = sun_pixels(frame.truth)
    radiance = {}
    for band, values in frame.radiance.items():
        filled = np.array(values)
        for row in np.flatnonzero(touched.any(axis=1)):
            gone = touched[row]
            if not gone.all():
                columns = np.arange(len(gone))
                filled[row, gone] = np.interp(columns[gone], columns[~gone], filled[row, ~gone])
        radiance[band] = filled
    return replace(frame, radiance=radiance, truth=replace(frame.truth, sun_visible_fraction=0.0))


def sun_pixels(truth: FrameTruth) -> NDArray[np.bool_]:
    """Return which pixels the Sun's disc may touch, shape (H, W)."""
    camera = truth.camera_model
    los = unproject(camera, pixel_grid(camera))
    apart = np.linalg.norm(los - np.array(truth.sun_cam), axis=-1)
    reach = truth.sun_angular_radius_rad + EDGE_PX / min(camera.fx, camera.fy)
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * apart, 1.0)) < reach) & (truth.sun_visible_fraction > 0.0)


SHIPPED = "vis-pair-1024-60deg"
WITH_GLARE = "vis-cmos-1024-60deg-full"
"""Shipped camera whose lens scatters and reflects; the pair's own lens is clean."""
FIELD_DEG = 100.0
"""Field of the cameras, which the source does not state. From 500 km the horizon is 22 deg below level boresights and
attitudes of 20 deg press it to 42 deg, so that 60 deg do not cover the published region."""
ALTITUDE_KM = 500.0
PICTURE_PX = 256

THERMAL = {
    "band": [{"name": "co2", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}],
    "optics": {"f_number": 1.0, "transmission": 1.0, "psf_sigma_px": 0.6},
    "detector": {
        "kind": "microbolometer",
        "pixel_pitch_um": 12.0,
        "netd_k": 0.25,
        "bits": 14,
        "scene_min_k": 0.0,
        "scene_max_k": 400.0,
    },
}
"""Behind the same geometry, a bolometer in the band of horizon sensors; 0.25 K is what 0.05 K of 8 to 14 um become."""


def pair(width: int = 1024, field_deg: float = FIELD_DEG, tables: JsonObject | None = None) -> JsonObject:
    """Return the shipped pair's camera as plain data, with another size and field; ``tables`` replace whole tables."""
    camera = _stated(load_camera(SHIPPED).model_dump(mode="json"))
    camera["camera"] |= {"width": width, "height": width, "fov_deg": field_deg, "name": f"pair-{width}-{field_deg:g}"}
    return {**camera, **(tables or {})}


def glare_optics(scattered: float | None = None, ghost: float | None = None, stray: float = 1.0) -> JsonObject:
    """Return the optics of a lens with scatter, ghost and a leaking baffle, which passes ``stray`` times as much."""
    optics: JsonObject = _stated(load_camera(WITH_GLARE).optics.model_dump(mode="json"))
    if scattered is not None:
        optics["scatter"] = {**optics["scatter"], "tis": scattered}
    if ghost is not None:
        optics["ghost"] = [{**one, "ratio": ghost} for one in optics["ghost"]]
    optics["stray"] = {**optics["stray"], "pst": [stray * share for share in optics["stray"]["pst"]]}
    return optics


def scene(name: str, *, air: bool = False, **tables: Any) -> JsonObject:
    """Return a scene over an airless sphere, or WGS84 with a real sky's air; ``tables`` replace or add tables."""
    made: JsonObject = {
        "scene": {"name": name},
        "platform": {"altitude_km": ALTITUDE_KM, "latitude_deg": 45.0 if air else 0.0},
        "earth": {"shape": "wgs84" if air else "sphere"},
        "atmosphere": {"profile": "us_standard" if air else "none"},
        # without air nothing is marched; with it, the arcs are those of 128 nodes to the pixel
        "render": {"nodes": 32 if air else 8},
    }
    return {**made, **tables}


def attitude(pitch_deg: float, yaw_deg: float) -> JsonObject:
    """Return the attitude that tilts the longitudinal axis (body z, down when level) in the planes of both cameras.

    The source's pitch tilts it about y; its yaw, the tilt across that, is a roll about x here.
    """
    return {"pitch_deg": pitch_deg, "roll_deg": yaw_deg}


def view(item: JsonObject) -> JsonObject:
    """Return the method's result for one view of both cameras.

    ``item``: ``camera``, ``scene`` (plain data, without head), ``seed``; ``picture`` adds small copies of both images,
    ``searched`` the result on arcs from :func:`searched`.
    """
    camera = CameraSpec.model_validate(item["camera"])
    images: dict[str, DetectorImage] = {}
    for head in camera.head:
        chosen = SceneSpec.model_validate({**item["scene"], "camera": {"file": "pair", "head": head.name}})
        images[head.name] = observe(render_frame(chosen, camera), camera, seed=item["seed"])
    found = measured(images)
    if item.get("searched"):
        found["searched"] = searched(images)
    if item.get("picture"):
        found["pictures"] = {name: small(image) for name, image in images.items()}
    return found


def views(item: JsonObject) -> JsonObject:
    """Return the method's result for one view through several cameras of equal geometry, by the cameras' names.

    ``item``: ``cameras``, and the rest as for :func:`view`; frames are rendered once. ``with`` and ``without`` are the
    same frames and seed with and without the Sun's light in the lens.
    """
    cameras = {name: CameraSpec.model_validate(camera) for name, camera in item["cameras"].items()}
    first = next(iter(cameras.values()))
    frames = {}
    for head in first.head:
        chosen = SceneSpec.model_validate({**item["scene"], "camera": {"file": "pair", "head": head.name}})
        frames[head.name] = render_frame(chosen, first)
    dark = {head: without_sunlight(frame) for head, frame in frames.items()}
    found: JsonObject = {name: {} for name in cameras}
    for name, camera in cameras.items():
        for light, lit in (("with", frames), ("without", dark)):
            images = {
                head: replace(observe(frame, camera, seed=item["seed"]), truth=frames[head].truth)
                for head, frame in lit.items()
            }
            found[name][light] = measured(images) | {"searched": searched(images)}
            if item.get("picture"):
                found[name][light]["pictures"] = {head: small(image) for head, image in images.items()}
    return found


def measured(images: dict[str, DetectorImage]) -> JsonObject:
    """Return the method's results on images of both cameras, every reading of the end points, beside the truth."""
    observation = observation_of_heads(images, ESTIMATOR)
    truth = next(iter(images.values())).truth
    result = solve(observation)
    down_body = np.array([0.0, 0.0, 1.0])
    nadir_body = _body(truth, truth.nadir_geocentric_cam)
    found: JsonObject = {
        "status": str(result.status),
        "reason": result.reason if isinstance(result, Refusal) else "",
        "tilt_deg": math.degrees(angle_between(down_body, nadir_body)),
        "in_view_px": {name: horizon_in_view_px(image.truth) for name, image in images.items()},
        "saturated": {name: float(np.mean(image.dn >= image.full_scale)) for name, image in images.items()},
        "error_deg": {},
    }
    if isinstance(result, Refusal):
        return found
    scored = score(truth, ESTIMATOR, result, earth_radius_m=observation.prior.sphere_radius_m)
    assert scored.sigma_nadir_arcsec is not None
    sigma_arcsec = math.hypot(scored.sigma_nadir_arcsec, scored.sigma_systematic_arcsec or 0.0)
    found |= {"sigma_deg": sigma_arcsec / 3600.0, "nees": scored.nees_nadir_total}
    claimed_tilt = angle_between(down_body, _body(truth, result.nadir_cam))
    found["tilt_error_deg"] = math.degrees(claimed_tilt) - found["tilt_deg"]
    for ends in ChordEnds:
        reading = solve(observation, ends)
        if isinstance(reading, Fit):
            found["error_deg"][ends.name] = _error_deg(truth, reading.nadir_cam)
    found["error_deg"]["CONE"], found["circle_px"] = _cone_and_circle(observation, truth)
    return found


def searched(images: dict[str, DetectorImage]) -> JsonObject:
    """Return the method's result on arcs of the limb search instead of the longest edges.

    :func:`horizonval.estimation.limb.finder.find_limb` takes the best cone of all edges, refines its points and refuses
    what need not be a horizon.
    """
    observation = observation_of_heads(images, ESTIMATOR)
    truth = next(iter(images.values())).truth
    arcs = []
    for name, head in observation.heads.items():
        limb = find_limb(head.image, head.camera, head.full_scale)
        if isinstance(limb, Refusal):
            return {"status": str(limb.status), "reason": limb.of_head(name).reason, "error_deg": {}}
        circle = fit_circle(limb.uv)
        if circle is None:
            return {"status": str(Outcome.SHORT_ARC), "reason": f"head {name}: the limb is straight", "error_deg": {}}
        arcs.append(Arc(limb.uv[np.argsort(circle.along(limb.uv), kind="stable")], circle))
    result = fit_arcs(arcs, list(observation.heads.values()))
    if isinstance(result, Refusal):
        return {"status": str(result.status), "reason": result.reason, "error_deg": {}}
    return {"status": str(result.status), "reason": "", "error_deg": {"SIGHT": _error_deg(truth, result.nadir_cam)}}


def horizon_in_view_px(truth: FrameTruth) -> float:
    """Return the length [px] of the hard horizon's true image inside a frame."""
    camera = truth.camera_model
    ellipsoid = truth.ellipsoid
    uv, in_front = project(camera, horizon_cam(np.array(truth.r_itrs), truth.q_cam_from_itrs, ellipsoid, n=7200))
    with np.errstate(invalid="ignore"):
        inside = in_front & (uv >= -0.5).all(axis=1) & (uv < (camera.width - 0.5, camera.height - 0.5)).all(axis=1)
        step = np.hypot(*(np.roll(uv, -1, axis=0) - uv).T)
    return float(step[inside & np.roll(inside, -1)].sum())


def small(image: DetectorImage) -> list[list[int]]:
    """Return an image of a few hundred pixels and 256 levels, block means, for a figure."""
    block = max(1, image.dn.shape[0] // PICTURE_PX)
    side = image.dn.shape[0] // block
    grey = image.dn[: side * block, : side * block].reshape(side, block, side, block).mean(axis=(1, 3))
    levels: list[list[int]] = np.rint(grey * (255.0 / image.full_scale)).astype(int).tolist()
    return levels


def _cone_and_circle(observation: Observation, truth: FrameTruth) -> tuple[float, float]:
    """Return the nadir error [deg] of one cone through all pixels of both arcs, and how far [px] circles miss them."""
    first = Rotation.from_quat(observation.q_cam_from_body)
    los, off = [], []
    for head in observation.heads.values():
        arc = find_arc(head.image, head.full_scale)
        assert not isinstance(arc, Refusal), "the method has found it before"
        turn = first * Rotation.from_quat(head.q_cam_from_body).inv()
        los.append(turn.apply(unproject(head.camera, arc.uv)))
        off.append(arc.circle.distance_px(arc.uv))
    cone = fit_cone(np.concatenate(los))
    return _error_deg(truth, cone.axis_cam), float(np.sqrt(np.mean(np.concatenate(off) ** 2)))


def _error_deg(truth: FrameTruth, nadir_cam: FloatArray) -> float:
    return math.degrees(angle_between(np.array(truth.nadir_geocentric_cam), nadir_cam))


def _body(truth: FrameTruth, v_cam: FloatArray | tuple[float, float, float]) -> FloatArray:
    return rotate(inverse(truth.q_cam_from_body), np.asarray(v_cam))


def answered(found: JsonObject) -> bool:
    """Whether a view got an answer, right or wrong."""
    return bool(found["status"] == Outcome.VALID)


def _stated(content: Any) -> Any:
    """Return plain data without the keys that a file would leave out."""
    if isinstance(content, dict):
        return {key: _stated(value) for key, value in content.items() if value is not None}
    return [_stated(value) for value in content] if isinstance(content, list) else content
