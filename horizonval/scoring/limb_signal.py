"""Signal, noise, veil and saturation at the limb, from the truth and the camera file, without an image.

By day a pixel on the limb collects ``S = L etendue tau t QE lambda / (h c)`` electrons. The Sun's veil adds V, the dark
current D. The noise of the step at the limb is::

    noise^2 = S + V + D + read^2 + step^2 / 12 + (PRNU (S + V))^2 + DSNU^2

and the limb saturates where S + V reaches full scale. The veil comes from the camera file: wings of the lens
(:mod:`horizonval.sensor.lens.scatter`) about a Sun in or near the frame, the baffle's table for a Sun outside.

A thermal limb is always in front of cold space. Its signal is the radiance of a black body of 220 K, the coldest air
seen at the limb, its noise the NETD and the pixels' offsets. A camera without a detector has no noise.

**Radiance L.** The tables hold the reflectance ``pi L / E`` of the limb's brightest layer (E the Sun's irradiance
across its rays, in the band) of clean US-standard air seen from 500 km in 450 to 750 nm, computed with this package's
march, all orders of scattering. It depends on the Sun's zenith angle z at the tangent point and on the Sun's side:
ahead (behind the limb), side, or behind the camera. The ground adds ``albedo G(z)`` at the limb and ``albedo B(z)``
some ten kilometres below it. ``HAZE`` is the ratio of the brightest layers with and without the default background of
particles (ground of albedo 0.3); it serves for every model of particles. Without air ``pi L / E = albedo cos(z)``.

The tables are good to 30 % by day in visible bands, to a factor of two in other bands, other air and in twilight. They
decide whether a signal exceeds five times its noise or full scale, and frames within a factor of three of a threshold
are borderline (:mod:`horizonval.scoring.limits`).

Neglected: ghosts, the tail of diffraction, moonlight (100 000 times fainter than sunlight), airglow, blooming.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import constants
from scipy.interpolate import RegularGridInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.scoring import limits
from horizonval.scoring.horizon_view import HorizonView
from horizonval.sensor.detector import exposure, readout, thermal
from horizonval.sensor.lens import optics, scatter, stray_light
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Cmos

ZENITH_DEG = np.array([0, 30, 60, 70, 80, 85, 88, 90, 92, 94, 96, 98, 100, 104, 110], dtype=np.float64)
AHEAD = np.array(
    [0.154, 0.185, 0.238, 0.241, 0.212, 0.152, 0.092, 0.048, 1.7e-2, 5.3e-3, 1.5e-3, 4.1e-4, 9.9e-5, 2.6e-6, 5e-8]
)
SIDE = np.array(
    [0.154, 0.154, 0.150, 0.144, 0.127, 0.103, 0.074, 0.046, 1.9e-2, 3.3e-3, 2.8e-4, 1.1e-5, 1.8e-6, 8e-8, 5e-8]
)
BEHIND = np.array(
    [0.154, 0.184, 0.240, 0.247, 0.231, 0.200, 0.164, 0.126, 8.1e-2, 4.2e-2, 1.7e-2, 5.0e-3, 1.2e-3, 4.5e-5, 5e-8]
)
GROUND_AT_LIMB = np.array(
    [0.317, 0.275, 0.150, 0.096, 0.042, 0.017, 0.007, 0.003, 5e-4, 1e-4, 2e-5, 2e-6, 2e-7, 1e-8, 1e-8]
)
GROUND_BELOW = np.array([0.59, 0.51, 0.28, 0.185, 0.083, 0.035, 0.012, 0.005, 1e-3, 2e-4, 4e-5, 4e-6, 4e-7, 1e-8, 1e-8])
HAZE_ZENITH_DEG = np.array([0, 30, 60, 70, 80, 85, 88, 90, 92, 94, 96, 98, 100, 104], dtype=np.float64)
HAZE_AZIMUTH_DEG = np.array([0, 15, 30, 45, 60, 90, 180], dtype=np.float64)
HAZE = np.array(
    [
        [0.93, 0.93, 0.93, 0.93, 0.93, 0.93, 0.93],
        [1.06, 1.05, 1.03, 1.01, 0.98, 0.94, 0.86],
        [1.71, 1.57, 1.34, 1.17, 1.06, 0.95, 0.82],
        [2.38, 2.03, 1.53, 1.24, 1.09, 0.96, 0.82],
        [3.32, 2.54, 1.67, 1.28, 1.11, 0.96, 0.82],
        [3.46, 2.56, 1.62, 1.25, 1.09, 0.95, 0.81],
        [3.66, 2.46, 1.50, 1.16, 1.05, 0.92, 0.80],
        [4.40, 2.88, 1.59, 1.16, 1.02, 0.91, 0.81],
        [5.13, 3.43, 1.90, 1.31, 1.07, 0.87, 0.84],
        [4.38, 3.01, 1.71, 1.18, 0.99, 0.88, 0.84],
        [3.50, 2.38, 1.45, 1.17, 1.02, 0.83, 0.85],
        [3.24, 2.34, 1.52, 1.20, 1.07, 1.56, 0.87],
        [3.02, 2.24, 1.50, 1.20, 1.11, 1.66, 0.89],
        [2.43, 1.95, 1.47, 1.59, 2.20, 1.71, 0.94],
    ]
)


def limb_reflectance(
    zenith_rad: FloatArray, cos_azimuth: FloatArray, albedo: float, *, air: bool, hazy: bool = False
) -> FloatArray:
    """Return ``pi L / E`` of the limb.

    ``zenith_rad``: the Sun's zenith angle at the tangent point. ``cos_azimuth``: cosine of the angle there between the
    line of sight and the Sun's azimuth, 1 with the Sun ahead. ``hazy``: whether the air has particles.
    """
    if not air:
        return np.asarray(albedo * np.maximum(np.cos(zenith_rad), 0.0))
    clear = _path(zenith_rad, cos_azimuth) + albedo * _log_table(zenith_rad, GROUND_AT_LIMB)
    return clear * _haze(zenith_rad, cos_azimuth) if hazy else clear


def brightest_reflectance(
    zenith_rad: FloatArray, cos_azimuth: FloatArray, albedo: float, *, air: bool, hazy: bool = False
) -> FloatArray:
    """Return ``pi L / E`` of the brightest thing near the limb, at it or below it; parameters as above."""
    at_limb = limb_reflectance(zenith_rad, cos_azimuth, albedo, air=air, hazy=hazy)
    if not air:
        return at_limb
    path = _path(zenith_rad, cos_azimuth)
    if hazy:
        path = path * _haze(zenith_rad, cos_azimuth)
    return np.maximum(at_limb, 0.8 * path + albedo * _log_table(zenith_rad, GROUND_BELOW))


def _haze(zenith_rad: FloatArray, cos_azimuth: FloatArray) -> FloatArray:
    azimuth = np.degrees(np.arccos(np.clip(cos_azimuth, -1.0, 1.0)))
    zenith = np.clip(np.degrees(zenith_rad), HAZE_ZENITH_DEG[0], HAZE_ZENITH_DEG[-1])
    table = RegularGridInterpolator((HAZE_ZENITH_DEG, HAZE_AZIMUTH_DEG), HAZE)
    return np.asarray(table(np.stack([zenith, azimuth], axis=-1)))


def _path(zenith_rad: FloatArray, cos_azimuth: FloatArray) -> FloatArray:
    side = _log_table(zenith_rad, SIDE)
    ahead, behind = (_log_table(zenith_rad, table) for table in (AHEAD, BEHIND))
    return np.where(
        cos_azimuth > 0, side + (ahead - side) * np.abs(cos_azimuth), side + (behind - side) * np.abs(cos_azimuth)
    )


def _log_table(zenith_rad: FloatArray, table: FloatArray) -> FloatArray:
    return np.asarray(np.exp(np.interp(np.degrees(zenith_rad), ZENITH_DEG, np.log(table))))


_RADIUS_KM = 6371.0


@dataclass(frozen=True)
class LimbSignal:
    """Signal at every sample of the horizon, shape (n,); meaningful where it is in view.

    ``lit`` and ``seen``: signal-to-noise ratio of the step at the limb without and with the Sun's veil. ``filling``:
    limb and veil over full scale, saturated above 1. ``veil_filling``: veil over full scale.
    """

    lit: FloatArray
    seen: FloatArray
    filling: FloatArray
    veil_filling: FloatArray


def limb_signal(truth: FrameTruth, spec: CameraSpec, band: Band, camera: CameraModel, view: HorizonView) -> LimbSignal:
    """Return the signal at the limb for one band."""
    n = len(view.in_view)
    if band.kind == "thermal":
        ratio = np.full(n, _thermal_ratio(spec, band))
        return LimbSignal(ratio, ratio, np.zeros(n), np.zeros(n))
    sun = stray_light.sun_of(truth)
    irradiance = stray_light.band_irradiance(band, sun.angular_radius_rad)
    air, albedo, brightest_albedo = ground_and_air(truth.scene)
    zenith = np.arccos(np.clip(view.cos_zenith, -1.0, 1.0))
    hazy = truth.scene.get("atmosphere", {}).get("aerosol", "none") != "none"
    radiance = limb_reflectance(zenith, view.cos_azimuth, albedo, air=air, hazy=hazy) * irradiance / math.pi
    brightest = brightest_reflectance(zenith, view.cos_azimuth, brightest_albedo, air=air, hazy=hazy)
    brightest = brightest * irradiance / math.pi
    if not isinstance(spec.detector, Cmos):
        # No noise at all: what shines is seen. Twilight fainter than a millionth of daylight is not called light.
        ratio = np.where(radiance > 1e-6 * irradiance, math.inf, 0.0)
        return LimbSignal(ratio, ratio, np.zeros(n), np.zeros(n))
    detector, pitch_m = spec.detector, spec.detector.pixel_pitch_um * 1e-6
    seconds_to_electrons = (
        detector.quantum_efficiency * bands.reference_wavelength_um(band) * 1e-6 / (constants.h * constants.c)
    )
    per_radiance = _etendue(camera, spec, pitch_m, view) * spec.optics.transmission * seconds_to_electrons
    full_e = _full_scale_e(detector)
    seconds = _exposure_s(detector, brightest * per_radiance, view, full_e)
    signal, top = radiance * per_radiance * seconds, brightest * per_radiance * seconds
    veil_w = _veil_w(truth, spec, band, camera, view, sun, irradiance)
    veil = veil_w * seconds_to_electrons * seconds
    dark = (
        detector.dark_current_e_per_s
        * seconds
        * exposure.dark_current_ratio(detector.temperature_c, detector.dark_reference_c, detector.dark_doubling_k)
    )
    gain = detector.gain_e_per_dn or readout.default_gain(detector.full_well_e, detector.bits, detector.black_level_dn)
    fixed = dark + detector.read_noise_e**2 + gain**2 / 12.0 + detector.dsnu_e**2

    def ratio_with(extra: FloatArray | float) -> FloatArray:
        light = signal + extra
        return np.asarray(signal / np.sqrt(light + fixed + (detector.prnu * light) ** 2))

    return LimbSignal(ratio_with(0.0), ratio_with(veil), (top + veil) / full_e, veil / full_e)


def ground_and_air(scene: dict[str, Any]) -> tuple[bool, float, float]:
    """Return whether a scene has air, the albedo of its ground and that of the brightest thing on it."""
    atmosphere = scene.get("atmosphere", {})
    air = atmosphere.get("profile") != "none" or any(atmosphere.get(key) for key in ("file", "profile_file"))
    surface = scene.get("surface", {})
    albedo = float(surface.get("albedo", limits.ALBEDO_OF_THE_EARTH))
    brightest = max(albedo, _brightest_snow(scene)) if surface.get("kind") == "earth" else albedo
    clouds = scene.get("clouds")
    if clouds is not None and clouds.get("cover", "climate") != 0:
        brightest = max(brightest, float(clouds.get("albedo", limits.ALBEDO_OF_CLOUDS)))
    return air, albedo, brightest


def _brightest_snow(scene: dict[str, Any]) -> float:
    """Return the albedo of ice sheets where they can be in sight, or of other snow."""
    platform = scene.get("platform", {})
    reach_deg = math.degrees(math.acos(_RADIUS_KM / (_RADIUS_KM + float(platform.get("altitude_km", math.inf)))))
    if abs(float(platform.get("latitude_deg", 0.0))) + reach_deg > limits.ICE_SHEETS_FROM_DEG:
        return limits.ALBEDO_OF_ICE_SHEETS
    return limits.ALBEDO_OF_SNOW


def _etendue(camera: CameraModel, spec: CameraSpec, pitch_m: float, view: HorizonView) -> FloatArray:
    """Return the etendue [m2 sr] of the pixels on the horizon; 0 out of view."""
    out = np.zeros(len(view.in_view))
    uv, los = view.uv[view.in_view], view.los_cam[view.in_view]
    step = np.array([[0.5, 0.0], [0.0, 0.5]])
    right, down = (unproject(camera, uv + one) - unproject(camera, uv - one) for one in step)
    solid_angle = np.linalg.norm(np.cross(right, down), axis=-1)
    off_axis = np.arctan2(np.hypot(los[:, 0], los[:, 1]), los[:, 2])
    area = optics.pupil_area_m2(camera.fx * pitch_m, spec.optics.f_number)
    # A pixel at the edge of a lens's image circle may have no second side.
    out[view.in_view] = np.nan_to_num(area * optics.pupil_share(camera, spec.optics, off_axis) * solid_angle)
    return out


def _full_scale_e(detector: Cmos) -> float:
    gain = detector.gain_e_per_dn or readout.default_gain(detector.full_well_e, detector.bits, detector.black_level_dn)
    return min(detector.full_well_e, (readout.full_scale(detector.bits) - detector.black_level_dn) * gain)


def _exposure_s(detector: Cmos, rate_e_per_s: FloatArray, view: HorizonView, full_e: float) -> float:
    """Return the exposure; an automatic one is taken to lay the brightest limb in view on its target."""
    rule = detector.auto_exposure
    if rule is None:
        return detector.exposure_s
    rate = float(rate_e_per_s[view.in_view].max()) if view.in_view.any() else 0.0
    if rate * rule.max_s <= rule.target * full_e:
        return rule.max_s
    return max(rule.target * full_e / rate, rule.min_s)


def _veil_w(
    truth: FrameTruth,
    spec: CameraSpec,
    band: Band,
    camera: CameraModel,
    view: HorizonView,
    sun: stray_light.Sun,
    irradiance: float,
) -> FloatArray:
    """Return the Sun's scattered light on the pixel of every sample [W]."""
    lens, n = spec.optics, len(view.in_view)
    if sun.visible_fraction <= 0.0 or spec.detector is None:
        return np.zeros(n)
    pitch_m = spec.detector.pixel_pitch_um * 1e-6
    veil = np.zeros(n)
    outside, _ = stray_light.outside_image(camera, sun)
    place, has_image = project(camera, np.array(sun.direction_cam))
    middle = 0.0
    if lens.scatter is not None and bool(has_image):
        pupil = lens.transmission * optics.pupil_area_m2(camera.fx * pitch_m, lens.f_number)
        pupil *= float(optics.pupil_share(camera, lens, np.asarray(sun.off_axis_rad)))
        point_w = irradiance * sun.visible_fraction * pupil

        def wings_w(uv: FloatArray) -> FloatArray:
            off = (np.where(np.isfinite(uv), uv, 0.0) - place) / (camera.fx, camera.fy)
            share = scatter.image_share(lens.scatter, (off**2).sum(axis=-1))  # type: ignore[arg-type]
            return point_w * share / (camera.fx * camera.fy)

        veil = wings_w(view.uv)
        middle = float(wings_w(np.array([[(camera.width - 1) / 2, (camera.height - 1) / 2]]))[0])
    if lens.stray is None or outside == 0.0:
        return veil
    level = stray_light.detector_irradiance(lens.stray, camera, band, sun) * pitch_m**2
    wings = veil * outside
    # As in the image plane: the table says how bright the middle is.
    table = wings * min(1.0, level / (middle * outside)) + max(level - middle * outside, 0.0) if middle > 0 else level
    return np.asarray(veil * (1.0 - outside) + table)


def _thermal_ratio(spec: CameraSpec, band: Band) -> float:
    detector = spec.detector
    if detector is None or isinstance(detector, Cmos):
        return math.inf
    measured_in = next((one for one in spec.band if one.name == detector.netd_band), band)
    sigma = thermal.noise_radiance(measured_in, detector, spec)
    offset_k = math.hypot(detector.residue_k, detector.drift_pattern_k_per_min * detector.minutes_since_correction)
    sigma = math.hypot(sigma, offset_k * thermal.radiance_per_kelvin(measured_in))
    signal = thermal.blackbody_radiance(band, limits.COLDEST_LIMB_K)
    return signal / sigma if sigma > 0 else math.inf
