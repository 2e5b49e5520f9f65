"""Each stage of the everything-on camera switched off: the image changes as the stage's formula says.

The camera is vis-cmos-1024-60deg-full with its 60 deg on fewer pixels, and a converter of a quarter of an electron per
step, so that what changes can be measured.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy import constants

from horizonval.geometry.camera import camera_from_spec, field_angles
from horizonval.geometry.ellipsoid import WGS84, itrs_from_geodetic
from horizonval.sensor.lens.stray_light import band_irradiance
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import load_camera

SIDE = 129
MIDDLE = SIDE // 2
GAIN, BLACK = 0.25, 400.0
FULL_WELL = 13500.0
POINT = (MIDDLE, MIDDLE - 10)
"""Row and column of the one bright pixel of scenes that have one, near the axis."""

FULL = load_camera("vis-cmos-1024-60deg-full").model_dump(mode="json")
FULL["camera"] |= {"width": SIDE, "height": SIDE}
FULL["detector"] |= {"bits": 16, "gain_e_per_dn": GAIN, "black_level_dn": BLACK}
SPEC = CameraSpec.model_validate(FULL)
FOCAL_PX = SPEC.camera.focal_px
LENS: Any = SPEC.optics
DETECTOR: Any = SPEC.detector
DARK_BAFFLE = {"stray": {"angle_deg": [30.0], "pst": [1e-30]}}
COLD = 2 ** ((DETECTOR.temperature_c - DETECTOR.dark_reference_c) / DETECTOR.dark_doubling_k)


def wavelength_m() -> float:
    """Mean of the response, by hand."""
    x = np.linspace(0.4, 0.8, 40001)
    weight = np.interp(x, SPEC.band[0].wavelength_um, SPEC.band[0].response)
    return float(1e-6 * np.sum(weight * x) / np.sum(weight))


LAMBDA_M = wavelength_m()
ELECTRONS_PER_WATT = DETECTOR.exposure_s * DETECTOR.quantum_efficiency * LAMBDA_M / (constants.h * constants.c)
ELECTRONS_PER_RADIANCE = math.pi * LENS.transmission * 5.5e-6**2 / (4 * LENS.f_number**2) * ELECTRONS_PER_WATT


AIRY_PX = LAMBDA_M * LENS.f_number / 5.5e-6


@dataclass(frozen=True)
class Stage:
    """One row of the table.

    ``off``: keys of [optics] and [detector] that switch the stage off, ``both``: other keys for both images. ``light``:
    electrons an even scene gives on the axis, ``point``: those that one pixel's light gives. ``measure`` is taken of
    each image in electrons, dark level subtracted; its change from off to on is compared with ``expected``.
    """

    name: str
    off: dict[str, Any]
    measure: Callable[[np.ndarray], float]
    expected: float
    rel: float
    light: float = 0.0
    point: float = 0.0
    noise: bool = False
    both: dict[str, Any] | None = None
    truth: dict[str, Any] | None = None


def distance(row: int, column: int) -> np.ndarray:
    y, x = np.mgrid[:SIDE, :SIDE]
    return np.asarray(np.hypot(y - row, x - column))


def outside_square(row: int, column: int, reach: int) -> np.ndarray:
    y, x = np.mgrid[:SIDE, :SIDE]
    return np.asarray(np.maximum(abs(y - row), abs(x - column)) > reach)


def total_where(chosen: np.ndarray) -> Callable[[np.ndarray], float]:
    return lambda electrons: float(electrons[chosen].sum())


def second_moment(electrons: np.ndarray) -> float:
    """Mean square distance along the rows within 5 pixels of the point, of the light there [px2]."""
    row, column = POINT
    part = electrons[row - 5 : row + 6, column - 5 : column + 6]
    return float((part * np.arange(-5, 6) ** 2).sum() / part.sum())


def pixel_variance(electrons: np.ndarray) -> float:
    """Variance from pixel to pixel; slow changes over the image drop out of the differences."""
    return float(np.var(np.diff(electrons, axis=1)) / 2)


def corner(electrons: np.ndarray) -> float:
    """Light over that on the axis, left of the middle at 25 deg."""
    column = MIDDLE - round(FOCAL_PX * math.tan(math.radians(25)))
    box = np.s_[MIDDLE - 2 : MIDDLE + 3, column - 1 : column + 2]
    return float(electrons[box].mean() / electrons[MIDDLE - 2 : MIDDLE + 3, MIDDLE - 2 : MIDDLE + 3].mean())


def scattered_between(near_px: float, far_px: float) -> float:
    """Share of a point's light that Harvey and Shack's law throws on a ring: an integral in closed form."""
    law = LENS.scatter
    power = law.s / 2 + 1

    def within(px: float) -> float:
        rho = px / FOCAL_PX
        x = rho / math.sqrt(1 + rho * rho)
        return (1 + (x / law.l_rad) ** 2) ** power - 1

    total = (1 + law.l_rad**-2) ** power - 1
    return float(law.tis * (within(far_px) - within(near_px)) / total)


def middle(electrons: np.ndarray) -> float:
    return float(electrons[MIDDLE - 2 : MIDDLE + 3, MIDDLE - 2 : MIDDLE + 3].mean())


def sun_at(off_axis_deg: float) -> dict[str, Any]:
    angle = math.radians(off_axis_deg)
    return {"sun_cam": (0.0, -math.sin(angle), math.cos(angle)), "sun_visible_fraction": 1.0}


def stray_electrons(off_axis_deg: float) -> float:
    """Between two entries of the table the logarithm is linear."""
    angles, pst = LENS.stray.angle_deg, LENS.stray.pst
    level = math.exp(np.interp(off_axis_deg, angles, np.log(pst)))
    return level * band_irradiance(SPEC.band[0], 0.00465) * 5.5e-6**2 * ELECTRONS_PER_WATT


def wing_electrons(off_axis_deg: float) -> float:
    """What scatter and diffraction of a point at this angle leave on the axis."""
    angle, law = math.radians(off_axis_deg), LENS.scatter
    power = law.s / 2 + 1
    b0 = law.tis * power / (math.pi * law.l_rad**2 * ((1 + law.l_rad**-2) ** power - 1))
    scattered = b0 * (1 + (math.sin(angle) / law.l_rad) ** 2) ** (law.s / 2) * math.cos(angle) ** 4 / FOCAL_PX**2
    diffracted = (1 - law.tis) * AIRY_PX / (math.pi * FOCAL_PX * math.tan(angle)) ** 3
    pupil_m2 = math.pi / 4 * (FOCAL_PX * 5.5e-6 / LENS.f_number) ** 2 * math.cos(angle)
    light = LENS.transmission * band_irradiance(SPEC.band[0], 0.00465) * pupil_m2 * ELECTRONS_PER_WATT
    # At 40 deg the vignetting is 0.8.
    return light * (1 - 0.2 * (off_axis_deg - 20) / 20) * (scattered + diffracted)


ANGLE_DEG = np.degrees(field_angles(camera_from_spec(SPEC.camera)))
COS4 = np.cos(np.radians(ANGLE_DEG)) ** 4
VIGNETTING = np.clip(1 - 0.2 * (ANGLE_DEG - 20) / 20, None, 1)
AT_25_DEG = (MIDDLE, MIDDLE - round(FOCAL_PX * math.tan(math.radians(25))))
RING = (distance(*POINT) > 8) & (distance(*POINT) < 40)
FAR = distance(*POINT) > 12
"""Where the bright point saturates nothing."""
MIRRORED = (MIDDLE, MIDDLE + 12)
GHOST = np.exp(-(distance(*MIRRORED) ** 2) / (2 * 15**2)) / (2 * math.pi * 15**2)
BRIGHT = 1e8
IN_ANOMALY: dict[str, Any] = {
    "r_itrs": tuple(itrs_from_geodetic(math.radians(-26), math.radians(-49), 5e5, WGS84).tolist())
}
IN_ANOMALY |= {"ellipsoid_a_m": WGS84.a_m, "ellipsoid_b_m": WGS84.b_m}
FLAT = 8000.0
STAGES = [
    Stage(
        "vignetting",
        {"vignetting": [], "vignetting_deg": []},
        corner,
        float((COS4 * (VIGNETTING - 1))[AT_25_DEG]),
        0.03,
        light=FLAT,
    ),
    # Integrating over the pixel and diffraction are in both images; the rest of the wings is cut off alike.
    Stage(
        "blur over the field",
        {"psf_field_deg": [], "psf_field_sigma_px": []},
        second_moment,
        float(np.interp(ANGLE_DEG[POINT], LENS.psf_field_deg, LENS.psf_field_sigma_px)) ** 2,
        0.05,
        point=1e4,
    ),
    # Beyond x pixels from the middle of a square an Airy pattern has 4 sqrt(2) / pi^3 lambda N / x of its light.
    Stage(
        "diffraction",
        {"diffraction": False},
        total_where(outside_square(*POINT, 5) & (distance(*POINT) < 50)),
        BRIGHT * (1 - LENS.scatter.tis) * AIRY_PX * (4 * math.sqrt(2) / math.pi**3 / 5.5 - 2 / math.pi**2 / 50),
        0.05,
        point=BRIGHT,
    ),
    Stage(
        "scatter",
        {"scatter": None},
        total_where(RING),
        BRIGHT * (scattered_between(8, 40) - LENS.scatter.tis * 2 / math.pi**2 * AIRY_PX * (1 / 8 - 1 / 40)),
        0.02,
        point=BRIGHT,
    ),
    Stage(
        "ghost",
        {"ghost": []},
        total_where(FAR),
        BRIGHT * LENS.ghost[0].ratio * float(GHOST[FAR].sum()),
        0.01,
        point=BRIGHT,
    ),
    *(
        Stage(f"stray light at {angle} deg", DARK_BAFFLE, middle, stray_electrons(angle), 0.01, truth=sun_at(angle))
        for angle in (32, 40, 50)
    ),
    # Without a table the Sun outside the image shines through the lens's own wings.
    Stage(
        "the baffle's table",
        {"stray": None},
        middle,
        stray_electrons(40) - wing_electrons(40),
        # On so few pixels most of it is diffraction, whose mean wavelength is the sunlight's, not the response's.
        0.05,
        truth=sun_at(40),
    ),
    Stage(
        "response of the pixels",
        {"prnu": 0.0},
        pixel_variance,
        0.01**2 * float(np.mean((FLAT * COS4 * VIGNETTING) ** 2)),
        0.1,
        light=FLAT,
        noise=True,
    ),
    Stage("dark pattern", {"dsnu_e": 0.0}, pixel_variance, 10.0**2, 0.1, noise=True),
    Stage("read noise", {"read_noise_e": 0.0}, pixel_variance, 13.0**2, 0.1, noise=True),
    # One in a hundred pixels instead of one in 1e4, which would be two; for a second, so that they glow.
    Stage(
        "hot pixels",
        {"hot_pixel_fraction": 0.0},
        np.mean,
        0.01 * 20000 * COLD * (1 - math.exp(-FULL_WELL / (20000 * COLD))),
        # 166 pixels with an exponential spread: 8 %.
        0.25,
        noise=True,
        both={"hot_pixel_fraction": 0.01, "exposure_s": 1.0},
    ),
    Stage(
        "cold",
        {"temperature_c": None, "dark_reference_c": None},
        np.mean,
        125.0 * (COLD - 1),
        0.01,
        both={"exposure_s": 1.0},
    ),
    Stage("dark current", {"dark_current_e_per_s": 0.0}, np.mean, 125.0 * COLD, 0.01, both={"exposure_s": 1.0}),
    # Mean path 2 h (the density of the angle is 2 cos sin, the path h / cos), half the flux through the plane. The
    # camera's flux gives 3 tracks in a second on this small array: a hundred times that.
    Stage(
        "protons",
        {"radiation": None},
        np.sum,
        0.5 * 1e5 * (SIDE * 5.5e-4) ** 2 * 2 * 5 * 400,
        # 250 tracks, 7 %, and as much again from their lengths and energies; what is over the full well is lost.
        0.3,
        noise=True,
        both={"radiation": {"flux_per_cm2_s": 1e5}, "exposure_s": 1.0},
        truth=IN_ANOMALY,
    ),
]


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_stage_switched_off(make_frame: Any, stage: Stage) -> None:
    def image(keys: dict[str, Any]) -> np.ndarray:
        tables = copy.deepcopy(FULL)
        for key, value in keys.items():
            tables["optics" if key in tables["optics"] else "detector"][key] = value
        radiance = np.full((SIDE, SIDE), stage.light / ELECTRONS_PER_RADIANCE)
        radiance[POINT] += stage.point / (ELECTRONS_PER_RADIANCE * COS4[POINT])
        frame = make_frame(radiance, tables, **({"sun_visible_fraction": 0.0} | (stage.truth or {})))
        dn = observe(frame, CameraSpec.model_validate(tables), seed=4, noise=stage.noise).dn
        return (dn.astype(float) - BLACK) * GAIN

    both = stage.both or {}
    change = stage.measure(image(both)) - stage.measure(image(both | stage.off))
    assert change == pytest.approx(stage.expected, rel=stage.rel, abs=1e-9)


def test_every_stage_of_the_camera_is_in_the_table() -> None:
    """What the file switches on beyond the plain camera's file."""
    plain = load_camera("vis-cmos-1024-60deg").model_dump(mode="json")
    added = {
        key
        for table in ("optics", "detector")
        for key, value in load_camera("vis-cmos-1024-60deg-full").model_dump(mode="json")[table].items()
        if value != plain[table].get(key)
    }
    levels = {"exposure_s", "dark_doubling_k", "hot_pixel_e_per_s", "psf_sigma_px"}
    assert added - levels == {key for stage in STAGES for key in stage.off} - {"read_noise_e", "dark_current_e_per_s"}
