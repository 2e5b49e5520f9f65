"""The image about a horizon: profiles across the limb, by azimuth about the nadir and angle off that horizon.

The horizon is that of the Earth's ellipsoid where position and attitude are known beside the image, else that of a
sphere. Along it, distances off it and azimuths mean the same in every camera, so that what is learned of one profile
holds for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

import horizonval as hv
from horizonval.geometry.camera import project
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.frames import north_east, rotate
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.geometry.rotation import tangent_basis

AZIMUTHS = 360
OFFSETS_RAD = np.radians(np.linspace(-4.0, 4.0, 25))
"""Off the horizon; negative towards the nadir."""
ENDS = 5
"""Samples at either end of a profile, whose means are the levels 1 of the Earth and 0 of the sky."""


@dataclass(frozen=True)
class Patch:
    """Profiles of one image, of the azimuths that are in it.

    Attributes
    ----------
    azimuth_rad : ndarray, shape (n,)
        About the nadir, from the first vector of its tangent basis towards the second.
    profiles : ndarray, shape (n, 25)
        From the Earth, level 1, to the sky, level 0.
    pixel_rad : ndarray, shape (n,)
        What a pixel covers across the horizon.
    contrast : ndarray, shape (n,)
        Digital numbers between the levels.
    directions : ndarray, shape (n, 3)
        To the horizon, in camera axes.
    """

    azimuth_rad: np.ndarray
    profiles: np.ndarray
    pixel_rad: np.ndarray
    contrast: np.ndarray
    directions: np.ndarray


class Sampler:
    """An image as it is asked for between its pixels, by cubic splines."""

    def __init__(self, observation: hv.Observation) -> None:
        self.observation = observation
        self._spline = spline_filter(np.asarray(observation.image, np.float64), order=3, mode="mirror")

    def patch(self, nadir_cam: np.ndarray, rho_rad: np.ndarray) -> Patch:
        """Return the profiles about a horizon.

        Parameters
        ----------
        nadir_cam : ndarray, shape (3,)
        rho_rad : ndarray, shape (AZIMUTHS,)
            Of the horizon, by :func:`azimuths_rad`.
        """
        camera = self.observation.camera
        azimuth = azimuths_rad()
        off = rho_rad[:, None] + OFFSETS_RAD
        level = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1) @ tangent_basis(nadir_cam).T
        lines = np.cos(off)[..., None] * nadir_cam + np.sin(off)[..., None] * level[:, None, :]
        uv, has_image = project(camera, lines)
        with np.errstate(invalid="ignore"):
            inside = has_image & (uv >= 0.0).all(axis=-1) & (uv <= [camera.width - 1, camera.height - 1]).all(axis=-1)
        seen = np.flatnonzero(inside.all(axis=1))
        uv = uv[seen]
        values = map_coordinates(self._spline, [uv[..., 1], uv[..., 0]], order=3, prefilter=False, mode="mirror")
        earth, sky = values[:, :ENDS].mean(axis=1), values[:, -ENDS:].mean(axis=1)
        contrast = earth - sky
        scale = np.where(np.abs(contrast) > 1e-9, contrast, 1e-9)
        middle = len(OFFSETS_RAD) // 2
        step_px = np.linalg.norm(uv[:, middle + 1] - uv[:, middle - 1], axis=-1)
        return Patch(
            azimuth[seen],
            (values - sky[:, None]) / scale[:, None],
            (OFFSETS_RAD[middle + 1] - OFFSETS_RAD[middle - 1]) / np.maximum(step_px, 1e-9),
            contrast,
            lines[seen, middle],
        )


def azimuths_rad() -> np.ndarray:
    """Return the azimuths of a patch, shape (AZIMUTHS,)."""
    return np.arange(AZIMUTHS) * (2.0 * np.pi / AZIMUTHS)


def horizon_rad(observation: hv.Observation, nadir_cam: np.ndarray) -> np.ndarray | None:
    """Return the horizon of the Earth's ellipsoid about a nadir, shape (AZIMUTHS,), or None where the place is unknown.

    Of the prior's position all is used, of its attitude the direction to the north alone.
    """
    prior = observation.prior
    if prior.r_itrs is None or prior.q_cam_from_itrs is None or prior.shape == "sphere":
        return None
    north = rotate(prior.q_cam_from_itrs, north_east(prior.r_itrs)[0])
    x, y = north @ tangent_basis(nadir_cam)
    # Tangent basis and nadir are right-handed, and so are north, east and nadir.
    return horizon_by_azimuth(prior.r_itrs, WGS84, azimuths_rad() - np.arctan2(y, x))
