"""Steepest place of a soft limb: a profile whose steepest place is known in closed form, along a slanted arc."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.limb.proposals import LimbPoints
from horizonval.estimation.limb.steepest import to_steepest
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.rotation import off_axis_angle

CAMERA = CameraModel(width=256, height=256, fx=222.0, fy=222.0, cx=127.5, cy=127.5)
RHO = math.radians(68.0)
SCALE_PX = 2.0
"""Scale height of the air in pixels: 8 km seen from 500 km are 0.7, from nearer or with a longer lens more."""


def air(nadir: np.ndarray, full: float = 1e9) -> np.ndarray:
    """Light of an exponential layer, 1 - exp(-exp(-x)), x the height over the scale: steepest where x = 0.

    The derivative is tau exp(-tau) with tau = exp(-x), which is largest at tau = 1 (Chapman's layer, 1931).
    """
    x = (off_axis_angle(unproject(CAMERA, pixel_grid(CAMERA)), nadir) - RHO) * CAMERA.fx / SCALE_PX
    return np.minimum(50.0 + 800.0 * -np.expm1(-np.exp(np.clip(-x, -50, 50))), full)


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0])
def test_a_layer_of_air_is_found_at_one_height_all_along(turn_deg):
    off, turn = math.radians(66.0), math.radians(turn_deg)
    nadir = np.array([math.sin(off) * math.sin(turn), math.sin(off) * math.cos(turn), math.cos(off)])
    image = air(nadir)
    found = find_limb(image, CAMERA)
    assert isinstance(found, LimbPoints)
    los, kept = to_steepest(image, CAMERA, found.los_cam, nadir, True)
    assert len(kept) > 0.9 * len(found.los_cam)
    place_px = (off_axis_angle(los, nadir) - RHO) * CAMERA.fx
    # The Gaussian of 1 px draws an asymmetric profile aside, the same everywhere; interpolation leaves hundredths.
    assert abs(place_px.mean()) < 0.35
    assert np.std(place_px) < 0.04


def test_clipping_above_the_steepest_place_hardly_moves_it():
    """Full scale at nine tenths of the ground's level: the steepest place lies at 63 %, 1 - 1/e, well below.

    The clip lies a pixel inside of it, within reach of the Gaussian: a tenth of the scale height is left.
    """
    nadir = np.array([0.0, math.sin(1.15), math.cos(1.15)])
    los = find_limb(air(nadir), CAMERA).los_cam
    plain, _ = to_steepest(air(nadir), CAMERA, los, nadir, True)
    clipped, _ = to_steepest(air(nadir, full=50.0 + 0.9 * 800.0), CAMERA, los, nadir, True)
    moved_px = (off_axis_angle(clipped, nadir).mean() - off_axis_angle(plain, nadir).mean()) * CAMERA.fx
    assert abs(moved_px) < 0.1 * SCALE_PX
