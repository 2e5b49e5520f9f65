"""Data of the frame viewer: every frame's exact digital numbers, the exact truth, and curves over the image.

*Numbers.* A page is one file, so the numbers are inside it: differences along each line, modulo 2**16, their signs in
the lowest bit so that small ones have no high byte (0, -1, 1, -2 are 0, 1, 2, 3), low bytes first and high bytes after
them, deflated, in base64. The viewer's code undoes this; nothing of it passes through a picture, so the number under
the pointer is the number that is stored.

*Lines of sight.* Directions are interpolated between Chebyshev nodes over the image, which for lenses as smooth as
these is exact to about a thousandth of a degree or much better. The horizon is the tangent cone ``Q`` of the exact
ellipsoid in camera axes: in the vertical plane of a direction, at the angle ``theta`` from the nadir ``n`` towards
``e``, the horizon is the root of ``n.Qn + 2 n.Qe tan(theta) + e.Qe tan(theta)^2 = 0``.

*Curves* are SVG path data in pixel coordinates. The fitted limb is the cone of half angle ``rho`` about the fitted
nadir, sent through the camera::

    d(t) = cos(rho) n + sin(rho) (e1 cos t + e2 sin t)
"""

from __future__ import annotations

import base64
import math
import threading
import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.spectral.bands import width_um
from horizonval.earth.spectral.planck import brightness_temperature_k
from horizonval.frame import DetectorImage, FrameTruth
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.frames import rotate
from horizonval.geometry.horizon import horizon_cam, tangent_cone
from horizonval.geometry.rotation import perpendicular
from horizonval.report import pictures
from horizonval.report.load import CaseView, load_case, load_run
from horizonval.report.words import DEG, VERDICTS, verdict_of
from horizonval.scoring.expected import Expected, expected_outcome
from horizonval.sensor.expected_image import black_level_dn, radiance_per_dn
from horizonval.truth.infrared_horizon import curve_cam

BUDGET_PX = 4_000_000
"""Maximum number of pixels with numbers on one page: 3 to 6 MB of noisy frames."""
MOST_BESIDE, BESIDE_PX = 16, BUDGET_PX
"""Maximum numbers of frames and of their pixels on pages other than a run's first one."""
CACHED = 16
"""Frames cached by the server, for stepping back and forth."""
NODES = 15
"""Nodes along each side of the image."""
_SMALLEST_Z = 0.1
_TEMPERATURES = 129
"""Entries of a thermal frame's table."""
_CONE_SAMPLES = 20_000
_POINTS_PER_LINE = 160
"""Vertices of a line in a 1000 px image, where a horizon bends by less than 0.1 px between them."""

# ----------------------------------------------------------------------------------------------------- frames of a run


def one_frame(
    view: CaseView, estimators: Sequence[str], expected: Expected | None = None, *, numbered: bool = True
) -> dict[str, Any]:
    """Return the viewer's data of a view: numbers, curves, outcomes and illumination.

    A view without image has its outcomes and the reason. ``expected``: the expected outcome if already known.
    ``numbered``: whether to include the digital numbers.
    """
    shown = about_frame(view, estimators)
    image = view.image
    if image is None:
        return {**shown, "problem": view.problem}
    truth = image.truth
    height, width = image.dn.shape
    _, black, white = pictures.grey_levels(image)
    return {
        **shown,
        "camera": truth.camera_spec.camera.name or "",
        "width": width,
        "height": height,
        "numbers": packed(image.dn) if numbered else "",
        "full": image.full_scale,
        "black": black,
        "white": white,
        "heat": heat_of(image),
        "sight": sightline_of(truth),
        "truth": horizon_path(truth),
        "infrared": infrared_path(truth, view.band),
        "layers": _layers(view, truth, estimators),
        "sun": (expected or expected_outcome(truth, view.band)).sun_in_frame,
    }


def about_frame(view: CaseView, estimators: Sequence[str]) -> dict[str, Any]:
    """Return the data of a view without its image: name, outcomes by estimator, and illumination.

    ``light`` is day or eclipse, ``sun_deg`` the Sun's exact angle from the axis, ``sun`` whether it is in the frame.
    """
    truth = view.image.truth if view.image is not None else None
    row = next((one for one in view.rows.values() if one.sun_visible_fraction is not None), None)
    fraction = truth.sun_visible_fraction if truth is not None else row.sun_visible_fraction if row else None
    angle = math.degrees(truth.sun_boresight_rad) if truth is not None else row.sun_boresight_deg if row else None
    rows = {}
    for name in (name for name in estimators if name in view.rows):
        result = view.rows[name]
        mark = verdict_of(result, broken=view.broken)
        rows[name] = {
            "kind": mark.key,
            "glyph": mark.glyph,
            "label": mark.label,
            "colour": mark.colour,
            "arcsec": result.nadir_error_arcsec,
            "error": DEG.text(result.nadir_error_arcsec) if result.is_claim else "",
            "bound": "" if result.bound_arcsec is None else DEG.text(result.bound_arcsec),
            "over": "" if result.error_over_bound is None else f"{result.error_over_bound:.3g}",
        }
    return {
        "name": view.case,
        "scene": view.scene,
        "band": view.band,
        "camera": next((one.camera for one in view.rows.values()), ""),
        "rows": rows,
        "light": "" if fraction is None else "day" if fraction > 0.0 else "eclipse",
        "sun_deg": None if angle is None else round(angle, 2),
        "sun": bool(row is not None and row.sun_in_frame),
    }


def numbered_frames(images: Sequence[DetectorImage | None], budget_px: int = BUDGET_PX) -> set[int]:
    """Return the images whose numbers a page holds: all if they fit, else an even selection."""
    there = [i for i, image in enumerate(images) if image is not None]
    pixels = sum(image.dn.size for image in images if image is not None)
    if pixels <= budget_px:
        return set(there)
    n = len(there) * budget_px // pixels
    return {there[k * len(there) // n] for k in range(n)}


def share_directions(frames: Sequence[dict[str, Any]]) -> None:
    """Replace directions that an earlier frame of a page has too, as those of one camera, by its number."""
    first: dict[tuple[float, ...], int] = {}
    for number, frame in enumerate(frames):
        if sight := frame.get("sight"):
            earlier = first.setdefault(tuple(sight["directions"]), number)
            if earlier != number:
                sight["directions"] = earlier


def striking_frames(views: Sequence[CaseView], estimators: Sequence[str]) -> dict[str, Any]:
    """Return the frames for a page other than a run's first one.

    False claims, crashes and missed frames go first, up to a size limit. The result has ``frames``, ``kept`` (the
    number of frames with an image) and ``estimators``.
    """
    views = [view for view in views if view.image is not None]
    order = sorted(
        views, key=lambda view: min((VERDICTS.index(verdict_of(row)) for row in view.rows.values()), default=9)
    )
    chosen: set[tuple[str, str]] = set()
    pixels = 0
    for view in order[:MOST_BESIDE]:
        assert view.image is not None
        pixels += view.image.dn.size
        if pixels > BESIDE_PX and chosen:
            break
        chosen.add((view.case, view.band))
    frames = [one_frame(view, estimators) for view in views if (view.case, view.band) in chosen]
    share_directions(frames)
    return {"frames": frames, "kept": len(views), "estimators": estimators}


class RunFrames:
    """Frames of a run's folder, read one at a time on request."""

    def __init__(self, run_dir: Path) -> None:
        self._dir = run_dir
        self._lock = threading.Lock()
        self._cached = lru_cache(CACHED)(self._frame)

    @cached_property
    def estimators(self) -> tuple[str, ...]:
        """The run's estimators, in the suite's order."""
        return load_run(self._dir, 0).estimators

    def listed(self) -> list[dict[str, Any]]:
        """Return all frames of the run, in order, as :func:`about_frame`; ``UserError`` if the run cannot be read."""
        with self._lock:
            run = load_run(self._dir, 0)
            return [about_frame(view, run.estimators) for view in run.views]

    def frame(self, case: str, band: str) -> dict[str, Any]:
        """Return one frame as :func:`one_frame`, with its numbers; ``UserError`` if it or its image is missing."""
        with self._lock:
            return self._cached(case, band)

    def _frame(self, case: str, band: str) -> dict[str, Any]:
        views = [view for view in load_case(self._dir, case) if view.band == band or not band]
        if not views:
            raise UserError(f"no band {band!r}", where=case)
        if views[0].image is None:
            raise UserError(views[0].problem)
        return one_frame(views[0], self.estimators)


# ------------------------------------------------------------------------------------- numbers, radiance, directions


def packed(dn: NDArray[np.uint16]) -> str:
    """Return digital numbers, shape (H, W), as text for the page's code."""
    difference = dn.astype(np.uint16)
    difference[:, 1:] -= dn[:, :-1]
    signed = difference.view(np.int16)
    coded = ((signed << 1) ^ (signed >> 15)).view(np.uint16)
    planes = np.concatenate([(coded & 0xFF).ravel(), (coded >> 8).ravel()]).astype(np.uint8)
    return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii")


def heat_of(image: DetectorImage) -> dict[str, Any] | None:
    """Return the conversion of digital numbers to radiance and brightness temperature; None without calibration.

    Radiances have the steps ``step`` from ``zero`` [W m-2 sr-1]; divided by ``width_um`` they are spectral. For a
    photon counting detector they follow the data sheet on the axis, above the black level, including noise and dark
    current. ``temperature_k`` of thermal bands has the temperatures of radiances in equal ratios, from the first step's
    to full scale's; interpolating 1 / T linearly in the logarithm of the radiance is accurate to 0.01 K.
    """
    step = radiance_per_dn(image)
    band = next((one for one in image.truth.camera_spec.band if one.name == image.band), None)
    if step is None or band is None:
        return None
    width = width_um(band)
    if band.kind != "thermal":
        return {"zero": -step * black_level_dn(image), "step": step, "width_um": width, "temperature_k": None}
    zero = image.observation.get("radiance_at_zero")
    if zero is None:
        # A frozen image has only the step of its detector.
        return None
    ends = zero + step, zero + step * image.full_scale
    kelvin = brightness_temperature_k(band, np.geomspace(*ends, _TEMPERATURES))
    return {
        "zero": zero,
        "step": step,
        "width_um": width,
        "temperature_k": [round(float(value), 4) for value in kelvin],
    }


def sightline_of(truth: FrameTruth) -> dict[str, Any] | None:
    """Return ``{flat, directions, nadir, cone}``; None if some node of the image has no direction.

    ``directions``: row by row, ``x/z, y/z`` if ``flat``, else unit vectors. ``nadir`` (geocentric) and the upper
    triangle of ``cone`` are in camera axes; refraction raises the cone.
    """
    camera = replace(truth.camera_model, image_circle_rad=None)
    node = np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    u = (camera.width - 1 + camera.width * node) / 2
    v = (camera.height - 1 + camera.height * node) / 2
    d = unproject(camera, np.stack(np.meshgrid(u, v), axis=-1)).reshape(-1, 3)
    if not np.isfinite(d).all():
        return None
    flat = bool((d[:, 2] > _SMALLEST_Z).all())
    values = d[:, :2] / d[:, 2:] if flat else d
    axes = rotate(truth.q_cam_from_itrs, np.eye(3))
    cone = axes.T @ tangent_cone(truth.r_itrs, truth.apparent_ellipsoid) @ axes
    cone /= np.abs(cone).max()
    return {
        "flat": flat,
        "directions": [round(float(value), 7) for value in values.ravel()],
        "nadir": [round(float(value), 9) for value in truth.nadir_geocentric_cam],
        "cone": [round(float(value), 10) for value in cone[np.triu_indices(3)]],
    }


# -------------------------------------------------------------------------------------------------------------- curves


def horizon_path(truth: FrameTruth) -> str:
    """Return the exact, refracted horizon inside the image; empty if there is none."""
    return _ring_path(
        truth.camera_model,
        horizon_cam(truth.r_itrs, truth.q_cam_from_itrs, truth.apparent_ellipsoid, _CONE_SAMPLES),
    )


def limb_path(camera: CameraModel, nadir_cam: ArrayLike, angular_radius_rad: float) -> str:
    """Return the fitted limb inside the image; empty if it does not cross it."""
    n = np.asarray(nadir_cam, dtype=np.float64)
    n = n / np.linalg.norm(n)
    first = perpendicular(n)
    t = np.arange(_CONE_SAMPLES)[:, None] * (math.tau / _CONE_SAMPLES)
    ring = np.cos(t) * first + np.sin(t) * np.cross(n, first)
    return _ring_path(camera, math.cos(angular_radius_rad) * n + math.sin(angular_radius_rad) * ring)


def infrared_path(truth: FrameTruth, band: str) -> str:
    """Return the infrared horizon (half plateau) of a band inside the image; empty if there is none."""
    if band not in truth.infrared_horizon:
        return ""
    d_cam, _ = curve_cam(truth, band, _CONE_SAMPLES)
    return _ring_path(truth.camera_model, d_cam)


def _ring_path(camera: CameraModel, d_cam: FloatArray) -> str:
    """Return the parts inside the image of a closed curve given by close directions."""
    uv, _ = project(camera, np.concatenate([d_cam, d_cam[:1]]))
    inside = (
        np.abs(uv - [(camera.width - 1) / 2, (camera.height - 1) / 2]) <= [camera.width / 2, camera.height / 2]
    ).all(axis=-1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    path = ""
    for start, stop in edges.reshape(-1, 2):
        run = uv[start:stop]
        if len(run) > 1:
            keep = np.unique(np.linspace(0, len(run) - 1, _points_per_line(camera)).round().astype(int))
            path += _line(run[keep])
    return path


def _points_per_line(camera: CameraModel) -> int:
    """Return the number of vertices that bend equally little in an image of any size."""
    return round(_POINTS_PER_LINE * math.sqrt(max(camera.width, camera.height, 100) / 1000.0))


def points_path(points: ArrayLike) -> str:
    """Return limb points as zero-length strokes, which round line caps turn into dots."""
    uv = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return "".join(f"M{_coordinate(u)} {_coordinate(v)}h0" for u, v in uv[np.isfinite(uv).all(axis=1)])


def _line(uv: FloatArray) -> str:
    return "M" + "L".join(f"{_coordinate(u)} {_coordinate(v)}" for u, v in uv)


def _coordinate(value: float) -> str:
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _layers(view: CaseView, truth: FrameTruth, estimators: Sequence[str]) -> list[dict[str, str]]:
    """Return limb points and fitted limb of each estimator as path data."""
    camera = truth.camera_model
    layers = []
    for name in estimators:
        detail = view.details.get(name) or {}
        fit = detail.get("fit") or {}
        limb = ""
        if fit.get("nadir_cam") is not None and fit.get("angular_radius_rad") is not None:
            limb = limb_path(camera, fit["nadir_cam"], fit["angular_radius_rad"])
        layers.append({"points": points_path(detail.get("points") or []), "limb": limb})
    return layers
