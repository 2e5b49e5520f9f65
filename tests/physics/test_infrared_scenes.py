"""The shipped infrared scenes show what they are there for: frames against published values and ray integrals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import horizonval.renderer  # noqa: F401  (names the LLVM library before any test imports Dr.Jit)
from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.atmosphere.profiles import profile
from horizonval.earth.optical import optical_model
from horizonval.earth.spectral.planck import brightness_temperature_k
from horizonval.frame import Hit, RadianceFrame
from horizonval.geometry.camera import pixel_grid, unproject
from horizonval.geometry.ellipsoid import geodetic_from_itrs
from horizonval.geometry.frames import inverse, rotate
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import deep_merge, load_scene
from horizonval.spec.scene import SceneSpec

Render = Callable[..., RadianceFrame]


def with_changes(
    name: str, bands: str, width: int, height: int, fov_deg: float, **changes: Any
) -> tuple[SceneSpec, CameraSpec]:
    """Return a shipped scene with some keys changed, one ray per pixel, seen in some bands by a smaller camera."""
    scene, camera = load_scene(name)
    geometry = camera.camera.model_copy(update={"width": width, "height": height, "fov_deg": fov_deg})
    chosen = [band for band in camera.band if band.name in bands.split()]
    tables = deep_merge(scene.model_dump(exclude_unset=True), {"render": {"subsamples": 1, "nodes": 64}, **changes})
    return SceneSpec.model_validate(tables), CameraSpec(camera=geometry, band=chosen)


@pytest.fixture(scope="module")
def rendered() -> Render:
    """Render a scene as :func:`with_changes` has it; the same one only once."""
    done: dict[str, RadianceFrame] = {}

    def render(*arguments: Any, **changes: Any) -> RadianceFrame:
        key = repr((arguments, changes))
        if key not in done:
            done[key] = render_frame(*with_changes(*arguments, **changes))
        return done[key]

    return render


def rays_itrs(frame: RadianceFrame) -> FloatArray:
    """Return the directions of all pixels' centres, shape (H, W, 3)."""
    camera = frame.truth.camera_model
    return rotate(inverse(frame.truth.q_cam_from_itrs), unproject(camera, pixel_grid(camera)))


def ends(frame: RadianceFrame) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return latitude and longitude [rad] and height [m] of what pixels see; where that is nothing, the camera's."""
    distance = np.where(np.isfinite(frame.maps["distance"]), frame.maps["distance"], 0.0).astype(float)
    return geodetic_from_itrs(np.array(frame.truth.r_itrs) + rays_itrs(frame) * distance[..., None])


def brightness_k(frame: RadianceFrame, name: str) -> FloatArray:
    band = next(b for b in frame.truth.camera_spec.band if b.name == name)
    return brightness_temperature_k(band, frame.radiance[name])


def below_the_horizon(frame: RadianceFrame) -> NDArray[np.bool_]:
    """Where a pixel and its neighbours see ground or cloud and nothing else: chords deeper than two pixels."""
    return frame.maps["tangent_height"] < -60e3


DAY_AND_NIGHT = ("co2 co2-narrow window", 48, 40, 24.0)


def test_the_carbon_dioxide_limb_does_not_know_day_from_night(rendered: Render) -> None:
    day, night = (rendered(name, *DAY_AND_NIGHT) for name in ("ir-day-side", "ir-night-side"))
    # A pixel is 27 km high: none of these sees any ground.
    limb = day.maps["tangent_height"] > 20e3
    assert ((day.radiance["co2"] > 0.1) & limb).sum() > 48
    for band in ("co2", "co2-narrow"):
        assert day.radiance[band][limb].tobytes() == night.radiance[band][limb].tobytes(), band
        # At the band's edges a little of the ground is seen between the lines.
        assert np.abs(brightness_k(day, band) - brightness_k(night, band)).max() < 0.4, band


def test_land_has_its_day_in_the_window_and_the_sea_has_none(rendered: Render) -> None:
    day, night = (rendered(name, *DAY_AND_NIGHT) for name in ("ir-day-side", "ir-night-side"))
    latitude, longitude, _ = np.degrees(ends(day))
    # Clear of the coasts by more than a pixel, which is 0.4 deg high at 32 N and 0.8 deg at 36 N.
    libya = below_the_horizon(day) & (latitude < 31.8) & (longitude > 11.0) & (longitude < 14.5)
    sea = below_the_horizon(day) & (latitude > 31.2) & (latitude < 36.0) & (longitude > 17.0) & (longitude < 19.3)
    sea |= below_the_horizon(day) & (latitude > 33.7) & (latitude < 36.0) & (longitude > 14.0) & (longitude < 19.3)
    assert min(libya.sum(), sea.sum()) > 60
    swing = brightness_k(day, "window") - brightness_k(night, "window")
    # The skin of dry land is 20 to 30 K warmer by day than by night (Z. Wan and others' MODIS products; A.
    # Sharifnezhadazizi et al., Remote Sens. 11, 2370 (2019)); a third to a half of that is left above humid, slant air.
    assert (swing[libya] > 5.0).all()
    assert (swing[libya] < 20.0).all()
    assert (swing[sea] == 0.0).all()
    # Tripolitania and the Gulf of Sidra.
    shore, gulf = libya & (latitude > 30.5), sea & (latitude < 32.6)
    assert np.median(brightness_k(day, "window")[shore]) > np.median(brightness_k(day, "window")[gulf])


def test_land_is_colder_than_the_sea_by_night(rendered: Render) -> None:
    """Tripolitania and the Gulf of Sidra at midnight in July, seen at the same angle from the vertical.

    The skin of the land is 6 K colder there. Seen lower, the same ground is colder through more air, and a flat sea
    emits less (0.89 at 72 deg, 0.83 at 75.7): medians over all of the shore and all of the gulf, 72 and 75.7 deg from
    the vertical, would compare that.
    """
    night = rendered("ir-night-side", "window", 192, 160, 24.0)
    lat, lon, _ = ends(night)
    up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    zenith = np.degrees(np.arccos(-np.sum(up * rays_itrs(night), axis=-1)))
    latitude, longitude = np.degrees(lat), np.degrees(lon)
    seen, below = brightness_k(night, "window"), below_the_horizon(night)
    shore = below & (latitude > 30.5) & (latitude < 32.4) & (longitude > 10.5) & (longitude < 14.5)
    gulf = below & (latitude > 31.0) & (latitude < 32.6) & (longitude > 17.0) & (longitude < 19.3)
    for low in (74.25, 74.75, 75.25):
        land, sea = (region & (zenith > low) & (zenith < low + 0.5) for region in (shore, gulf))
        assert min(land.sum(), sea.sum()) > 2
        assert np.median(seen[land]) < np.median(seen[sea])


STRAIGHT = {"refraction": False}
"""The truth's maps, and the rays here, are straight."""


def test_clouds_are_as_cold_in_the_window_as_the_air_at_their_tops(rendered: Render) -> None:
    frame = rendered("ir-cold-cloud", "window", 48, 40, 24.0, atmosphere=STRAIGHT)
    _, _, height = ends(frame)
    air = profile("tropical")
    expected = np.interp(height, air.altitude_m, air.temperature_k)
    high = below_the_horizon(frame) & (frame.maps["hit"] == Hit.CLOUD) & (height > 10e3)
    assert high.sum() > 200
    assert expected[high].min() < 203.0
    # Above 10 km the window has hardly any water vapour left: 0.1 K between cloud and camera. The tables know a top's
    # temperature along the ray between stations, to 0.4 K where it stands at the tropopause.
    np.testing.assert_allclose(brightness_k(frame, "window")[high], expected[high], rtol=0, atol=0.5)


def test_clouds_do_not_reach_the_limb_of_carbon_dioxide(rendered: Render) -> None:
    view: tuple[Any, ...] = ("ir-cold-cloud", "co2-narrow", 12, 96, 2.0)
    clouds, clear = (rendered(*view, camera={"mount_roll_deg": 68.5}, **k) for k in ({}, {"clouds": {"cover": 0.0}}))
    height = clear.maps["tangent_height"]
    found, expected = clouds.radiance["co2-narrow"], clear.radiance["co2-narrow"]
    # The highest tops are at 16 km, a pixel is 8 km high, and half the plateau is reached at 40 km.
    limb = (height > 24e3) & (height < 75e3)
    assert limb.sum() > 70
    np.testing.assert_allclose(found[limb], expected[limb], rtol=1e-3)
    # Below, the band sees through the thin air above a cloud: its cold top costs a little of the radiance.
    low = (height > 0) & (height < 12e3)
    assert low.sum() > 10
    assert np.abs(found[low] / expected[low] - 1.0).max() < 0.05


AU_OF_20_MARCH = 0.9960
SUN: tuple[Any, ...] = ("ir-sun-in-frame", "co2 window", 40, 40, 1.0)
TO_THE_SUN: dict[str, Any] = {"camera": {"mount_yaw_deg": 92.0, "mount_roll_deg": 69.1}, "atmosphere": STRAIGHT}


def transmission(band: EmittingBand, frame: RadianceFrame, pixels: FloatArray) -> FloatArray:
    """Return exp(-tau) per g point of the whole air along rays, shape (n, g): midpoints of equal pieces of 1 km."""
    s = np.arange(500.0, 5e6, 1e3)
    passed = []
    for direction in pixels:
        height = geodetic_from_itrs(np.array(frame.truth.r_itrs) + s[:, None] * direction)[2]
        inside = height < band.level_m[-1]
        ln_k = [np.interp(height[inside], band.level_m, row[0]) for row in band.ln_extinction]
        passed.append(np.exp(-1e3 * np.exp(ln_k).sum(axis=1)))
    return np.array(passed)


def test_the_sun_shines_through_the_limb_and_leaves_it_alone(rendered: Render) -> None:
    with_sun = rendered(*SUN, **TO_THE_SUN)
    without = rendered(*SUN, **TO_THE_SUN, sun={"zenith_deg": 20.0})
    rays = rays_itrs(with_sun)
    off_centre = np.arccos(np.clip(rays @ np.array(with_sun.truth.sun_itrs), -1.0, 1.0))
    radius = with_sun.truth.sun_angular_radius_rad
    pixel = np.radians(1.0 / 40)
    outside, disc = off_centre > radius + pixel, off_centre < radius - pixel
    assert disc.sum() > 250
    model = optical_model(*with_changes(*SUN, **TO_THE_SUN), sun_distance_au=AU_OF_20_MARCH)
    seen = {}
    for band in model.thermal:
        np.testing.assert_allclose(
            with_sun.radiance[band.name][outside], without.radiance[band.name][outside], rtol=1e-6, err_msg=band.name
        )
        excess = with_sun.radiance[band.name].astype(float) - without.radiance[band.name]
        sample = np.argwhere(disc)[:: max(1, disc.sum() // 40)]
        found = excess[tuple(sample.T)]
        expected = transmission(band, with_sun, rays[tuple(sample.T)]) @ band.sun_radiance
        # The frame's tables and 64 nodes against pieces of 1 km: 3e-4; and the Sun's distance, to 1e-4, twice.
        np.testing.assert_allclose(found, expected, rtol=1e-3, err_msg=band.name)
        seen[band.name] = found
    assert seen["co2"].min() < 0.7 * seen["co2"].max()
    assert seen["window"].min() > 0.99 * seen["window"].max()
    # 5036 K at 11.1 um in the centre of the disc (F. Saiedy and R. M. Goody, Mon. Not. R. Astron. Soc. 119, 213
    # (1959)); the mean over the disc is up to 2 % darker, and measurements scatter by 1 %.
    assert brightness_k(with_sun, "window")[disc].mean() == pytest.approx(5000.0, abs=100.0)


def plateau(frame: RadianceFrame, band: str, columns: slice) -> float:
    """Return the mean radiance of the limb between 12 and 24 km in some columns."""
    height = frame.maps["tangent_height"][:, columns]
    return float(frame.radiance[band][:, columns][(height > 12e3) & (height < 24e3)].mean())


def test_one_frame_sees_the_air_of_many_latitudes(rendered: Render) -> None:
    frame = rendered("ir-limb-equinox", "co2", 96, 120, 92.0)
    latitude = np.degrees(ends(frame)[0])[frame.maps["hit"] == Hit.SURFACE]
    assert latitude.min() < 25.0
    assert latitude.max() > 60.0
    everywhere = rendered("ir-limb-equinox", "co2", 96, 120, 92.0, atmosphere={"latitude_deg": 45.0})
    south, north = slice(-12, None), slice(0, 12)
    # Plateaus of 5.75 W m-2 sr-1 in the tropics, 5.0 to 5.2 at 60 N in March, halfway between the subarctic climates'
    # 4.4 and 6.6 and nearer to winter; and one and the same where one column of air serves the whole frame.
    assert plateau(frame, "co2", south) > 1.08 * plateau(frame, "co2", north)
    assert plateau(everywhere, "co2", south) == pytest.approx(plateau(everywhere, "co2", north), rel=0.02)


@pytest.mark.slow
def test_in_march_the_hemispheres_differ(rendered: Render) -> None:
    view: tuple[Any, ...] = ("ir-limb-equinox", "co2", 8, 96, 1.0)
    north, south = (
        rendered(*view, camera={"mount_roll_deg": 63.0}, platform={"latitude_deg": latitude})
        for latitude in (49.0, -49.0)
    )
    # Both see 42 deg: 28 parts of summer and 72 of winter in the north, the other way round in the south. The limbs of
    # the midlatitude climates at 18 km are 6.23 and 4.82 W m-2 sr-1, and temperatures are blended: their logarithms
    # to first order, 3 % for the second.
    expected = (6.23 / 4.82) ** (0.72 - 0.28)
    assert plateau(south, "co2", slice(None)) / plateau(north, "co2", slice(None)) == pytest.approx(expected, rel=0.03)
