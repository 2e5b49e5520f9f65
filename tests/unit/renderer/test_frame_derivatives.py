"""Derivatives of frames against central differences of whole frames, in double precision."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import horizonval as hv
from horizonval.core.errors import UserError
from horizonval.earth.atmosphere.air_change import AS_IT_IS, AirChange
from horizonval.earth.atmosphere.profiles import profile
from horizonval.renderer.derivatives.frame_derivatives import frame_derivatives
from horizonval.renderer.derivatives.parameters import POSE, ROTATIONS, displaced, level_axes
from horizonval.renderer.derivatives.whole_frames import Images, central_difference, radiance_images
from horizonval.renderer.plugin.backend import activate
from horizonval.renderer.scene.description import describe

activate()

SIZE = 20
TURNED = {"yaw_deg": 13.0, "pitch_deg": 7.3}
"""No outline is parallel to the rows: where one just touches a row, the covered share has an infinite second slope."""
SINGLE = {"orders": "single", "nodes": 64}


def _visible(**changes: Any) -> hv.Scene:
    camera = hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": SIZE, "height": SIZE})
    keys: dict[str, Any] = {"altitude_km": 550, "latitude_deg": 10, "mount_roll_deg": 65, "attitude": TURNED}
    return hv.Scene(camera=camera, **{**keys, "render": SINGLE, **changes})


def _infrared(**changes: Any) -> hv.Scene:
    scene = hv.Scene.from_file("ir-limb-tropical")
    band = [b.model_dump(exclude_unset=True) for b in scene.camera.spec.band if b.name == "co2"]
    size = {"width": SIZE, "height": SIZE}
    camera = scene.camera.changed(camera=size, band=band, detector={"netd_band": "co2"})
    return scene.changed(camera=camera, attitude=TURNED, surface={"kind": "uniform"}, render={"nodes": 32}, **changes)


def _worst(
    scene: hv.Scene, parameters: tuple[str, ...], pixels: float = 1e-7, least_steady: float = 0.98
) -> dict[str, float]:
    """Return the largest error by parameter, as a share of the largest derivative; steps are some ``pixels``.

    Pixels in which a frame jumps between the two poses, where a cell begins to be cut by the hard edge, are those of
    which differences over two steps disagree; there are at most a few.
    """
    camera = scene.camera.spec
    described = describe(scene.spec, camera)
    images, _ = frame_derivatives(scene.spec, camera, parameters)
    pixel = np.radians(camera.camera.fov_deg or 24.0) / SIZE
    worst = {}
    for parameter in parameters:

        def at(step: float, parameter: str = parameter) -> Images:
            sensor = displaced(described.sensor, described.truth.ellipsoid, parameter, step)
            return radiance_images(described.limb, sensor)

        step = pixels * pixel * (1.0 if parameter in ROTATIONS else 2e6)
        near, far = central_difference(at, step), central_difference(at, 3.0 * step)
        for band, image in images[parameter].items():
            scale = np.abs(near[band]).max()
            steady = np.abs(near[band] - far[band]) < 1e-5 * scale
            assert steady.mean() > least_steady
            worst[parameter] = float(np.abs(image - near[band])[steady].max() / scale)
    return worst


@pytest.mark.parametrize("parameters", [("rotation_x", "up"), pytest.param(POSE, marks=pytest.mark.slow)])
def test_pose_of_a_marched_frame(parameters: tuple[str, ...]) -> None:
    assert max(_worst(_visible(render={**SINGLE, "method": "march"}), parameters).values()) < 1e-5


def test_attitude_of_a_frame_from_tables() -> None:
    assert max(_worst(_visible(), ROTATIONS).values()) < 1e-5


def test_position_of_a_frame_from_tables() -> None:
    """Each position has its own table, so that steps must be longer, and jumps are more."""
    assert max(_worst(_visible(), ("up", "east"), pixels=3e-4, least_steady=0.95).values()) < 1e-5


@pytest.mark.slow
def test_attitude_of_a_frame_with_all_orders() -> None:
    """The skylight on the ground is found in single precision: over a 1e-3th of a pixel its rounding is 1e-5."""
    scene = _visible(render={**SINGLE, "orders": "all"})
    assert max(_worst(scene, ("rotation_x", "rotation_z"), pixels=1e-3, least_steady=0.8).values()) < 2e-5


@pytest.mark.slow
def test_pose_of_a_frame_through_climates() -> None:
    """Rows of latitude are tables in single precision, and the air bends at each: steps are a 1e-3th of a pixel."""
    keys: dict[str, Any] = {"latitude_deg": 40, "atmosphere": {"profile": "by_latitude_month"}}
    scene = _visible(render={**SINGLE, "method": "march"}, **keys)
    worst = _worst(scene, ("rotation_x", "north"), pixels=1e-3, least_steady=0.0)
    assert worst["rotation_x"] < 1e-4
    assert worst["north"] < 1e-3


@pytest.mark.parametrize("parameters", [("rotation_z", "north"), pytest.param(POSE, marks=pytest.mark.slow)])
def test_pose_of_an_infrared_frame(parameters: tuple[str, ...]) -> None:
    assert max(_worst(_infrared(), parameters).values()) < 1e-5


@pytest.mark.slow
def test_pose_of_an_infrared_frame_with_weather() -> None:
    """The air bends at every column of the map: a step of millimetres has the slopes of the tables' cubics there, which
    are off by 1.2e-3 of the largest derivative; over a kilometre differences and derivative agree to 4e-4."""
    worst = _worst(_infrared(atmosphere={"profile": "weather", "seed": 3}), ("rotation_z", "north"))
    assert worst["rotation_z"] < 1e-5
    assert worst["north"] < 2e-3


def test_a_turn_about_the_boresight_moves_the_image_about_its_middle() -> None:
    """No share of the derivatives' code: a frame far from the limb is differentiated by its own pixels."""
    scene = _visible(mount_roll_deg=0.0, attitude={"yaw_deg": 0.0}, sun_zenith_deg=60.0, sun_azimuth_deg=40.0)
    camera = scene.camera.changed(camera={"width": 41, "height": 41, "fov_deg": 30.0})
    scene = scene.changed(camera=camera)
    images, left_out = frame_derivatives(scene.spec, camera.spec, ("rotation_z", "gain"))
    radiance = images["gain"]["vis"]
    by_row, by_column = np.gradient(radiance)
    x = np.arange(41) - 20.0
    expected = -(by_row * x[None, :] - by_column * x[:, None])
    inner = slice(3, -3)
    difference = np.abs(images["rotation_z"]["vis"] + expected)[inner, inner]
    assert difference.max() < 0.02 * np.abs(expected[inner, inner]).max()
    assert left_out == ()


def test_what_is_left_out_is_said() -> None:
    from horizonval.renderer.derivatives.pose import PoseFrame
    from horizonval.renderer.plugin.plugins import mitsuba_scene

    scene = _visible(surface={"kind": "earth"}, clouds={"cover": 0.5}, sun_zenith_deg=100.0, sun_azimuth_deg=180.0)
    described = describe(scene.spec, scene.camera.spec)
    integrator = mitsuba_scene(described.limb, described.sensor).integrator()
    left_out = PoseFrame.of(integrator, described.sensor, described.truth.ellipsoid).left_out()
    assert left_out == ("coasts", "edges of clouds")


def test_air_without_change_is_the_same_to_the_bit() -> None:
    state = profile("tropical")
    assert AS_IT_IS.state(state) is state
    assert np.all(AS_IT_IS.ln_density(state.altitude_m, state.temperature_k) == 0.0)


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
    images, _ = frame_derivatives(scene.spec, scene.camera.spec, names)
    image = {name: images[name]["vis"] for name in names}
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
    np.testing.assert_array_equal(slopes.images["gain"]["vis"], frame.radiance["vis"])
    with pytest.raises(UserError, match="unknown parameter 'rotation'"):
        frame.derivatives(parameters=["rotation"])
    with pytest.raises(UserError, match="no band 'ir'"):
        slopes.jacobian("ir")
