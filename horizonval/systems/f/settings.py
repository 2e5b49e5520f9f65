"""Sizes of the scanner, ours where nothing is printed: round numbers of the size that scanners of the kind have.

*Noise.* A thermistor bolometer of detectivity 2e8 cm Hz^0.5 / W behind 5 cm2 of aperture at f/1 and half of the light:
a field of 1 deg has 3e-4 sr, so that 5 W m-2 sr-1 bring 3.8e-7 W; the flake is 0.44 mm wide (0.0019 cm2), and in the
band ``1 / (4 tau)`` of the electronics, 250 Hz, the noise is ``sqrt(0.0019 * 250) / 2e8 = 3.4e-9 W``: 1 / 110 of the
plateau in one sample. Edges are averaged over 16 turns, 8 s.
"""

from __future__ import annotations

import math

from horizonval.systems.f.electronics import ScannerElectronics
from horizonval.systems.f.scan_cone import ScanCone

ALTITUDE_KM, INCLINATION_DEG = 800.0, 108.0
BANDS = {"carbon dioxide, 14 to 16 um": (14.0, 16.0), "window, 10.5 to 12.5 um": (10.5, 12.5)}
CO2, WINDOW = BANDS
PLACES = 24
HALF_ANGLE_RAD = math.radians(45.0)
BEAM_RAD = math.radians(1.0)
RATE_RAD_S = 2.0 * math.pi * 2.0
DETECTOR_S, AMPLIFIER_S = 2e-3, 1e-3
FRACTION = 0.4
NOISE_SHARE, TURNS = 1.0 / 110.0, 16
LIMB_M = 40e3
PHASE_STEP_RAD = math.radians(0.05)
NODES = 128
DIGITS = 7

CONE = ScanCone.to_the_right(HALF_ANGLE_RAD)
ELECTRONICS = ScannerElectronics(BEAM_RAD, HALF_ANGLE_RAD, RATE_RAD_S, (DETECTOR_S, AMPLIFIER_S))
