"""Frames by both methods: what the view tables say against the march along every cell with four times the nodes.

A scene here is a place, a Sun, and a view given by its azimuth from the Sun's and its angle from the nadir; everything
else comes as tables of a scene file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.frame import RadianceFrame
from horizonval.geometry.camera import camera_from_spec, pixel_grid, unproject
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

GREEN = {"name": "green", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 1}
RED = {"name": "red", "kind": "solar", "lo_um": 0.62, "hi_um": 0.72, "nodes": 1}
NIR = {"name": "nir", "kind": "solar", "lo_um": 0.8, "hi_um": 0.9, "nodes": 1}
BLUE = {"name": "blue", "kind": "solar", "lo_um": 0.42, "hi_um": 0.48, "nodes": 1}

NODES = 128
"""Of the march along a ray, the default of a scene."""
FINER = 4
"""How many times as many the reference has."""
DISC_MARGIN_RAD = math.radians(0.3)
"""Pixels as near to the edge of Sun or Moon count for themselves, not for what the brightest pixel is."""

LIMB_TOP_M = 80e3
"""The brightest pixel between the ground and this height is what errors are a share of."""
WORST, MEDIAN = 2e-3, 1e-4
"""Largest errors at the default accuracy, as shares of the bright limb."""
AIRLESS = 0.03
"""A limb below this share of the brightest pixel is no limb."""
DARK = 1e-4
"""Pixels below this share of the bright limb do not count for the median."""
Tables = dict[str, Any]


def angle_of_limb_deg(altitude_km: float) -> float:
    """Return the angle from the nadir to the horizon."""
    return math.degrees(math.asin(6371.0 / (6371.0 + altitude_km)))


def scene_of(
    sun_zenith_deg: float | None,
    altitude_km: float = 500.0,
    *,
    off_nadir_deg: float | None = None,
    azimuth_deg: float = 0.0,
    sun_azimuth_deg: float = 77.0,
    **tables: Any,
) -> SceneSpec:
    """Return a scene whose boresight is ``azimuth_deg`` from the Sun's azimuth; at the horizon by default.

    Without a zenith angle of the Sun the epoch places it. ``tables`` are merged into the scene's own.
    """
    tilt = angle_of_limb_deg(altitude_km) if off_nadir_deg is None else off_nadir_deg
    scene: Tables = {
        "camera": {"file": "test"},
        "platform": {"altitude_km": altitude_km, "latitude_deg": 37.0, "longitude_deg": -11.0},
        "attitude": {"yaw_deg": sun_azimuth_deg + azimuth_deg, "pitch_deg": tilt},
        "render": {"nodes": NODES},
    }
    if sun_zenith_deg is not None:
        scene["sun"] = {"zenith_deg": sun_zenith_deg, "azimuth_deg": sun_azimuth_deg}
    for name, table in tables.items():
        scene[name] = scene.get(name, {}) | table if isinstance(table, dict) else table
    return SceneSpec.model_validate(scene)


def camera_of(*bands: Tables, **geometry: Any) -> CameraSpec:
    """Return a camera of 64 x 64 pixels and 60 deg unless said otherwise; the green band without bands."""
    shape = {"width": 64, "height": 64, "fov_deg": 60.0} | geometry
    return CameraSpec.model_validate({"camera": shape, "band": list(bands) or [GREEN]})


def rendered(scene: SceneSpec, camera: CameraSpec, **render: Any) -> RadianceFrame:
    """Return the frame with some of the keys of ``[render]`` changed."""
    changed = scene.render.model_copy(update=render)
    return render_frame(scene.model_copy(update={"render": changed}), camera)


@dataclass(frozen=True)
class Comparison:
    """Errors of the pixels of one band, as shares of the radiance of the bright limb."""

    band: str
    worst: float
    median: float
    where: tuple[int, int]
    height_km: float
    share: float

    def __str__(self) -> str:
        return (
            f"{self.band}: worst {self.worst:.1e} at {self.where}, lowest height {self.height_km:.1f} km, "
            f"{self.share:.1e} of the bright limb; median {self.median:.1e}"
        )


def compare(frame: RadianceFrame, reference: RadianceFrame, camera: CameraSpec) -> list[Comparison]:
    """Return the errors of a frame, band by band.

    The bright limb is the brightest pixel of the reference between the ground and :data:`LIMB_TOP_M`, or the brightest
    of all if there is none or no air, outside the discs of Sun and Moon; their pixels are judged as shares of
    themselves.
    """
    off_disc = ~_on_discs(reference, camera)
    height = reference.maps["tangent_height"]
    results = []
    for band, expected in reference.radiance.items():
        theirs, ours = expected.astype(np.float64), frame.radiance[band].astype(np.float64)
        assert np.isfinite(ours).all(), f"{band}: not finite"
        limb = theirs[off_disc & (height > 0.0) & (height < LIMB_TOP_M)].max(initial=0.0)
        brightest = theirs[off_disc].max(initial=0.0)
        limb = float(limb if limb > AIRLESS * brightest else brightest) or float(theirs.max())
        if not limb:
            assert np.array_equal(ours, theirs), f"{band}: light where there is none"
            continue
        error = np.abs(ours - theirs) / np.maximum(limb, np.where(off_disc, 0.0, theirs))
        row, column = (int(v) for v in np.unravel_index(np.argmax(error), error.shape))
        median = float(np.median(error[theirs > DARK * limb]))
        place = (row, column), float(height[row, column]) / 1e3, float(theirs[row, column]) / limb
        results.append(Comparison(band, float(error[row, column]), median, *place))
    return results


def table_errors(scene: SceneSpec, camera: CameraSpec, finer: int = FINER) -> list[Comparison]:
    """Return how far a scene's frame is from the march of every cell with four, or ``finer``, times the nodes."""
    reference = rendered(scene, camera, method="march", nodes=finer * scene.render.nodes)
    return compare(rendered(scene, camera), reference, camera)


def _on_discs(frame: RadianceFrame, camera: CameraSpec) -> np.ndarray:
    """Return which pixels may see some of the Sun or the Moon, shape (rows, columns)."""
    model, truth = camera_from_spec(camera.camera), frame.truth
    los = unproject(model, pixel_grid(model))
    pixel = 1.5 / min(model.fx, model.fy)
    near = np.zeros(los.shape[:-1], dtype=bool)
    discs: list[tuple[FloatArray, float]] = [(np.array(truth.sun_cam), truth.sun_angular_radius_rad)]
    if truth.moon_cam is not None:
        discs.append((np.array(truth.moon_cam), truth.moon_angular_radius_rad))
    for centre, radius in discs:
        cosine = np.nan_to_num(los, nan=0.0) @ centre
        near |= np.arccos(np.clip(cosine, -1.0, 1.0)) < radius + pixel + DISC_MARGIN_RAD
    return near
