"""Signal, noise, veil and saturation at the limb, from the truth and the camera file, without an image.

By day a pixel on the limb collects ``S = L etendue tau t QE lambda / (h c)`` electrons, with L from
:mod:`horizonval.scoring.limb_radiance`; the Sun's veil adds V, the dark current D. The step at the limb stands out of

    noise^2 = S + V + D + read^2 + step^2 / 12 + (PRNU (S + V))^2 + DSNU^2

and is lost where S + V reaches full scale. The veil is that of the optics' own settings: wings of the lens
(:mod:`horizonval.sensor.lens.scatter`) about a Sun in or near the frame, the baffle's table for a Sun outside of it.

A thermal limb always stands before cold space; its signal is the radiance of a black body of 220 K, the coldest air
that is seen at the limb, its noise the NETD and the pixels' offsets.

Neglected: ghosts, the tail of diffraction, moonlight (100 000 times fainter than sunlight), airglow, blooming.
A camera without a detector is taken as free of noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import constants

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.scoring import limits
from horizonval.scoring.horizon_view import HorizonView
from horizonval.scoring.limb_radiance import brightest_reflectance, limb_reflectance
from horizonval.sensor.detector import converter, exposure, thermal, thermal_noise
from horizonval.sensor.lens import optics, scatter, stray_light
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Cmos

_RADIUS_KM = 6371.0


@dataclass(frozen=True)
class LimbSignal:
    """At every sample of the horizon, shape (n,); meaningful where it is in view.

    Attributes
    ----------
    lit : ndarray
        Signal-to-noise ratio of the step at the limb without the Sun's veil.
    seen : ndarray
        The same with the veil.
    filling : ndarray
        Limb and veil over full scale: the limb is saturated above 1.
    veil_filling : ndarray
        Veil over full scale.
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
    gain = detector.gain_e_per_dn or converter.default_gain(
        detector.full_well_e, detector.bits, detector.black_level_dn
    )
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
    gain = detector.gain_e_per_dn or converter.default_gain(
        detector.full_well_e, detector.bits, detector.black_level_dn
    )
    return min(detector.full_well_e, (converter.full_scale(detector.bits) - detector.black_level_dn) * gain)


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
    sigma = math.hypot(sigma, offset_k * thermal_noise.radiance_per_kelvin(measured_in))
    signal = thermal_noise.blackbody_radiance(band, limits.COLDEST_LIMB_K)
    return signal / sigma if sigma > 0 else math.inf
