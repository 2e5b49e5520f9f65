"""Light on parts of the spacecraft against closed forms: sunlight, the shine of a uniform Earth, heat, shadows."""

from __future__ import annotations

import math

import numpy as np
import pytest

import horizonval as hv
from horizonval.earth.spectral.planck import black_body_radiance
from horizonval.sensor.lens.stray_light import band_irradiance

ALTITUDE_KM, RADIUS_KM = 500.0, 6371.0
SOLAR = [{"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6}]
THERMAL = [{"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0}]


def _frame(band: list[dict], part: list[dict], size: int = 24, **keywords: object) -> hv.Frame:
    """Return a frame over an airless, evenly white or warm sphere."""
    camera = {"camera": {"name": "square", "width": size, "height": size, "fov_deg": 50.0}, "band": band}
    scene = {
        "altitude_km": ALTITUDE_KM,
        "earth": {"shape": "sphere", "radius_km": RADIUS_KM},
        "atmosphere": {"profile": "none"},
        "surface": {"kind": "uniform", "albedo": 0.3, "emissivity": 1.0},
        "moon": {"enabled": False},
        "render": {"part_samples": 256},
    }
    return hv.render(hv.Scene(camera, part=part, **scene | keywords))


def _sphere_from_plate(tilt_rad: float) -> float:
    """Return the view factor from a small plate to a sphere, ``tilt`` from its normal to the sphere's centre.

    Howell's catalogue of radiation configuration factors, a differential planar element to a sphere.
    """
    h = 1.0 + ALTITUDE_KM / RADIUS_KM
    root = math.sqrt(h * h - 1.0)
    if tilt_rad <= math.acos(1.0 / h) and tilt_rad <= math.pi / 2 - math.asin(1.0 / h):
        return math.cos(tilt_rad) / h**2
    first = 0.5 - math.asin(root / (h * math.sin(tilt_rad))) / math.pi
    second = math.cos(tilt_rad) * math.acos(-root / math.tan(tilt_rad))
    second -= root * math.sqrt(1.0 - (h * math.cos(tilt_rad)) ** 2)
    return first + second / (math.pi * h**2)


@pytest.mark.parametrize("zenith_deg", [0.0, 40.0, 70.0])
def test_a_lambert_panel_in_sunlight(zenith_deg: float) -> None:
    """Seen from above, it sees no Earth: E cos(theta) rho / pi. The Sun's disc is the only noise."""
    panel = {"shape": "panel", "frame": "cam", "width_m": 3.0, "height_m": 3.0, "position_m": [0.0, 0.0, 1.0]}
    frame = _frame(SOLAR, [panel | {"bsdf": {"type": "diffuse", "reflectance": 0.5}}], sun={"zenith_deg": zenith_deg})
    band, truth = frame.truth.camera_spec.band[0], frame.truth
    expected = band_irradiance(band, truth.sun_angular_radius_rad) * math.cos(math.radians(zenith_deg)) * 0.5 / math.pi
    assert (frame.maps["part"] == 1.0).all()
    # single precision, and the mean of the noise below over a sixteenth of 576 pixels
    np.testing.assert_allclose(frame.radiance["vis"].mean(), expected, rtol=1e-4)
    # cos(theta) over half a degree of Sun, from 36 rays
    assert frame.radiance["vis"].std() < 3e-4 * expected


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 60.0, 85.0])
def test_a_panel_over_an_evenly_warm_earth(tilt_deg: float) -> None:
    """Cold and reflecting, seen from below: the Earth's radiance times the view factor, plus the little it emits."""
    panel = {
        "shape": "panel",
        "frame": "cam",
        "width_m": 2.0,
        "height_m": 30.0,
        "position_m": [0.0, 0.0, 1.0],
        "roll_deg": tilt_deg,
        "emissivity": 0.2,
        "temperature_k": 150.0,
    }
    frame = _frame(THERMAL, [panel], attitude={"roll_deg": 180.0}, size=16)
    band = frame.truth.camera_spec.band[0]
    earth = float(black_body_radiance(band, 288.15))
    expected = 0.2 * float(black_body_radiance(band, 150.0)) + 0.8 * earth * _sphere_from_plate(math.radians(tilt_deg))
    covered = frame.maps["part"] == 1.0
    assert covered.sum() > 100
    light = frame.radiance["lwir"][covered]
    # a fourth of the pixels each way has rays
    assert light.mean() == pytest.approx(expected, rel=0.005)
    # noise of single pixels with 256 rays, as the docs say
    assert light.std() < 0.015 * expected


def test_a_panel_in_earthshine_by_sunlight() -> None:
    """A Lambert Earth under the Sun in the zenith, of radiance E A cos(theta) / pi, by a sum over its cap."""
    panel = {"shape": "panel", "frame": "cam", "width_m": 3.0, "height_m": 3.0, "position_m": [0.0, 0.0, 1.0]}
    part = [panel | {"bsdf": {"type": "diffuse", "reflectance": 0.5}}]
    frame = _frame(SOLAR, part, sun={"zenith_deg": 0.0}, attitude={"roll_deg": 180.0}, size=16)
    irradiance = band_irradiance(frame.truth.camera_spec.band[0], frame.truth.sun_angular_radius_rad)
    h = 1.0 + ALTITUDE_KM / RADIUS_KM
    cosine = np.linspace(1.0 / h, 1.0, 200_001)
    distance2 = 1.0 + h * h - 2.0 * h * cosine
    # cos at the plate, cos of emission, cos of the Sun; area 2 pi d(cosine)
    integrand = (h - cosine) * (h * cosine - 1.0) * cosine / distance2**2
    on_plate = 2.0 * math.pi * np.trapezoid(integrand, cosine) * irradiance * 0.3 / math.pi
    assert frame.radiance["vis"].mean() == pytest.approx(on_plate * 0.5 / math.pi, rel=0.003)


def test_parts_throw_shadows_on_each_other() -> None:
    """The Sun behind the camera: a disc half way to a panel darkens what lies behind it, to a border 2 mm wide."""
    white = {"bsdf": {"type": "diffuse", "reflectance": 0.5}, "frame": "cam"}
    panel = white | {"shape": "panel", "width_m": 3.0, "height_m": 3.0, "position_m": [0.0, 0.0, 1.0]}
    disc = {
        "shape": "disc",
        "radius_m": 0.05,
        "position_m": [0.15, 0.0, 0.6],
        "frame": "cam",
        "material": "black_paint",
    }
    frame = _frame(SOLAR, [panel, disc], sun={"zenith_deg": 0.0}, size=200)
    light, focal = frame.radiance["vis"], frame.truth.camera_model.fx
    x = (np.arange(200) - 99.5) / focal
    row = light[99:101].mean(axis=0)
    open_sky = row[np.abs(x + 0.3) < 0.1].mean()
    # the shadow reaches from 0.1 to 0.2, the disc's own image from 0.167 on
    assert row[(x > 0.106) & (x < 0.16)].max() < 0.02 * open_sky
    assert row[(x > 0.05) & (x < 0.094)].min() > 0.99 * open_sky


def test_a_hot_part_emits_and_reflects_nothing_where_it_is_black() -> None:
    disc = {"shape": "disc", "frame": "cam", "radius_m": 2.0, "position_m": [0.0, 0.0, 1.0], "temperature_k": 350.0}
    frame = _frame(THERMAL, [disc | {"emissivity": 1.0}])
    expected = float(black_body_radiance(frame.truth.camera_spec.band[0], 350.0))
    np.testing.assert_allclose(frame.radiance["lwir"], expected, rtol=1e-6)


def test_eclipse_puts_the_sun_out() -> None:
    panel = {"shape": "panel", "frame": "cam", "width_m": 3.0, "height_m": 3.0, "position_m": [0.0, 0.0, 1.0]}
    frame = _frame(SOLAR, [panel], sun={"zenith_deg": 150.0}, night={"sky_background": False, "airglow": False}, size=8)
    assert frame.truth.sun_visible_fraction == 0.0
    assert frame.radiance["vis"].max() == 0.0


def test_a_mirror_shows_the_sun_as_it_is() -> None:
    """A smooth mirror that sends the Sun into the camera: the disc's own radiance, less the mirror's loss."""
    mirror = {"shape": "panel", "frame": "cam", "width_m": 1.0, "height_m": 1.0, "position_m": [0.0, 0.0, 1.0]}
    metal = {"type": "conductor", "material": "none", "specular_reflectance": 0.8}
    camera = {"camera": {"name": "long", "width": 16, "height": 16, "fov_deg": 0.2}, "band": SOLAR}
    scene = hv.Scene(
        camera,
        altitude_km=ALTITUDE_KM,
        atmosphere={"profile": "none"},
        sun={"zenith_deg": 0.0},
        moon={"enabled": False},
        part=[mirror | {"bsdf": metal}],
    )
    frame = hv.render(scene)
    radius = frame.truth.sun_angular_radius_rad
    irradiance = band_irradiance(frame.truth.camera_spec.band[0], radius)
    expected = 0.8 * irradiance / (math.pi * math.sin(radius) ** 2)
    np.testing.assert_allclose(frame.radiance["vis"], expected, rtol=2e-3)


def test_equal_scenes_give_equal_bytes_whatever_was_rendered_before() -> None:
    panel = {"shape": "panel", "frame": "cam", "width_m": 0.6, "height_m": 0.3, "position_m": [0.0, 0.0, 1.0]}
    first, other, again = (
        _frame(SOLAR, [panel], attitude={"roll_deg": roll_deg}).radiance["vis"] for roll_deg in (180.0, 150.0, 180.0)
    )
    assert first.tobytes() == again.tobytes()
    assert first.tobytes() != other.tobytes()
