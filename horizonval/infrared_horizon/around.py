"""The infrared horizon all round a camera, for every thermal band: what a frame's truth carries.

The air depends on height and latitude alone, so that rays at azimuths A and -A about the nadir see the same: half of the
circle is integrated. Where the air is the same everywhere, only the ellipsoid's curvature still turns with the azimuth
(0.7 % of its radius, some 30 m of the horizon's height); its first harmonics are then enough, and on a sphere one
azimuth.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from horizonval.earth.column import OpticalModel
from horizonval.earth.emission import EmittingBand
from horizonval.earth.ground_emission import GroundEmission
from horizonval.geometry.ellipsoid import Ellipsoid, geodetic_height
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.infrared_horizon.ground import ground_radiance
from horizonval.infrared_horizon.locators import GROUND_RAY_M, Located, locate, profile_heights_m
from horizonval.infrared_horizon.radiance import Air, ground_ray, limb_radiance
from horizonval.infrared_horizon.rays import FloatArray, angle_of_height, ground_points

AZIMUTHS = 36
"""Around the horizon, from north to east. Between two of them heights are linear to 10 m (by 72 of them)."""

_HARMONICS = 4


def infrared_horizon(
    model: OpticalModel, r_itrs: ArrayLike, ellipsoid: Ellipsoid, *, azimuths: int = AZIMUTHS
) -> dict[str, dict[str, Any]]:
    """Return the infrared horizon of every thermal band of a model, as plain data.

    Parameters
    ----------
    model : OpticalModel
        Its ``thermal`` bands and ``emission``.
    r_itrs : array_like, shape (3,)
        Camera [m].
    ellipsoid : Ellipsoid
    azimuths : int
        Even.

    Returns
    -------
    dict
        By band: ``kind`` ("opaque" or "window", see :mod:`horizonval.infrared_horizon.locators`), and lists over the
        azimuths about the geocentric nadir:

        - ``azimuth_deg``, from north to east;
        - ``geometric_angle_rad``: of the hard horizon from the geocentric nadir;
        - ``plateau_radiance``: W m-2 sr-1;
        - ``half_plateau_height_m`` and ``half_plateau_angle_rad``, the angle of the ray of that lowest height;
        - ``maximum_gradient_height_m`` and ``maximum_gradient_angle_rad``.

        Heights are rounded to 0.1 m and radiances to six digits: rounding differs between machines in the last bit,
        and truths must not. Empty where the camera is not above the air, or nothing absorbs.
    """
    r = np.asarray(r_itrs, dtype=np.float64)
    found = {}
    for band in model.thermal:
        air = Air(band)
        if float(geodetic_height(r, ellipsoid)) <= air.top_m or not air.absorbs:
            continue
        assert model.emission is not None
        found[band.name] = _of_band(band, air, model.emission, r, ellipsoid, azimuths)
    return found


def _of_band(
    band: EmittingBand, air: Air, emission: GroundEmission, r: FloatArray, ellipsoid: Ellipsoid, azimuths: int
) -> dict[str, Any]:
    azimuth = np.arange(azimuths) * (math.tau / azimuths)
    located = profile_around(band, air, emission, r, ellipsoid, azimuth)
    half, steepest = np.round(located.half_plateau_m, 1), np.round(located.maximum_gradient_m, 1)
    return {
        "kind": located.kind,
        "azimuth_deg": (np.arange(azimuths) * (360.0 / azimuths)).tolist(),
        "geometric_angle_rad": _angles(horizon_by_azimuth(r, ellipsoid, azimuth)),
        "plateau_radiance": [float(f"{value:.6g}") for value in located.plateau.tolist()],
        "half_plateau_height_m": half.tolist(),
        "half_plateau_angle_rad": _angles(angle_of_height(r, ellipsoid, azimuth, half)),
        "maximum_gradient_height_m": steepest.tolist(),
        "maximum_gradient_angle_rad": _angles(angle_of_height(r, ellipsoid, azimuth, steepest)),
    }


def profile_around(
    band: EmittingBand,
    air: Air,
    emission: GroundEmission,
    r_itrs: FloatArray,
    ellipsoid: Ellipsoid,
    azimuth_rad: FloatArray,
) -> Located:
    """Return where a band's profiles drop at azimuths in equal steps round the whole circle from 0, even in number."""
    half = azimuth_rad[: len(azimuth_rad) // 2 + 1]
    if air.is_uniform and ellipsoid.is_sphere:
        solved, spread = half[:1], np.ones((len(half), 1))
    elif air.is_uniform:
        solved = np.linspace(0.0, math.pi, _HARMONICS + 1)
        spread = _cosine_series(solved, half)
    else:
        solved, spread = half, np.eye(len(half))
    heights = profile_heights_m(air.top_m)
    radiance = spread @ limb_radiance(air, r_itrs, ellipsoid, solved, heights)
    path, passed = ground_ray(air, r_itrs, ellipsoid, solved, GROUND_RAY_M)
    mirrored = np.abs(np.arange(len(azimuth_rad)) - len(azimuth_rad) * (np.arange(len(azimuth_rad)) >= len(half)))
    place, _ = ground_points(r_itrs, ellipsoid, azimuth_rad, GROUND_RAY_M)
    ground = ground_radiance(band, emission, place, ellipsoid)
    disc = ((spread @ path)[mirrored] + (spread @ passed)[mirrored] * ground).sum(axis=1)
    return locate(heights, radiance[mirrored], disc)


def _cosine_series(nodes_rad: FloatArray, wanted_rad: FloatArray) -> FloatArray:
    """Return the matrix, shape (wanted, nodes), that carries even functions of azimuth from nodes to other places."""
    order = np.arange(len(nodes_rad))
    return np.linalg.solve(np.cos(nodes_rad[:, None] * order).T, np.cos(wanted_rad[:, None] * order).T).T


def _angles(angle_rad: FloatArray) -> list[float]:
    return [float(value) for value in np.round(angle_rad, 12)]
