"""Derivatives as central differences of whole frames: the reference, and what the air's own parameters are made by.

With steps h and 2h Richardson's rule removes the error of second order::

    D = (4 D_h - D_2h) / 3
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.plugin.settings import CameraSettings, LimbSettings

Images = dict[str, FloatArray]
"""Radiance by band, each of shape (H, W), float64."""


def radiance_images(limb: LimbSettings, camera: CameraSettings) -> Images:
    """Return the radiance of every band before it is rounded to single precision."""
    from horizonval.renderer.plugin.plugins import mitsuba_scene

    scene = mitsuba_scene(limb, camera)
    radiance, _ = scene.integrator().radiance(scene.sensors()[0])
    shape = camera.camera.height, camera.camera.width
    return {band: np.array(values, dtype=np.float64).reshape(shape) for band, values in radiance.items()}


def central_difference(images_at: Callable[[float], Images], step: float, richardson: bool = False) -> Images:
    """Return the derivative of images by a number at 0.

    Parameters
    ----------
    images_at : callable
        Images at a value of the number.
    step : float
    richardson : bool
        Whether twice the step is taken too, and its error removed.
    """
    high, low = images_at(step), images_at(-step)
    slope = {band: (high[band] - low[band]) / (2.0 * step) for band in high}
    if not richardson:
        return slope
    twice = central_difference(images_at, 2.0 * step)
    return {band: (4.0 * slope[band] - twice[band]) / 3.0 for band in slope}
