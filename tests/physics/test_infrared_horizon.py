"""The infrared horizon of the truth against a table made by other code, and against closed forms."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar
from scipy.special import k1e

from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.column import OpticalModel
from horizonval.earth.optical import optical_model
from horizonval.earth.surface.ground_emission import GroundEmission, uniform_ground
from horizonval.frame import FrameTruth
from horizonval.geometry.ellipsoid import WGS84, itrs_from_geodetic, sphere
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import truth_of
from horizonval.truth.infrared_horizon import infrared_horizon
from horizonval.truth.infrared_radiance import BandMedium, ground_ray, limb_radiances, ray_paths

SPHERE = sphere(6_371_230.0)
CAMERA_M = np.array([6_371_230.0 + 500e3, 0.0, 0.0])

# Height of half the plateau [km] and plateau [W m-2 sr-1] of 14.0 to 16.3 um with 420 ppm of CO2, planet of 6371.23 km.
# Made with the same k-distribution by another integrator on its own grid, which agrees with sasktran2 to 2e-4 (notes of
# the table's makers, printed to 0.01).
LIMB = {
    "tropical": (41.53, 5.79),
    "midlatitude_summer": (42.40, 6.23),
    "midlatitude_winter": (40.37, 4.89),
    "subarctic_summer": (42.64, 6.59),
    "subarctic_winter": (38.00, 4.53),
    "us_standard": (41.23, 5.54),
}


def scene(profile: str, **platform: Any) -> SceneSpec:
    """Clean air: the integrators it is compared with have no particles."""
    return SceneSpec.model_validate(
        {
            "camera": {"file": "t"},
            "platform": {"altitude_km": 500.0} | platform,
            "atmosphere": {"profile": profile, "aerosol": "none", "halocarbons": False, "refraction": False},
        }
    )


def camera(*ranges_um: tuple[float, float]) -> CameraSpec:
    bands = [{"name": f"b{i}", "kind": "thermal", "lo_um": lo, "hi_um": hi} for i, (lo, hi) in enumerate(ranges_um)]
    return CameraSpec.model_validate({"camera": {"width": 1, "height": 1, "fov_deg": 1}, "band": bands})


def model_of(profile: str, lo_um: float = 14.0, hi_um: float = 16.3, **platform: Any) -> OpticalModel:
    return optical_model(scene(profile, **platform), camera((lo_um, hi_um)))


def exponential(k0_per_m: float, scale_m: float, temperature_k: float = 250.0) -> OpticalModel:
    """An isothermal absorber that falls exponentially, above a black ground of the same temperature."""
    model = model_of("us_standard")
    z = model.thermal[0].altitude_m
    band = replace(
        model.thermal[0],
        wavelength_um=np.array([15.0]),
        level_m=z,
        ln_extinction=(math.log(k0_per_m) - z / scale_m)[None, None, :],
        temperature_k=np.full((1, len(z)), temperature_k),
        source_weight_per_cm=model.thermal[0].source_weight_per_cm.sum(axis=0, keepdims=True),
        sun_radiance=np.zeros(1),
    )
    return replace(model, thermal=(band,), emission=black(temperature_k))


def black(temperature_k: float) -> GroundEmission:
    return uniform_ground(temperature_k, 1.0)


def depth(height_m: float, k0_per_m: float, scale_m: float) -> float:
    """Optical depth of a limb ray: ``k0 exp(R/H) 2 b K1(b/H)``, b = R + h, for an exponential without top."""
    b = SPHERE.a_m + height_m
    return k0_per_m * 2.0 * b * float(k1e(b / scale_m)) * math.exp(-height_m / scale_m)


@pytest.mark.parametrize("climate", list(LIMB))
def test_half_plateau_of_the_climates(climate: str) -> None:
    found = infrared_horizon(model_of(climate), CAMERA_M, SPHERE)["b0"]
    height, plateau = LIMB[climate]
    assert found["kind"] == "opaque"
    # Theirs is linear between radiances 2 km apart and printed to 0.01 km; 1 km of height is 5 % of radiance there.
    assert found["half_plateau_height_m"][0] / 1e3 == pytest.approx(height, abs=0.05)
    # Printed to 0.01, and the largest of values 2 km apart.
    assert found["plateau_radiance"][0] == pytest.approx(plateau, rel=3e-3)
    assert len(set(found["half_plateau_height_m"])) == 1


@pytest.mark.parametrize("interval", ["14.0-16.3um", "8-14um"])
@pytest.mark.parametrize("climate", ["us_standard", "tropical"])
def test_radiances_of_another_integrator(climate: str, interval: str) -> None:
    with (Path(__file__).parents[1] / "data" / "thermal_limb.csv").open() as file:
        rows = [r for r in csv.DictReader(file) if r["atmosphere"] == climate and r["interval"] == interval]
    rows = [r for r in rows if float(r["tangent_height_km"]) > 0]
    assert len(rows) > 5
    lo, hi = (float(x) for x in interval.removesuffix("um").split("-"))
    heights = np.array([float(r["tangent_height_km"]) for r in rows]) * 1e3
    air = BandMedium(model_of(climate, lo, hi).thermal[0])
    found = limb_radiances([air], ray_paths(CAMERA_M, SPHERE, [0.4], heights, air.top_m))[0][0]
    # Five figures printed; 2e-3 for the cut bins of 14.0 to 16.3 um and both codes' steps.
    np.testing.assert_allclose(found, [float(r["radiance_420ppm_W_m2_sr"]) for r in rows], rtol=2e-3)


@pytest.mark.parametrize("band_um", [(14.0, 16.3), (8.0, 14.0), (10.5, 12.5)])
@pytest.mark.parametrize("climate", ["tropical", "subarctic_winter"])
def test_the_quadrature_has_converged(climate: str, band_um: tuple[float, float]) -> None:
    """Shells eight times thinner change the radiance by less than 1e-4 of the brightest."""
    air = BandMedium(model_of(climate, *band_um).thermal[0])
    rays = ray_paths(CAMERA_M, SPHERE, [0.0], np.array([0.0, 2e3, 5.3e3, 9e3, 16e3, 24.7e3, 38e3, 50e3]), air.top_m)
    (coarse,), (fine,) = limb_radiances([air], rays), limb_radiances([air], rays, step_m=125.0)
    assert np.abs(coarse - fine).max() < 1e-4 * fine.max()
    down = ray_paths(CAMERA_M, SPHERE, [0.0], [-10e3], air.top_m)[0]
    (path, passed), (path_fine, passed_fine) = ground_ray(air, down), ground_ray(air, down, step_m=125.0)
    assert abs(path.sum() - path_fine.sum()) < 2e-4 * path_fine.sum()
    assert np.abs(passed - passed_fine).max() < 2e-4


def test_bands_together_are_each_alone() -> None:
    """In air by latitude, with cirrus that is in two bands of four: those are cut at other places than the rest."""
    clear = scene("by_latitude_month", latitude_deg=40.0)
    cirrus = SceneSpec.model_validate(clear.model_dump(exclude_unset=True) | {"layer": [{"kind": "subvisible_cirrus"}]})
    bands = [
        *optical_model(clear, camera((14.0, 16.3), (8.0, 14.0))).thermal,
        *optical_model(cirrus, camera((8.0, 14.0), (10.5, 12.5))).thermal,
    ]
    airs = [BandMedium(band) for band in bands]
    assert [air.layout == airs[0].layout for air in airs] == [True, True, False, False]
    assert airs[2].layout == airs[3].layout
    rays = ray_paths(CAMERA_M, SPHERE, [0.0, 1.0, 2.5], np.array([0.0, 8e3, 12e3, 30e3]), airs[0].top_m)
    for air, found in zip(airs, limb_radiances(airs, rays), strict=True):
        np.testing.assert_array_equal(found, limb_radiances([air], rays)[0])


SCALE_M = 7000.0


def test_isothermal_exponential_limb_has_the_closed_form() -> None:
    """``L = B (1 - exp(-tau))`` at every height."""
    k0 = 1.0 / depth(40e3, 1.0, SCALE_M)
    model = exponential(k0, SCALE_M)
    air = BandMedium(model.thermal[0])
    heights = np.array([5e3, 20e3, 30e3, 36e3, 40e3, 47.3e3, 60e3])
    found = limb_radiances([air], ray_paths(CAMERA_M, SPHERE, [1.0], heights, air.top_m))[0][0]
    full = float(model.thermal[0].source(250.0)[0])
    tau = np.array([depth(h, k0, SCALE_M) for h in heights])
    # The band is linear in height over 100 m, 2.5e-5 above the exponential, and ends at 100 km (exp(-8.6) of what a
    # ray at 40 km meets, 3e-3 of what one at 60 km meets).
    np.testing.assert_allclose(found[:-1], full * -np.expm1(-tau[:-1]), rtol=3e-4)
    assert found[-1] == pytest.approx(full * -math.expm1(-tau[-1]), rel=5e-3)


def test_isothermal_exponential_limb_drops_where_it_must() -> None:
    """Half height where tau = ln 2; steepest where tau = 1, since ``-dL/dh = B tau exp(-tau) / H``."""
    k0 = 1.0 / depth(40e3, 1.0, SCALE_M)
    found = infrared_horizon(exponential(k0, SCALE_M), CAMERA_M, SPHERE)["b0"]
    half = brentq(lambda h: depth(h, k0, SCALE_M) - math.log(2.0), 20e3, 60e3)
    # 3e-4 of radiance is 3 m.
    assert found["half_plateau_height_m"][7] == pytest.approx(half, abs=5.0)
    assert half == pytest.approx(40e3 + SCALE_M * math.log(1.0 / math.log(2.0)), abs=3.0)

    def slope(h: float) -> float:
        return math.exp(-depth(h + 1.0, k0, SCALE_M)) - math.exp(-depth(h - 1.0, k0, SCALE_M))

    steepest = minimize_scalar(lambda h: -slope(h), bounds=(30e3, 50e3), method="bounded").x
    assert steepest == pytest.approx(40e3, abs=20.0)
    # A broad maximum seen through a spline of 0.5 km.
    assert found["maximum_gradient_height_m"][7] == pytest.approx(steepest, abs=20.0)


def test_a_limb_without_air_to_speak_of_drops_at_the_ground() -> None:
    found = infrared_horizon(exponential(1e-9, SCALE_M), CAMERA_M, SPHERE)["b0"]
    assert found["kind"] == "window"
    assert set(found["half_plateau_height_m"]) == {0.0}
    assert found["half_plateau_angle_rad"] == found["geometric_angle_rad"]


def test_the_plateau_of_a_window_follows_the_ground() -> None:
    """Without air to speak of the ray to the ground has the ground's own light: emissivity and the hour of the day."""
    model = exponential(1e-9, SCALE_M)
    full = float(model.thermal[0].source(250.0)[0])
    grey = replace(model, emission=replace(black(250.0), emissivity=0.9))
    assert infrared_horizon(grey, CAMERA_M, SPHERE)["b0"]["plateau_radiance"][5] == pytest.approx(0.9 * full, rel=2e-3)
    swing = (10.0, 10.0)
    earth_like = uniform_ground(250.0, 1.0, kind="earth")
    emission = replace(earth_like, water_k=(240.0, 240.0), diurnal_k=swing, desert_diurnal_k=swing)
    place = itrs_from_geodetic(math.radians(20.0), math.radians(20.0), 500e3)
    # Half past one over the Sahara: the Sun has gone 22.5 deg further west.
    sun = (math.cos(math.radians(-2.5)), math.sin(math.radians(-2.5)), 0.0)
    earth = replace(model, emission=emission)
    found = infrared_horizon(earth, place, WGS84, sun_itrs=sun)["b0"]
    # Desert and soil of emissivity 0.96 or so, 260 K when warmest; 22 deg of longitude away that is 0.6 K less.
    warmest = max(found["plateau_radiance"])
    assert 0.95 < warmest / float(model.thermal[0].source(260.0)[0]) < 0.99
    # Northward lies the Mediterranean, and the sea sends little of its own at 3 deg from the level.
    assert min(found["plateau_radiance"][-2:] + found["plateau_radiance"][:3]) < 0.6 * warmest


def test_angles_are_those_of_the_heights() -> None:
    """On a sphere ``sin(angle) = (R + h) / D``, to the 0.1 m of the stored heights: 1e-7 rad from 500 km."""
    found = infrared_horizon(model_of("us_standard"), CAMERA_M, SPHERE)["b0"]
    distance = float(np.linalg.norm(CAMERA_M))
    for name in ("half_plateau", "maximum_gradient"):
        expected = np.arcsin((SPHERE.a_m + np.array(found[f"{name}_height_m"])) / distance)
        np.testing.assert_allclose(found[f"{name}_angle_rad"], expected, rtol=0, atol=2e-9)
    np.testing.assert_allclose(found["geometric_angle_rad"], math.asin(SPHERE.a_m / distance), rtol=0, atol=2e-9)


def test_a_winter_horizon_is_lower_towards_the_pole() -> None:
    """January at 45 N from 500 km: in the north the limb lies at 67 N, in subarctic winter; in the south at 23 N."""
    model = model_of("by_latitude_month", latitude_deg=45.0, epoch_utc="2026-01-15T12:00:00Z")
    place = itrs_from_geodetic(math.radians(45.0), 0.2, 500e3)
    found = infrared_horizon(model, place, WGS84)["b0"]
    height = np.array(found["half_plateau_height_m"]) / 1e3
    north, south = height[0], height[18]
    # 20 m of the ellipsoid's curvature; rays that reach 10 deg further south see a milder winter.
    assert north == pytest.approx(LIMB["subarctic_winter"][0], abs=0.1)
    assert found["plateau_radiance"][0] == pytest.approx(LIMB["subarctic_winter"][1], rel=0.01)
    # Between midlatitude winter and the tropics.
    assert LIMB["midlatitude_winter"][0] + 0.5 < south < LIMB["tropical"][0] + 0.5
    # In the far north a trace of midlatitude winter lowers it by 35 m before it rises.
    np.testing.assert_allclose(height[:4], north, rtol=0, atol=0.05)
    assert np.all(np.diff(height[3:17]) > 0.0)
    np.testing.assert_array_equal(height[1:18], height[:18:-1])


def test_the_north_in_july_is_the_south_in_january() -> None:
    """Climates six months apart swap their hemispheres."""
    heights = []
    for latitude, month in ((40.0, 1), (-40.0, 7)):
        model = model_of("by_latitude_month", latitude_deg=latitude, epoch_utc=f"2026-{month:02d}-15T12:00:00Z")
        place = itrs_from_geodetic(math.radians(latitude), 0.0, 800e3)
        found = infrared_horizon(model, place, WGS84)["b0"]["half_plateau_height_m"]
        heights.append(np.array(found[:19]))
    # The middles of January and July are not quite half a year apart: 0.3 % of the blend.
    np.testing.assert_allclose(heights[1], heights[0][::-1], rtol=0, atol=60.0)


def doubled(band: EmittingBand) -> EmittingBand:
    """The same air in two rows, which takes the way of air that changes with latitude."""
    return replace(
        band,
        sin_latitude=np.array([-1.0, 1.0]),
        ln_extinction=np.repeat(band.ln_extinction, 2, axis=1),
        temperature_k=np.repeat(band.temperature_k, 2, axis=0),
    )


@pytest.mark.parametrize(("latitude_deg", "altitude_km"), [(50.0, 500.0), (-8.0, 35_786.0), (90.0, 800.0)])
def test_uniform_air_needs_few_azimuths(latitude_deg: float, altitude_km: float) -> None:
    model = model_of("midlatitude_summer")
    place = itrs_from_geodetic(math.radians(latitude_deg), 1.0, altitude_km * 1e3)
    few = infrared_horizon(model, place, WGS84)["b0"]
    every = infrared_horizon(replace(model, thermal=(doubled(model.thermal[0]),)), place, WGS84)["b0"]
    for name in ("half_plateau_height_m", "maximum_gradient_height_m"):
        np.testing.assert_allclose(few[name], every[name], rtol=0, atol=0.21)
    np.testing.assert_allclose(few["plateau_radiance"], every["plateau_radiance"], rtol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("altitude_km", "rms_m", "most_m"), [(500.0, 40.0, 120.0), (35_786.0, 90.0, 300.0)])
def test_between_the_azimuths_heights_are_linear(altitude_km: float, rms_m: float, most_m: float) -> None:
    platform: dict[str, Any] = {"latitude_deg": 30.0, "altitude_km": altitude_km, "epoch_utc": "2026-01-15T12:00:00Z"}
    model = model_of("by_latitude_month", **platform)
    place = itrs_from_geodetic(math.radians(30.0), 0.0, altitude_km * 1e3)
    stored = np.array(infrared_horizon(model, place, WGS84)["b0"]["half_plateau_height_m"])
    dense = np.array(infrared_horizon(model, place, WGS84, azimuths=72)["b0"]["half_plateau_height_m"])
    np.testing.assert_array_equal(dense[::2], stored)
    error = 0.5 * (stored + np.roll(stored, -1)) - dense[1::2]
    assert np.sqrt(np.mean(error**2)) < rms_m
    assert np.abs(error).max() < most_m


def test_inside_the_air_there_is_no_horizon_to_speak_of() -> None:
    model = model_of("us_standard")
    assert infrared_horizon(model, np.array([SPHERE.a_m + 90e3, 0.0, 0.0]), SPHERE) == {}
    assert infrared_horizon(replace(model, thermal=()), CAMERA_M, SPHERE) == {}
    assert infrared_horizon(replace(model, top_m=20e3), CAMERA_M, SPHERE) == {}


@pytest.mark.parametrize("altitude_m", [120e3, 2e9])
def test_near_and_far_cameras_see_the_same_horizon(altitude_m: float) -> None:
    """All rays of a sphere's uniform air with one lowest height are alike, from wherever one looks along them."""
    found = infrared_horizon(model_of("us_standard"), np.array([0.0, 0.0, SPHERE.a_m + altitude_m]), SPHERE)["b0"]
    near = infrared_horizon(model_of("us_standard"), CAMERA_M, SPHERE)["b0"]
    # Coordinates 2e9 m away are rounded to 0.2 um; heights are stored to 0.1 m.
    np.testing.assert_allclose(found["half_plateau_height_m"], near["half_plateau_height_m"], rtol=0, atol=0.11)


def test_small_planets_have_their_own() -> None:
    """A shorter path through the same air: the half moves down by ``H ln(sqrt(R / R'))``."""
    k0, radius = 1.0 / depth(40e3, 1.0, SCALE_M), 2.0e6
    model = exponential(k0, SCALE_M)
    small = infrared_horizon(model, np.array([radius + 500e3, 0.0, 0.0]), sphere(radius))["b0"]
    large = infrared_horizon(model, CAMERA_M, SPHERE)["b0"]
    b = (radius + 40e3) / SCALE_M
    # Exactly by K1; the chord of the sphere's radius alone is 30 m off.
    ratio = b * k1e(b) * SCALE_M / ((SPHERE.a_m + 40e3) * k1e((SPHERE.a_m + 40e3) / SCALE_M))
    moved = large["half_plateau_height_m"][0] - small["half_plateau_height_m"][0]
    assert moved == pytest.approx(-SCALE_M * math.log(ratio), abs=40.0)


@pytest.mark.slow
def test_the_renderer_agrees() -> None:
    """A column of a frame, over winter air that changes with latitude, drops where the truth says.

    The renderer has other rays, other steps and another quadrature. 2 m of 470 m pixels in the opaque band; in the
    window the chord between two pixels' centres is 10 m off.
    """
    from horizonval.renderer.frame import render_frame

    tables = {"camera": {"width": 4, "height": 300, "fx": 6000.0, "fy": 6000.0}}
    spec = CameraSpec.model_validate(camera((14.0, 16.3), (8.0, 14.0)).model_dump(mode="json") | tables)
    described = scene("by_latitude_month", latitude_deg=40.0, epoch_utc="2026-01-15T12:00:00Z").model_dump(
        mode="json", exclude_unset=True
    )
    # Rolled and yawed so that the camera looks north.
    described |= {"attitude": {"yaw_deg": 90.0, "roll_deg": 67.7}, "render": {"subsamples": 1}}
    frame = render_frame(SceneSpec.model_validate(described), spec)
    height = frame.maps["tangent_height"][::-1, 2].astype(float)
    for name, height_m, share in (("b0", 10.0, 3e-4), ("b1", 25.0, 3e-4)):
        radiance = frame.radiance[name][::-1, 2].astype(float)
        stored = frame.truth.infrared_horizon[name]
        plateau = np.interp(-10e3, height, radiance)
        if stored["kind"] == "opaque":
            plateau = radiance[(height > 10e3) & (height < 24e3)].max()
        assert plateau == pytest.approx(stored["plateau_radiance"][0], rel=share)
        last = np.flatnonzero(radiance >= 0.5 * plateau)[-1]
        half = np.interp(-0.5 * plateau, -radiance[last : last + 2], height[last : last + 2])
        assert half == pytest.approx(stored["half_plateau_height_m"][0], abs=height_m)


def test_truths_of_thermal_cameras_have_it() -> None:
    spec = camera((14.0, 16.3), (8.0, 14.0))
    truth = truth_of(scene("us_standard"), spec)
    assert list(truth.infrared_horizon) == ["b0", "b1"]
    assert len(truth.infrared_horizon["b1"]["half_plateau_angle_rad"]) == 36
    stated = truth.infrared_horizon["b0"]["accuracy"]
    assert (stated["interval"], stated["half_height_km"]) == ("14.0-16.3 um", 2.0)
    assert stated["heights_km"][0] == [None, 0.0]
    assert FrameTruth.from_dict(json.loads(json.dumps(truth.to_dict(), allow_nan=False))) == truth
    plain = truth_of(scene("us_standard"), spec, infrared=False)
    assert plain.infrared_horizon == {}
    assert plain == replace(truth, infrared_horizon={})
    tables = {"camera": {"file": "t"}, "platform": {"altitude_km": 500.0}, "atmosphere": {"profile": "none"}}
    airless = SceneSpec.model_validate(tables)
    assert truth_of(airless, spec).infrared_horizon == {}
    solar = {"name": "v", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6}
    visible = CameraSpec.model_validate({"camera": {"width": 1, "height": 1, "fov_deg": 1}, "band": [solar]})
    assert truth_of(scene("us_standard"), visible).infrared_horizon == {}
