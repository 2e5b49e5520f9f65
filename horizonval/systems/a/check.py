"""Is the image generator right? Its limb against the exact horizon, and against a stock Mitsuba sphere.

The sphere glows evenly, so a pixel is its coverage, and the edge of a column (or row) is the sum of its coverages. The
analytic edge is the projected horizon's mean over the pixel's width, by quadrature. The stock sphere shares with
this package only the focal length and the nadir: ``mitsuba.sphere`` before ``mitsuba.perspective``, sampled.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry.camera import camera_from_spec
from horizonval.geometry.horizon import horizon_columns, horizon_rows
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.systems.a.bank import camera_of, radius_of, scene_of

SAMPLES = 256
"""Stratified, per pixel of the stock sphere: an edge pixel's coverage to 0.02 or so."""
GAUSS, WEIGHT = (v / 2 for v in np.polynomial.legendre.leggauss(6))


def check(item: JsonObject) -> JsonObject:
    """Return the rms and largest departure [px] of the rendered edges from both authorities, and how many edges."""
    geometry = camera_of(item).camera.model_dump(mode="json", exclude_none=True)
    glow = {"name": "glow", "kind": "thermal", "lo_um": 10.0, "hi_um": 11.0}
    camera = CameraSpec.model_validate({"camera": geometry, "band": [glow]})
    tables = scene_of(item).model_dump(mode="json", exclude_none=True)
    scene = SceneSpec.model_validate(tables | {"surface": {"temperature_k": 288.0}})
    frame = render_frame(scene, camera)
    radiance = frame.radiance["glow"].astype(np.float64)
    coverage = radiance / radiance.max()
    intrinsics = camera_from_spec(camera.camera)
    ellipsoid = frame.truth.ellipsoid
    pose = (intrinsics, frame.truth.q_cam_from_itrs, frame.truth.r_itrs)
    rho = radius_of(item["altitude_km"])
    stock = _stock_sphere(np.array(frame.truth.nadir_geocentric_cam), rho, item["pixels"], item["fov_deg"])
    against_curve, against_stock = [], []
    at = (np.arange(item["pixels"])[:, None] + GAUSS).ravel()
    for find, ours, other in ((horizon_rows, coverage, stock), (horizon_columns, coverage.T, stock.T)):
        crossings = find(*pose, at, ellipsoid).reshape(item["pixels"], len(GAUSS), -1)
        used, rows = _crossed_once(ours, crossings)
        against_curve.append((_edge(ours) - rows @ WEIGHT)[used])
        against_stock.append((_edge(ours) - _edge(other))[used])
    curve, sphere = np.concatenate(against_curve), np.concatenate(against_stock)
    return {
        "edges": len(curve),
        "curve_rms_px": float(np.sqrt(np.mean(curve**2))),
        "curve_max_px": float(np.abs(curve).max()),
        "stock_mean_px": float(sphere.mean()),
        "stock_rms_px": float(np.sqrt(np.mean(sphere**2))),
        "stock_max_px": float(np.abs(sphere).max()),
    }


def _edge(coverage: FloatArray) -> FloatArray:
    """Return the row of every column's edge from what is covered of it."""
    filled = coverage.sum(axis=0)
    return np.asarray(np.where(coverage[0] > 0.5, filled, len(coverage) - filled) - 0.5)


def _crossed_once(coverage: FloatArray, crossings: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which columns the horizon crosses once, away from the ends, and where: (n,) and (n, quadrature points)."""
    once = np.all(np.isfinite(crossings).sum(axis=2) == 1, axis=1)
    rows = np.where(once[:, None], np.nan_to_num(crossings).sum(axis=2), -1.0)
    once &= (rows.min(axis=1) > 0.5) & (rows.max(axis=1) < len(coverage) - 1.5)
    # a sliver at either end is a second crossing between the quadrature points
    once &= np.isin(coverage[0], (0.0, 1.0)) & np.isin(coverage[-1], (0.0, 1.0))
    return once, rows


def _stock_sphere(nadir_cam: FloatArray, rho: float, pixels: int, fov_deg: float) -> FloatArray:
    """Return the coverage of a unit sphere that Mitsuba's own plug-ins see at that place."""
    import mitsuba as mi

    # Mitsuba's camera looks along z with x to the left and y up: ours turned by half a turn about z.
    centre = (nadir_cam / np.sin(rho) * (-1.0, -1.0, 1.0)).tolist()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 1},
            "sensor": {
                "type": "perspective",
                "fov": fov_deg,
                "film": {
                    "type": "hdrfilm",
                    "width": pixels,
                    "height": pixels,
                    "rfilter": {"type": "box"},
                    "pixel_format": "luminance",
                    "component_format": "float32",
                },
                "sampler": {"type": "stratified", "sample_count": SAMPLES},
            },
            "earth": {
                "type": "sphere",
                "center": centre,
                "radius": 1.0,
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
        }
    )
    image = np.array(mi.render(scene, spp=SAMPLES, seed=mi.UInt32(0))).astype(np.float64)
    return image.reshape(pixels, pixels)
