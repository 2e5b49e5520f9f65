"""Derivatives of frames against closed forms, differences of marched frames over other steps, and physics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import horizonval as hv
from horizonval.api.derivatives import image_derivatives, level_axes
from horizonval.core.errors import UserError
from horizonval.earth.atmosphere.air import AirChange
from horizonval.earth.atmosphere.profiles import profile

SIZE = 20
TURNED = {"yaw_deg": 13.0, "pitch_deg": 7.3}
SINGLE = {"orders": "single", "nodes": 64}


def _visible(**changes: Any) -> hv.Scene:
    camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": SIZE, "height": SIZE})
    keys: dict[str, Any] = {"altitude_km": 550, "latitude_deg": 10, "mount_roll_deg": 65, "attitude": TURNED}
    return hv.Scene(camera=camera, **{**keys, "render": SINGLE, **changes})


def _infrared() -> hv.Scene:
    scene = hv.Scene.from_file("ir-limb-tropical")
    band = [b.model_dump(exclude_unset=True) for b in scene.camera.spec.band if b.name == "co2"]
    camera = scene.camera.changed(camera={"width": SIZE, "height": SIZE}, band=band, detector={"netd_band": "co2"})
    return scene.changed(camera=camera, attitude=TURNED, surface={"kind": "uniform"}, render={"nodes": 32})


def _worst_of_most(scene: hv.Scene, parameters: tuple[str, ...], **other: Any) -> dict[str, float]:
    """Return the error against differences over a third of the step that 95 % of all pixels have at most.

    As a share of the largest derivative. The others have a cell that the hard edge enters or leaves.
    """
    found = image_derivatives(scene, parameters)
    expected = image_derivatives(scene.changed(**other) if other else scene, parameters, scale=1 / 3)
    band = next(iter(found[parameters[0]]))
    pairs = {p: (found[p][band], expected[p][band]) for p in parameters}
    return {p: float(np.quantile(np.abs(a - b), 0.95) / np.abs(b).max()) for p, (a, b) in pairs.items()}


@pytest.mark.parametrize("make", [_visible, _infrared])
def test_differences_equal_those_over_a_smaller_step(make: Any) -> None:
    assert max(_worst_of_most(make(), ("rotation_x", "north")).values()) < 1e-4


def test_frames_from_tables_have_the_slopes_of_marched_frames() -> None:
    worst = _worst_of_most(_visible(), ("rotation_z", "up"), render={**SINGLE, "method": "march"})
    assert max(worst.values()) < 1e-3


@pytest.mark.slow
def test_position_in_light_of_all_orders_has_small_rounding_errors() -> None:
    assert _worst_of_most(_visible(render={**SINGLE, "orders": "all"}), ("up",))["up"] < 3e-3


def test_jumps_of_coasts_and_clouds_are_left_out() -> None:
    """Jumps reach a hundred times the radiance per pixel, in 6 % of these pixels; few have one to both sides."""
    scene = _visible(surface={"kind": "earth"}, clouds={"cover": 0.5})
    found = image_derivatives(scene, ("rotation_x", "gain"))
    per_pixel = np.abs(found["rotation_x"]["vis"]) / hv.render(scene, progress=False).truth.camera_model.fx
    assert np.quantile(per_pixel, 0.99) < 5.0 * found["gain"]["vis"].max()


def test_a_turn_about_the_boresight_moves_the_image_about_its_middle() -> None:
    """A frame far from the limb is differentiated by its own pixels."""
    scene = _visible(mount_roll_deg=0.0, attitude={"yaw_deg": 0.0}, sun={"zenith_deg": 60.0, "azimuth_deg": 40.0})
    scene = scene.changed(camera=scene.camera.changed(camera={"width": 41, "height": 41, "fov_deg": 30.0}))
    images = image_derivatives(scene, ("rotation_z", "gain"))
    by_row, by_column = np.gradient(images["gain"]["vis"])
    x = np.arange(41) - 20.0
    expected = -(by_row * x[None, :] - by_column * x[:, None])
    inner = slice(3, -3)
    difference = np.abs(images["rotation_z"]["vis"] + expected)[inner, inner]
    assert difference.max() < 0.02 * np.abs(expected[inner, inner]).max()


def test_warmer_air_is_in_hydrostatic_balance_over_the_same_pressure() -> None:
    """``d ln p / dz = -M g / (R T)`` before and after; the change is integrated over 1 km levels."""
    z = np.linspace(0.0, 60e3, 601)
    state = profile("us_standard").at(z)
    warm = AirChange(warmer_k=3.0).state(state)
    assert warm.pressure_pa[0] == pytest.approx(state.pressure_pa[0], rel=1e-14)
    np.testing.assert_allclose(warm.temperature_k - state.temperature_k, 3.0, rtol=1e-12)
    gravity = 9.80665 * (6_356_766.0 / (6_356_766.0 + z)) ** 2
    slope = 28.9644e-3 * gravity / 8.314462618 * (1.0 / state.temperature_k - 1.0 / warm.temperature_k)
    found = np.gradient(np.log(warm.pressure_pa / state.pressure_pa), z)
    np.testing.assert_allclose(found[1:-1], slope[1:-1], rtol=2e-3)
    np.testing.assert_allclose(
        warm.number_density_air * warm.temperature_k / warm.pressure_pa,
        state.number_density_air * state.temperature_k / state.pressure_pa,
        rtol=1e-12,
    )


def test_derivatives_by_the_air_have_the_signs_of_physics() -> None:
    """A denser, thin limb scatters more; raised air shines more above where it was; without particles none count."""
    scene = _visible(atmosphere={"aerosol": "none"})
    scene = scene.changed(camera=scene.camera.changed(camera={"fov_deg": 6.0}), mount_roll_deg=68.0)
    scene = scene.changed(attitude={"yaw_deg": 1.0, "pitch_deg": 1.0})
    names = ("density", "limb_height", "aerosol", "gain")
    image = {name: bands["vis"] for name, bands in image_derivatives(scene, names).items()}
    frame = hv.render(scene, progress=False)
    tangent = frame.maps["tangent_height"]
    thin = (tangent > 45e3) & (tangent < 70e3)
    assert thin.sum() > 5
    ratio = image["density"][thin] / image["gain"][thin]
    np.testing.assert_allclose(ratio, 1.0, atol=0.03)
    scale_height = image["gain"][thin] / image["limb_height"][thin]
    assert np.all((scale_height > 5e3) & (scale_height < 10e3))
    assert not image["aerosol"].any()


def test_level_axes_are_east_north_and_up() -> None:
    from horizonval.geometry.ellipsoid import WGS84, geodetic_height, itrs_from_geodetic

    r = itrs_from_geodetic(np.radians(40.0), np.radians(30.0), 500e3, WGS84)
    axes = level_axes(r, WGS84)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    heights = [float(geodetic_height(r + axis, WGS84)) - float(geodetic_height(r, WGS84)) for axis in axes]
    np.testing.assert_allclose(heights, [0.0, 0.0, 1.0], atol=1e-6)
    assert axes[1][2] > 0.0
    assert np.cross(axes[1], axes[2]) == pytest.approx(axes[0])


def test_the_interface_gives_images_and_refuses_unknown_parameters() -> None:
    frame = hv.render(_visible(), progress=False)
    slopes = frame.derivatives(parameters=["rotation_y", "gain"], progress=False)
    assert slopes.parameters == ("rotation_y", "gain")
    assert slopes.jacobian("vis").shape == (SIZE, SIZE, 2)
    assert slopes.units["rotation_y"] == "W m-2 sr-1 rad-1"
    image = frame.radiance["vis"]
    np.testing.assert_allclose(slopes.images["gain"]["vis"], image, rtol=0.0, atol=1e-3 * image.max())
    with pytest.raises(UserError, match="unknown parameter 'rotation'"):
        frame.derivatives(parameters=["rotation"])
    with pytest.raises(UserError, match="no band 'ir'"):
        slopes.jacobian("ir")
