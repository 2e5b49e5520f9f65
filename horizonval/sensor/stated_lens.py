"""What an estimator is told of a camera's lens: what its file says, and nothing that an image would have to show."""

from __future__ import annotations

import math

import numpy as np

from horizonval.estimation.lens import Lens
from horizonval.sensor.lens.diffraction import mean_wavelength_m
from horizonval.spec.camera import Band, CameraSpec


def stated_lens(camera: CameraSpec, band: Band | None) -> Lens | None:
    """Return what is told of the lens in a band; None of one without diffraction and with one spread over the field.

    Diffraction needs the pitch of the detector's pixels.
    """
    optics, pitch_um = camera.optics, None if camera.detector is None else camera.detector.pixel_pitch_um
    stated = Lens()
    if any(optics.psf_field_sigma_px):
        sigmas = np.array(optics.psf_field_sigma_px)
        angles = np.array([math.radians(angle) for angle in optics.psf_field_deg])
        stated = Lens(angles, sigmas / math.sqrt(np.mean(sigmas**2)))
    if optics.diffraction and band is not None and pitch_um is not None:
        spread_px = mean_wavelength_m(band) * optics.f_number / (1e-6 * pitch_um)
        stated = Lens(stated.angles_rad, stated.ratios, spread_px)
    return None if len(stated.ratios) == 1 and not stated.diffraction_px else stated
