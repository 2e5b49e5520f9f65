"""The lens: from the radiance of the scene to the power on the pixels.

Cameras that count photons use the power on each pixel; thermal cameras use the radiance that would give the same power
on the axis. Both go through the same stages, in the order of the light::

    collected    solid angle, pupil, vignetting                                 (optics)
    ghosts       added                                                          (stray_light)
    spread       aberration, diffraction, defocus, scatter                      (lens_spread)
    stray light  of the Sun outside the image: through the wings of the lens,   (stray_light)
                 brought to the level of the baffle's table where one is given

A baffle's table gives the irradiance in the middle of the image: wings that are fainter there get an even veil added,
brighter ones are dimmed. The halo of a Sun just outside does not change while the table is not below the wings' own
``PST = tau pi / (4 N^2) cos(theta) K(tan theta) (f / pitch)^2`` at the border (:mod:`horizonval.sensor.lens.scatter`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel, project
from horizonval.sensor.lens import lens_spread, optics, stray_light
from horizonval.sensor.lens.stray_light import Sun
from horizonval.spec.camera import Band
from horizonval.spec.optics import Optics


def radiance_on_axis(
    radiance: FloatArray,
    geometry: CameraModel,
    lens: Optics,
    pixel_pitch_m: float | None = None,
    band: Band | None = None,
    sun: Sun | None = None,
) -> FloatArray:
    """Return the radiance [W m-2 sr-1] that on the axis would give every pixel the power it gets, shape (H, W).

    The transmission is not in it: stray light, whose table has it, is divided by it. Pitch and band are needed for
    diffraction and defocus; without a Sun there is no stray light from outside the image.
    """
    light = radiance * optics.relative_illumination(geometry, lens)
    on_axis_power = math.pi * lens.transmission / (4 * lens.f_number**2)
    return _through(light, geometry, lens, pixel_pitch_m, band, sun, geometry.fx * geometry.fy, 1 / on_axis_power)


def pixel_power_w(
    radiance: FloatArray,
    geometry: CameraModel,
    lens: Optics,
    pixel_pitch_m: float,
    band: Band | None = None,
    sun: Sun | None = None,
) -> FloatArray:
    """Return the power on each pixel [W], shape (H, W); parameters as in :func:`radiance_on_axis`."""
    light = optics.pixel_power_w(radiance, optics.etendue(geometry, pixel_pitch_m, lens), lens.transmission)
    pixel_area_m2 = pixel_pitch_m**2 * geometry.fx / geometry.fy
    pupil = lens.transmission * optics.pupil_area_m2(geometry.fx * pixel_pitch_m, lens.f_number)
    return _through(light, geometry, lens, pixel_pitch_m, band, sun, pupil, pixel_area_m2)


def _through(
    light: FloatArray,
    geometry: CameraModel,
    lens: Optics,
    pixel_pitch_m: float | None,
    band: Band | None,
    sun: Sun | None,
    per_source_irradiance: float,
    per_detector_irradiance: float,
) -> FloatArray:
    """Return the light after all stages that follow the collection, in its own unit.

    The last two numbers convert to it an irradiance across the Sun's rays, gathered by the pupil into one point, and
    one on the detector.
    """
    if lens.ghost:
        light = light + sum(stray_light.ghost_image(light, geometry, ghost) for ghost in lens.ghost)
    out = lens_spread.spread(light, geometry, lens, band, pixel_pitch_m)
    if sun is None or band is None or sun.visible_fraction == 0:
        return out
    wings: FloatArray | float = 0.0
    if lens.scatter is not None or lens.diffraction:
        wings = _wings_of_sun_outside(geometry, lens, pixel_pitch_m, band, sun) * per_source_irradiance
    if lens.stray is None:
        return out + wings
    veil = stray_light.detector_irradiance(lens.stray, geometry, band, sun) * per_detector_irradiance
    return out + _at_level(wings, veil)


def _at_level(wings: FloatArray | float, veil: float) -> FloatArray | float:
    """Return wings with an even veil under them, or dimmed, so that the middle of the image has the veil's level."""
    middle = wings if isinstance(wings, float) else float(wings[wings.shape[0] // 2, wings.shape[1] // 2])
    if middle <= 0.0:
        return veil
    return wings * min(1.0, veil / middle) + max(veil - middle, 0.0)


def _wings_of_sun_outside(
    geometry: CameraModel, lens: Optics, pixel_pitch_m: float | None, band: Band, sun: Sun
) -> FloatArray | float:
    """Return the irradiance [W m-2] across the Sun's rays times the share of it that lands on each pixel."""
    share, direction = stray_light.outside_image(geometry, sun)
    # Beyond the image circle there is no image, but the light is in the lens.
    place, has_image = project(replace(geometry, image_circle_rad=None), direction)
    if share == 0 or not has_image:
        return 0.0
    off_axis = np.arctan2(np.hypot(direction[0], direction[1]), direction[2])
    arriving = stray_light.band_irradiance(band, sun.angular_radius_rad) * sun.visible_fraction * share
    seen = float(optics.pupil_share(geometry, lens, np.asarray(off_axis)))
    return arriving * seen * lens_spread.wings_of_point(geometry, lens, band, pixel_pitch_m, *map(float, place))
