"""What the ground sends up a ray that meets it, band by band.

A ground of emissivity e and temperature T sends ``e S(T)`` and throws back the rest of the sky's light.
"""

from __future__ import annotations

import numpy as np

from horizonval.earth.emission import EmittingBand
from horizonval.earth.ground_emission import GroundEmission
from horizonval.geometry.ellipsoid import Ellipsoid, geodetic_from_itrs
from horizonval.infrared_horizon.rays import FloatArray


def ground_radiance(
    band: EmittingBand, emission: GroundEmission, place_itrs: FloatArray, ellipsoid: Ellipsoid
) -> FloatArray:
    """Return the radiance [W m-2 sr-1], shape (n, g), of the ground at places of shape (n, 3)."""
    latitude, _, _ = geodetic_from_itrs(place_itrs, ellipsoid)
    temperature = np.interp(np.sin(latitude), emission.sin_latitude, emission.water_k)
    return emission.emissivity * band.source(temperature)
