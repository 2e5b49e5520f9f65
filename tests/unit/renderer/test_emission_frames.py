"""Frames of thermal bands: tables against the direct march, black bodies, clouds, the camera's roll."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from emission_models import black, camera, frame_of, isothermal, scene
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel
from horizonval.earth.optical import optical_model
from horizonval.frame import Hit
from horizonval.geometry.ellipsoid import WGS84
from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.spec.load import load_suite

activate()

CO2 = {"name": "b", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}
WINDOW = {"name": "b", "kind": "thermal", "lo_um": 10.5, "hi_um": 12.5}
VARYING = {"atmosphere": {"profile": "by_latitude_month"}}
WEATHER = {"atmosphere": {"profile": "weather", "seed": 3}}
CLOUDS = {"cover": 0.6, "top_km": 12.0, "mean_top_km": 8.0}


def _view(air: OpticalModel, origin: FloatArray, nodes: int = 256, layer_m: float | None = None) -> Any:
    from horizonval.renderer.kernel.frame_geometry import RayCoordinates
    from horizonval.renderer.planet import Planet
    from horizonval.renderer.position import Position
    from horizonval.renderer.thermal.emission_table import ThermalAir, ThermalView

    b = air.thermal[0]
    assert air.emission is not None
    thermal = ThermalAir.of(b, air.emission)
    planet = Planet(WGS84.a_m, WGS84.b_m)
    coordinates = RayCoordinates.of(planet, origin, thermal.top_m)
    return ThermalView(thermal, Position(planet, tuple(origin.tolist())), coordinates, nodes, 1e-3, layer_m)


def _looked(view: Any, o: Any, d: Any, to_ground: bool) -> Any:
    from horizonval.renderer.thermal.emission_image import RayEnds, mixed, warmth_k
    from horizonval.renderer.thermal.emission_table import mirrored

    values = view.table(to_ground).covered(*_place(view.coordinates, o, d, to_ground))
    if not to_ground:
        return values[0]
    _, normal, _ = mirrored(view.coordinates.planet, o, d)
    return mixed(values, view.air.kinds, RayEnds(None, None, {}, warmth_k(view.air.emission, normal, o)))


def _place(coordinates: Any, o: Any, d: Any, to_ground: bool) -> Any:
    from horizonval.renderer.view_table.ray_table import RayPlane

    return RayPlane(coordinates, to_ground).place(o, d)


@pytest.mark.parametrize(
    ("table", "altitude_m", "spectrum"),
    [
        (VARYING, 500e3, CO2),
        (WEATHER, 500e3, WINDOW),
        *(
            pytest.param(table, altitude_m, spectrum, marks=pytest.mark.slow)
            for table in ({}, VARYING, WEATHER)
            for altitude_m in (500e3, 30e3, 35786e3)
            for spectrum in (CO2, WINDOW)
        ),
    ],
)
def test_tables_say_what_the_march_says(table: dict[str, Any], altitude_m: float, spectrum: dict[str, Any]) -> None:
    """2e-3 of the bright limb at worst and a median of 4e-4, among rays that crowd where radiance bends.

    A quarter of them passes within 2 km of the hard limb, as many near 16 km. 5e-3 from a geostationary orbit, where
    two climates meet along the limb, and from a balloon, around which the steps are long.
    """
    from horizonval.renderer.rays import thermal_radiance
    from horizonval.renderer.tables import vectors
    from horizonval.renderer.thermal.emission_table import nodes_for

    most = 2e-3 if 1e5 < altitude_m < 1e7 else 5e-3
    air = replace(optical_model(scene(**table), camera(spectrum)), refractivity=None)
    latitude = np.radians(20.0)
    origin = (WGS84.a_m - 2e3 + altitude_m) * np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    view = _view(air, origin, nodes_for(128))
    coordinates = view.coordinates
    rng = np.random.default_rng(np.random.SeedSequence(5))
    height = np.concatenate([rng.uniform(0, 2e3, 100), rng.uniform(14.5e3, 17e3, 100), rng.uniform(0, 90e3, 200)])
    if coordinates.inside:
        radius = coordinates.distance_m
        dip = np.arccos(np.minimum((WGS84.a_m + height) / radius, 1.0))
        below = np.arccos(WGS84.a_m / radius) - dip
        height = np.concatenate([below, rng.uniform(0.0, coordinates.limb.most, 100)])
    grazing = np.concatenate([rng.uniform(0.0, 0.03, 100), rng.uniform(0.0, np.pi / 2, 200)])
    bright = 0.0
    for to_ground, v in ((False, height), (True, grazing)):
        azimuth = rng.uniform(-np.pi, np.pi, len(v))
        d = coordinates.directions(v, azimuth, to_ground)
        direct = thermal_radiance(air, WGS84.a_m, np.tile(origin, (len(v), 1)), d, polar_radius_m=WGS84.b_m, nodes=512)[
            "b"
        ]
        bright = bright or direct.max()
        error = np.abs(np.array(_looked(view, vectors(origin[None, :]), vectors(d), to_ground)) - direct) / bright
        assert error.max() < most
        assert np.median(error) < most / 5


@pytest.mark.parametrize("opacity_per_m", [1e-7, 1e-5, 1e-2])
def test_a_frame_of_an_isothermal_planet_is_a_black_body(opacity_per_m: float) -> None:
    """1e-6 wherever a pixel is all ground, float32 included; nothing in the frame is brighter."""
    air = isothermal(opacity_per_m, 250.0)
    image = frame_of(air, scene(), camera(CO2))[:, :, 0]
    ground = render_frame(scene(atmosphere={"profile": "none"}), camera(CO2)).maps["tangent_height"] < -50e3
    assert ground.sum() > 1000
    assert image[ground] == pytest.approx(black(250.0), rel=1e-6)
    assert image.max() < black(250.0) * (1.0 + 1e-6)


def test_the_roll_of_the_camera_turns_the_picture_and_nothing_else() -> None:
    """1e-6 in bright pixels, the rounding of float32 and of angles: both frames read one table."""
    seen = scene(**VARYING, render={"subsamples": 1})
    spec = camera(CO2)
    air = optical_model(seen, spec)
    level, rolled = (frame_of(air, seen, spec, roll)[:, :, 0] for roll in (0.0, np.pi / 2))
    turned = np.rot90(rolled, -1)
    if not np.allclose(turned, level, rtol=0.1, atol=0.1 * level.max()):
        turned = np.rot90(rolled, 1)
    bright = level > 0.01 * level.max()
    assert turned[bright] == pytest.approx(level[bright], rel=1e-6)


def test_bytes_do_not_depend_on_the_frames_before() -> None:
    """A frame at another attitude first, or nothing: the same bytes, and few nodes are made for a second frame."""
    import mitsuba as mi

    from horizonval.renderer.description import describe
    from horizonval.renderer.plugins import mitsuba_scene
    from horizonval.renderer.table_store import TABLES

    described = describe(scene(**VARYING, surface={"kind": "earth"}, clouds=CLOUDS), camera(CO2))

    def frame(roll: float) -> bytes:
        turned = described.sensor.itrs_from_cam @ Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix()
        looking = replace(described.sensor, itrs_from_cam=turned)
        return np.array(mi.render(mitsuba_scene(described.limb, looking), spp=1)).tobytes()

    rolls = (0.3, -2.0)
    alone = []
    for roll in rolls:
        TABLES.clear()
        alone.append(frame(roll))
    assert len(set(alone)) == 2
    size = TABLES.nbytes
    together = [frame(roll) for roll in rolls[::-1]][::-1]
    assert together == alone
    assert size <= TABLES.nbytes < 2 * size
    # Air and clouds' tops, to the ground and past it, and the outline of clouds.
    assert len(TABLES) == 5


def test_one_table_serves_scenes_that_differ_in_what_it_does_not_hold() -> None:
    """Another emissivity of clouds and another Sun: the same tables. Another height of the camera: others."""
    from horizonval.renderer.table_store import TABLES

    spec = camera(WINDOW)
    TABLES.clear()
    frames = [
        render_frame(scene(clouds=CLOUDS, render={"subsamples": 1}, sun={"zenith_deg": z}), spec) for z in (20.0, 50.0)
    ]
    before = len(TABLES)
    assert frames[0].radiance["b"].tobytes() == frames[1].radiance["b"].tobytes()
    render_frame(scene(platform={"altitude_km": 501.0}), spec)
    assert before < len(TABLES) <= before + 2


def _cloudy(air: OpticalModel, emissivity: float, spec: Any, **changes: Any) -> FloatArray:
    """A frame under clouds of an emissivity, through the plugin's own properties."""
    import mitsuba as mi

    from horizonval.renderer.description import describe
    from horizonval.renderer.plugins import mitsuba_scene

    described = describe(scene(clouds=CLOUDS, render={"subsamples": 1}, **changes), spec)
    assert air.emission is not None
    emission = replace(air.emission, cloud_emissivity=emissivity)
    limb = replace(described.limb, model=replace(air, emission=emission))
    return np.array(mi.render(mitsuba_scene(limb, described.sensor), spp=1))[:, :, 0]


def _uncut(hit: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return the pixels through which no outline runs: all around them meet the same."""
    return np.asarray(minimum_filter(hit, 3) == maximum_filter(hit, 3))


@pytest.mark.slow
def test_clouds_between_opaque_and_invisible() -> None:
    """Emissivity 0 is a clear sky; a half is the mean of that and opaque clouds, radiance being linear in it: 1e-6.

    Pixels that the outline cuts are two rays; their mean lies between the extremes of the clear centres around.
    """
    spec = camera(WINDOW, fov_deg=4.0)
    limb = {"camera": {"file": "test", "mount_roll_deg": 68.0}}
    clear_scene = scene(**limb, render={"subsamples": 1})
    air = optical_model(clear_scene, spec)
    clear = render_frame(clear_scene, spec).radiance["b"]
    seen = render_frame(scene(**limb, clouds=CLOUDS, render={"subsamples": 1}), spec).maps
    invisible, half, opaque = (_cloudy(air, e, spec, **limb) for e in (0.0, 0.5, 1.0))
    uncut = _uncut(seen["hit"])
    assert (uncut & (seen["hit"] == Hit.CLOUD) & (seen["tangent_height"] > 0.0)).sum() > 100
    assert (~uncut).mean() < 0.15
    assert invisible[uncut] == pytest.approx(clear[uncut], rel=1e-6)
    assert np.all(invisible > minimum_filter(clear, 3) * (1.0 - 1e-6) - 1e-9)
    assert np.all(invisible < maximum_filter(clear, 3) * (1.0 + 1e-6) + 1e-9)
    assert half == pytest.approx(0.5 * (invisible + opaque), rel=1e-6)
    assert (opaque / np.maximum(clear, 1e-3))[clear > 1.0].min() < 0.8


@pytest.mark.slow
def test_opaque_clouds_straight_down_have_the_closed_form() -> None:
    """Air above the top, summed on 10 m here, and a black body as warm as the air there: 1e-3."""
    spec = camera(WINDOW, fov_deg=0.5, pixels=16)
    down = {"camera": {"file": "test", "mount_roll_deg": 0.0}, "clouds": CLOUDS | {"cover": 1.0}}
    seen = scene(**down, render={"subsamples": 1})
    frame = render_frame(seen, spec)
    b = optical_model(seen, spec).thermal[0]
    top_m = 500e3 - frame.maps["distance"].astype(float)
    for row, column in ((3, 5), (10, 12)):
        z = np.arange(top_m[row, column], 1e5, 10.0)
        k, s = b.extinction_at(z)[:, 0], b.source(b.air_k(z)[0]).T
        layer = 0.5 * (k[:, 1:] + k[:, :-1]) * np.diff(z)
        above = np.concatenate([np.cumsum(layer[:, ::-1], axis=1)[:, ::-1], np.zeros((len(k), 1))], axis=1)
        passed = np.exp(-above)
        air = np.sum(0.5 * (s[:, 1:] + s[:, :-1]) * np.diff(passed, axis=1))
        expected = air + np.sum(passed[:, 0] * s[:, 0])
        assert float(frame.radiance["b"][row, column]) == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_no_sky_shines_through_clouds_past_the_horizon() -> None:
    """By night over black ground, without airglow: a ray that ends on a cloud beyond the horizon is dark."""
    seen = scene(
        camera={"file": "test", "mount_roll_deg": 68.0},
        sun={"zenith_deg": 150.0},
        surface={"albedo": 0.0},
        clouds=CLOUDS | {"cover": 1.0, "albedo": 0.0},
        night={"airglow": False, "moonlight": False},
        render={"subsamples": 1, "orders": "single"},
    )
    visible = {"name": "b", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 1}
    frame = render_frame(seen, camera(visible, fov_deg=4.0, pixels=96))
    cloud = (frame.maps["hit"] == Hit.CLOUD) & (frame.maps["tangent_height"] > 3e3) & _uncut(frame.maps["hit"])
    space = frame.maps["tangent_height"] > 60e3
    assert cloud.sum() > 100
    assert frame.radiance["b"][cloud].max() < 1e-6 * frame.radiance["b"][space].min()


@pytest.mark.slow
@pytest.mark.parametrize("spectrum", [CO2, WINDOW], ids=["co2", "window"])
def test_what_a_cloud_top_reads_is_what_the_march_wrote(spectrum: dict[str, Any], monkeypatch: Any) -> None:
    """P and Q of random rays, halfway between stations too: 4e-3 of the brightest, worst at the tropopause's kink."""
    from horizonval.renderer.tables import vectors
    from horizonval.renderer.thermal import emission_table
    from horizonval.renderer.view_table.ray_table import RayPlane
    from horizonval.renderer.view_table.stations import StationPlace, look_at_stations

    air = optical_model(scene(**VARYING), camera(spectrum))
    origin = (WGS84.a_m + 500e3) * np.array([np.cos(0.4), 0.0, np.sin(0.4)])
    view = _view(air, origin, 128, 15e3)
    coordinates = view.coordinates
    rng = np.random.default_rng(np.random.SeedSequence(9))
    twice = 2 * emission_table.STATIONS - 1
    for to_ground, most in ((False, 10e3), (True, np.pi / 2)):
        v, azimuth = rng.uniform(0.0, most, 50), rng.uniform(-np.pi, np.pi, 50)
        d = coordinates.directions(v, azimuth, to_ground)
        o, ray = vectors(origin[None, :]), vectors(d)
        table, place = view.cloud_table(to_ground), _place(coordinates, o, ray, to_ground)
        table.cover(*place)
        with monkeypatch.context() as patch:
            patch.setattr(emission_table, "STATIONS", twice)
            exact = emission_table._station_values(view.air, RayPlane(coordinates, to_ground), ray, 128, 15e3)
        for k in range(twice):
            station = StationPlace.at(0.5 * k + 0.0 * place[0], 0.0, 0.5 * (twice - 1.0))
            looked = np.stack([np.array(x) for x in look_at_stations(table, *place, station, 1, [0])[:2]], axis=1)
            assert np.abs(looked - exact[:, k]).max() < 4e-3 * exact.max(), (to_ground, k)


def test_no_radiance_is_negative() -> None:
    """A frame with cells within metres of the top of the air, where the cubic through its end dips below zero."""
    (case,) = (case for case in load_suite("cameras").cases if case.name == "ir-thermopile-32-110deg")
    frame = render_frame(case.scene, case.camera)
    assert frame.radiance["lwir"].min() == 0.0
    assert frame.radiance["lwir"].max() > 20.0
