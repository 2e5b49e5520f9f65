"""The signal at the limb that scoring expects, against the counts of the simulated sensor."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy import constants
from synthetic import CMOS, truth_at

from horizonval.frame import MAP_UNITS, FrameTruth, RadianceFrame
from horizonval.geometry.camera import camera_from_spec
from horizonval.scoring import limits
from horizonval.scoring.horizon_view import HorizonView, horizon_view
from horizonval.scoring.limb_signal import (
    LimbSignal,
    brightest_reflectance,
    ground_and_air,
    limb_reflectance,
    limb_signal,
)
from horizonval.sensor.detector import thermal
from horizonval.sensor.lens import stray_light
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec

ALBEDO = 0.4
BLACK_DN = 60.0
PLAIN: dict[str, Any] = CMOS | {"exposure_s": 6e-5, "read_noise_e": 40.0, "bits": 12}
PLAIN |= {"black_level_dn": BLACK_DN, "gain_e_per_dn": 4.0}
DARK = {"dark_current_e_per_s": 6e6, "temperature_c": 32.0, "dark_reference_c": 20.0, "dark_doubling_k": 6.0}
BAFFLE = {"angle_deg": [20.0, 60.0], "pst": [2.0e-3, 1.0e-3]}
PATCH = 10


def camera(detector: dict[str, Any], **lens: Any) -> dict[str, Any]:
    return {
        "camera": {"name": "vis", "width": 256, "height": 256, "fov_deg": 60.0},
        "optics": {"f_number": 4.0, "transmission": 0.7, **lens},
        "band": [{"name": "vis", "kind": "solar", "lo_um": 0.45, "hi_um": 0.75}],
        "detector": detector,
    }


def seen(
    tables: dict[str, Any], scene: dict[str, Any] | None = None, **pose: Any
) -> tuple[FrameTruth, CameraSpec, HorizonView, LimbSignal]:
    """A limb through the image's middle, of ground without air unless the scene says otherwise."""
    pose = {"roll_deg": 68.0, "sun_zenith_deg": 75.0, "sun_azimuth_deg": 270.0} | pose
    truth = truth_at(tables, **pose)
    bare = {"atmosphere": {"profile": "none"}, "surface": {"albedo": ALBEDO}}
    truth = dataclasses.replace(truth, scene=truth.scene | (bare if scene is None else scene))
    spec, geometry = truth.camera_spec, camera_from_spec(truth.camera_spec.camera)
    view = horizon_view(truth, geometry)
    return truth, spec, view, limb_signal(truth, spec, spec.band[0], geometry, view)


def counts(truth: FrameTruth, spec: CameraSpec, radiance: float, uv: np.ndarray) -> np.ndarray:
    """Electrons that pixels around a place stand for, many draws of a uniform scene."""
    shape = (spec.camera.height, spec.camera.width)
    maps = {name: np.zeros(shape, np.float32) for name in MAP_UNITS}
    frame = RadianceFrame({"vis": np.full(shape, radiance, np.float32)}, maps, truth)
    column, row = (round(float(c)) for c in uv)
    part = slice(row - PATCH, row + PATCH + 1), slice(column - PATCH, column + PATCH + 1)
    gain = PLAIN["gain_e_per_dn"]
    images = [observe(frame, spec, seed=seed).dn[part].astype(float) for seed in range(6)]
    return (np.stack(images) - BLACK_DN) * gain


@pytest.mark.parametrize(
    ("detector", "lens"),
    [
        ({}, {}),
        ({"read_noise_e": 5.0}, {"transmission": 0.9, "f_number": 2.8}),
        (DARK | {"exposure_s": 1.1e-4}, {}),
        ({"prnu": 0.06}, {}),
        ({"dsnu_e": 120.0}, {}),
        ({"read_noise_e": 1.0, "gain_e_per_dn": 4.0, "exposure_s": 2e-6}, {}),
        ({}, {"stray": BAFFLE}),
        ({"prnu": 0.05}, {"stray": BAFFLE}),
    ],
)
def test_signal_noise_and_veil_are_those_of_the_sensor(detector: dict[str, Any], lens: dict[str, Any]) -> None:
    """At the limb's middle in view, with 2600 pixels counted: their deviation is known to 1.5 %, the signal to less."""
    truth, spec, view, signal = seen(camera(PLAIN | detector, **lens))
    where = np.flatnonzero(view.in_view)
    k = where[np.argmin(np.hypot(*(view.uv[where] - 127.5).T))]
    irradiance = stray_light.band_irradiance(spec.band[0], truth.sun_angular_radius_rad)
    lit = counts(truth, spec, ALBEDO * irradiance * view.cos_zenith[k] / math.pi, view.uv[k])
    unlit = counts(truth, spec, 0.0, view.uv[k])
    step = lit.mean() - unlit.mean()
    assert signal.seen[k] == pytest.approx(step / lit.std(), rel=0.06)
    full_e = min(PLAIN["full_well_e"], (4095 - BLACK_DN) * PLAIN["gain_e_per_dn"])
    without = dataclasses.replace(truth, sun_visible_fraction=0.0)
    dark = counts(without, spec, 0.0, view.uv[k])
    veil = unlit.mean() - dark.mean()
    assert signal.veil_filling[k] * full_e == pytest.approx(veil, rel=0.05, abs=4.0)
    assert signal.filling[k] * full_e == pytest.approx(step + veil, rel=0.02, abs=4.0)
    if "stray" in lens:
        assert veil > 0.1 * full_e
        clear = counts(without, spec, ALBEDO * irradiance * view.cos_zenith[k] / math.pi, view.uv[k])
        assert signal.lit[k] == pytest.approx(step / clear.std(), rel=0.06)
        assert signal.lit[k] > 1.05 * signal.seen[k]
    else:
        assert signal.lit[k] == signal.seen[k]
        assert (signal.veil_filling == 0.0).all()


def test_the_wings_of_the_sun_are_harveys_law() -> None:
    """Of the light through a flat pupil, the share that a surface of given total scatter sends to a pixel."""
    tis, shoulder = 0.02, 0.01
    tables = camera(PLAIN, scatter={"tis": tis, "l_rad": shoulder, "s": -2.0})
    truth, spec, view, signal = seen(tables, sun_zenith_deg=100.0)
    geometry = camera_from_spec(spec.camera)
    x, y, z = truth.sun_cam
    sun = np.array([geometry.cx + geometry.fx * x / z, geometry.cy + geometry.fy * y / z])
    rho2 = (((view.uv[view.in_view] - sun) / (geometry.fx, geometry.fy)) ** 2).sum(axis=1)
    level = tis / (math.pi * shoulder**2 * math.log(1 + 1 / shoulder**2))
    share = level / (1 + rho2 / (1 + rho2) / shoulder**2) / (1 + rho2) ** 2 / geometry.fx**2
    pupil_m2 = math.pi / 4 * (geometry.fx * 5.5e-6 / 4.0) ** 2 * z
    irradiance = stray_light.band_irradiance(spec.band[0], truth.sun_angular_radius_rad)
    photon_j = constants.h * constants.c / 0.6e-6
    electrons = irradiance * 0.7 * pupil_m2 * share / photon_j * 0.6 * PLAIN["exposure_s"]
    assert rho2.max() > 4 * rho2.min()
    assert signal.veil_filling[view.in_view] * PLAIN["full_well_e"] == pytest.approx(electrons, rel=1e-6)
    half = seen(tables, sun_zenith_deg=100.0, sun_visible_fraction=0.5)[3].veil_filling
    assert half == pytest.approx(0.5 * signal.veil_filling)


def test_the_table_says_how_bright_the_middle_is_and_wings_how_it_falls() -> None:
    """Where a baffle's table and the lens's wings speak of the same Sun outside the image, it is counted once."""
    pose = {"sun_zenith_deg": 78.0}
    wings = {"scatter": {"tis": 0.5, "l_rad": 0.3, "s": -1.5}}
    table = seen(camera(PLAIN, stray=BAFFLE), **pose)[3].veil_filling
    truth, _, view, alone = seen(camera(PLAIN, **wings), **pose)
    both = seen(camera(PLAIN, stray=BAFFLE, **wings), **pose)[3].veil_filling
    assert not (np.abs(np.array(truth.sun_cam[:2]) / truth.sun_cam[2]) < math.tan(math.radians(30))).all()
    at = view.in_view
    middle = np.argmin(np.hypot(*(view.uv[at] - 127.5).T))
    assert both[at][middle] == pytest.approx(table[at][middle], rel=0.1)
    assert np.ptp(table[at]) == pytest.approx(0.0, abs=1e-12)
    assert np.corrcoef(both[at], alone.veil_filling[at])[0, 1] > 0.99


def test_a_sun_inside_the_image_is_the_wings_alone() -> None:
    """No part of it is outside, where the baffle's table speaks."""
    pose = {"sun_zenith_deg": 100.0}
    wings = {"scatter": {"tis": 0.02, "l_rad": 0.01, "s": -2.0}}
    truth, _, view, both = seen(camera(PLAIN, stray=BAFFLE, **wings), **pose)
    assert (np.abs(np.array(truth.sun_cam[:2]) / truth.sun_cam[2]) < math.tan(math.radians(28))).all()
    alone = seen(camera(PLAIN, **wings), **pose)[3]
    assert both.veil_filling[view.in_view] == pytest.approx(alone.veil_filling[view.in_view])


@pytest.mark.parametrize(
    ("least", "most", "target"), [(1e-7, 1.0, 0.5), (1e-7, 1.0, 0.8), (1e-3, 1.0, 0.5), (1e-9, 1e-6, 0.5)]
)
def test_an_automatic_exposure_lays_the_brightest_limb_on_its_target(least: float, most: float, target: float) -> None:
    rule = {"target": target, "min_s": least, "max_s": most}
    _, _, view, fixed = seen(camera(PLAIN))
    _, _, _, signal = seen(camera(PLAIN | {"auto_exposure": rule}))
    per_second = fixed.filling[view.in_view].max() / PLAIN["exposure_s"]
    seconds = float(np.clip(target / per_second, least, most))
    assert signal.filling[view.in_view].max() == pytest.approx(per_second * seconds, rel=1e-9)


def test_full_scale_is_the_wells_or_the_converters() -> None:
    """Twice the well doubles what fits in; with few bits the converter is full first."""
    wide = PLAIN | {"bits": 16}
    base = seen(camera(wide))[3].filling
    assert seen(camera(wide | {"full_well_e": 27000.0}))[3].filling == pytest.approx(base / 2)
    narrow = seen(camera(PLAIN | {"bits": 10}))[3].filling
    assert narrow == pytest.approx(base * 13500.0 / ((1023 - BLACK_DN) * 4.0))


def test_without_a_detector_what_shines_is_seen() -> None:
    tables = {key: value for key, value in camera(PLAIN).items() if key != "detector"}
    _, _, view, signal = seen(tables)
    lit = view.cos_zenith > 1e-4
    assert np.isinf(signal.lit[lit & view.in_view]).all()
    assert (signal.lit[view.cos_zenith < 0] == 0.0).all()
    assert (signal.filling == 0.0).all()
    assert (signal.veil_filling == 0.0).all()


def thermal_camera(**detector: Any) -> dict[str, Any]:
    keys = {"kind": "microbolometer", "pixel_pitch_um": 17.0, "netd_k": 0.08, "bits": 14, "netd_f_number": 1.0}
    return {
        "camera": {"name": "lwir", "width": 160, "height": 120, "fov_deg": 57.0},
        "optics": {"f_number": 1.4, "transmission": 0.8},
        "band": [{"name": "lwir", "kind": "thermal", "lo_um": 8.0, "hi_um": 14.0}],
        "detector": keys | detector,
    }


def test_a_thermal_limb_stands_before_cold_space() -> None:
    """220 K over the NETD of a slower and darker lens; pixels' offsets add to it as independent errors do."""
    truth, spec, _, plain = seen(thermal_camera(residue_k=0.0, minutes_since_correction=0.0))
    band = spec.band[0]
    per_kelvin = thermal.blackbody_radiance(band, 300.5) - thermal.blackbody_radiance(band, 299.5)
    coldest = thermal.blackbody_radiance(band, limits.COLDEST_LIMB_K)
    noise_k = 0.08 * 1.4**2 / 0.8
    assert plain.lit == pytest.approx(coldest / (noise_k * per_kelvin), rel=1e-4)
    assert (plain.seen == plain.lit).all()
    assert (plain.filling == 0.0).all()
    assert (plain.veil_filling == 0.0).all()
    keys = {"residue_k": 0.2, "drift_pattern_k_per_min": 0.05, "minutes_since_correction": 6.0}
    drifted = seen(thermal_camera(**keys))[3]
    assert drifted.lit == pytest.approx(coldest / (math.sqrt(noise_k**2 + 0.2**2 + 0.3**2) * per_kelvin), rel=1e-4)
    free = seen({key: value for key, value in thermal_camera().items() if key != "detector"})[3]
    assert np.isinf(free.lit).all()
    assert truth.sun_visible_fraction == 1.0


LOW = {"altitude_km": 500.0, "latitude_deg": 20.0}


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        ({}, (True, limits.ALBEDO_OF_THE_EARTH, limits.ALBEDO_OF_THE_EARTH)),
        ({"atmosphere": {"profile": "none"}}, (False, limits.ALBEDO_OF_THE_EARTH, limits.ALBEDO_OF_THE_EARTH)),
        ({"atmosphere": {"profile": "none", "file": "a.json"}, "surface": {"albedo": 0.1}}, (True, 0.1, 0.1)),
        ({"atmosphere": {"profile": "none", "profile_file": "a.csv"}, "surface": {"albedo": 0.1}}, (True, 0.1, 0.1)),
        ({"surface": {"albedo": 0.1, "kind": "earth"}}, (True, 0.1, 0.98)),
        ({"platform": LOW, "surface": {"albedo": 0.1, "kind": "earth"}}, (True, 0.1, limits.ALBEDO_OF_SNOW)),
        ({"platform": LOW, "surface": {"albedo": 0.9, "kind": "earth"}}, (True, 0.9, 0.9)),
        # Antarctica begins in sight: 500 km up the horizon is 22 deg away
        ({"platform": LOW | {"latitude_deg": -40.0}, "surface": {"kind": "earth"}}, (True, 0.3, 0.98)),
        ({"surface": {"albedo": 0.1}, "clouds": {"cover": 0.3}}, (True, 0.1, limits.ALBEDO_OF_CLOUDS)),
        ({"surface": {"albedo": 0.1}, "clouds": {"cover": 0.3, "albedo": 0.5}}, (True, 0.1, 0.5)),
        ({"surface": {"albedo": 0.6}, "clouds": {"cover": 0.3, "albedo": 0.5}}, (True, 0.6, 0.6)),
        ({"surface": {"albedo": 0.1}, "clouds": {"cover": 0.0}}, (True, 0.1, 0.1)),
        ({"surface": {"albedo": 0.1}, "clouds": {}}, (True, 0.1, limits.ALBEDO_OF_CLOUDS)),
    ],
)
def test_what_a_scene_has_that_shines(scene: dict[str, Any], expected: tuple[bool, float, float]) -> None:
    assert ground_and_air(scene) == expected


def test_reflectance_goes_evenly_from_the_side_to_ahead_and_behind() -> None:
    zenith = np.full(5, math.radians(75.0))
    way = limb_reflectance(zenith, np.array([-1.0, -0.5, 0.0, 0.5, 1.0]), 0.0, air=True)
    assert way[[1, 3]] == pytest.approx([(way[0] + way[2]) / 2, (way[2] + way[4]) / 2])
    assert (way[[0, 4]] > way[2]).all()
    bright, dark = (limb_reflectance(zenith, np.zeros(5), albedo, air=True) for albedo in (0.8, 0.2))
    middle = limb_reflectance(zenith, np.zeros(5), 0.5, air=True)
    assert middle == pytest.approx((bright + dark) / 2), "the ground's part is proportional to its albedo"
    assert (brightest_reflectance(zenith, np.zeros(5), 0.8, air=True) > bright).all()
