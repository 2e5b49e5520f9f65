"""Materials of the ground, whose mixtures form all kinds of ground, and their reflectance from 0.3 to 2.5 um.

The spectra are rounded after published measurements:

- ``vegetation``: a closed green canopy; ``soil``: dry soil, rock and straw (shapes after the ASTER spectral library, A.
  M. Baldridge et al., Remote Sens. Environ. 113, 711 (2009));
- ``sand``: bright desert, at the dark end of the bare sands by which satellites are calibrated, as rocky desert lies
  between the sands (H. Cosnefroy et al., ibid. 58, 101 (1996): 0.18 to 0.25 at 0.45 um, 0.35 to 0.5 at 0.65, 0.45 to
  0.6 at 0.85, 0.55 to 0.7 at 1.6);
- ``snow``: S. G. Warren, Rev. Geophys. 20, 67 (1982), grains of a tenth of a millimetre, reduced by a tenth for age and
  dirt; also of sea ice; ``firn``: the clean, dry snow of ice sheets (T. C. Grenfell, S. G. Warren, P. C. Mullen, J.
  Geophys. Res. 99, 18669 (1994): 0.96 to 0.98 in all visible light);
- ``water``: reflectance from below the surface of clear oceanic water with 0.1 mg of chlorophyll per m3 (A. Morel and
  S. Maritorena, ibid. 106, 7163 (2001)); ``foam``: P. Koepke, Appl. Opt. 23, 1816 (1984), spectrally flat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

DRY = ("vegetation", "soil", "sand", "snow", "firn")
"""Materials of land; snow lies on sea ice too."""
FOAM_ALBEDO = 0.22

_SPECTRA = {
    "vegetation": (
        (0.30, 0.40, 0.45, 0.50, 0.55, 0.60, 0.65, 0.68, 0.70, 0.72, 0.75, 0.80, 0.90, 1.10, 1.30, 1.45, 1.65, 1.95,
         2.20, 2.50),
        (0.03, 0.035, 0.04, 0.05, 0.09, 0.07, 0.05, 0.045, 0.09, 0.18, 0.32, 0.37, 0.39, 0.39, 0.34, 0.14, 0.24, 0.06,
         0.13, 0.05),
    ),
    "soil": (
        (0.30, 0.40, 0.50, 0.60, 0.70, 0.80, 0.90, 1.10, 1.30, 1.65, 1.95, 2.20, 2.50),
        (0.04, 0.07, 0.11, 0.16, 0.20, 0.23, 0.25, 0.28, 0.31, 0.33, 0.28, 0.31, 0.25),
    ),
    "sand": (
        (0.30, 0.40, 0.45, 0.50, 0.55, 0.60, 0.65, 0.70, 0.80, 0.90, 1.10, 1.30, 1.65, 1.95, 2.20, 2.50),
        (0.07, 0.12, 0.17, 0.21, 0.29, 0.35, 0.39, 0.42, 0.46, 0.48, 0.53, 0.57, 0.60, 0.53, 0.58, 0.48),
    ),
    "snow": (
        (0.30, 0.50, 0.60, 0.70, 0.80, 0.90, 1.00, 1.05, 1.10, 1.20, 1.30, 1.40, 1.50, 1.65, 1.80, 1.95, 2.20, 2.50),
        (0.88, 0.89, 0.885, 0.87, 0.85, 0.81, 0.73, 0.71, 0.72, 0.57, 0.55, 0.30, 0.05, 0.10, 0.18, 0.03, 0.12, 0.03),
    ),
    "firn": (
        (0.30, 0.50, 0.60, 0.70, 0.80, 0.90, 1.00, 1.05, 1.10, 1.20, 1.30, 1.40, 1.50, 1.65, 1.80, 1.95, 2.20, 2.50),
        (0.97, 0.98, 0.98, 0.97, 0.95, 0.92, 0.85, 0.83, 0.84, 0.71, 0.69, 0.45, 0.12, 0.20, 0.30, 0.07, 0.21, 0.08),
    ),
    "water": (
        (0.30, 0.40, 0.44, 0.49, 0.51, 0.55, 0.58, 0.60, 0.65, 0.70, 2.50),
        (0.015, 0.022, 0.020, 0.012, 0.008, 0.004, 0.002, 0.001, 0.0005, 0.0, 0.0),
    ),
}  # fmt: skip
NAMES = tuple(_SPECTRA)


def spectrum(material: str, wavelength_um: ArrayLike) -> FloatArray:
    """Return the albedo of a material of :data:`NAMES`; of water the part from below its surface."""
    return np.interp(np.asarray(wavelength_um, dtype=np.float64), *_SPECTRA[material])
