"""Visible arrays: power on the pixels to digital numbers.

The stages follow the charge: photoelectrons and dark electrons (Poisson), full well, read noise, converter.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.earth import bands
from horizonval.errors import UserError
from horizonval.geometry.camera import Camera
from horizonval.sensor import converter, exposure, image_plane, readout
from horizonval.sensor.stray_light import Sun
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Cmos

FloatArray = NDArray[np.float64]
Streams = Callable[[str], np.random.Generator | None]
"""Gives the generator of a named stage; None for an observation without noise."""


def respond(
    radiance: FloatArray,
    geometry: Camera,
    camera: CameraSpec,
    detector: Cmos,
    band: Band,
    rng: Streams,
    sun: Sun | None = None,
) -> tuple[NDArray[np.uint16], dict[str, Any]]:
    """Return digital numbers, shape (H, W), and the settings that an image carries."""
    _require_black_below_white(detector)
    bits, black = detector.bits, detector.black_level_dn
    power = image_plane.pixel_power_w(radiance, geometry, camera.optics, detector.pixel_pitch_um * 1e-6, band, sun)
    electrons = exposure.photoelectrons(
        power, detector.exposure_s, detector.quantum_efficiency, bands.reference_wavelength_um(band) * 1e-6
    )
    dark = np.full_like(electrons, exposure.dark_electrons(detector.dark_current_e_per_s, detector.exposure_s))
    photon_rng, dark_rng, read_rng = rng("photon"), rng("dark"), rng("read")
    if photon_rng is not None and dark_rng is not None:
        electrons = exposure.count(electrons, detector.full_well_e, photon_rng)
        dark = exposure.count(dark, detector.full_well_e, dark_rng)
    charge = readout.saturate(electrons + dark, detector.full_well_e)
    if read_rng is not None:
        charge = readout.add_read_noise(charge, detector.read_noise_e, read_rng)
    gain = detector.gain_e_per_dn or converter.default_gain(detector.full_well_e, bits, black)
    return converter.digitise(charge, gain, black, bits), {"gain_e_per_dn": gain}


def _require_black_below_white(detector: Cmos) -> None:
    white = converter.full_scale(detector.bits)
    if detector.black_level_dn >= white:
        raise UserError(
            f"black_level_dn = {detector.black_level_dn}",
            where="detector.black_level_dn",
            expected=f"below {white}, the largest number of {detector.bits} bits",
        )
