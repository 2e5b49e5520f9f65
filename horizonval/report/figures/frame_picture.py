"""Pictures of rendered frames: sunlight in colour or grey over a white ground, heat as brightness temperatures."""

from __future__ import annotations

import base64
from datetime import datetime

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands, sunlight
from horizonval.earth.spectral.brightness import brightness_temperature_k
from horizonval.frame import Hit, RadianceFrame
from horizonval.geometry.ephemeris import AU_M, sun_itrs
from horizonval.report.figures.infrared import ThermalPanel, infrared_picture
from horizonval.report.figures.tone import tone_mapped
from horizonval.spec.camera import Band

LOW_LIMB_M = 15e3
"""Air seen up to here decides the colour scale of an infrared picture together with ground and clouds."""


def frame_picture(frame: RadianceFrame) -> NDArray[np.uint8]:
    """Return a picture of a frame, shape (H, W, 3), sRGB.

    Three solar bands make one in colour, the longest wavelengths red; of other numbers the first is grey. Without solar
    bands all thermal ones are shown as brightness temperatures, with their scale.
    """
    shown = [band for band in frame.truth.camera_spec.band if band.name in frame.radiance]
    solar = [band for band in shown if band.kind == "solar"]
    if not solar:
        return infrared_picture([thermal_panel(band, frame) for band in shown])
    chosen = sorted(solar, key=bands.reference_wavelength_um, reverse=True) if len(solar) == 3 else [solar[0]] * 3
    when = datetime.fromisoformat(frame.truth.epoch_utc)
    return tone_mapped(np.stack([reflectance(frame.radiance[b.name], b, when) for b in chosen], axis=-1)).rgb


def reflectance(radiance: NDArray[np.float32], band: Band, epoch_utc: datetime) -> FloatArray:
    """Return a solar band's radiance over that of a white ground under the Sun's zenith, in the shape of the image."""
    _, distance_m = sun_itrs(epoch_utc)
    distance_au = distance_m / AU_M
    if band.lo_um is not None and band.hi_um is not None:
        irradiance = sunlight.band_irradiance(band.lo_um, band.hi_um, distance_au)
    else:
        wavelength_um, weight_um = bands.sampled(band)
        irradiance = float(sunlight.irradiance(wavelength_um, distance_au) @ weight_um)
    return radiance.astype(np.float64) / (irradiance / np.pi)


def thermal_panel(band: Band, frame: RadianceFrame) -> ThermalPanel:
    """Return a thermal band of a frame as brightness temperatures, with the pixels that decide their scale."""
    hit, height = frame.maps["hit"], frame.maps["tangent_height"]
    counts = (hit == Hit.SURFACE) | (hit == Hit.CLOUD) | ((hit == Hit.ATMOSPHERE) & (height < LOW_LIMB_M))
    lo, hi = bands.limits_um(band)
    return ThermalPanel(
        f"{band.name}: {lo:g} to {hi:g} µm", brightness_temperature_k(band, frame.radiance[band.name]), counts
    )


def png(rgb: NDArray[np.uint8]) -> bytes:
    """Return a picture, shape (H, W, 3), as the bytes of a PNG file."""
    done, data = cv2.imencode(".png", rgb[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not done:
        raise RuntimeError("OpenCV cannot write PNG")
    return data.tobytes()


def png_uri(rgb: NDArray[np.uint8]) -> str:
    """Return a picture as a PNG in a ``data:`` URI, for a page that needs nothing beside it."""
    return "data:image/png;base64," + base64.b64encode(png(rgb)).decode("ascii")
