"""Frames of a pass over one station: a mount that rests, a satellite that streaks, stars, sky, detector.

For every exposure the mount is sent to where an old orbit predicts the satellite, rests there, and the shutter opens.
The camera points away from its reading, the clock differs from UTC, and the orbit is old: errors of stated size, each
from a named random stream. Frames know all of them; what is measured in them
(:mod:`~horizonval.systems.e.ground.reduction`) does not.

*Camera.* The mount rests during an exposure, so that stars are points (they move by 1.5 arcsec in 0.1 s) and a
satellite is a streak. Camera axes follow from the mount's azimuth and elevation: z along the boresight, x to the right
(rising azimuth), y down. The mount's reading differs from where the camera looks by a small rotation.

The detector's stages are those of :mod:`horizonval.sensor`; the point spread of the points is applied to them before
the pixels, in closed form, and that of the sky, which is smooth, is left out.

*Pass.* An observer who is fixed to the Earth sees a satellite, to first order in v / c, in the Earth-fixed direction
that it had when its light left it: light time and the station's aberration together (what is left, the Coriolis bend of
the light's path, is 0.04 arcsec). Refraction lifts that direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.air import air_of
from horizonval.earth.gases import rayleigh
from horizonval.earth.optical import OpticalModel, optical_model
from horizonval.earth.spectral import bands
from horizonval.geometry import clock
from horizonval.geometry.camera import CameraModel, camera_from_spec, project, unproject
from horizonval.geometry.orbit import ElementSet, itrs_states
from horizonval.geometry.sun_and_moon import sun_angular_radius, sun_itrs, sun_visible_fraction
from horizonval.sensor.detector import exposure, fixed_pattern, readout
from horizonval.sensor.lens import optics
from horizonval.sensor.streams import stream
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import Cmos
from horizonval.systems.e.ground.detection import points_image, streak_image
from horizonval.systems.e.ground.sky import (
    SUN_MAGNITUDE,
    Brightness,
    Correction,
    RefractingAir,
    Sky,
    apparent_elevation,
    sky_scene,
    sunlight_share,
    sunlight_through_air,
)
from horizonval.systems.e.localisation.stations import Station, enu_directions

TRACKER = {
    "camera": {"name": "ground-tracker", "width": 512, "height": 512, "focal_length_mm": 113.0},
    "optics": {"f_number": 2.8, "transmission": 0.8, "psf_sigma_px": 0.9},
    "band": [{"name": "visible", "kind": "solar", "lo_um": 0.5, "hi_um": 0.75, "nodes": 3}],
    "detector": {
        "kind": "cmos",
        "pixel_pitch_um": 5.5,
        "exposure_s": 0.1,
        "quantum_efficiency": 0.6,
        "full_well_e": 13500.0,
        "read_noise_e": 6.0,
        "dark_current_e_per_s": 50.0,
        "prnu": 0.01,
        "bits": 12,
        "black_level_dn": 64.0,
    },
}
"""Pixels of 10 arcsec on 1.4 deg behind a pupil of 40 mm: a lens and a machine-vision array as amateurs use them."""


def tracker() -> CameraSpec:
    """Return the camera of both stations."""
    return CameraSpec.model_validate(TRACKER)


def cam_from_enu(azimuth_rad: float, elevation_rad: float) -> FloatArray:
    """Return the rotation from station axes (east, north, up) to those of a camera that looks there, shape (3, 3)."""
    sa, ca, se, ce = np.sin(azimuth_rad), np.cos(azimuth_rad), np.sin(elevation_rad), np.cos(elevation_rad)
    return np.array([[ca, -sa, 0.0], [se * sa, se * ca, -ce], [ce * sa, ce * ca, se]])


def detector_of(camera: CameraSpec) -> Cmos:
    """Return the camera's detector, which must be a visible array."""
    assert isinstance(camera.detector, Cmos)
    return camera.detector


def electrons_of_power(power_w: FloatArray, camera: CameraSpec) -> FloatArray:
    """Return the photoelectrons of an exposure from power on the detector [W] in the camera's first band."""
    detector = detector_of(camera)
    reference_m = bands.reference_wavelength_um(camera.band[0]) * 1e-6
    return exposure.photoelectrons(power_w, detector.exposure_s, detector.quantum_efficiency, reference_m)


def electrons_of_irradiance(irradiance: FloatArray, camera: CameraSpec) -> FloatArray:
    """Return the photoelectrons that points of some band irradiance [W m-2] at the pupil give in an exposure."""
    lens = camera.optics
    focal_m = camera.camera.focal_px * detector_of(camera).pixel_pitch_um * 1e-6
    area = optics.pupil_area_m2(focal_m, lens.f_number)
    return electrons_of_power(np.asarray(irradiance, float) * area * lens.transmission, camera)


def electrons_of_sky(radiance: FloatArray, camera: CameraSpec) -> FloatArray:
    """Return the photoelectrons of every pixel, shape (H, W), from band radiance [W m-2 sr-1]."""
    geometry = camera_from_spec(camera.camera)
    etendue = optics.etendue(geometry, detector_of(camera).pixel_pitch_um * 1e-6, camera.optics)
    return electrons_of_power(optics.pixel_power_w(radiance, etendue, camera.optics.transmission), camera)


def digital_numbers(
    photoelectrons: FloatArray, camera: CameraSpec, unit: str, exposure_name: str, seed: int
) -> NDArray[np.uint16]:
    """Return the detector's image of expected photoelectrons, shape (H, W).

    ``unit``: the station's camera, for its fixed pattern; ``exposure_name``, ``seed``: for the noise.
    """
    detector = detector_of(camera)
    shape = (photoelectrons.shape[0], photoelectrons.shape[1])

    def rng(stage: str) -> np.random.Generator:
        return stream(exposure_name, unit, camera.band[0].name, stage, seed)

    unequal = photoelectrons * fixed_pattern.response(unit, detector.serial, shape, detector.prnu)
    counted = exposure.count(unequal, detector.full_well_e, rng("photon"))
    dark = exposure.count(
        np.full(shape, detector.dark_current_e_per_s * detector.exposure_s), detector.full_well_e, rng("dark")
    )
    held = readout.add_read_noise(
        readout.saturate(counted + dark, detector.full_well_e), detector.read_noise_e, rng("read")
    )
    return readout.digitise(held, gain_e_per_dn(camera), detector.black_level_dn, detector.bits)


def gain_e_per_dn(camera: CameraSpec) -> float:
    """Return the converter's electrons per digital number."""
    detector = detector_of(camera)
    return detector.gain_e_per_dn or readout.default_gain(detector.full_well_e, detector.bits, detector.black_level_dn)


def electrons_of_dn(dn: NDArray[np.uint16], camera: CameraSpec) -> FloatArray:
    """Return digital numbers as electrons above the black level, shape (H, W)."""
    return (dn.astype(np.float64) - detector_of(camera).black_level_dn) * gain_e_per_dn(camera)


WAVELENGTH_UM = 0.62
"""Wavelength of refraction: the middle of the tracker's band. Dispersion over the band (0.4 arcsec at 48 deg) blurs far
less than the point spread."""


@dataclass(frozen=True)
class Pass:
    """A satellite over a station."""

    elements: ElementSet
    station: Station
    epoch_utc: datetime

    def geometric_enu(self, seconds: ArrayLike) -> FloatArray:
        """Return station to satellite [m] at instants after the epoch, shape (..., 3), in east, north, up."""
        r, _ = itrs_states(self.elements, self.epoch_utc, seconds)
        return (r - self.station.r_itrs) @ self.station.itrs_from_enu

    def retarded_enu(self, seconds: ArrayLike) -> FloatArray:
        """Return the same for the satellite as it is seen: where it was when its light left it."""
        t = np.asarray(seconds, float)
        distance = np.linalg.norm(self.geometric_enu(t), axis=-1)
        # Once is enough: in the light time of 3 ms the distance changes by 20 m, or 0.07 microseconds.
        return self.geometric_enu(t - distance / speed_of_light)

    def apparent_enu(self, air: RefractingAir, seconds: ArrayLike) -> FloatArray:
        """Return unit vectors in which the satellite is seen through the air, shape (..., 3)."""
        d = self.retarded_enu(seconds)
        azimuth, elevation = azimuth_elevation(d)
        lifted = apparent_elevation(air, self.station.height_m, elevation, np.linalg.norm(d, axis=-1))
        return enu_directions(azimuth, lifted)

    def light(self, seconds: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the phase angle [rad] at the satellite and the visible share of the Sun's disc, shape (...).

        The Sun's position is that of the middle time: it moves by 15 arcsec/s in Earth-fixed axes.
        """
        t = np.asarray(seconds, float)
        r, _ = itrs_states(self.elements, self.epoch_utc, t)
        middle = clock.utc_after(self.epoch_utc, float(np.mean(t)))
        sun, distance = sun_itrs(middle)
        to_observer = self.station.r_itrs - r
        across = np.linalg.norm(np.cross(to_observer, sun), axis=-1)
        return np.arctan2(across, to_observer @ sun), sun_visible_fraction(r, sun, float(sun_angular_radius(distance)))


def azimuth_elevation(d_enu: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return azimuth in ``[0, 2 pi)`` and elevation [rad], shape (...), of vectors (..., 3) in east, north, up."""
    d = np.asarray(d_enu, float)
    return np.mod(np.arctan2(d[..., 0], d[..., 1]), 2.0 * np.pi), np.arctan2(d[..., 2], np.hypot(d[..., 0], d[..., 1]))


def standard_air(station: Station, epoch_utc: datetime) -> tuple[RefractingAir, Correction]:
    """Return the refracting air of the sky's scene, and what an observer with barometer and thermometer knows of it."""
    state = air_of(sky_scene(station, epoch_utc, 0.0)).state
    air = RefractingAir(state.altitude_m, rayleigh.refractivity(state.number_density_air, [WAVELENGTH_UM]))
    pressure = float(np.exp(np.interp(station.height_m, state.altitude_m, np.log(state.pressure_pa))))
    temperature = float(np.interp(station.height_m, state.altitude_m, state.temperature_k))
    return air, Correction.of(pressure * 1e-2, temperature - 273.15, station.height_m, WAVELENGTH_UM)


ARCSEC = math.pi / 648_000.0

FAINTEST_STAR, BRIGHTEST_STAR = 11.0, 4.0
_TO_SIXTH_PER_DEG2, _SLOPE = 0.12, 0.44
"""Stars brighter than magnitude m per square degree, ``0.12 x 10^(0.44 (m - 6))``: near the means over the whole sky,
5000 down to the 6th, 1e5 to the 9th and 6e5 to the 11th magnitude."""


@dataclass(frozen=True)
class StationErrors:
    """Standard deviations of errors; ``common`` ones are constant for a station and pass.

    ``pointing_rad``, ``pointing_common_rad``: boresight against the mount's reading, on each of two axes (encoder,
    mount model); ``roll_rad``: about the boresight; ``clock_s``, ``clock_common_s``: of the exposure's middle;
    ``prediction_s``: lead of the predicted orbit, equal for all stations.
    """

    pointing_rad: float = 2.0 * ARCSEC
    pointing_common_rad: float = 1.0 * ARCSEC
    roll_rad: float = 20.0 * ARCSEC
    clock_s: float = 1.0e-3
    clock_common_s: float = 0.2e-3
    prediction_s: float = 0.05


@dataclass(frozen=True)
class Exposure:
    """One frame: digital numbers (H, W), and its origin.

    ``second``: nominal middle; ``read_az_el_rad``: the mount's reading; ``path_uv``: shape (3, 2), the satellite at
    begin, middle and end; ``clock_s``: delay of the exposure; ``pointing_rad``: rotation from read to true camera axes;
    ``satellite_e``, ``sky_e``: photoelectrons of the satellite in all, and of the sky in the middle pixel;
    ``magnitude``: of the satellite, above the air.
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

    ``dimmer_mag``: makes the satellite fainter, infinite for an empty sky; ``blur``: point spread as a sum of
    Gaussians, shares of light and widths relative to the calibrated one, which fits assume.
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
        station, exposure_s = self.path.station, detector_of(self.camera).exposure_s
        late = self._clock_s(second)
        t = second + late + exposure_s * np.array([-0.5, 0.0, 0.5])
        reading, turned = self.read_az_el(second), self._pointing_rad(second)
        axes = Rotation.from_rotvec(turned).as_matrix() @ cam_from_enu(*reading)
        path_uv, _ = project(self.geometry, self.path.apparent_enu(self.air[0], t) @ axes.T)

        corners = np.array([[u, v] for v in (0, self.geometry.height - 1) for u in (0, self.geometry.width - 1)], float)
        towards = unproject(self.geometry, corners) @ axes @ station.itrs_from_enu.T
        radiance = _between_corners(self.sky.radiance(towards, second), self.geometry)
        sky_e = electrons_of_sky(radiance, self.camera)

        retarded = self.path.retarded_enu(t[1])
        phase, lit = self.path.light(t[1])
        share = float(sunlight_share(self.body, phase, np.linalg.norm(retarded)) * lit * 10 ** (-0.4 * self.dimmer_mag))
        below, _ = sunlight_through_air(
            self.model, self.camera.band[0].name, station.height_m, azimuth_elevation(retarded)[1]
        )
        satellite_e = float(electrons_of_irradiance(below * share, self.camera))

        shape, sigma = sky_e.shape, self.camera.optics.psf_sigma_px
        stars_uv, stars_share = self._stars(second)
        stars_e = electrons_of_irradiance(float(below) * stars_share, self.camera)
        light = sky_e
        for part, width in self.blur:
            light = light + streak_image(path_uv, part * satellite_e, width * sigma, (shape[0], shape[1]))
            light += points_image(stars_uv, part * stars_e, width * sigma, (shape[0], shape[1]))
        dn = digital_numbers(light, self.camera, station.name, self._name(second), self.seed)
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
        """Return positions (n, 2) and shares of the Sun's irradiance (n,) of a frame's random stars."""
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
