"""A photon counting detector's numbers as radiances, against the light that makes the electrons, worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import constants

from horizonval.frame import DetectorImage
from horizonval.report.viewer import heat_of
from horizonval.sensor.expected_image import black_level_dn, radiance_per_dn


def test_a_number_is_the_radiance_that_fills_it(make_truth, camera_tables):
    truth = make_truth(camera_tables)
    image = DetectorImage(np.zeros((30, 40), np.uint16), "vis", truth, 1023, {"camera": camera_tables})
    # 5.5 um pixels behind f/4: solid angle of the pupil from the image, over the pixel's area.
    focal_m = 20.0 / math.tan(math.radians(30.0)) * 5.5e-6
    pupil_m2 = math.pi / 4 * (focal_m / 4.0) ** 2
    watts = pupil_m2 * (5.5e-6 / focal_m) ** 2 * 0.8
    photon_j = constants.h * constants.c / 0.6e-6
    electrons_per_radiance = watts * 2e-4 / photon_j * 0.6
    dn_per_electron = (1023 - 32) / 13500
    assert radiance_per_dn(image) == pytest.approx(1.0 / (electrons_per_radiance * dn_per_electron), rel=1e-3)
    assert black_level_dn(image) == 32
    heat = heat_of(image)
    assert heat["zero"] + heat["step"] * 32 == pytest.approx(0.0, abs=1e-12)
    assert heat["width_um"] == pytest.approx(0.3)
    assert heat["temperature_k"] is None


def test_what_does_not_tell_has_none(make_truth):
    image = DetectorImage(np.zeros((30, 40), np.uint16), "vis", make_truth(), 1023)
    assert radiance_per_dn(image) is None
    assert black_level_dn(image) == 0.0
    assert heat_of(replace(image)) is None
