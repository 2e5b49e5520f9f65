"""A visible array with everything on, measured as a laboratory measures it, and its parts against other programs.

Photon transfer: EMVA 1288 (release 4.0 linear, chapter 6): two images per level, half the variance of their difference,
gain from its slope against the mean; response non-uniformity (chapter 8) from the spatial variance that grows with the
square of the mean.
"""

from __future__ import annotations

import hashlib
import math
import os
import pickle
import subprocess
import sys
from typing import Any

import cv2
import numpy as np
import pytest
from scipy import constants, ndimage, stats

from horizonval.sensor.detector import bayer, protons, readout
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec

SIZE = 256
GAIN, BLACK, READ_E, DARK_E_PER_S = 4.0, 200.0, 12.0, 2000.0
PRNU, DSNU_E, GHOST, EXPOSURE_S = 0.01, 6.0, 0.004, 1e-3

ALL_ON: dict[str, Any] = {
    "camera": {"name": "bench", "width": SIZE, "height": SIZE, "fov_deg": 0.1},
    "optics": {
        "f_number": 4.0,
        "transmission": 0.8,
        "vignetting_deg": [0.0, 30.0],
        "vignetting": [1.0, 0.5],
        "psf_field_deg": [0.0, 10.0],
        "psf_field_sigma_px": [0.7, 1.4],
        "diffraction": True,
        "defocus_um": 10.0,
        "scatter": {"tis": 0.02, "l_rad": 0.005, "s": -1.8},
        "stray": {"angle_deg": [5.0, 60.0], "pst": [1e-9, 1e-12]},
        "ghost": [{"ratio": GHOST, "scale": -1.0, "blur_px": 2.0}],
    },
    "band": [{"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6}],
    "detector": {
        "kind": "cmos",
        "pixel_pitch_um": 5.5,
        "exposure_s": EXPOSURE_S,
        "quantum_efficiency": 0.6,
        "full_well_e": 60000,
        "read_noise_e": READ_E,
        "dark_current_e_per_s": DARK_E_PER_S,
        "bits": 14,
        "black_level_dn": BLACK,
        "gain_e_per_dn": GAIN,
        "temperature_c": 38.0,
        "dark_reference_c": 22.0,
        "dark_doubling_k": 8.0,
        "prnu": PRNU,
        "dsnu_e": DSNU_E,
        "hot_pixel_fraction": 1e-3,
        "hot_pixel_e_per_s": 1e4,
        "blooming": "column",
        "shutter": "rolling",
        "row_time_s": 1e-5,
        "radiation": {"flux_per_cm2_s": 10.0},
    },
}
# Two doublings of the dark current, and the hot pixels' mean.
DARK_E = 4 * EXPOSURE_S * (DARK_E_PER_S + 1e-3 * 1e4)
ELECTRONS = np.geomspace(30.0, 45000.0, 12)
TURNING = {"scene": {"attitude": {"rate_deg_s": [1.0, 2.0, 3.0]}}}


def radiance_for(electrons: float) -> float:
    """Radiance for photoelectrons by hand: E = pi tau L p^2 / (4 N^2) t QE lambda / (h c), and the ghost's share."""
    per_radiance = math.pi * 0.8 * (5.5e-6) ** 2 / (4 * 4.0**2) * EXPOSURE_S * 0.6 * 0.55e-6
    return electrons / (per_radiance / (constants.h * constants.c) * (1 + GHOST))


@pytest.fixture
def shoot(make_frame):
    def run(electrons: float, seed: int) -> np.ndarray:
        frame = make_frame(radiance_for(electrons), ALL_ON, **TURNING)
        return observe(frame, CameraSpec.model_validate(ALL_ON), seed=seed).dn.astype(float)

    return run


def test_photon_transfer_of_a_camera_with_everything_on(shoot):
    """65 536 pixels: a variance has a standard error of 0.55 %, twelve of them some 0.2 %."""
    dark_a, dark_b = shoot(0.0, 100), shoot(0.0, 101)
    dark_mean, dark_var = (dark_a.mean() + dark_b.mean()) / 2, (dark_a - dark_b).var() / 2
    # the hot pixels' own scatter: 65 of them, exponential with 40 e
    assert dark_mean == pytest.approx(BLACK + DARK_E / GAIN, abs=0.05)
    assert dark_var == pytest.approx((READ_E**2 + DARK_E) / GAIN**2 + 1 / 12, rel=0.03)
    means, temporal, spatial = [], [], []
    for i, electrons in enumerate(ELECTRONS):
        a, b = shoot(electrons, 2 * i), shoot(electrons, 2 * i + 1)
        difference = (a - b).var() / 2
        means.append((a.mean() + b.mean()) / 2 - dark_mean)
        temporal.append(difference - dark_var)
        # a and b have the same pattern: their covariance is free of all noise in time
        spatial.append(float(np.mean((a - a.mean()) * (b - b.mean()))))
        # EMVA's PRNU of a unit is centred within its standard error 1 % / 256
        assert means[-1] == pytest.approx(electrons / GAIN, rel=1e-3, abs=0.1)
        assert difference == pytest.approx((electrons + DARK_E + READ_E**2) / GAIN**2 + 1 / 12, rel=0.025)
    mean, variance = np.array(means), np.array(temporal)
    # least squares, each variance as good as its size: sqrt(2 / 65536) of the whole of it
    weight = (variance + dark_var) ** -2
    gain = np.sum(weight * mean**2) / np.sum(weight * mean * variance)
    assert gain == pytest.approx(GAIN, rel=0.01)
    # the quadratic term; at the top level its share of the spatial variance is 99.9 %
    prnu = math.sqrt(np.polyfit(mean**2, spatial, 1)[0])
    assert prnu == pytest.approx(PRNU, rel=0.015)


def test_noise_is_white_and_of_the_right_variance_in_every_pixel(make_frame):
    """64 images of a slope: each pixel's sample variance is chi-squared with 63 degrees of freedom."""
    tables = ALL_ON | {"camera": ALL_ON["camera"] | {"width": 48, "height": 40}}
    tables["detector"] = ALL_ON["detector"] | {"hot_pixel_fraction": 0.0}
    tables["optics"] = {"f_number": 4.0, "transmission": 0.8}
    slope = radiance_for(20000.0) * (1 + GHOST) * np.linspace(0.1, 1.0, 48)[None, :] * np.ones((40, 1))
    frame, spec = make_frame(slope, tables), CameraSpec.model_validate(tables)
    dn = np.stack([observe(frame, spec, seed=s).dn for s in range(64)]).astype(float)
    electrons = (dn.mean(axis=0) - BLACK) * GAIN - 4 * EXPOSURE_S * DARK_E_PER_S
    # photons of the pixel's own response, dark electrons (DSNU is no charge: it brings no shot noise), amplifier, steps
    expected = (electrons + 4 * EXPOSURE_S * DARK_E_PER_S + READ_E**2) / GAIN**2 + 1 / 12
    ratio = 63 * dn.var(axis=0, ddof=1) / expected
    assert stats.kstest(ratio.ravel(), stats.chi2(63).cdf).pvalue > 1e-4
    noise = (dn - dn.mean(axis=0)) / np.sqrt(expected * 63 / 64)
    # correlation to neighbours in the image up to two pixels away: 64 x 1900 products
    for rows, columns in ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0)):
        product = noise[:, rows:, columns:] * noise[:, : 40 - rows, : 48 - columns]
        assert abs(product.mean()) < 5 / math.sqrt(product.size)
    # between images, whose means were taken off: -1 / 63 each; 2016 pairs of 1920 pixels
    flat = noise.reshape(64, -1)
    pairs = (flat @ flat.T / flat.shape[1])[np.triu_indices(64, 1)] + 1 / 63
    assert np.abs(pairs).max() < 5.5 / math.sqrt(flat.shape[1])


def test_same_bytes_in_another_process(make_frame, tmp_path):
    tables = ALL_ON | {"camera": ALL_ON["camera"] | {"width": 64, "height": 48}}
    tables["detector"] = ALL_ON["detector"] | {"radiation": {"flux_per_cm2_s": 1e7}}
    # over the South Atlantic
    r = 6871008.8 * np.array([math.cos(-0.45) * math.cos(-0.85), math.cos(-0.45) * math.sin(-0.85), math.sin(-0.45)])
    frame = make_frame(None, tables, r_itrs=tuple(r.tolist()), **TURNING)
    path = tmp_path / "frame"
    path.write_bytes(pickle.dumps((frame, tables)))
    code = (
        "import pickle, sys, hashlib\n"
        "from horizonval.sensor.observe import observe\n"
        "from horizonval.spec.camera import CameraSpec\n"
        f"frame, tables = pickle.load(open({str(path)!r}, 'rb'))\n"
        "dn = observe(frame, CameraSpec.model_validate(tables), seed=5).dn\n"
        "print(hashlib.sha256(dn.tobytes()).hexdigest())\n"
    )
    here = observe(frame, CameraSpec.model_validate(tables), seed=5).dn
    assert not np.array_equal(here, observe(frame, CameraSpec.model_validate(tables), seed=6).dn)
    there = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONHASHSEED": "9"},
    )
    assert there.stdout.strip() == hashlib.sha256(here.tobytes()).hexdigest()


OPENCV = {"RGGB": cv2.COLOR_BayerBG2RGB, "BGGR": cv2.COLOR_BayerRG2RGB}
OPENCV |= {"GRBG": cv2.COLOR_BayerGB2RGB, "GBRG": cv2.COLOR_BayerGR2RGB}


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.parametrize("shape", [(48, 64), (47, 63)])
def test_mosaic_against_opencv(pattern, shape):
    """OpenCV's plain demosaicing is the same bilinear one; it copies the border, and rounds."""
    raw = np.random.default_rng(2).integers(0, 60000, shape).astype(np.uint16)
    theirs = cv2.cvtColor(raw, OPENCV[pattern])
    for channel, colour in enumerate("RGB"):
        ours = bayer.plane(raw.astype(float), pattern, colour)
        np.testing.assert_allclose(ours[2:-2, 2:-2], theirs[2:-2, 2:-2, channel], atol=1.0)


def test_smear_against_packets_shifted_row_by_row():
    """Empty packets come in through the far end, integrate, and leave over the rows before them."""
    rng = np.random.default_rng(4)
    rate, row_time, exposure = rng.uniform(0, 1e6, (37, 3)), 2e-6, 1e-3
    rate[20, 1] = 1e9
    packets = np.zeros_like(rate)
    for _ in range(37):
        packets = np.vstack([packets[1:], np.zeros((1, 3))]) + rate * row_time
    # the last step was the dwell in the packet's own row, which belongs to the exposure
    packets += rate * (exposure - row_time)
    storage = np.zeros_like(rate)
    for row in range(37):
        storage[row] = packets[0]
        packets = np.vstack([packets[1:], np.zeros((1, 3))]) + rate * row_time
    ours = rate * exposure + readout.smear_e(rate, row_time)
    np.testing.assert_allclose(ours, storage, rtol=1e-12)


def test_blooming_keeps_charge_and_its_length_is_the_excess_over_the_well():
    held = np.zeros((401, 5))
    held[200, 2] = 101.0 * 1000.0
    bloomed = readout.bloom(held, 1000.0)
    assert bloomed.sum() == pytest.approx(held.sum(), rel=1e-12)
    np.testing.assert_array_equal(np.flatnonzero(bloomed[:, 2]), np.arange(150, 251))
    assert bloomed.max() == 1000.0
    crowded = np.random.default_rng(1).uniform(0.0, 600.0, (400, 50))
    crowded[20:380:40] += 4000.0
    after = readout.bloom(crowded, 1000.0)
    assert after.max() <= 1000.0
    assert (after >= np.minimum(crowded, 1000.0) - 1e-9).all()
    # a row hands some 1600 e each way to neighbours with 700 e of room on average: none reaches the border
    np.testing.assert_allclose(after.sum(axis=0), crowded.sum(axis=0), rtol=1e-12)


def test_a_sun_blooms_with_noise_as_far_as_without(make_frame):
    tables = ALL_ON | {"camera": ALL_ON["camera"] | {"width": 5, "height": 1501}, "optics": {"f_number": 4.0}}
    tables["detector"] = ALL_ON["detector"] | {"hot_pixel_fraction": 0.0, "prnu": 0.0, "dsnu_e": 0.0}
    scene = np.zeros((1501, 5))
    scene[750, 2] = radiance_for(1000 * 60000.0) * 0.8 * (1 + GHOST)
    spec = CameraSpec.model_validate(tables)
    # at 14 bits the full well is not the converter's end: 15200 of 16383
    lengths = [
        int((observe(make_frame(scene, tables), spec, noise=noise).dn[:, 2] > 14000).sum()) for noise in (True, False)
    ]
    assert lengths[1] == pytest.approx(1000, abs=2)
    assert lengths[0] == pytest.approx(lengths[1], abs=3)


def test_protons_rate_directions_and_charge():
    """500 tracks through a thick layer over 4 Mpx: lengths, azimuths and charges of separate streaks."""
    depth, pitch, per_um, shape = 100.0, 5.0, 400.0, (2000, 2000)
    hits = protons.mean_hits(1000.0, shape, pitch, 1.0)
    # half the omnidirectional flux through 1 cm2: J / 4 from each side
    assert hits == pytest.approx(500.0, rel=1e-12)
    image = protons.streaks_e(hits, shape, pitch, depth, per_um, np.random.default_rng(8))
    labels, found = ndimage.label(image > 0, structure=np.ones((3, 3)))
    # Poisson, and the few that cross each other
    assert found == pytest.approx(500, abs=5 * math.sqrt(500))
    boxes = ndimage.find_objects(labels)
    down = np.array([box[0].stop - box[0].start - 1 for box in boxes])
    across = np.array([box[1].stop - box[1].start - 1 for box in boxes])
    length = np.hypot(down, across) * pitch
    # sin^2(theta) is even: P(tan < x) = x^2 / (1 + x^2); whole pixels smear lengths by one in 20 at the median
    assert stats.kstest(length / depth, lambda x: x**2 / (1 + x**2)).statistic < 0.1
    long = length > 50
    # azimuth modulo its mirror images, even over a quarter turn
    assert stats.kstest(np.arctan2(down, across)[long] / (math.pi / 2), "uniform").pvalue > 1e-3
    charges = ndimage.sum(image, labels, np.arange(1, found + 1))
    per_length = charges / np.hypot(length, depth) / per_um
    # log-normal of mean 1 and spread 0.5: its own standard deviation is 0.53
    # 500 tracks: 3.2 % standard error, times four; whole pixels of length add 2 %
    assert np.log(per_length).std() == pytest.approx(0.5, rel=0.15)
    assert per_length.mean() == pytest.approx(1.0, abs=5 * 0.53 / math.sqrt(found))
