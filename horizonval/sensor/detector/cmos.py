"""Visible arrays: power on the pixels to digital numbers.

The stages follow the light and the charge::

    motion, colour mosaic -> exposure -> photoelectrons x response, smear (Poisson), dark electrons (Poisson), offsets,
    protons -> full well, blooming -> read noise -> converter -> interpolated colour

Each but photoelectrons, full well and converter is off unless the camera file asks for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, camera_from_spec
from horizonval.geometry.ellipsoid import geodetic_from_itrs
from horizonval.sensor import motion
from horizonval.sensor.detector import bayer, exposure, fixed_pattern, protons, readout
from horizonval.sensor.lens import image_plane, optics
from horizonval.sensor.lens.stray_light import sun_of
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Cmos

Streams = Callable[[str], np.random.Generator | None]
"""Gives the generator of a named stage; None for an observation without noise."""


def respond(
    radiance: Callable[[Band], FloatArray],
    truth: FrameTruth,
    geometry: CameraModel,
    camera: CameraSpec,
    detector: Cmos,
    band: Band,
    rng: Streams,
    behind: Callable[[Band], FloatArray] | None = None,
) -> tuple[NDArray[np.uint16], dict[str, Any]]:
    """Return digital numbers, shape (H, W), and the settings that an image carries.

    ``radiance`` gives the checked radiance of a band, shape (H, W); a mosaic asks for all colours. ``behind`` gives it
    without parts of the spacecraft, where the frame has some. Without noise (:data:`Streams`) pixels do not differ.
    """
    bits, black, full_well = detector.bits, detector.black_level_dn, detector.full_well_e
    noisy, unit = rng("read") is not None, fixed_pattern.unit(camera.camera.name, truth)
    expected = expected_charge(radiance, truth, geometry, camera, detector, band, noisy, behind)
    electrons, dark, seconds, shape = expected.electrons, expected.dark, expected.seconds, expected.electrons.shape
    photon_rng, dark_rng, read_rng = rng("photon"), rng("dark"), rng("read")
    if photon_rng is not None and dark_rng is not None:
        electrons = exposure.count(electrons, full_well, photon_rng)
        dark = exposure.count(dark, full_well, dark_rng)
    collected = electrons + dark
    if noisy and detector.dsnu_e > 0.0:
        collected = collected + fixed_pattern.dark_offset_e(unit, detector.serial, shape, detector.dsnu_e)
    collected = _with_protons(collected, detector, truth, seconds, rng("protons"))
    spill = readout.bloom if detector.blooming == "column" else readout.saturate
    held = spill(collected, full_well)
    if read_rng is not None:
        held = readout.add_read_noise(held, detector.read_noise_e, read_rng)
    gain = electrons_per_dn(detector)
    dn = readout.digitise(held, gain, black, bits)
    if detector.bayer is not None:
        whole = bayer.plane(dn.astype(np.float64), detector.bayer, bayer.colour_of(band.name))
        dn = np.floor(whole + 0.5).astype(np.uint16)
    settings: dict[str, Any] = {"gain_e_per_dn": gain}
    if detector.auto_exposure is not None:
        settings["exposure_s"] = seconds
    return dn, settings


@dataclass(frozen=True, eq=False)
class ExpectedCharge:
    """Expected charge of the pixels: photoelectrons with smear, dark electrons, shape (H, W) each, and the exposure."""

    electrons: FloatArray
    dark: FloatArray
    seconds: float


def electrons_per_dn(detector: Cmos) -> float:
    """Return the converter's gain: the detector's own, or the one that lays a full well on the largest number."""
    gain = readout.default_gain(detector.full_well_e, detector.bits, detector.black_level_dn)
    return detector.gain_e_per_dn or gain


def radiance_per_dn(camera: CameraSpec, detector: Cmos, band: Band, seconds: float) -> float:
    """Return the band radiance on the axis per digital number [W m-2 sr-1], by the data sheet, at an exposure."""
    geometry = camera_from_spec(camera.camera)
    pitch_m = detector.pixel_pitch_um * 1e-6
    area_m2 = optics.pupil_area_m2(geometry.fx * pitch_m, camera.optics.f_number)
    power_w = np.array(camera.optics.transmission * area_m2 / (geometry.fx * geometry.fy))
    wavelength_m = bands.reference_wavelength_um(band) * 1e-6
    electrons = exposure.photoelectrons(power_w, seconds, detector.quantum_efficiency, wavelength_m)
    return electrons_per_dn(detector) / float(electrons)


def expected_charge(
    radiance: Callable[[Band], FloatArray],
    truth: FrameTruth,
    geometry: CameraModel,
    camera: CameraSpec,
    detector: Cmos,
    band: Band,
    unlike: bool,
    behind: Callable[[Band], FloatArray] | None = None,
) -> ExpectedCharge:
    """Return the expected charge; parameters as for :func:`respond`, ``unlike``: whether pixels differ."""
    shape = (geometry.height, geometry.width)
    unit = fixed_pattern.unit(camera.camera.name, truth)
    colours, pitch_m = _colours(camera, detector, band), detector.pixel_pitch_um * 1e-6
    power_w = {
        letter: image_plane.pixel_power_w(radiance(one), geometry, camera.optics, pitch_m, one, sun_of(truth))
        for letter, one in colours.items()
    }
    dark_rate = _dark_rate(detector, unit, shape, unlike)
    seconds = detector.exposure_s
    if detector.auto_exposure is not None:
        # From the camera at rest: how far it turns depends on the exposure, and hardly changes a percentile.
        rate = _electrons(power_w, colours, detector, 1.0) + dark_rate
        seconds = exposure.exposure_s(rate, detector.full_well_e, detector.auto_exposure)
    turn = motion.rate_cam_rad_s(truth)
    motion.check_turn(turn, camera, seconds)
    row_time_s = detector.row_time_s if detector.shutter == "rolling" and detector.row_time_s is not None else 0.0

    def moved(power: FloatArray, one: Band) -> FloatArray:
        if behind is None or not turn.any():
            return motion.blur_by_motion(power, geometry, turn, seconds, row_time_s)
        still = image_plane.pixel_power_w(behind(one), geometry, camera.optics, pitch_m, one, sun_of(truth))
        blurred = motion.blur_by_motion(still, geometry, turn, seconds, row_time_s)
        return motion.behind_still_parts(power, still, blurred, truth, geometry)

    moved_w = {letter: moved(power, colours[letter]) for letter, power in power_w.items()}
    electrons = _electrons(moved_w, colours, detector, seconds)
    if detector.shutter == "frame_transfer" and detector.row_time_s is not None:
        electrons = electrons + readout.smear_e(electrons / seconds, detector.row_time_s)
    if unlike and detector.prnu > 0.0:
        electrons = electrons * fixed_pattern.response(unit, detector.serial, shape, detector.prnu)
    dark = np.broadcast_to(dark_rate * seconds, shape)
    return ExpectedCharge(electrons, np.asarray(dark), seconds)


def _colours(camera: CameraSpec, detector: Cmos, band: Band) -> dict[str, Band]:
    """Return the bands that pixels see: by letter for a mosaic, else the one asked for under the empty string."""
    return {"": band} if detector.bayer is None else {bayer.colour_of(one.name): one for one in camera.band}


def _electrons(power_w: dict[str, FloatArray], colours: dict[str, Band], detector: Cmos, seconds: float) -> FloatArray:
    """Return the expected photoelectrons of every pixel, shape (H, W), from each colour's whole image."""
    planes = {
        letter: exposure.photoelectrons(
            power, seconds, detector.quantum_efficiency, bands.reference_wavelength_um(colours[letter]) * 1e-6
        )
        for letter, power in power_w.items()
    }
    return planes[""] if detector.bayer is None else bayer.mosaic(planes, detector.bayer)


def _dark_rate(detector: Cmos, name: str, shape: tuple[int, int], noisy: bool) -> FloatArray | float:
    """Return the expected dark electrons per second, hot pixels included unless there is no noise."""
    warmer = exposure.dark_current_ratio(detector.temperature_c, detector.dark_reference_c, detector.dark_doubling_k)
    current = detector.dark_current_e_per_s * warmer
    if not noisy or detector.hot_pixel_fraction == 0.0:
        return current
    hot = fixed_pattern.hot_dark_current(
        name, detector.serial, shape, detector.hot_pixel_fraction, detector.hot_pixel_e_per_s
    )
    return current + warmer * hot


def _with_protons(
    electrons: FloatArray, detector: Cmos, truth: FrameTruth, seconds: float, rng: np.random.Generator | None
) -> FloatArray:
    """Return the charge with the protons' streaks. Rows wait half the read-out time on average, and collect."""
    if detector.radiation is None or rng is None:
        return electrons
    ellipsoid = truth.ellipsoid
    latitude, longitude, _ = geodetic_from_itrs(np.array(truth.r_itrs), ellipsoid)
    anomaly = protons.anomaly(float(np.degrees(latitude)), float(np.degrees(longitude)))
    shape = (electrons.shape[0], electrons.shape[1])
    open_s = seconds + 0.5 * shape[0] * (detector.row_time_s or 0.0)
    hits = protons.mean_hits(detector.radiation.flux_per_cm2_s * anomaly, shape, detector.pixel_pitch_um, open_s)
    return electrons + protons.streaks_e(
        hits, shape, detector.pixel_pitch_um, detector.radiation.depth_um, detector.radiation.charge_e_per_um, rng
    )
