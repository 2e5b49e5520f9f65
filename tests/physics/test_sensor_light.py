"""The lens against direct sums, closed forms and the exact theory of a defocused pupil; none of it shares its code."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import constants, integrate
from scipy.special import j0, j1

from horizonval.geometry.camera import CameraModel
from horizonval.sensor.lens import lens_spread
from horizonval.sensor.lens.stray_light import band_irradiance
from horizonval.sensor.observe import observe
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.optics import Optics

NARROW = Band(name="line", kind="thermal", lo_um=0.5499, hi_um=0.5501)
SIGMA, TIS, L_RAD, S = 0.8, 0.03, 0.004, -1.7


def own_wings(rows: int, columns: int, focal_px: float) -> np.ndarray:
    """Scattered share per pixel at all offsets: Harvey and Shack's form summed over 16 x 16 points of each pixel."""
    total = (
        2 * math.pi * integrate.quad(lambda x: (1 + (x / L_RAD) ** 2) ** (S / 2) * x, 0, 1, limit=400, points=[0.01])[0]
    )
    node, weight = np.polynomial.legendre.leggauss(16)
    y = (np.arange(-rows + 1, rows)[:, None] + node / 2).ravel() / focal_px
    x = (np.arange(-columns + 1, columns)[:, None] + node / 2).ravel() / focal_px
    rho2 = y[:, None] ** 2 + x[None, :] ** 2
    share = TIS / total * (1 + rho2 / (1 + rho2) / L_RAD**2) ** (S / 2) / (1 + rho2) ** 2 / focal_px**2
    blocks = share.reshape(2 * rows - 1, 16, 2 * columns - 1, 16)
    return np.einsum("iajb,a,b->ij", blocks, weight / 2, weight / 2)


def test_spread_against_a_direct_sum_with_the_sun_at_1e9():
    """Core and wings of every pixel added one by one; dark outside, the Sun in a corner, a limb of 1."""
    rows, columns, focal = 29, 37, 800.0
    rng = np.random.default_rng(3)
    image = np.where(np.arange(rows)[:, None] > 15, 1.0, 0.05) * rng.uniform(0.5, 1.0, (rows, columns))
    image[2, 3] = 1e9
    y, x = np.arange(-rows + 1, rows)[:, None], np.arange(-columns + 1, columns)[None, :]
    core = np.exp(-(x**2 + y**2) / (2 * SIGMA**2))
    core /= core.sum()
    wings = own_wings(rows, columns, focal)
    kernel = (1 - TIS) * core + wings
    expected, lost = np.zeros_like(image), 0.0
    for row in range(rows):
        for column in range(columns):
            part = kernel[rows - 1 - row : 2 * rows - 1 - row, columns - 1 - column : 2 * columns - 1 - column]
            expected += image[row, column] * part
            lost += image[row, column] * (1 - part.sum())
    camera = CameraModel(columns, rows, focal, focal, (columns - 1) / 2, (rows - 1) / 2)
    lens = Optics.model_validate({"psf_sigma_px": SIGMA, "scatter": {"tis": TIS, "l_rad": L_RAD, "s": S}})
    out = lens_spread.spread(image, camera, lens, border="dark")
    assert out.min() >= 0
    # the product takes the pixel's centre for its mean from 8 px on: 1e-3; nothing came round into the far corner
    np.testing.assert_allclose(out, expected, rtol=1e-3)
    assert (out.sum() + lost) / image.sum() == pytest.approx(1, abs=1e-6)
    bookkeeping = (lens_spread.lost_share(camera, lens) * image).sum()
    assert (out.sum() + bookkeeping) / image.sum() == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("f_number", [4.0, 8.0])
def test_encircled_energy_of_the_airy_pattern(f_number):
    """Rayleigh's 1 - J0^2 - J1^2. Pixels of 0.5 um sample lambda N = 2.2 or 4.4 um; its pixels are cut to 1 / 8."""
    pitch = 0.5e-6
    spread = lens_spread.core_spread_px(NARROW, f_number, pitch)
    reach = lens_spread.core_reach_px(0.0, 0.0, spread)
    kernel = lens_spread.core_kernel(0.0, 0.0, NARROW, f_number, pitch, reach)
    fine = (np.arange(8 * (2 * reach + 1)) + 0.5) / 8 - reach - 0.5
    radius = np.hypot(fine[:, None], fine[None, :])
    for rings in (0.5, 1.0, 1.22, 2.233, 3.238, 6.0, 9.0):
        v = math.pi * rings
        expected = 1 - j0(v) ** 2 - j1(v) ** 2
        inside = (radius <= rings * spread).reshape(2 * reach + 1, 8, -1, 8).mean(axis=(1, 3))
        # taking the light as even within a pixel of 0.23 lambda N blunts the peak: 0.013 at half a ring
        assert (kernel * inside).sum() == pytest.approx(expected, abs=0.015)
    # beyond the square: the mean of J0^2 + J1^2 is 2 / (pi v), averaged over the square's angle
    angle = np.linspace(0, math.pi / 4, 2001)
    edge = math.pi * (reach + 0.5) / np.cos(angle) / spread
    assert 1 - kernel.sum() == pytest.approx(np.mean(2 / (math.pi * edge)), rel=0.01)


def exact_modulation(waves: float, s: float) -> float:
    """Overlap of two sheared pupils with the phase 2 pi W r^2 (Hopkins 1955), by adding points."""
    side = np.linspace(-1, 1, 1201)
    x, y = np.meshgrid(side, side)
    both = ((x - s) ** 2 + y**2 <= 1) & ((x + s) ** 2 + y**2 <= 1)
    phase = 2 * math.pi * waves * ((x + s) ** 2 - (x - s) ** 2)
    return float(np.cos(phase[both]).sum() / (x**2 + y**2 <= 1).sum())


@pytest.mark.parametrize(("waves", "tolerance"), [(0.0, 0.005), (0.1, 0.07), (3.0, 0.06), (5.0, 0.04)])
def test_defocused_modulation_against_the_exact_theory(waves, tolerance):
    """Modulation of the kernel on pixels of lambda N / 4, where the geometric disc is said to hold."""
    f_number, wavelength = 4.0, 0.55e-6
    pitch = wavelength * f_number / 4
    radius = waves * wavelength * 8 * f_number**2 / (2 * f_number) / pitch
    spread = lens_spread.core_spread_px(NARROW, f_number, pitch)
    assert spread == pytest.approx(4.0, rel=1e-3)
    reach = lens_spread.core_reach_px(0.0, radius, spread)
    kernel = lens_spread.core_kernel(0.0, radius, NARROW, f_number, pitch, reach)
    line = kernel.sum(axis=0)
    offset = np.arange(-reach, reach + 1)
    for s in (0.03, 0.08, 0.14, 0.22, 0.4, 0.7):
        frequency = s / spread
        modulation = float(np.sum(line * np.cos(2 * math.pi * frequency * offset)))
        assert modulation == pytest.approx(exact_modulation(waves, s), abs=tolerance + (1 - line.sum()))


STRAY = {"angle_deg": [12.0, 30.0, 50.0, 75.0], "pst": [4e-4, 3e-5, 2e-6, 5e-8], "cutoff_deg": 85.0}
BENCH: dict[str, Any] = {
    "camera": {"name": "bench", "width": 32, "height": 32, "fov_deg": 20.0},
    "optics": {"f_number": 2.0, "transmission": 0.5, "stray": STRAY},
    "band": [{"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6}],
    "detector": {
        "kind": "cmos",
        "pixel_pitch_um": 10.0,
        "exposure_s": 1.0,
        "quantum_efficiency": 0.5,
        "full_well_e": 1e8,
        "read_noise_e": 1,
        "bits": 16,
        "gain_e_per_dn": 1000.0,
    },
}


@pytest.mark.parametrize(
    "angle_deg", [11.0, 12.0, 16.0, 21.0, 30.0, 37.0, 45.0, 50.0, 60.0, 70.0, 80.0, 84.9, 85.1, 90.0]
)
@pytest.mark.parametrize("seen", [1.0, 0.35, 0.0])
def test_stray_light_is_the_given_transmittance_from_radiance_to_numbers(make_frame, angle_deg, seen):
    """E_detector = PST E_Sun seen; the table's logarithm is linear in the angle. Behind the Earth there is none."""
    turn = math.radians(angle_deg)
    sun = (math.sin(turn), 0.0, math.cos(turn))
    expected_log = np.interp(angle_deg, STRAY["angle_deg"], np.log(STRAY["pst"]))
    pst = math.exp(expected_log) if angle_deg < STRAY["cutoff_deg"] else 0.0  # type: ignore[operator]
    spec = CameraSpec.model_validate(BENCH)
    irradiance = band_irradiance(spec.band[0], 0.00465)
    electrons = pst * irradiance * seen * (10e-6) ** 2 * 0.5 * 0.55e-6 / (constants.h * constants.c)
    # a converter whose full scale is 50 000 steps of the answer: 1e-5
    gain = max(electrons / 50000, 1e-6)
    tables = BENCH | {"detector": BENCH["detector"] | {"gain_e_per_dn": gain, "full_well_e": 1e8}}
    frame = make_frame(0.0, tables, sun_cam=sun, sun_visible_fraction=seen)
    dn = observe(frame, CameraSpec.model_validate(tables), noise=False).dn
    assert dn.max() - dn.min() == 0
    assert float(dn[0, 0]) * gain == pytest.approx(electrons, rel=1e-3, abs=1e-3 * gain)


def test_irradiance_of_the_sun_in_the_band():
    """1.85 kW m-2 um-1 at 0.55 um outside the air (ASTM E490: 1.83 to 1.93 between 0.5 and 0.6 um), 0.1 um, 1 au."""
    at_one_au = math.asin(6.957e8 / constants.au)
    assert band_irradiance(Band(name="v", kind="solar", lo_um=0.5, hi_um=0.6), at_one_au) == pytest.approx(
        185.0, rel=0.03
    )


def test_wings_go_on_outside_the_field_as_inside():
    """The Sun on a wide image's pixel, and the same Sun outside a crop of that image, veil the crop alike."""
    wide = CameraModel(201, 41, 300.0, 300.0, 100.0, 20.0)
    lens = Optics.model_validate({"scatter": {"tis": TIS, "l_rad": L_RAD, "s": S}})
    image = np.zeros((41, 201))
    image[20, 150] = 1e9
    inside = lens_spread.spread(image, wide, lens, border="dark")[:, :121]
    crop = replace(wide, width=121)
    outside = 1e9 * lens_spread.wings_of_point(crop, lens, None, None, 150.0, 20.0)
    np.testing.assert_allclose(outside, inside, rtol=2e-3)
