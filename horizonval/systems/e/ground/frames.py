"""Frames of a pass over one station: a mount that rests, a satellite that streaks, stars, sky, detector.

For every exposure the mount is sent to where an old orbit predicts the satellite, rests there, and the shutter opens.
The camera then looks beside its reading, the clock is beside UTC, and the orbit was old: errors of stated size, each
drawn from a stream of its own name. Frames know all of them; what is measured in them (:mod:`reduction`) does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.earth.optical import OpticalModel, optical_model
from horizonval.geometry.camera import CameraModel, camera_from_spec, project, unproject
from horizonval.sensor.streams import stream
from horizonval.spec.camera import CameraSpec
from horizonval.systems.e.ground import ground_camera as cam
from horizonval.systems.e.ground.ground_pass import Pass, azimuth_elevation, standard_air
from horizonval.systems.e.ground.refraction import Correction, RefractingAir
from horizonval.systems.e.ground.satellite import SUN_MAGNITUDE, Brightness, sunlight_share, sunlight_through_air
from horizonval.systems.e.ground.sky import Sky, sky_scene
from horizonval.systems.e.ground.streak import points_image, streak_image

ARCSEC = math.pi / 648_000.0

FAINTEST_STAR, BRIGHTEST_STAR = 11.0, 4.0
_TO_SIXTH_PER_DEG2, _SLOPE = 0.12, 0.44
"""Stars brighter than magnitude m per square degree, ``0.12 x 10^(0.44 (m - 6))``: near the means over the whole sky,
5000 down to the 6th, 1e5 to the 9th and 6e5 to the 11th magnitude."""


@dataclass(frozen=True)
class StationErrors:
    """What is beside the truth, standard deviations; ``common`` ones are drawn once for a station and pass.

    Attributes
    ----------
    pointing_rad, pointing_common_rad : float
        Of the camera's boresight against the mount's reading, on each of two axes: encoder, and mount model.
    roll_rad : float
        About the boresight.
    clock_s, clock_common_s : float
        Of the exposure's middle.
    prediction_s : float
        The old orbit runs ahead by this, alike for all stations.
    """

    pointing_rad: float = 2.0 * ARCSEC
    pointing_common_rad: float = 1.0 * ARCSEC
    roll_rad: float = 20.0 * ARCSEC
    clock_s: float = 1.0e-3
    clock_common_s: float = 0.2e-3
    prediction_s: float = 0.05


@dataclass(frozen=True)
class Exposure:
    """One frame: digital numbers (H, W), and what made it.

    Attributes
    ----------
    second : float
        Nominal middle of the exposure.
    read_az_el_rad : ndarray, shape (2,)
        The mount's reading.
    path_uv : ndarray, shape (3, 2)
        Where the satellite was at the begin, in the middle and at the end.
    clock_s : float
        By how much the exposure came late.
    pointing_rad : ndarray, shape (3,)
        Rotation from the read to the true camera axes.
    satellite_e, sky_e : float
        Photoelectrons of the satellite in all, and of the sky in the middle pixel.
    magnitude : float
        Of the satellite, above the air.
    """

    dn: NDArray[np.uint16]
    second: float
    read_az_el_rad: FloatArray
    path_uv: FloatArray
    clock_s: float
    pointing_rad: FloatArray
    satellite_e: float
    sky_e: float
    magnitude: float


@dataclass(frozen=True)
class Frames:
    """The exposures of one station: pass, sky, camera, satellite, errors, seed.

    ``dimmer_mag`` makes the satellite fainter, to find out how faint it may be; infinite for an empty sky. ``blur``:
    the point spread as a sum of Gaussians, shares of the light and widths in units of the calibrated one, which is what
    a fit takes it for.
    """

    path: Pass
    sky: Sky
    camera: CameraSpec
    body: Brightness
    errors: StationErrors
    seed: int
    dimmer_mag: float = 0.0
    blur: tuple[tuple[float, float], ...] = ((1.0, 1.0),)

    @cached_property
    def air(self) -> tuple[RefractingAir, Correction]:
        """The air that refracts, and what the observer knows of it."""
        return standard_air(self.path.station, self.path.epoch_utc)

    @cached_property
    def model(self) -> OpticalModel:
        """Optical properties of the air in the camera's band."""
        return optical_model(sky_scene(self.path.station, self.path.epoch_utc, 0.0), self.camera)

    @cached_property
    def geometry(self) -> CameraModel:
        """The camera's intrinsics."""
        return camera_from_spec(self.camera.camera)

    @cached_property
    def prediction_s(self) -> float:
        """By how much the old orbit runs ahead."""
        return float(self._draw("orbit", "prediction", 1)[0]) * self.errors.prediction_s

    def read_az_el(self, second: float) -> FloatArray:
        """Return the mount's reading in an exposure: where the old orbit predicts the satellite, shape (2,)."""
        return np.array(azimuth_elevation(self.path.apparent_enu(self.air[0], second + self.prediction_s)))

    def expose(self, second: float) -> Exposure:
        """Return the frame whose exposure has its nominal middle at ``second`` after the epoch."""
        station, exposure_s = self.path.station, cam.detector_of(self.camera).exposure_s
        late = self._clock_s(second)
        t = second + late + exposure_s * np.array([-0.5, 0.0, 0.5])
        reading, turned = self.read_az_el(second), self._pointing_rad(second)
        cam_from_enu = Rotation.from_rotvec(turned).as_matrix() @ cam.cam_from_enu(*reading)
        path_uv, _ = project(self.geometry, self.path.apparent_enu(self.air[0], t) @ cam_from_enu.T)

        corners = np.array([[u, v] for v in (0, self.geometry.height - 1) for u in (0, self.geometry.width - 1)], float)
        towards = unproject(self.geometry, corners) @ cam_from_enu @ station.itrs_from_enu.T
        radiance = _between_corners(self.sky.radiance(towards, second), self.geometry)
        sky_e = cam.electrons_of_sky(radiance, self.camera)

        retarded = self.path.retarded_enu(t[1])
        phase, lit = self.path.light(t[1])
        share = float(sunlight_share(self.body, phase, np.linalg.norm(retarded)) * lit * 10 ** (-0.4 * self.dimmer_mag))
        below, _ = sunlight_through_air(
            self.model, self.camera.band[0].name, station.height_m, azimuth_elevation(retarded)[1]
        )
        satellite_e = float(cam.electrons_of_irradiance(below * share, self.camera))

        shape, sigma = sky_e.shape, self.camera.optics.psf_sigma_px
        stars_uv, stars_share = self._stars(second)
        stars_e = cam.electrons_of_irradiance(float(below) * stars_share, self.camera)
        light = sky_e
        for part, width in self.blur:
            light = light + streak_image(path_uv, part * satellite_e, width * sigma, (shape[0], shape[1]))
            light += points_image(stars_uv, part * stars_e, width * sigma, (shape[0], shape[1]))
        dn = cam.digital_numbers(light, self.camera, station.name, self._name(second), self.seed)
        return Exposure(
            dn,
            second,
            reading,
            path_uv,
            late,
            turned,
            satellite_e,
            float(sky_e[shape[0] // 2, shape[1] // 2]),
            SUN_MAGNITUDE - 2.5 * math.log10(share) if share > 0.0 else math.inf,
        )

    def _name(self, second: float) -> str:
        return f"{self.path.station.name} {second:.3f} {self.dimmer_mag}"

    def _draw(self, name: str, stage: str, count: int) -> FloatArray:
        return stream(name, self.camera.camera.name, "errors", stage, self.seed).standard_normal(count)

    def _clock_s(self, second: float) -> float:
        own, common = self._draw(self._name(second), "clock", 1), self._draw(self.path.station.name, "clock", 1)
        return float(own[0] * self.errors.clock_s + common[0] * self.errors.clock_common_s)

    def _pointing_rad(self, second: float) -> FloatArray:
        e = self.errors
        own, common = self._draw(self._name(second), "pointing", 3), self._draw(self.path.station.name, "pointing", 2)
        return own * [e.pointing_rad, e.pointing_rad, e.roll_rad] + np.append(common * e.pointing_common_rad, 0.0)

    def _stars(self, second: float) -> tuple[FloatArray, FloatArray]:
        """Return places (n, 2) and shares of the Sun's irradiance (n,) of the stars of a frame.

        A random field for every frame, as the mount steps on by a fifth of the field from one to the next.
        """
        rng = stream(self._name(second), self.camera.camera.name, "stars", "field", self.seed)
        size = np.array([self.geometry.width, self.geometry.height], float)
        field_deg2 = float(np.prod(np.degrees(size / self.geometry.fx)))
        faint, bright = (_TO_SIXTH_PER_DEG2 * 10 ** (_SLOPE * (m - 6.0)) for m in (FAINTEST_STAR, BRIGHTEST_STAR))
        count = int(rng.poisson((faint - bright) * field_deg2))
        per_deg2 = rng.uniform(bright, faint, count)
        m = 6.0 + np.log10(per_deg2 / _TO_SIXTH_PER_DEG2) / _SLOPE
        return rng.uniform(-0.5, size - 0.5, (count, 2)), 10 ** (-0.4 * (m - SUN_MAGNITUDE))


def _between_corners(corner: FloatArray, camera: CameraModel) -> FloatArray:
    """Return values at every pixel, shape (H, W), bilinear between those at the four corner pixels, row by row."""
    x, y = np.linspace(0.0, 1.0, camera.width), np.linspace(0.0, 1.0, camera.height)
    return np.stack([1.0 - y, y], axis=1) @ corner.reshape(2, 2) @ np.stack([1.0 - x, x])
