"""The infrared horizon all round a camera, for every thermal band, as a frame's truth has it.

Air that depends on height and latitude alone looks the same along rays at azimuths A and -A about the nadir: half of
the circle is integrated, and all of it where the air varies with longitude. Where the air is the same everywhere, only
the ellipsoid's curvature changes with the azimuth (0.7 % of its radius, some 30 m of the horizon's height); its first
harmonics are then enough, and on a sphere one azimuth.

**Limb profile.** ``L(h)`` is the radiance of the clear limb against the lowest geodetic height of the ray. The plateau
is the largest ``L`` between 10 and 24 km if the air itself is the horizon there (``opaque``: on average at least 0.6 of
the ray 10 km below the hard horizon, as in the 15 um band of CO2), else that ray's radiance (``window``: the ground is
the horizon, blurred by water vapour). Horizon sensors locate half of the plateau, or the steepest fall. The latter is a
broad maximum: it depends on what counts as structure (here 0.5 km) by some 0.3 km, and where two heights are nearly as
steep it may be either.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from horizonval.core.arrays import FloatArray
from horizonval.core.digests import content_digest
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.column import OpticalModel
from horizonval.earth.surface.ground_emission import GroundEmission
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import project
from horizonval.geometry.ellipsoid import Ellipsoid, geodetic_height
from horizonval.geometry.frames import rotate
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.truth.infrared_radiance import (
    BandMedium,
    GroundPlaces,
    RayPath,
    StraightHeights,
    angle_of_height,
    directions,
    ground_places,
    ground_points,
    ground_radiance,
    ground_ray,
    limb_radiances,
    ray_paths,
    straight_heights,
)

HALF_PLATEAU, MAXIMUM_GRADIENT = "half_plateau", "maximum_gradient"
_VISIBLE_SAMPLES = 7200


def curve_cam(truth: FrameTruth, band: str, samples: int, locator: str = HALF_PLATEAU) -> tuple[FloatArray, FloatArray]:
    """Return directions in camera axes, shape (samples, 3), and heights [m] round the infrared horizon of a band.

    In equal steps of azimuth about the geocentric nadir, from north. Between the stored azimuths the height, and the
    angle by which the curve stands above the exact hard horizon, are linear.
    """
    stored = truth.infrared_horizon[band]
    azimuth = np.arange(samples) * (math.tau / samples)
    at = np.radians(stored["azimuth_deg"])
    above = np.array(stored[f"{locator}_angle_rad"]) - np.array(stored["geometric_angle_rad"])
    ellipsoid = truth.ellipsoid
    hard = horizon_by_azimuth(truth.r_itrs, ellipsoid, azimuth)
    d_itrs = directions(truth.r_itrs, azimuth, hard + np.interp(azimuth, at, above, period=math.tau))
    height = np.interp(azimuth, at, stored[f"{locator}_height_m"], period=math.tau)
    return rotate(truth.q_cam_from_itrs, d_itrs), height


def visible_height_m(truth: FrameTruth, band: str, locator: str = HALF_PLATEAU) -> float | None:
    """Return the mean height of a band's infrared horizon over what of it lies inside the image; None without."""
    if band not in truth.infrared_horizon:
        return None
    camera = truth.camera_model
    d_cam, height = curve_cam(truth, band, _VISIBLE_SAMPLES, locator)
    uv, _ = project(camera, d_cam)
    low, high = -0.5, np.array([camera.width, camera.height]) - 0.5
    # Comparisons with NaN, the mark of a direction without an image, are False.
    inside = ((uv >= low) & (uv <= high)).all(axis=-1)
    return float(height[inside].mean()) if inside.any() else None


PLATEAU_M = (10e3, 24e3)
GROUND_RAY_M = -10e3
"""Height of the ray that stands for the Earth's disc: 10 km of chord depth, half a degree or less below the horizon."""
OPAQUE_SHARE = 0.6

_STEP_M = 25.0


def profile_heights_m(top_m: float) -> FloatArray:
    """Return the heights [m] of the rays of profiles, up to 90 km: 0.5 km apart where bands drop, wider elsewhere."""
    heights = np.concatenate(
        [
            np.arange(0.0, 8e3, 500.0),
            np.arange(8e3, 28e3, 1e3),
            np.arange(28e3, 50e3, 500.0),
            np.arange(50e3, 60e3, 1e3),
            np.arange(60e3, 91e3, 3e3),
        ]
    )
    return heights[heights < top_m - 500.0]


def needed(height_m: FloatArray, *, opaque: bool) -> NDArray[np.bool_]:
    """Return which heights the profile of a band needs.

    Opaque air hides what is below its plateau; a window drops low down, and is even above 28 km.
    """
    return height_m >= PLATEAU_M[0] if opaque else (height_m <= 28e3) | (height_m % 4e3 == 0.0)


@dataclass(frozen=True)
class HorizonHeights:
    """The horizon in limb profiles of several azimuths; arrays of shape (azimuths,)."""

    kind: str
    plateau: FloatArray
    half_plateau_m: FloatArray
    maximum_gradient_m: FloatArray


def locate(
    height_m: FloatArray, radiance: FloatArray, ground_radiance: FloatArray, opaque: bool | None = None
) -> HorizonHeights:
    """Return where the profiles (azimuths, n) of one band drop, at n heights that rise.

    A cubic spline connects the heights. ``ground_radiance`` (azimuths,) is that of the rays of :data:`GROUND_RAY_M`;
    ``opaque``: whether the air is the horizon, None to decide by the means over the azimuths. ``half_plateau_m`` is the
    highest crossing of half of the plateau; 0 where the whole limb is darker (the drop is then at the hard horizon).
    ``maximum_gradient_m`` is where -dL/dh is largest.
    """
    fine = np.arange(height_m[0], height_m[-1] + 0.5 * _STEP_M, _STEP_M)
    fine[-1] = min(fine[-1], height_m[-1])
    spline = CubicSpline(height_m, radiance, axis=1)
    level, slope = spline(fine), -spline(fine, 1)
    within = (fine >= PLATEAU_M[0]) & (fine <= PLATEAU_M[1])
    air = level[:, within].max(axis=1)
    if opaque is None:
        opaque = bool(air.mean() >= OPAQUE_SHARE * ground_radiance.mean())
    plateau = air if opaque else ground_radiance
    return HorizonHeights(
        kind="opaque" if opaque else "window",
        plateau=plateau,
        half_plateau_m=np.array([_highest(fine, row, 0.5 * p) for row, p in zip(level, plateau, strict=True)]),
        maximum_gradient_m=np.array([_peak(fine, row) for row in slope]),
    )


def _highest(height_m: FloatArray, level: FloatArray, wanted: float) -> float:
    """Return the highest place where a profile comes down to a level; 0 if it is nowhere above."""
    above = np.flatnonzero(level >= wanted)
    if not above.size:
        return 0.0
    i = int(above[-1])
    if i == len(level) - 1:
        return float(height_m[i])
    share = (level[i] - wanted) / (level[i] - level[i + 1])
    return float(height_m[i] + share * (height_m[i + 1] - height_m[i]))


def _peak(height_m: FloatArray, values: FloatArray) -> float:
    """Return the place of the largest of equally spaced values, by the parabola through its neighbours."""
    i = int(np.argmax(values))
    if i in (0, len(values) - 1):
        return float(height_m[i])
    bend = values[i - 1] - 2.0 * values[i] + values[i + 1]
    shift = 0.5 * (values[i - 1] - values[i + 1]) / bend if bend < 0.0 else 0.0
    return float(height_m[i] + np.clip(shift, -0.5, 0.5) * _STEP_M)


AZIMUTHS = 36
"""Around the horizon, from north to east.

Taken as linear between two of them, in air that changes with latitude, half-plateau heights are within 30 m rms (0.1 km
at most) from low orbits and 70 m rms (0.25 km) from a geostationary one. The steepest fall jumps by up to 2 km where a
profile has two places that are nearly as steep.
"""

_HARMONICS = 4
_LOWEST_TOP_M = 30e3


def infrared_horizon(
    model: OpticalModel,
    r_itrs: ArrayLike,
    ellipsoid: Ellipsoid,
    *,
    sun_itrs: ArrayLike = (1.0, 0.0, 0.0),
    azimuths: int = AZIMUTHS,
) -> dict[str, dict[str, Any]]:
    """Return the infrared horizon of every thermal band of a model, as plain data.

    Parameters
    ----------
    model : OpticalModel
        Its ``thermal`` bands and ``emission``.
    r_itrs : array_like, shape (3,)
        Camera [m].
    ellipsoid : Ellipsoid
    sun_itrs : array_like, shape (3,)
        Towards the Sun: the hour of the day on land. Matters where the ground is an "earth".
    azimuths : int
        Even.

    Returns
    -------
    dict
        By band: ``kind`` ("opaque" or "window"), and lists over the azimuths about the geocentric nadir:

        - ``azimuth_deg``, from north to east;
        - ``geometric_angle_rad``: of the hard horizon from the geocentric nadir;
        - ``plateau_radiance``: W m-2 sr-1;
        - ``half_plateau_height_m`` and ``half_plateau_angle_rad``, the angle of the ray of that lowest height;
        - ``maximum_gradient_height_m`` and ``maximum_gradient_angle_rad``.

        Heights are those of the ray's straight line outside the air, over the geometric planet: bent rays come lower
        (7 m at 40 km, 0.5 km at 10 km). Heights are rounded to 0.1 m, radiances to six digits, so that machines agree.
        Empty where the camera is not above the air, nothing absorbs, or an atmosphere file ends below 30 km.

    Notes
    -----
    The last eight are cached. Some 0.2 s for a band, and 1 to 2 s where the air changes with latitude.
    """
    if not model.thermal:
        return {}
    place, sun = (tuple(np.asarray(v, dtype=np.float64).tolist()) for v in (r_itrs, sun_itrs))
    digest = content_digest(model.top_m, model.emission, model.refractivity, model.thermal)
    request = _HorizonRequest(digest, place, ellipsoid, sun, azimuths, model)
    return copy.deepcopy(_computed(request))


@dataclass(frozen=True)
class _HorizonRequest:
    """What an infrared horizon depends on; the model is compared by its digest."""

    digest: str
    r_itrs: tuple[float, ...]
    ellipsoid: Ellipsoid
    sun_itrs: tuple[float, ...]
    azimuths: int
    model: OpticalModel = field(compare=False)


@lru_cache(maxsize=8)
def _computed(asked: _HorizonRequest) -> dict[str, dict[str, Any]]:
    model, ellipsoid = asked.model, asked.ellipsoid
    r = np.array(asked.r_itrs)
    if float(geodetic_height(r, ellipsoid)) <= model.top_m or model.top_m < _LOWEST_TOP_M:
        return {}
    assert model.emission is not None
    heights = straight_heights(model, ellipsoid.mean_radius_m)
    airs = [BandMedium(band, heights) for band in model.thermal]
    zonal = all(air.column_map is None for air in airs)
    view = _CameraRays.of(asked, heights, all(air.is_uniform for air in airs), zonal)
    found = _located(view, [(b, a) for b, a in zip(model.thermal, airs, strict=True) if a.absorbs], model.emission)
    return {name: _plain(view, heights) for name, heights in found.items()}


@dataclass(frozen=True)
class _CameraRays:
    """The rays of a camera, the same for all bands, past the planet raised by ``rise_m``.

    ``spread``: matrix from the azimuths that are integrated to all; ``past``, ``down``: rays past and to the ground.
    """

    r_itrs: FloatArray
    ellipsoid: Ellipsoid
    rise_m: float
    azimuth_rad: FloatArray
    height_m: FloatArray
    spread: FloatArray
    past: list[RayPath]
    down: RayPath
    ground: GroundPlaces

    @classmethod
    def of(cls, asked: _HorizonRequest, air: StraightHeights, uniform: bool, zonal: bool) -> _CameraRays:
        r_itrs, azimuths, top_m = np.array(asked.r_itrs), asked.azimuths, air.top_m
        ellipsoid = asked.ellipsoid.raised(air.rise_m)
        azimuth: FloatArray = np.arange(azimuths, dtype=np.float64) * (math.tau / azimuths)
        half = azimuth[: azimuths // 2 + 1]
        mirrored = np.minimum(np.arange(azimuths), azimuths - np.arange(azimuths))
        if not zonal:
            solved, spread, mirrored = azimuth, np.eye(azimuths), np.arange(azimuths)
        elif not uniform:
            solved, spread = half, np.eye(len(half))
        elif ellipsoid.is_sphere:
            solved, spread = half[:1], np.ones((len(half), 1))
        else:
            solved = np.linspace(0.0, math.pi, _HARMONICS + 1)
            spread = _cosine_series(solved, half)
        heights = profile_heights_m(top_m)
        down, *past = ray_paths(
            r_itrs, ellipsoid, solved, np.append(GROUND_RAY_M, heights), top_m, with_places=not zonal
        )
        place = ground_points(r_itrs, ellipsoid, azimuth, GROUND_RAY_M)
        emission = asked.model.emission
        assert emission is not None
        ground = ground_places(r_itrs, place, ellipsoid, np.array(asked.sun_itrs), emission)
        return cls(r_itrs, asked.ellipsoid, air.rise_m, azimuth, heights, spread[mirrored], past, down, ground)

    def limbs(self, airs: Sequence[BandMedium], which: NDArray[np.bool_]) -> list[FloatArray]:
        """Return the limbs of bands at some of the heights, shape (azimuths, n)."""
        rays = [path for path, one in zip(self.past, which, strict=True) if one]
        return [self.spread @ limb for limb in limb_radiances(airs, rays)] if airs else []


def _located(
    view: _CameraRays, bands: Sequence[tuple[EmittingBand, BandMedium]], emission: GroundEmission
) -> dict[str, HorizonHeights]:
    """Find the horizons of bands: first whether the air or the ground is the horizon, then where it drops."""
    height = view.height_m
    within = (height >= PLATEAU_M[0]) & (height <= PLATEAU_M[1])
    plateaus = view.limbs([air for _, air in bands], within)
    discs = []
    for band, air in bands:
        path, passed = ground_ray(air, view.down)
        ground = ground_radiance(band, emission, view.ground)
        discs.append((view.spread @ path + (view.spread @ passed) * ground).sum(axis=1))
    opaque = [p.max(axis=1).mean() >= OPAQUE_SHARE * d.mean() for p, d in zip(plateaus, discs, strict=True)]
    found = {}
    for kind in (False, True):
        of_kind = [n for n, value in enumerate(opaque) if value == kind]
        wanted = needed(height, opaque=kind)
        rest = view.limbs([bands[n][1] for n in of_kind], wanted & ~within)
        for n, more in zip(of_kind, rest, strict=True):
            profile = np.empty((len(more), len(height)))
            profile[:, within], profile[:, wanted & ~within] = plateaus[n], more
            found[bands[n][0].name] = locate(height[wanted], profile[:, wanted], discs[n], kind)
    return {band.name: found[band.name] for band, _ in bands}


def _plain(view: _CameraRays, located: HorizonHeights) -> dict[str, Any]:
    half, steepest = (
        np.round(height_m + view.rise_m, 1) for height_m in (located.half_plateau_m, located.maximum_gradient_m)
    )
    azimuths = len(view.azimuth_rad)

    def angles(height_m: FloatArray) -> list[float]:
        angle_rad = angle_of_height(view.r_itrs, view.ellipsoid, view.azimuth_rad, height_m)
        return [float(value) for value in np.round(angle_rad, 12)]

    return {
        "kind": located.kind,
        "azimuth_deg": [k * 360.0 / azimuths for k in range(azimuths)],
        "geometric_angle_rad": angles(np.zeros(azimuths)),
        "plateau_radiance": [float(f"{value:.6g}") for value in located.plateau.tolist()],
        "half_plateau_height_m": half.tolist(),
        "half_plateau_angle_rad": angles(half),
        "maximum_gradient_height_m": steepest.tolist(),
        "maximum_gradient_angle_rad": angles(steepest),
    }


def _cosine_series(nodes_rad: FloatArray, wanted_rad: FloatArray) -> FloatArray:
    """Return the matrix, shape (wanted, nodes), that carries even functions of azimuth from nodes to other places."""
    order = np.arange(len(nodes_rad))
    return np.linalg.solve(np.cos(nodes_rad[:, None] * order).T, np.cos(wanted_rad[:, None] * order).T).T
