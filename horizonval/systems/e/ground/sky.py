"""The sky over a ground station: rendered on a coarse grid of directions, read anywhere between.

The renderer looks up from the station with a fisheye: light scattered any number of times, airglow and the sky behind,
straight rays. A cloudless sky away from the Sun is smooth, so that the logarithm of its radiance on a grid of some
degrees is enough for a spline; in time, a parabola through three epochs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RectBivariateSpline

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import camera_from_spec, project
from horizonval.geometry.frames import rotate
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.systems.e.localisation.stations import Station

FIELD_DEG = 124.0
"""Of the fisheye; a circle of it in the image reaches down to an elevation of 28 deg."""


@dataclass(frozen=True)
class Sky:
    """Radiance over a station in one band.

    Attributes
    ----------
    seconds : ndarray, shape (3,)
        After the pass's epoch.
    log_radiance : ndarray, shape (3, n, n)
        Natural logarithm of W m-2 sr-1 in the fisheye's pixels.
    q_cam_from_itrs : tuple of float
        The fisheye's attitude.
    """

    seconds: FloatArray
    log_radiance: FloatArray
    q_cam_from_itrs: tuple[float, ...]

    def radiance(self, direction_itrs: ArrayLike, second: float) -> FloatArray:
        """Return the radiance [W m-2 sr-1], shape (...), in directions (..., 3) at one instant."""
        n = self.log_radiance.shape[-1]
        uv, _ = project(camera_from_spec(fisheye(n, []).camera), rotate(self.q_cam_from_itrs, direction_itrs))
        at = np.arange(n, dtype=float)
        looks = [RectBivariateSpline(at, at, image).ev(uv[..., 1], uv[..., 0]) for image in self.log_radiance]
        t0, t1, t2 = self.seconds
        t = second
        weights = (
            (t - t1) * (t - t2) / ((t0 - t1) * (t0 - t2)),
            (t - t0) * (t - t2) / ((t1 - t0) * (t1 - t2)),
            (t - t0) * (t - t1) / ((t2 - t0) * (t2 - t1)),
        )
        return np.asarray(np.exp(sum(w * look for w, look in zip(weights, looks, strict=True))))

    def plain(self) -> dict[str, Any]:
        """Return plain data from which :meth:`of_plain` makes the same sky."""
        return {
            "seconds": self.seconds.tolist(),
            "log_radiance": self.log_radiance.tolist(),
            "q_cam_from_itrs": list(self.q_cam_from_itrs),
        }

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> Sky:
        """Build from :meth:`plain`."""
        return cls(np.array(plain["seconds"]), np.array(plain["log_radiance"]), tuple(plain["q_cam_from_itrs"]))


def fisheye(pixels: int, band: Sequence[Band]) -> CameraSpec:
    """Return a camera for the sky: ``pixels`` squared, f-theta, over :data:`FIELD_DEG`."""
    geometry = {"name": "sky", "width": pixels, "height": pixels, "fov_deg": FIELD_DEG, "projection": "fisheye"}
    return CameraSpec.model_validate({"camera": geometry, "band": [b.model_dump(exclude_none=True) for b in band]})


def sky_scene(station: Station, epoch_utc: datetime, second: float) -> SceneSpec:
    """Return the scene of a camera that looks up from a station: clean US 1976 air over a ground of albedo 0.3."""
    return SceneSpec.model_validate(
        {
            "scene": {"name": f"sky-{station.name}"},
            "camera": {"file": "sky"},
            "platform": {
                "epoch_utc": epoch_utc + timedelta(seconds=second),
                "latitude_deg": float(np.degrees(station.latitude_rad)),
                "longitude_deg": float(np.degrees(station.longitude_rad)),
                "altitude_km": station.height_m * 1e-3,
            },
            "attitude": {"pitch_deg": 180.0},
            "render": {"subsamples": 1},
        }
    )


def render_sky(station: Station, epoch_utc: datetime, seconds: Sequence[float], band: Band, pixels: int = 33) -> Sky:
    """Return the sky over a station from three rendered frames, at ``seconds`` after the epoch."""
    camera = fisheye(pixels, [band])
    frames = [render_frame(sky_scene(station, epoch_utc, s), camera) for s in seconds]
    images = np.stack([np.log(np.asarray(f.radiance[band.name], float)) for f in frames])
    return Sky(np.asarray(seconds, float), images, tuple(frames[0].truth.q_cam_from_itrs))
