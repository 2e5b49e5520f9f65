"""The stages of visible arrays, each against its formula, switched on and off."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from synthetic import CMOS

from horizonval.geometry.camera import CameraModel
from horizonval.sensor import motion
from horizonval.sensor.detector import exposure, fixed_pattern
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import AutoExposure

BENCH: dict[str, Any] = {
    "camera": {"name": "bench", "width": 128, "height": 96, "fov_deg": 0.1},
    "optics": {"f_number": 4.0, "transmission": 0.8},
    "band": [{"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6}],
    "detector": CMOS
    | {"exposure_s": 1e-3, "full_well_e": 60000, "read_noise_e": 2, "bits": 14, "black_level_dn": 100}
    | {"gain_e_per_dn": 4.0},
}


def bench(**detector: Any) -> dict[str, Any]:
    """Return the bench camera with other detector keys; None leaves a key out."""
    keys = {k: v for k, v in (BENCH["detector"] | detector).items() if v is not None}
    return BENCH | {"detector": keys}


@pytest.fixture
def shoot(make_frame):
    """Observe a scene with the bench camera; return electrons as the numbers stand for them."""

    def run(radiance: Any, *, seed: int = 0, noise: bool = True, truth: Any = None, **detector: Any) -> np.ndarray:
        tables = bench(**detector)
        frame = make_frame(radiance, tables, **(truth or {}))
        spec = CameraSpec.model_validate(tables)
        assert spec.detector is not None
        image = observe(frame, spec, seed=seed, noise=noise)
        gain = image.observation["gain_e_per_dn"]
        return (image.dn.astype(float) - tables["detector"]["black_level_dn"]) * gain

    return run


@pytest.mark.parametrize(
    "keys",
    [
        {"temperature_c": -10.0},
        {"temperature_c": -300.0, "dark_reference_c": 20.0},
        {"row_time_s": 1e-5},
        {"shutter": "rolling"},
        {"bits": 16, "gain_e_per_dn": None, "full_well_e": 13500},
        {"gain_e_per_dn": 500.0},
        {"black_level_dn": 16383.0},
        {"temperature_c": 20.0, "dark_reference_c": 20.0, "dark_doubling_k": 0.01},
        {"read_noise_e": -1.0},
        {"bayer": "RGBG"},
        {"auto_exposure": {"min_s": 1.0, "max_s": 0.1}},
    ],
)
def test_contradictions_are_refused(keys):
    with pytest.raises(ValidationError, match="|".join(keys)):
        CameraSpec.model_validate(bench(**keys))


def test_keys_left_alone_leave_no_trace():
    """Archives rest on it: a file without the later keys is the same plain data as before there were any."""
    detector = CameraSpec.model_validate(BENCH).model_dump(mode="json")["detector"]
    assert set(detector) == set(BENCH["detector"]) | {"dark_current_e_per_s"}


def test_a_unit_keeps_its_pattern_and_another_serial_number_has_another(shoot):
    """Patterns of 2 % over 12 288 pixels under other noise: a correlation of nothing has a standard error of 0.009."""
    units = ({}, {}, {"serial": 1})
    first, again, other = (shoot(20.0, seed=k, prnu=0.02, **unit).ravel() for k, unit in enumerate(units))
    assert first.mean() > 5000
    assert np.corrcoef(first, again)[0, 1] > 0.5
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.05


def test_hot_pixels(shoot):
    """Their share and their mean; without noise there are none."""
    keys = {"hot_pixel_fraction": 0.02, "hot_pixel_e_per_s": 2e6, "dark_current_e_per_s": 0.0}
    image = shoot(0.0, **keys)
    current = fixed_pattern.hot_dark_current("bench", 0, (96, 128), 0.02, 2e6)
    hot = current > 0
    assert hot.mean() == pytest.approx(0.02, abs=0.0064)  # 5 standard errors of 12 288 draws
    # one in e^5 is below 10 e-
    np.testing.assert_allclose(image[hot].mean(), (current[hot] * 1e-3).mean(), rtol=0.02)
    assert np.abs(image[~hot]).max() < 20
    assert shoot(0.0, noise=False, **keys).max() == 0.0


def test_smear_in_an_image(shoot):
    """A bright spot leaves its row time over exposure in every pixel of its column, nothing beside it."""
    scene = np.zeros((96, 128))
    scene[20:24, 50] = 100.0
    keys = {"noise": False, "full_well_e": 1e6, "gain_e_per_dn": 61.0}
    sharp = shoot(scene, **keys)
    smeared = shoot(scene, shutter="frame_transfer", row_time_s=1e-5, **keys)
    bright = sharp[21, 50]
    assert bright > 20_000
    # 4 rows times row time over exposure; each number is rounded to 61 e-
    assert smeared[80, 50] == pytest.approx(4 * bright * 1e-2, abs=65)
    assert smeared[:, 49].max() == sharp[:, 49].max() == 0.0


def test_automatic_exposure():
    rule = AutoExposure(target=0.5, percentile=90.0, min_s=1e-4, max_s=1e-1)
    rate = np.concatenate([np.full(95, 1e6), np.full(5, 1e12)])
    assert exposure.exposure_s(rate, 10_000.0, rule) == pytest.approx(5e-3)
    assert exposure.exposure_s(rate * 1e6, 10_000.0, rule) == 1e-4
    assert exposure.exposure_s(rate * 0.0, 10_000.0, rule) == 1e-1


def test_a_camera_with_automatic_exposure_says_what_it_chose(make_frame):
    tables = bench(auto_exposure={"target": 0.5, "percentile": 50.0, "min_s": 1e-6, "max_s": 1.0})
    spec = CameraSpec.model_validate(tables)
    for radiance in (0.5, 50.0):
        image = observe(make_frame(radiance, tables), spec)
        assert image.dn.mean() == pytest.approx(100 + 0.5 * 60000 / 4, rel=0.002)
        assert image.observation["exposure_s"] * radiance == pytest.approx(
            observe(make_frame(1.0, tables), spec).observation["exposure_s"], rel=1e-9
        )


def test_a_colour_camera_observes_each_band(make_frame):
    tables = bench(bayer="RGGB", read_noise_e=0.0) | {
        "band": [
            {"name": "red", "kind": "solar", "lo_um": 0.6, "hi_um": 0.7},
            {"name": "green", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6},
            {"name": "blue", "kind": "solar", "lo_um": 0.4, "hi_um": 0.5},
        ]
    }
    spec = CameraSpec.model_validate(tables)
    frame = make_frame({"red": 10.0, "green": 20.0, "blue": 5.0}, tables)
    means = {b: observe(frame, spec, band=b, noise=False).dn.mean() - 100 for b in ("red", "green", "blue")}
    # electrons go with radiance times wavelength; numbers are rounded to whole ones
    assert means["red"] / means["green"] == pytest.approx(10 * 0.65 / (20 * 0.55), abs=2e-3)
    assert means["blue"] / means["green"] == pytest.approx(5 * 0.45 / (20 * 0.55), abs=2e-3)


def test_a_mosaic_wants_three_colours_and_a_whole_cell():
    with pytest.raises(ValidationError, match=r'bayer = "RGGB" takes three bands .* the camera has \[\'vis\'\]'):
        CameraSpec.model_validate(bench(bayer="RGGB"))
    colours = [{"name": c, "kind": "solar", "lo_um": 0.5, "hi_um": 0.6} for c in ("red", "green", "blue")]
    line = bench(bayer="RGGB") | {"band": colours, "camera": BENCH["camera"] | {"height": 1}}
    with pytest.raises(ValidationError, match=r"needs 2 x 2 pixels at least, the camera has width = 128, height = 1"):
        CameraSpec.model_validate(line)


WIDE = CameraModel(width=160, height=120, fx=200.0, fy=200.0, cx=79.5, cy=59.5)


def spot(place: np.ndarray) -> np.ndarray:
    """Return a smooth spot of 4 px, centred on a pixel position (column, row)."""
    y, x = np.mgrid[0 : WIDE.height, 0 : WIDE.width].astype(float)
    return np.exp(-0.5 * ((x - place[0]) ** 2 + (y - place[1]) ** 2) / 16.0)


def test_a_camera_at_rest_is_left_alone(make_truth):
    image = spot(np.array([50.0, 50.0]))
    assert motion.blur_by_motion(image, WIDE, np.zeros(3), 1.0, 1e-3) is image
    truth = make_truth()
    assert not motion.rate_cam_rad_s(truth).any()


def test_a_body_held_inertially_turns_at_the_orbital_rate(make_truth):
    """500 km above 6371 km: a turn in 94.47 minutes, 2 pi sqrt(r^3 / GM), about lvlh's y axis, pitch up."""
    scene = {"attitude": {"hold": "inertial"}}
    rate = motion.rate_cam_rad_s(make_truth(scene=scene))
    assert 2 * math.pi / np.linalg.norm(rate) / 60 == pytest.approx(94.47, abs=0.01)
    truth = make_truth(scene=scene, q_body_from_lvlh=(0.0, 0.0, 0.0, 1.0))
    np.testing.assert_allclose(motion.rate_cam_rad_s(truth)[[0, 2]], 0.0, atol=1e-15)
    assert motion.rate_cam_rad_s(truth)[1] > 0


def test_turning_cameras_blur_images(shoot):
    scene = np.zeros((96, 128))
    scene[:, 64:] = 20.0
    still = shoot(scene, noise=False)
    turning = shoot(scene, noise=False, truth={"scene": {"attitude": {"rate_deg_s": [0.0, 5.0, 0.0]}}})
    edge = np.flatnonzero((turning[48] > 100) & (turning[48] < turning[48].max() - 100))
    # 5 deg/s for 1 ms at 1280 px per degree: 6.4 px
    assert 5 <= len(edge) <= 8
    assert np.abs(turning[48] - still[48]).max() > 1000


def test_protons_over_the_anomaly_only(shoot):
    keys = {"radiation": {"flux_per_cm2_s": 1e6}, "exposure_s": 1e-2, "read_noise_e": 0.0}
    r = 6871008.8
    lat, lon = math.radians(-26), math.radians(-49)
    inside = {"r_itrs": (r * math.cos(lat) * math.cos(lon), r * math.cos(lat) * math.sin(lon), r * math.sin(lat))}
    hit = shoot(0.0, truth=inside, **keys)
    clear = shoot(0.0, **keys)
    assert (hit > 100).sum() > 10
    assert clear.max() <= 4.0
    assert shoot(0.0, truth=inside, noise=False, **keys).max() <= 4.0
