"""Refraction against the ray equation, another code, closed forms, and against no refraction."""

from __future__ import annotations

import csv
import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bent_rays import Air, limb_radiance, shoot
from reference_rays import DATA, RayTable
from scipy.integrate import solve_ivp

from horizonval.core.errors import UserError
from horizonval.earth.atmosphere.profiles import profile
from horizonval.earth.atmosphere_file import file_model, read_atmosphere
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.earth.gases import rayleigh
from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.renderer.planet import Planet
from horizonval.renderer.rays import radiance_along_rays
from horizonval.renderer.refraction import BendingField, ray_end, to_apparent_radius, true_direction
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

RADIUS_M = 6_371_000.0
Z = np.linspace(0.0, 1e5, 1001)
ARCMIN = np.radians(1.0 / 60.0)


@pytest.fixture(scope="module")
def mi() -> Any:
    activate()
    import mitsuba

    return mitsuba


def _model(refractivity: np.ndarray | None, extinction: np.ndarray, albedo: float = 0.0) -> OpticalModel:
    zero = np.zeros_like(extinction)
    node = SpectralNode(
        name="n",
        band="n",
        weight=1.0,
        wavelength_um=0.55,
        extinction_per_m=extinction,
        molecular_per_m=extinction,
        molecular_cos2=0.75,
        particle_per_m=zero,
        asymmetry=zero,
        solar_irradiance=1.0,
        sun_radiance=0.0,
    )
    return OpticalModel(Z, 1e5, (node,), albedo, refractivity=refractivity)


def _exponential(ground: float, scale_m: float) -> OpticalModel:
    share = np.exp(-Z / scale_m)
    return _model(ground * share, 1.2e-5 * share)


def _bending_field(model: OpticalModel, planet: Planet | None = None) -> BendingField:
    return BendingField.of(to_apparent_radius(model, planet or Planet(RADIUS_M, RADIUS_M)))


def _scale(field: BendingField, refractivity: float) -> float:
    """Return by how much lengths are multiplied among the straight rays."""
    return field.planet.a_m / (RADIUS_M * (1.0 + refractivity))


def _limb(sza_deg: float, azimuth_deg: float, height_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    impact, distance = RADIUS_M + height_m, RADIUS_M + 500e3
    z, a = np.radians([sza_deg, azimuth_deg])
    sun = np.array([np.sin(z) * np.cos(a), np.sin(z) * np.sin(a), np.cos(z)])
    return np.array([-np.sqrt(distance**2 - impact**2), 0.0, impact]), np.array([1.0, 0.0, 0.0]), sun


def _bending_by_ode(ground: float, scale_m: float, lowest_m: float) -> tuple[float, float]:
    """Return impact parameter and bending of the ray whose lowest point is given: the ray equation in polar form."""

    def equation(_: float, y: np.ndarray) -> list[float]:
        r, _, slope = y
        excess = ground * np.exp(-(r - RADIUS_M) / scale_m)
        return [np.sin(slope), np.cos(slope) / r, np.cos(slope) * (1.0 / r - excess / scale_m / (1.0 + excess))]

    def top(_: float, y: np.ndarray) -> float:
        return float(y[0] - RADIUS_M - Z[-1])

    top.terminal = True  # type: ignore[attr-defined]
    start = [RADIUS_M + lowest_m, 0.0, 0.0]
    end = solve_ivp(equation, [0.0, 3e6], start, rtol=1e-11, atol=1e-11, max_step=2e3, events=top).y[:, -1]
    index = 1.0 + ground * np.exp(-lowest_m / scale_m)
    return index * (RADIUS_M + lowest_m), 2.0 * float(end[1] - end[2])


def _bending(mi: Any, field: BendingField, impact_m: float) -> float:
    o = tuple(mi.Float64(v) for v in (-2e7, 0.0, impact_m * _scale(field, 2.8e-4)))
    return float(field.angle(o, tuple(mi.Float64(v) for v in (1.0, 0.0, 0.0)))[0])


@pytest.mark.parametrize("lowest_m", [0.0, 10e3, 30e3])
def test_bending_equals_the_ray_equation(mi: Any, lowest_m: float) -> None:
    """1e-4 from the ground up, as often bent as the Earth's air bends light."""
    impact, expected = _bending_by_ode(2.8e-4, 8000.0, lowest_m)
    assert _bending(mi, _bending_field(_exponential(2.8e-4, 8000.0)), impact) == pytest.approx(expected, rel=1e-4)


def test_weak_bending_equals_the_closed_form(mi: Any) -> None:
    """``N sqrt(2 pi R / H)`` for small N; its next term is of order H / R, and N R / H = 0.08 of the slope here."""
    ground, scale, lowest = 2.8e-4, 8000.0, 30e3
    impact, _ = _bending_by_ode(ground, scale, lowest)
    at_lowest = ground * np.exp(-lowest / scale)
    expected = at_lowest * np.sqrt(2.0 * np.pi * (RADIUS_M + lowest) / scale)
    assert _bending(mi, _bending_field(_exponential(ground, scale)), impact) == pytest.approx(expected, rel=5e-3)


def _standard_air() -> OpticalModel:
    state = profile("us76").at(Z)
    return _model(rayleigh.refractivity(state.number_density_air, 0.59), 1e-5 * np.exp(-Z / 8000.0))


def _from_the_ground(mi: Any, field: BendingField, elevation_rad: np.ndarray) -> np.ndarray:
    """Return true elevations of what is seen at apparent ones by an observer on the ground."""
    zero = mi.Float64(np.zeros_like(elevation_rad))
    o = (zero, zero, zero + field.planet.a_m)
    d = (mi.Float64(np.cos(elevation_rad)), zero, mi.Float64(np.sin(elevation_rad)))
    x, _, z = (np.array(v) for v in true_direction(field, o, d))
    return np.arctan2(z, x)


def test_horizontal_refraction_of_standard_air(mi: Any) -> None:
    """About 34' on the horizon (the almanacs' value at 10 C; 33' at 15 C), 58" tan z high up, 1 % at 45 deg."""
    field = _bending_field(_standard_air())
    apparent = np.array([0.0, np.radians(45.0)])
    lift = apparent - _from_the_ground(mi, field, apparent)
    assert 32.0 < lift[0] / ARCMIN < 35.0
    assert lift[1] == pytest.approx(2.772e-4 * (1.0 - 8400.0 / RADIUS_M), rel=1e-2)


def test_setting_sun_is_flattened(mi: Any) -> None:
    """From the ground the Sun standing on the horizon is 0.8 to 0.85 as high as wide."""
    field = _bending_field(_standard_air())
    apparent = np.linspace(0.0, 1.0, 601) * 40.0 * ARCMIN
    true = _from_the_ground(mi, field, apparent)
    upper = np.interp(true[0] + 32.0 * ARCMIN, true, apparent)
    assert 0.8 < upper / (32.0 * ARCMIN) < 0.85


def test_disc_behind_the_air_is_where_the_ray_equation_puts_it(mi: Any) -> None:
    """From 500 km, half way through the air the Sun's limbs: 1e-4 of the disc's height."""
    field = _bending_field(_exponential(2.8e-4, 8000.0))
    distance = RADIUS_M + 500e3
    impact, bending = np.array([_bending_by_ode(2.8e-4, 8000.0, h) for h in (2e3, 8e3, 20e3, 40e3)]).T
    dip = np.arccos(impact / distance)
    zero = mi.Float64(np.zeros(4))
    o = (zero, zero, zero + distance * _scale(field, 2.8e-4))
    d = (mi.Float64(np.cos(dip)), zero, mi.Float64(-np.sin(dip)))
    x, _, z = (np.array(v) for v in true_direction(field, o, d))
    assert np.abs(np.arctan2(-z, x) - (dip + bending)).max() < 1e-4 * 32.0 * ARCMIN


def test_no_refractivity_is_no_refraction(mi: Any) -> None:
    """1e-10, lit and dark, limb and ground."""
    model = _exponential(0.0, 8000.0)
    rays = [_limb(sza, azimuth, h) for sza in (30.0, 60.0, 85.0) for azimuth in (0.0, 120.0) for h in (5e3, 30e3, -2e4)]
    o, d, sun = (np.array(v) for v in zip(*rays, strict=True))
    with_zero = radiance_along_rays(replace(model, albedo=0.3), RADIUS_M, o, d, sun, nodes=512)["n"]
    without = radiance_along_rays(replace(model, albedo=0.3, refractivity=None), RADIUS_M, o, d, sun, nodes=512)["n"]
    assert with_zero == pytest.approx(without, rel=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sza_deg", "azimuth_deg", "height_m"),
    [
        (85.0, 0.0, 10e3), (90.0, 90.0, 5e3), (60.0, 0.0, 10e3), (90.0, 0.0, 15e3),
        (93.0, 0.0, 20e3), (95.0, 0.0, 30e3), (95.0, 180.0, 20e3),
    ],
)  # fmt: skip
def test_limb_equals_brute_force(mi: Any, sza_deg: float, azimuth_deg: float, height_m: float) -> None:
    """1e-4: bent lines of sight, bent sunlight and its spreading, 128 nodes as in an image."""
    o, d, sun = _limb(sza_deg, azimuth_deg, height_m)
    air = Air(radius_m=RADIUS_M)
    model = _exponential(air.refractivity, air.scale_m)
    ours = radiance_along_rays(model, RADIUS_M, o[None], d[None], sun[None], nodes=128)["n"][0]
    assert ours == pytest.approx(limb_radiance(air, o, d, sun), rel=1e-4)


def test_refracted_limb_equals_another_code() -> None:
    """SASKTRAN2, named by the heights of unbent rays.

    It leaves out how the Sun's light spreads, ``N / cos^2`` of its zenith angle: 1e-3 up to 60 deg, 3e-3 at 75.
    """
    table = RayTable("limb_refraction_sasktran2.csv")
    with (DATA / "refractive_index_550nm.csv").open() as file:
        refractivity = [float(row["refractivity"]) for row in csv.DictReader(file)]
    atmosphere = read_atmosphere(DATA / "atm_rayleigh.json").model_copy(update={"refractivity": refractivity})
    activate()
    model = file_model(atmosphere, thermal=False, refracted="atm_rayleigh.json")
    ours = radiance_along_rays(model, RADIUS_M, *table.vectors)["550nm"]
    bent, straight = table["refracted_550nm"], table["straight_550nm"]
    high_sun = table["sza"] <= 60.0
    error = np.abs(ours / bent - 1.0)
    assert len(table.rows) > 100
    assert np.abs(bent / straight - 1.0).max() > 0.03
    assert error[high_sun].max() < 1e-3
    assert error.max() < 3e-3


def test_air_that_holds_light_is_refused(mi: Any) -> None:
    """A duct: the index falls by more than 1.57e-7 per metre."""
    refractivity = np.interp(Z, [0.0, 1000.0, 1200.0, 1e5], [2.8e-4, 2.7e-4, 2.2e-4, 0.0])
    with pytest.raises(UserError, match="refractivity: the air at 1"):
        to_apparent_radius(_model(refractivity, np.zeros_like(Z)), Planet(RADIUS_M, RADIUS_M))


def _frame(tmp_path: Path, scene: dict[str, Any], camera: dict[str, Any], refraction: bool) -> np.ndarray:
    """Render a sphere under air that bends light (exponentially, 2.8e-4) and does nothing else."""
    band = {
        "name": camera["band"][0]["name"],
        "wavelength_nm": 550.0,
        "scattering_per_m": [0.0] * len(Z),
        "absorption_per_m": [0.0] * len(Z),
        "phase": "rayleigh",
    }
    air = {
        "planet_radius_km": 6371.0,
        "top_km": 100.0,
        "altitude_km": (Z / 1e3).tolist(),
        "temperature_K": [280.0] * len(Z),
        "refractivity": (2.8e-4 * np.exp(-Z / 8000.0)).tolist(),
        "bands": [band],
        "surface": {"albedo": 0.0, "temperature_K": 280.0, "emissivity": 1.0},
    }
    (tmp_path / "air.json").write_text(json.dumps(air))
    atmosphere = {"file": str(tmp_path / "air.json"), "refraction": refraction}
    earth = {"shape": "sphere", "radius_km": RADIUS_M / 1e3}
    spec = SceneSpec.model_validate({"earth": earth, "atmosphere": atmosphere, "surface": {"albedo": 0.0}, **scene})
    return render_frame(spec, CameraSpec.model_validate(camera)).radiance[band["name"]].astype(float)


def test_hard_limb_is_that_of_the_larger_planet(mi: Any, tmp_path: Path) -> None:
    """A glowing ball seen whole: its solid angle grows as that of a ball of radius ``n R``, to 1 % of the growth."""
    camera = {
        "camera": {"width": 128, "height": 128, "fov_deg": 20.0},
        "band": [{"name": "lwir", "kind": "thermal", "lo_um": 10.0, "hi_um": 11.0}],
    }
    scene = {"camera": {"file": "test"}, "platform": {"altitude_km": 36_000.0}}
    images = [_frame(tmp_path, scene, camera, refraction) for refraction in (False, True)]
    focal = 64.0 / np.tan(np.radians(10.0))
    x = (np.arange(128.0) - 63.5) / focal
    weight = (1.0 + x[:, None] ** 2 + x[None, :] ** 2) ** -1.5
    straight, bent = ((image * weight).sum() for image in images)

    def solid_angle(radius: float) -> float:
        return 1.0 - np.sqrt(1.0 - (radius / (RADIUS_M + 36e6)) ** 2)

    growth = solid_angle((1.0 + 2.8e-4) * RADIUS_M) / solid_angle(RADIUS_M) - 1.0
    assert bent / straight - 1.0 == pytest.approx(growth, rel=1e-2)


def test_sun_setting_behind_the_limb_is_flattened_in_the_frame(mi: Any, tmp_path: Path) -> None:
    """Area of the apparent disc over that of the free one, from 500 km, 3 %: the rays from the ray equation."""
    camera = {
        "camera": {"width": 200, "height": 200, "fov_deg": 1.0},
        "band": [{"name": "vis", "kind": "solar", "lo_um": 0.6, "hi_um": 0.7, "nodes": 1}],
    }

    def area(zenith_deg: float, refraction: bool) -> int:
        scene = {
            "camera": {"file": "test", "mount_roll_deg": 68.4},
            "platform": {"altitude_km": 500.0},
            "sun": {"zenith_deg": zenith_deg, "azimuth_deg": 270.0},
        }
        image = _frame(tmp_path, scene, camera, refraction)
        return int((image > 0.2 * image.max()).sum())

    zenith_deg = 111.95
    lowest = np.concatenate([np.linspace(0.0, 20e3, 11), np.linspace(24e3, 60e3, 10)])
    impact, bending = np.array([_bending_by_ode(2.8e-4, 8000.0, h) for h in lowest]).T
    dip = np.arccos(impact / (RADIUS_M + 500e3))
    sun = np.radians(zenith_deg - 90.0)
    radius = np.sqrt(area(111.6, False) / np.pi) * np.radians(1.0) / 200.0
    fine = np.linspace(dip[-1], dip[0], 20_000)
    offset = np.interp(fine, dip[::-1], (dip + bending)[::-1]) - sun
    assert np.abs(offset[[0, -1]]).min() > radius
    share = np.trapezoid(2.0 * np.sqrt(np.maximum(radius**2 - offset**2, 0.0)), fine) / (np.pi * radius**2)
    assert share < 0.6
    assert area(zenith_deg, True) / area(111.6, False) == pytest.approx(share, rel=3e-2)


@pytest.mark.parametrize(
    ("impact_m", "height_m"),
    [*itertools.product((-3e6, -3e5, -2e4, -1e3), (0.0, 3e3, 12e3)), (2.5e3, 3e3), (2.5e3, 12e3)],
)
def test_rays_end_where_the_ray_equation_ends_them(mi: Any, impact_m: float, height_m: float) -> None:
    """Place and direction within 1e-5 rad, 60 m, at the ground and at cloud tops, from high above to a grazing ray.

    ``impact_m``: of the straight line, over the ground.
    """
    field = _bending_field(_exponential(2.8e-4, 8000.0))
    impact, d = RADIUS_M + impact_m, np.array([1.0, 0.0, 0.0])
    o = np.array([-np.sqrt((RADIUS_M + 500e3) ** 2 - impact**2), 0.0, impact])
    t0 = -float(o[0]) - np.sqrt((RADIUS_M + 100e3) ** 2 - impact**2)
    _, track = shoot(Air(), (o + (t0 - 1.0) * d)[None], d[None], 1.4e6, 2800)
    states = np.array(track)[:, 0]
    height = np.linalg.norm(states[:, :3], axis=-1) - RADIUS_M
    below = np.flatnonzero(height <= height_m)
    k = below[0]
    w = (height[k - 1] - height_m) / (height[k - 1] - height[k])
    place, arriving = ((1.0 - w) * states[k - 1] + w * states[k])[None, :6].reshape(2, 3)
    scale = _scale(field, 2.8e-4)
    origin, direction = (tuple(mi.Float64(float(v)) for v in vector) for vector in (scale * o, d))
    apparent = height_m + 2.8e-4 * (np.exp(-height_m / 8000.0) * (RADIUS_M + height_m) - RADIUS_M)
    middle, half, _ = field.planet.chord(origin, direction, mi.Float64(scale * apparent))
    end = ray_end(field.planet, field, origin, direction, middle - half)
    ours = np.array([float(c[0]) for c in end.point])
    assert float(end.height_m[0]) == pytest.approx(height_m, abs=5.0)
    assert np.linalg.norm(ours - place) < 100.0
    theirs = arriving / np.linalg.norm(arriving)
    assert np.linalg.norm([float(c[0]) for c in end.direction] - theirs) < 1e-5
