"""Every shipped camera on the bench, photon transfer, exposure of the Earth and NETD, and before a limb.

The image is a small window on the axis whose pixels all look within 0.1 deg: what a pixel gets from an even scene
depends on its pitch and on the f-number alone. Models: Janesick, *Photon Transfer* (2007), eq. 5.1; the definition of
NETD for thermal arrays; R. C. Jones's D*.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import constants, integrate

from horizonval.frame import Hit
from horizonval.geometry.frames import inverse, rotate
from horizonval.geometry.pose import pose_from_spec
from horizonval.renderer.frame import render_frame
from horizonval.sensor.observe import observe
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Cmos, LinearArray, Microbolometer, Thermopile
from horizonval.spec.files import shipped_names
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec

H_C = constants.h * constants.c
SOLAR = [
    (name, band.name) for name in shipped_names("camera") for band in load_camera(name).band if band.kind == "solar"
]
THERMAL = [
    (name, band.name) for name in shipped_names("camera") for band in load_camera(name).band if band.kind == "thermal"
]
SHEET_NETD_K = {
    # 50 mK of the detector at f/1, seen through f/1.1.
    "ir-bolometer-160-57deg": 0.05 * 1.1**2,
    "ir-bolometer-160-57deg-full": 0.05,
    "ir-bolometer-640-48deg": 0.05,
    "ir-thermopile-32-110deg": 0.1,
}
"""Of the whole camera, as its data sheet has it."""


def on_the_bench(name: str, side: int, **detector: Any) -> dict[str, Any]:
    """Return a shipped camera with a square window on the axis and other detector keys."""
    tables = load_camera(name).model_dump(mode="json")
    geometry = {"name": name, "width": side, "height": side, "fov_deg": 0.1}
    geometry["projection"] = tables["camera"]["projection"]
    tables["detector"] |= detector
    return tables | {"camera": geometry, "head": []}


def response(band: Band, wavelength_um: np.ndarray) -> np.ndarray:
    if band.lo_um is not None:
        return np.where((wavelength_um >= band.lo_um) & (wavelength_um <= (band.hi_um or 0)), 1.0, 0.0)
    return np.interp(wavelength_um, band.wavelength_um, band.response, left=0, right=0) / max(band.response)


def band_grid(band: Band) -> tuple[np.ndarray, np.ndarray]:
    low, high = band.lo_um or band.wavelength_um[0], band.hi_um or band.wavelength_um[-1]
    wavelength = np.linspace(low, high, 20001)
    return wavelength, response(band, wavelength)


def photoelectron_rate(spec: CameraSpec, band: Band) -> float:
    """Electrons per second and W m-2 sr-1, by hand: pi tau p^2 / (4 N^2) QE lambda / (h c)."""
    assert isinstance(spec.detector, Cmos)
    wavelength, weight = band_grid(band)
    lambda_m = 1e-6 * integrate.trapezoid(weight * wavelength, wavelength) / integrate.trapezoid(weight, wavelength)
    lens = spec.optics
    power = math.pi * lens.transmission * (spec.detector.pixel_pitch_um * 1e-6) ** 2 / (4 * lens.f_number**2)
    return power * spec.detector.quantum_efficiency * lambda_m / H_C


def own_pixels(detector: Cmos, band: str, side: int) -> np.ndarray:
    """Pixels that see the band: all, or those of its colour."""
    if detector.bayer is None:
        return np.ones((side, side), bool)
    return np.tile(np.array(list(detector.bayer)).reshape(2, 2) == band[0].upper(), (side // 2, side // 2))


def transfer_curve(make_frame: Any, name: str, band_name: str, side: int) -> list[tuple[float, float, float, float]]:
    """Return measured mean and variance [dn], and those of the model, at 12 levels from 5 % to 85 % of the full well.

    What spreads light is left out of the lens: it leaves an even scene even, which the next test sees.
    """
    tables = on_the_bench(name, side, auto_exposure=None)
    tables["optics"] = {key: tables["optics"][key] for key in ("f_number", "transmission")}
    spec = CameraSpec.model_validate(tables)
    detector = spec.detector
    assert isinstance(detector, Cmos)
    (band,) = (b for b in spec.band if b.name == band_name)
    seconds, black = detector.exposure_s, detector.black_level_dn
    gain = detector.gain_e_per_dn or detector.full_well_e / (2**detector.bits - 1 - black)
    warmth = 0.0
    if detector.temperature_c is not None and detector.dark_reference_c is not None:
        warmth = (detector.temperature_c - detector.dark_reference_c) / detector.dark_doubling_k
    dark = detector.dark_current_e_per_s * seconds * 2**warmth
    # During the transfer every packet passes the other rows of its column.
    lit_s = seconds + (detector.row_time_s or 0) * (side - 1) * (detector.shutter == "frame_transfer")
    chosen = own_pixels(detector, band_name, side)
    found = []
    for level in np.linspace(0.05, 0.85, 12):
        electrons = level * detector.full_well_e
        radiance = electrons / (photoelectron_rate(spec, band) * lit_s)
        frame = make_frame({b.name: radiance for b in spec.band}, tables, sun_visible_fraction=0.0)
        one, two = (observe(frame, spec, band_name, seed).dn.astype(float)[chosen] for seed in (1, 2))
        mean = black + (electrons + dark) / gain
        variance = (electrons + dark + detector.read_noise_e**2) / gain**2 + 1 / 12
        # The difference of two frames is free of what makes pixels differ.
        found.append(((one.mean() + two.mean()) / 2, np.var(one - two) / 2, mean, variance))
    return found


def check_curve(curve: list[tuple[float, float, float, float]], black: float, variance_rel: float) -> float:
    """Compare a curve with its model, and return the gain that it shows [e-/dn]."""
    mean, variance, model_mean, model_variance = np.array(curve).T
    # The pattern's mean over the window is within 2e-4, the photons' at 5 % of the smallest full well within 3e-4.
    np.testing.assert_allclose(mean - black, model_mean - black, rtol=2e-3)
    np.testing.assert_allclose(variance, model_variance, rtol=variance_rel)
    slope, _ = np.polyfit(mean - black, variance, 1, w=1 / variance)
    return float(1 / slope)


@pytest.mark.parametrize(("name", "band"), SOLAR)
def test_photon_transfer(make_frame: Any, name: str, band: str) -> None:
    """65 536 pixels, in colour a half or a quarter: standard error of a variance 0.55 % (0.8, 1.1), a gain 0.2 %."""
    detector = load_camera(name).detector
    assert isinstance(detector, Cmos)
    share = own_pixels(detector, band, 2).mean()
    curve = transfer_curve(make_frame, name, band, 256)
    gain = check_curve(curve, detector.black_level_dn, 4 * 0.0055 / math.sqrt(share))
    expected = detector.full_well_e / (2**detector.bits - 1 - detector.black_level_dn)
    assert gain == pytest.approx(expected, rel=0.01 / math.sqrt(share))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "band"), [pair for pair in SOLAR if pair[1] == "vis"])
def test_photon_transfer_to_one_percent(make_frame: Any, name: str, band: str) -> None:
    """640 x 640 pixels: standard error of a variance 0.22 %; 1 % is 4.5 of them."""
    detector = load_camera(name).detector
    assert isinstance(detector, Cmos)
    curve = transfer_curve(make_frame, name, band, 640)
    gain = check_curve(curve, detector.black_level_dn, 0.01)
    expected = detector.full_well_e / (2**detector.bits - 1 - detector.black_level_dn)
    assert gain == pytest.approx(expected, rel=0.005)


@pytest.mark.parametrize(("name", "band"), SOLAR)
def test_a_sunlit_limb_is_well_exposed(make_frame: Any, name: str, band: str) -> None:
    """77 W m-2 sr-1 um-1 in all bands, the middle of 50 to 100: on 50 to 70 % of full scale in the brightest band."""
    tables = on_the_bench(name, 48)
    spec = CameraSpec.model_validate(tables)
    assert spec.camera.name == name
    radiance = {b.name: 77 * float(integrate.trapezoid(*reversed(band_grid(b)))) for b in spec.band}
    frame = make_frame(radiance, tables, sun_visible_fraction=0.0)
    levels = {b.name: observe(frame, spec, b.name, noise=False).dn / (2 ** _bits(spec) - 1) for b in spec.band}
    assert 0.5 < max(np.median(level) for level in levels.values()) < 0.7
    assert 0.35 < np.median(levels[band]) < 0.7
    # Ghosts larger than the image leave its border a little darker; nothing else sees that it is one.
    assert np.ptp(levels[band]) < 0.005


def _bits(spec: CameraSpec) -> int:
    assert spec.detector is not None
    return spec.detector.bits


def planck(wavelength_m: np.ndarray, temperature_k: float) -> np.ndarray:
    x = H_C / (wavelength_m * constants.k * temperature_k)
    return np.asarray(2 * constants.h * constants.c**2 / wavelength_m**5 / np.expm1(x))


def black_body(band: Band, temperature_k: float) -> float:
    wavelength, weight = band_grid(band)
    return float(integrate.trapezoid(weight * planck(wavelength * 1e-6, temperature_k), wavelength * 1e-6))


def per_kelvin(band: Band) -> float:
    return black_body(band, 300.5) - black_body(band, 299.5)


def sheet_netd_k(name: str, spec: CameraSpec, band: Band) -> float:
    """NETD of the whole camera: its data sheet's where that says it, else from what the file states."""
    if name in SHEET_NETD_K:
        return SHEET_NETD_K[name]
    detector, lens = spec.detector, spec.optics
    if isinstance(detector, Thermopile):
        return detector.netd_k
    if isinstance(detector, Microbolometer):
        # A figure for one band is the same noise in watts behind another filter.
        stated = [b for b in spec.band if b.name == getattr(detector, "netd_band", None)] or [band]
        filtered = per_kelvin(stated[0]) / per_kelvin(band)
        return detector.netd_k * filtered * (lens.f_number / detector.netd_f_number) ** 2 / lens.transmission
    assert isinstance(detector, LinearArray)
    assert detector.sensing == "pyroelectric"
    assert detector.d_star_cm_rthz_per_w is not None
    assert detector.bandwidth_hz is not None
    # Noise-equivalent power over the power per kelvin; a chopped element takes the difference of two looks.
    side_cm = detector.pixel_pitch_um * 1e-4
    nep_w = side_cm * math.sqrt(detector.bandwidth_hz) / detector.d_star_cm_rthz_per_w
    etendue = lens.transmission * (side_cm * 1e-2) ** 2 * math.pi / (4 * lens.f_number**2)
    return math.sqrt(2) * nep_w / (etendue * per_kelvin(band))


@pytest.mark.parametrize(("name", "band_name"), THERMAL)
def test_netd(make_frame: Any, name: str, band_name: str) -> None:
    """Noise of a 300 K scene over the response between 299 and 301 K. 40 000 pixels: standard error 0.4 %.

    The noise is that which differs from frame to frame between two shutter corrections: residue and drift are off.
    """
    off = {"residue_k": 0.0, "minutes_since_correction": 0.0}
    tables = on_the_bench(name, 200, **off)
    spec = CameraSpec.model_validate(tables)
    (band,) = (b for b in spec.band if b.name == band_name)

    def view(temperature_k: float, seed: int) -> np.ndarray:
        radiance = {b.name: black_body(b, temperature_k) for b in spec.band}
        frame = make_frame(radiance, tables, sun_visible_fraction=0.0)
        return observe(frame, spec, band_name, seed).dn.astype(float)

    signal = (view(301, 1).mean() - view(299, 2).mean()) / 2
    noise = np.std(view(300, 3) - view(300, 4)) / math.sqrt(2)
    assert noise / signal == pytest.approx(sheet_netd_k(name, spec, band), rel=0.03)


def test_the_pair_looks_across_the_longitudinal_axis() -> None:
    """Perpendicular to each other and to the body's z."""
    camera = load_camera("vis-pair-1024-60deg")
    axes, downs = [], []
    for head in camera.head:
        scene = SceneSpec.model_validate(
            {"camera": {"file": "vis-pair-1024-60deg", "head": head.name}, "platform": {"altitude_km": 500.0}}
        )
        q = pose_from_spec(scene, camera).q_cam_from_body
        axes.append(rotate(inverse(q), [0.0, 0.0, 1.0]))
        downs.append(rotate(q, [0.0, 0.0, 1.0]))
    assert axes[0] @ axes[1] == pytest.approx(0, abs=1e-12)
    assert [axis[2] for axis in axes] == pytest.approx([0, 0], abs=1e-12)
    # The Earth is at the bottom of both images.
    for down in downs:
        assert down == pytest.approx([0, 1, 0], abs=1e-12)


def test_the_four_heads_have_the_horizon_of_400_km_in_the_middle() -> None:
    """Nadir angle of the horizon of a sphere of 6378.137 km from 400 km, to the hundredth that the paper prints."""
    camera = load_camera("ir-linear-160-four-heads")
    assert math.degrees(math.asin(6378.137 / 6778.137)) == pytest.approx(70.22, abs=0.005)
    assert [head.mount_yaw_deg for head in camera.head] == [45, 135, 225, 315]
    assert {head.mount_pitch_deg for head in camera.head} == {70.22}
    assert math.degrees(1 / camera.camera.focal_px) == pytest.approx(0.1, rel=1e-12)


MOST_PX = 32


def fewer_pixels(name: str) -> CameraSpec:
    """Return the camera with its field on at most 32 x 32 pixels; a line of detectors keeps its own."""
    spec = load_camera(name)
    tables = spec.model_dump(mode="json")
    geometry = tables["camera"]
    if spec.camera.height > 1:
        step = max(1.0, max(spec.camera.width, spec.camera.height) / MOST_PX)
        width, height = round(spec.camera.width / step), round(spec.camera.height / step)
        fx = spec.camera.focal_px / step
        geometry |= {"width": width, "height": height, "fx": fx, "fov_deg": None, "focal_length_mm": None}
        geometry["fy"] = None if spec.camera.fy is None else spec.camera.fy / step
    return CameraSpec.model_validate(tables)


def scene_of(name: str, spec: CameraSpec) -> SceneSpec:
    """A limb by day: from the geostationary ring for the full disc, else from 400 km."""
    camera: dict[str, Any] = {"file": name, "head": spec.head[0].name if spec.head else None}
    altitude_km = 400.0
    if "geo" in name:
        altitude_km = 35786.0
    elif spec.camera.projection != "fisheye" and (not spec.head or spec.head[0].name == "right"):
        # A head to the right looks where the housing is mounted; others have mountings of their own.
        camera["mount_roll_deg"] = 70.0
    return SceneSpec.model_validate(
        {
            "camera": camera,
            "platform": {"altitude_km": altitude_km},
            "atmosphere": {"profile": "none"},
            "sun": {"zenith_deg": 20.0},
            "render": {"orders": "single"},
        }
    )


@pytest.mark.parametrize("name", shipped_names("camera"))
def test_limb_of_a_bare_earth(name: str) -> None:
    spec = fewer_pixels(name)
    frame = render_frame(scene_of(name, spec), spec)
    ground, space = frame.maps["hit"] == Hit.SURFACE, frame.maps["hit"] == Hit.SPACE
    assert ground.any()
    assert space.any()
    for band in spec.band:
        image = observe(frame, spec, band.name, seed=1)
        bright, dark = np.median(image.dn[ground]), np.median(image.dn[space])
        assert dark < 0.1 * image.full_scale
        # A bare ground of albedo 0.3 is darker than a limb with its air; 300 K is little of a range up to 573 K.
        if band.kind == "solar":
            least = 0.1 * image.full_scale
        else:
            least = 10 * image.observation["sigma_radiance"] / image.observation["radiance_per_dn"]
        assert bright - dark > least
