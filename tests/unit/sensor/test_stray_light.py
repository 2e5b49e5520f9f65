"""The veil of a Sun outside the image against the given transmittance, and how it goes on from a Sun inside."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.earth.spectral import sunlight
from horizonval.geometry.camera import CameraModel, pixel_grid, pixel_solid_angle, unproject
from horizonval.sensor.lens import image_plane, scatter, stray_light
from horizonval.sensor.lens.stray_light import Sun
from horizonval.spec.camera import Band
from horizonval.spec.optics import Optics, Scatter, Stray

CAMERA = CameraModel(width=121, height=121, fx=104.8, fy=104.8, cx=60.0, cy=60.0)  # 60 deg
BAND = Band(name="vis", kind="solar", lo_um=0.5, hi_um=0.6)
RADIUS = math.asin(sunlight.SOLAR_RADIUS_M / sunlight.ASTRONOMICAL_UNIT_M)
PITCH = 5e-6
TABLE = {"angle_deg": [30.0, 40.0, 60.0, 85.0], "pst": [1e-3, 1e-5, 3e-7, 1e-8]}


def sun_at(angle_deg: float, visible: float = 1.0) -> Sun:
    """Return the Sun to the right of the boresight."""
    angle = math.radians(angle_deg)
    return Sun((math.sin(angle), 0.0, math.cos(angle)), RADIUS, visible)


def veil(angle_deg: float, stray: dict[str, object] | None = None, visible: float = 1.0) -> np.ndarray:
    """Return the power on the pixels of a scene that is dark but for the Sun outside."""
    lens = Optics(f_number=2.0, stray=Stray.model_validate(stray or TABLE))
    dark = np.zeros((121, 121))
    return image_plane.pixel_power_w(dark, CAMERA, lens, PITCH, BAND, sun_at(angle_deg, visible))


def test_both_kinds_of_detector_get_the_same_veil():
    lens = Optics(f_number=2.0, transmission=0.8, stray=Stray.model_validate(TABLE))
    uniform = np.full((121, 121), 3.0)
    power = image_plane.pixel_power_w(uniform, CAMERA, lens, PITCH, BAND, sun_at(45))
    signal = image_plane.radiance_on_axis(uniform, CAMERA, lens, PITCH, BAND, sun_at(45))
    # P = pi tau L p^2 / (4 N^2)
    np.testing.assert_allclose(power, signal * math.pi * 0.8 * PITCH**2 / 16, rtol=1e-12)


def test_no_veil_from_a_sun_inside_and_part_of_it_on_the_border():
    assert not veil(0.0).any()
    assert not veil(29.0).any()
    edge = math.degrees(math.atan(60.5 / 104.8))
    half, all_of_it = veil(edge)[0, 0], veil(edge + 0.3)[0, 0]
    # The table falls by a tenth over 0.3 deg; the share is counted on 2048 points.
    assert half / all_of_it == pytest.approx(0.5 * 10 ** (0.3 / 5), rel=0.02)


def test_share_outside_is_a_segment_of_the_disc():
    edge = math.degrees(math.atan(60.5 / 104.8))
    radius_deg = math.degrees(RADIUS)
    for inside in (-0.6, -0.2, 0.3, 0.8):
        share, middle = stray_light.outside_image(CAMERA, sun_at(edge - inside * radius_deg))
        segment = (math.acos(inside) - inside * math.sqrt(1 - inside**2)) / math.pi
        assert share == pytest.approx(segment, abs=3e-3)
        assert math.degrees(math.atan2(middle[0], middle[2])) > edge


def test_irradiance_is_weighted_as_the_band_counts():
    """Against plain sums over the spectrum's table; at half the distance four times as much."""
    wavelength = np.linspace(0.4, 0.9, 500001)
    band = Band(name="a", kind="solar", wavelength_um=[0.4, 0.6, 0.9], response=[0.0, 0.5, 0.2])
    response = np.interp(wavelength, [0.4, 0.6, 0.9], [0.0, 1.0, 0.4])
    mean = np.sum(response * wavelength) / response.sum()
    spectrum = sunlight.irradiance(wavelength)
    exact = np.trapezoid(response * wavelength / mean * spectrum, wavelength)
    assert stray_light.band_irradiance(band, RADIUS) == pytest.approx(exact, rel=1e-5)
    thermal = Band(name="b", kind="thermal", lo_um=8, hi_um=12)
    assert stray_light.band_irradiance(thermal, RADIUS) == pytest.approx(sunlight.band_irradiance(8, 12), rel=1e-5)
    near = math.asin(2 * math.sin(RADIUS))
    assert stray_light.band_irradiance(band, near) == pytest.approx(4 * exact, rel=1e-5)


SCATTERING = Optics(f_number=2.0, transmission=0.8, scatter=Scatter(tis=0.01, l_rad=0.01, s=-2.0))


def sun_image(angle_deg: float) -> np.ndarray:
    """Return the power on the pixels of the Sun alone, drawn by its disc's share of every pixel, and scattered."""
    sun = sun_at(angle_deg)
    fine = (np.arange(16) - 7.5) / 16
    share = np.zeros((121, 121))
    # Only the middle rows have Sun.
    rows = slice(57, 64)
    uv = pixel_grid(CAMERA)[rows, :, None, None, :] + np.stack(np.meshgrid(fine, fine), axis=-1)
    cosine = unproject(CAMERA, uv) @ np.array(sun.direction_cam)
    share[rows] = (cosine > math.cos(RADIUS)).mean(axis=(2, 3))
    radiance = share * stray_light.band_irradiance(BAND, RADIUS) / (math.pi * RADIUS**2)
    return image_plane.pixel_power_w(radiance, CAMERA, SCATTERING, PITCH, BAND, sun)


@pytest.mark.parametrize("angle_deg", [32.0, 45.0, 60.0])
def test_wings_of_a_sun_outside_are_the_level_a_table_joins(angle_deg):
    power = sun_image(angle_deg)
    # PST = tau pi / (4 N^2) cos(theta) K(tan theta) (f / pitch)^2
    angle = math.radians(angle_deg)
    share = scatter.image_share(SCATTERING.scatter, np.array(math.tan(angle) ** 2))
    level = 0.8 * math.pi / (4 * 2.0**2) * math.cos(angle) * float(share)
    irradiance = stray_light.band_irradiance(BAND, RADIUS)
    assert power[60, 60] / PITCH**2 == pytest.approx(level * irradiance, rel=3e-5)
    assert power[60, 120] > power[60, 0] > 0


def test_scattered_level_of_a_sun_on_the_axis():
    """Scattered radiance behind the lens is ``E BSDF``; a pixel at theta takes it in by ``cos^4``."""
    power = sun_image(0.0)
    level = SCATTERING.scatter
    angle = math.atan(50 / 104.8)
    exact = stray_light.band_irradiance(BAND, RADIUS) * level.level / (1 + (math.sin(angle) / 0.01) ** 2)
    exact *= math.pi * 0.8 * PITCH**2 / 16 * math.cos(angle) ** 4
    # The disc's own size and its drawing on 16 x 16 points per pixel: 2 %.
    assert power[60, 110] == pytest.approx(exact, rel=0.02)
    assert pixel_solid_angle(CAMERA)[60, 60] == pytest.approx(104.8**-2)


@pytest.mark.parametrize(("angle_deg", "pst"), [(30.5, 3e-5), (31.0, 1e-3), (45.0, 1e-9), (70.0, 1e-6)])
def test_a_table_sets_the_level_and_the_wings_their_shape(angle_deg, pst):
    """The middle of the image has the table's level; the halo of the Sun is left, dimmed where the table is low."""
    lens = SCATTERING.model_copy(update={"stray": Stray(angle_deg=[angle_deg], pst=[pst])})
    dark = np.zeros((121, 121))
    power = image_plane.pixel_power_w(dark, CAMERA, lens, PITCH, BAND, sun_at(angle_deg))
    wings = image_plane.pixel_power_w(dark, CAMERA, SCATTERING, PITCH, BAND, sun_at(angle_deg))
    level = pst * stray_light.band_irradiance(BAND, RADIUS) * PITCH**2
    assert power[60, 60] == pytest.approx(level, rel=1e-9)
    dimmed = min(1.0, level / wings[60, 60])
    np.testing.assert_allclose(power - power[60, 60], dimmed * (wings - wings[60, 60]), atol=1e-9 * power.max())
    assert power[60, 120] > power[60, 60]
