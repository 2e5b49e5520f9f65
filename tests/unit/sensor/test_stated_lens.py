"""What an estimator is told of a lens, and what that is worth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import constants

import horizonval as hv
from horizonval.estimation.methods.limb_profile import ESTIMATOR
from horizonval.estimation.observation import Fit, Observation
from horizonval.frame import DetectorImage
from horizonval.report.viewer import heat_of
from horizonval.sensor.expected_image import black_level_dn, radiance_per_dn, stated_lens
from horizonval.spec.load import load_camera
from horizonval.suites.observation import observation_of


def test_it_is_what_the_file_says() -> None:
    """550 nm or so at f/4 on pixels of 5.5 um; 0.6 px in the middle, 1.1 at 40 deg, whose root mean square is 0.886."""
    camera = load_camera("vis-cmos-1024-60deg-full")
    lens = stated_lens(camera, camera.band[0])
    assert lens.diffraction_px == pytest.approx(0.6 * 4.0 / 5.5, rel=0.03)
    np.testing.assert_allclose(lens.angles_rad, np.radians([0.0, 40.0]))
    np.testing.assert_allclose(lens.ratios, np.array([0.6, 1.1]) / 0.886, rtol=1e-3)
    assert lens.in_wider_pixels(4).diffraction_px == lens.diffraction_px / 4
    np.testing.assert_allclose(lens.shares(np.radians([10.0, 50.0])), [[0.75, 0.0], [0.25, 1.0]])


def test_a_plain_lens_and_one_without_pixels() -> None:
    camera = load_camera("vis-cmos-512-60deg")
    assert stated_lens(camera, camera.band[0]).blur_px == 0.7
    unstated = camera.optics.model_copy(update={"psf_sigma_px": 0.0})
    assert stated_lens(camera.model_copy(update={"optics": unstated}), camera.band[0]) is None
    camera = load_camera("vis-cmos-1024-60deg-full").model_copy(update={"detector": None})
    lens = stated_lens(camera, camera.band[0])
    assert lens.diffraction_px == 0.0


SCENE = """[camera]
file = "vis-cmos-1024-60deg-full"
mount_yaw_deg = 90.0
mount_roll_deg = 75.0
[camera.camera]
width = 256
height = 256
fov_deg = 90.0
[platform]
altitude_km = 500.0
heading_deg = 90.0
epoch_utc = 2026-03-20T12:00:00Z
[sun]
zenith_deg = 55.0
azimuth_deg = 110.0
[atmosphere]
profile = "us_standard"
[render]
subsamples = 4
nodes = 64
[prior]
position_sigma_km = 1.0
attitude_sigma_deg = [2.0, 2.0, 2.0]
climate = "by_latitude_month"
"""


@pytest.fixture(scope="module")
def frame(tmp_path_factory: pytest.TempPathFactory) -> hv.Frame:
    """A limb by day through every stage of lens and detector."""
    path = tmp_path_factory.mktemp("lens") / "scene.toml"
    path.write_text(SCENE)
    return hv.render(path)


@pytest.mark.slow
def test_a_profile_seen_through_all_of_a_lens(frame: hv.Frame) -> None:
    """Within three of its sigmas; told nothing of the lens the fit has no answer, or claims half as much more."""
    image = frame.observe(seed=1)
    seen = observation_of(image, ESTIMATOR)
    assert seen.lens is not None
    known = _error_and_claim(seen, image)
    error, claimed = known
    assert claimed < np.radians(180.0 / 3600.0)
    assert error < 3.0 * claimed
    without = _error_and_claim(replace(seen, lens=None), image)
    assert without is None or without[1] > 1.5 * claimed


def _error_and_claim(seen: Observation, image: hv.Image) -> tuple[float, float] | None:
    result = ESTIMATOR.run(seen)
    if not isinstance(result, Fit):
        return None
    cosine = float(result.nadir_cam @ np.array(image.truth.nadir_geocentric_cam))
    return float(np.arccos(min(cosine, 1.0))), float(np.sqrt(np.trace(result.total_covariance_nadir_cam)))


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
