"""Geometry, ground and clouds inside the renderer, against the numpy side and closed forms; the march has converged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import drjit as dr
import emission_models
import numpy as np
import pytest
from earth_forms import is_land
from earth_forms import snow_factor as snow_factor_of
from scipy.optimize import brentq

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds import relief
from horizonval.earth.clouds.relief import BASE_M, CloudField
from horizonval.earth.optical import optical_model
from horizonval.earth.surface import ground_map, surface
from horizonval.earth.surface.ground_map import ground_cover
from horizonval.frame import Hit
from horizonval.geometry.camera import camera_from_spec, unproject
from horizonval.geometry.ellipsoid import WGS84, geodetic_height, surface_normal
from horizonval.geometry.frames import rotate
from horizonval.geometry.sun_and_moon import AU_M, sun_itrs
from horizonval.renderer.frame import render_frame
from horizonval.renderer.kernel.discs import cell_coverage
from horizonval.renderer.planet import Planet
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.truth.frame_truth import truth_of

SOLAR = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 2}
THERMAL = {"name": "lwir", "kind": "thermal", "lo_um": 10.0, "hi_um": 11.0}
CLOUDS = {"cover": 0.5, "seed": 5, "scale_km": 200.0}


def _scene(**changes: Any) -> SceneSpec:
    return emission_models.scene(**({"platform": emission_models.PACIFIC} | changes))


def _camera(band: dict[str, Any] = SOLAR, **size: Any) -> CameraSpec:
    return emission_models.camera(band, **({"width": 96, "height": 72} | size))


SMALL = _camera(width=48, height=36)


def _vec(mi: Any, v: np.ndarray) -> Any:
    return tuple(mi.Float64(np.ascontiguousarray(v[:, k])) for k in range(3))


def _across(up: np.ndarray) -> np.ndarray:
    side = np.cross(up, [0.0, 0.0, 1.0])
    return side / np.linalg.norm(side)


def _places(n: int, seed: int) -> np.ndarray:
    v = np.random.default_rng(np.random.SeedSequence(seed)).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def test_kernel_reflectance_equals_numpy(mi: Any) -> None:
    """1e-6: Dr.Jit's erf."""
    from horizonval.earth.surface import surface as snow
    from horizonval.renderer.kernel.surface import snow_factor

    rng = np.random.default_rng(np.random.SeedSequence(8))
    a, b, c = rng.uniform(-0.05, 1.0, 2000), rng.uniform(-0.05, 1.0, 2000), rng.uniform(-1.0, 1.0, 2000)
    ours = np.array(surface.glint_brdf(mi.Float64(a), mi.Float64(b), mi.Float64(c), mi.Float64(0.04), dr))
    assert ours == pytest.approx(surface.glint_brdf(a, b, c, 0.04), rel=1e-6, abs=1e-12)
    table = mi.Float64(snow.mean_snow_reflection())
    ours = np.array(snow_factor(table, mi.Float64(a), mi.Float64(b), mi.Float64(c)))
    assert ours == pytest.approx(snow_factor_of(a, b, c), rel=1e-6)


@pytest.mark.parametrize("month", [1.3, 7.5])
def test_kernel_ground_equals_numpy(mi: Any, month: float) -> None:
    """Materials to 1e-6 (a place is known to 1e-9 deg), and heights, in all but the few places where rounding decides
    whether there is land.
    """
    from horizonval.renderer.kernel.surface import GroundTable, Places, cover, height_m

    normal = _places(50_000, 3)
    latitude, longitude = np.degrees(np.arcsin(normal[:, 2])), np.degrees(np.arctan2(normal[:, 1], normal[:, 0]))
    table, places = GroundTable.of(month), Places.below(_vec(mi, normal))
    land, ours = cover(table, places)
    expected = ground_cover(latitude, longitude, month)
    same = np.array(land) == expected.land
    assert np.sum(~same) <= 2
    assert set(ours) == set(expected.shares)
    for name, share in ours.items():
        assert np.array(share)[same] == pytest.approx(expected.shares[name][same], abs=1e-6)
        assert expected.shares[name].max() > 0.4
    assert np.array(height_m(table, places)) == pytest.approx(ground_map.height_m(latitude, longitude), abs=0.1)


def first_squares(square_km: float, latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> np.ndarray:
    """Return whether places lie on squares of the first kind."""
    pieces = ground_map.piece_counts(square_km)
    belt = np.clip(np.floor((latitude_deg / 180.0 + 0.5) * len(pieces)).astype(int), 0, len(pieces) - 1)
    turn = np.mod(longitude_deg / 360.0 + 0.5, 1.0)
    return (belt + np.minimum(np.floor(turn * pieces[belt]), pieces[belt] - 1.0)) % 2 == 0


@pytest.mark.parametrize("square_km", [50.0, 1000.0, 15_000.0])
def test_kernel_squares_equal_numpy(mi: Any, square_km: float) -> None:
    """Of 20 000 places none is on the other side of a border."""
    from horizonval.renderer.kernel.surface import is_first_square

    normal = _places(20_000, 9)
    latitude, longitude = np.degrees(np.arcsin(normal[:, 2])), np.degrees(np.arctan2(normal[:, 1], normal[:, 0]))
    ours = np.array(is_first_square(mi.Float64(ground_map.piece_counts(square_km)), _vec(mi, normal)))
    assert np.array_equal(ours, first_squares(square_km, latitude, longitude))
    assert 0.45 < ours.mean() < 0.55


EARTH_CLOUDS = CloudField(None, 17e3, 7e3, 300e3, 7, 0.8, "earth", 6)
EVEN_CLOUDS = CloudField(0.5, 12e3, 5e3, 300e3, 7, 0.8)
ORIGIN = np.array([4e6, 3e6, 4.7e6])
UP = ORIGIN / np.linalg.norm(ORIGIN)


@pytest.mark.parametrize("field", [EVEN_CLOUDS, EARTH_CLOUDS], ids=["even", "earth"])
def test_kernel_clouds_equal_numpy(mi: Any, field: CloudField) -> None:
    """Tops of up to 12 km, as the lattice's cells are in single precision; then the table between its nodes."""
    from horizonval.renderer.kernel.clouds import cloud_table, top_at

    normal = _places(20_000, 4)
    table = cloud_table(field, Planet(WGS84.a_m, WGS84.b_m), tuple(ORIGIN.tolist()))
    near = UP + 0.2 * normal * np.random.default_rng(1).uniform(0, 1, (len(normal), 1))
    near /= np.linalg.norm(near, axis=1)[:, None]
    if field is EVEN_CLOUDS:
        assert np.array(top_at(field, _vec(mi, normal))) == pytest.approx(relief.top_m(field, normal), abs=0.1)
        error = np.array(table.top(_vec(mi, near))) - relief.top_m(field, near)
        assert np.sqrt(np.mean(error**2)) < 250.0
        return
    albedo = relief.albedo(field, near)
    ours = 0.8 * np.array(table.brightness(mi.Float64(2e3), _vec(mi, near)))
    assert table.translucent
    # edges are sharper than nodes lie apart
    assert np.quantile(np.abs(ours - albedo), 0.9) < 0.06
    assert ours.mean() == pytest.approx(albedo.mean(), abs=2e-3)


@pytest.mark.parametrize("radius_m", [6.9e6, 4.2e7])
def test_the_table_of_the_earths_clouds_follows_them_at_its_nodes(mi: Any, radius_m: float) -> None:
    """40 m rms, from structure bilinear over four nodes; clear and cloudy differ in less than 0.5 % of all nodes."""
    from horizonval.renderer.kernel.clouds import TABLE_SIDE, cloud_table

    table = cloud_table(EARTH_CLOUDS, Planet(WGS84.a_m, WGS84.a_m), tuple((radius_m * UP).tolist()))
    row, column = np.random.default_rng(3).integers(400, TABLE_SIDE - 400, (2, 10_000))
    x, y = ((n - 0.5 * (TABLE_SIDE - 1)) / float(table.globe.per_unit[0]) for n in (column, row))
    east, north = (np.array([float(c[0]) for c in axis]) for axis in table.globe.axes)
    shrink = np.sqrt(1.0 - 0.25 * (x * x + y * y))
    normal = (x * shrink)[:, None] * east + (y * shrink)[:, None] * north + (1.0 - 0.5 * (x * x + y * y))[:, None] * UP
    exact = relief.top_m(EARTH_CLOUDS, normal)
    ours = np.array(table.values).reshape(TABLE_SIDE, TABLE_SIDE)[row, column]
    assert np.sqrt(np.mean((ours - exact) ** 2)) < 40.0
    assert np.mean((ours > relief.BASE_M) != (exact > relief.BASE_M)) < 0.005


def test_steps_that_are_skipped_meet_no_cloud(mi: Any) -> None:
    """The same ends, to the bit, as with every step."""
    from horizonval.renderer.kernel.clouds import cloud_table, first_cloud

    planet, side = Planet(WGS84.a_m, WGS84.b_m), _across(UP)
    o = tuple(mi.Float64(float(v)) for v in ORIGIN)

    def rays(lowest_m: FloatArray) -> Any:
        angle = np.arcsin(lowest_m / np.linalg.norm(ORIGIN))
        return _vec(mi, -np.cos(angle)[:, None] * UP + np.sin(angle)[:, None] * side)

    down, past = rays(np.linspace(1e5, 6.35e6, 20_000)), rays(np.linspace(6.37e6, 6.39e6, 2000))
    for field in (EARTH_CLOUDS, CloudField(0.2, 12e3, 5e3, 300e3, 7, 0.8)):
        table = cloud_table(field, planet, tuple(ORIGIN.tolist()))
        assert float(table.squares[0].steps[0]) > 10.0
        every = replace(table, squares=tuple(replace(s, steps=mi.Float64(1.0)) for s in table.squares))
        for d, to_ground in ((down, True), (past, False)):
            hit, t = (np.array(v) for v in first_cloud(table, planet, o, d, to_ground))
            hit_of_every, t_of_every = (np.array(v) for v in first_cloud(every, planet, o, d, to_ground))
            assert 0.1 < hit.mean() < 0.95
            assert np.array_equal(hit, hit_of_every)
            assert np.array_equal(t[hit], t_of_every[hit])


def test_thin_clouds_hand_on_what_they_do_not_reflect(mi: Any) -> None:
    """Light to and fro between cloud and ground adds up to the closed form; opaque clouds leave no ground."""
    from horizonval.renderer.kernel.surface import _through

    cloud, ground = 0.3, np.array([0.0, 0.05, 0.4, 0.85])
    orders = sum((1.0 - cloud) ** 2 * ground * (cloud * ground) ** k for k in range(60))
    assert np.array(_through(mi.Float64(cloud), mi.Float64(ground))) == pytest.approx(cloud + orders, rel=1e-12)
    base = {"atmosphere": {"profile": "none"}, "surface": {"albedo": 0.9}, "sun": {"zenith_deg": 20.0}}
    snow = render_frame(_scene(**base), SMALL).radiance["vis"]
    frame = render_frame(_scene(**base, clouds={"seed": 3}), SMALL)
    on_cloud = frame.maps["hit"] == Hit.CLOUD
    assert on_cloud.any()
    # no cloud over snow is darker than a black veil would be; opaque grey ones were, by a factor of ten
    lit = on_cloud & (snow > 0.0) & (frame.maps["tangent_height"] < -1e4)
    assert np.quantile(frame.radiance["vis"][lit] / snow[lit], 0.02) > 0.5


@pytest.mark.parametrize("sun_zenith_deg", [75.0, 88.0])
def test_snow_under_clouds_sends_back_no_more_than_it_receives(mi: Any, sun_zenith_deg: float) -> None:
    """Light from a cloud is diffuse: cloud and snow together have an albedo, from the cloud's to 1, at every angle."""
    from horizonval.renderer.kernel.surface import make_ground, surface_hits

    winter = {"latitude_deg": 62.0, "longitude_deg": 100.0, "epoch_utc": "2025-01-15T00:00:00Z"}
    scene = _scene(platform={"altitude_km": 500.0} | winter, surface={"kind": "earth"}, clouds={})
    model = surface.ground_model(scene)
    origin = np.array(truth_of(scene, _camera()).r_itrs)
    up = origin / np.linalg.norm(origin)
    side = _across(up)
    off, around = (v.ravel() for v in np.meshgrid(np.linspace(0.2, 1.1, 64), np.linspace(0.0, 2 * np.pi, 128)))
    across = np.cos(around)[:, None] * side + np.sin(around)[:, None] * np.cross(up, side)
    d = -np.cos(off)[:, None] * up + np.sin(off)[:, None] * across
    planet = Planet(WGS84.a_m, WGS84.b_m)
    ground = make_ground(model, planet, tuple(origin.tolist()))
    assert ground is not None
    zenith = np.radians(sun_zenith_deg)
    light = np.cos(zenith) * up + np.sin(zenith) * side
    o, sun = (tuple(mi.Float64(float(c)) for c in v) for v in (origin, light))
    (hit,) = surface_hits(ground, planet, o, _vec(mi, d), [sun], to_ground=True)
    (direct,), _ = hit.at(model, [0.55], 1).reflectance()
    on_cloud, lit = np.array(hit.cloud), np.array(hit.sunlit)
    snow, white = (np.array(hit.shares[k]) for k in ("snow", "cloud"))
    assert (on_cloud & (snow > 0.9)).sum() > 500
    albedo = np.pi * np.array(direct)[on_cloud]
    assert np.all(albedo <= lit[on_cloud] * (1.0 + 1e-9))
    assert np.all(albedo >= lit[on_cloud] * white[on_cloud] * model.clouds.albedo * (1.0 - 1e-9))


def test_rays_end_where_the_clouds_are(mi: Any) -> None:
    """The end lies on the relief (2 m: ten bisections of a step), and no point before it inside one."""
    from horizonval.renderer.kernel.clouds import cloud_table, first_cloud

    origin = np.array(truth_of(_scene(), _camera()).r_itrs)
    up, radius = origin / np.linalg.norm(origin), np.linalg.norm(origin)
    side = _across(up)
    # from off the nadir to grazing 11 km; a search that nothing stops would go on below the ground
    angle = np.arcsin(np.linspace(0.3, 1.0, 4000) * 6.386e6 / radius)
    d = -np.cos(angle)[:, None] * up + np.sin(angle)[:, None] * side
    planet = Planet(WGS84.a_m, WGS84.b_m)
    field = CloudField(0.5, 12e3, 5e3, 200e3, 5, 0.8)
    table = cloud_table(field, planet, tuple(origin.tolist()))
    o = tuple(mi.Float64(float(v)) for v in origin)
    hit, t = (np.array(v) for v in first_cloud(table, planet, o, _vec(mi, d), to_ground=False))
    hit &= geodetic_height(origin + t[:, None] * d, WGS84) > 0.0
    assert 1000 < hit.sum() < 3900
    end = origin + t[hit, None] * d[hit]
    height = geodetic_height(end, WGS84)
    top = np.array(table.top(_vec(mi, surface_normal(end, WGS84))))
    steep = np.abs(top - height)
    assert np.median(steep) < 2.0
    assert np.all((height <= top + 2.0) & (height > 0.0))
    grazing = hit & (np.sin(angle) * radius > 6.381e6)
    assert grazing.any()
    for back_m in (200.0, 1000.0, 5000.0):
        before = origin + (t[hit, None] - back_m) * d[hit]
        over = np.array(table.top(_vec(mi, surface_normal(before, WGS84))))
        outside = (geodetic_height(before, WGS84) > over) | (over < BASE_M)
        assert outside.mean() > 0.97


def test_no_clouds_and_no_cover_are_the_same_bytes(mi: Any) -> None:
    plain, bare = (render_frame(_scene(**change), SMALL) for change in ({}, {"clouds": {"cover": 0.0}}))
    assert plain.radiance["vis"].tobytes() == bare.radiance["vis"].tobytes()
    assert all(plain.maps[k].tobytes() == bare.maps[k].tobytes() for k in plain.maps)


@pytest.mark.parametrize("band", [SOLAR, THERMAL], ids=["solar", "thermal"])
def test_between_the_clouds_is_the_plain_ground(mi: Any, band: dict[str, Any]) -> None:
    """1e-6 of the radiance scattered once, wherever a pixel has neither cloud nor shadow (most of them)."""
    once = {"orders": "single"}
    camera = _camera(band, width=48, height=36)
    plain = render_frame(_scene(render=once), camera).radiance[band["name"]]
    frame = render_frame(_scene(clouds=CLOUDS | {"cover": 0.1}, render=once), camera)
    same = np.isclose(frame.radiance[band["name"]], plain, rtol=1e-6, atol=0.0)
    assert same[frame.maps["hit"] != Hit.CLOUD].mean() > 0.6
    assert same[frame.maps["hit"] == Hit.CLOUD].mean() < 0.05


def test_cloud_pixels_without_air_have_the_closed_form(mi: Any) -> None:
    """Albedo by height, Lambert, under a Sun so high that few are shaded; the truth stays that of the ellipsoid."""
    scene = _scene(atmosphere={"profile": "none"}, clouds=CLOUDS, sun={"zenith_deg": 5.0}, render={"subsamples": 1})
    spec = _camera()
    frame, truth = render_frame(scene, spec), truth_of(scene, spec)
    assert frame.truth == truth
    # away from the ellipsoid's edge, where a cell is two rays
    v, u = np.nonzero((frame.maps["hit"] == Hit.CLOUD) & (np.abs(frame.maps["tangent_height"]) > 5e4))
    inverse = np.array(truth.q_cam_from_itrs) * [-1, -1, -1, 1]
    d = rotate(inverse, unproject(camera_from_spec(spec.camera), np.stack([u, v], axis=-1).astype(float)))
    p = np.array(truth.r_itrs) + frame.maps["distance"][v, u, None].astype(float) * d
    height, normal = geodetic_height(p, WGS84), surface_normal(p, WGS84)
    field = relief.cloud_field(scene)
    ceiling = np.minimum(field.top_m, relief.tropopause_m(np.degrees(np.arcsin(normal[:, 2]))))
    # the walls below the base are as grey as the base
    white = field.albedo * (0.6 + 0.4 * np.maximum(height - BASE_M, 0.0) / (ceiling - BASE_M))
    model = optical_model(scene, spec, sun_itrs(scene.platform.epoch_utc)[1] / AU_M)
    irradiance = sum(n.weight * n.solar_irradiance for n in model.nodes)
    expected = white / np.pi * irradiance * (normal @ np.array(truth.sun_itrs))
    ratio = frame.radiance["vis"][v, u] / expected
    assert np.mean(np.abs(ratio - 1.0) < 1e-3) > 0.9
    assert ratio.max() < 1.002
    # rays that would have passed the Earth end on clouds too
    past = frame.maps["tangent_height"] > 0.0
    assert np.array_equal(frame.maps["hit"][past] == Hit.CLOUD, np.isfinite(frame.maps["distance"][past]))
    assert (frame.maps["hit"][past] == Hit.CLOUD).any()


def test_an_isothermal_planet_hides_its_clouds(mi: Any) -> None:
    """A black cloud as warm as black ground without air looks like it; only the limb is wider."""
    base = {"atmosphere": {"profile": "none"}, "surface": {"temperature_k": 288.0}}
    plain = render_frame(_scene(**base), _camera(THERMAL)).radiance["lwir"]
    cloudy = render_frame(_scene(**base, clouds=CLOUDS), _camera(THERMAL)).radiance["lwir"]
    inside = plain == plain.max()
    assert cloudy[inside] == pytest.approx(plain.max(), rel=1e-6)
    assert cloudy.sum() > plain.sum()


def test_glint_lies_at_the_mirror_point(mi: Any) -> None:
    """The specular point of a sphere (Alhazen), closed in the plane of camera, centre and Sun, 2 px on a calm sea."""
    radius, altitude, zenith = 6.371e6, 5e5, np.radians(55.0)
    scene = _scene(
        atmosphere={"profile": "none"},
        earth={"shape": "sphere", "radius_km": 6371.0},
        platform={"altitude_km": 500.0, "latitude_deg": -20.0, "longitude_deg": -120.0, "heading_deg": 0.0},
        camera={"file": "test", "mount_roll_deg": 50.0},
        surface={"kind": "earth", "wind_speed_m_s": 0.0},
        sun={"zenith_deg": 55.0, "azimuth_deg": 270.0},
    )
    spec = _camera(width=200, height=160)
    truth = truth_of(scene, spec)
    image = render_frame(scene, spec).radiance["vis"].astype(float)
    weight = np.where(image > 0.5 * image.max(), image, 0.0)
    v, u = (float((weight * grid).sum() / weight.sum()) for grid in np.indices(image.shape))

    def excess(psi: float) -> float:
        """Angle of reflection minus incidence at the point psi from the subsatellite point."""
        nadir = np.arctan2(radius * np.sin(psi), radius + altitude - radius * np.cos(psi))
        return (nadir + psi) - (zenith - psi)

    psi = brentq(excess, 0.0, 0.3)
    up = np.array(truth.r_itrs) / np.linalg.norm(truth.r_itrs)
    sun = np.array(truth.sun_itrs)
    side = sun - (sun @ up) * up
    side /= np.linalg.norm(side)
    point = radius * (np.cos(psi) * up + np.sin(psi) * side)
    assert not is_land(np.degrees(np.arcsin(point[2] / radius)), np.degrees(np.arctan2(point[1], point[0])))
    x, y, z = rotate(np.array(truth.q_cam_from_itrs), point - np.array(truth.r_itrs))
    camera = camera_from_spec(spec.camera)
    assert u == pytest.approx(camera.cx + camera.fx * x / z, abs=1.0)
    # the blob leans to the horizon, where facets are seen more end on
    assert v == pytest.approx(camera.cy + camera.fy * y / z, abs=4.0)


def _disc_above(edge: float) -> float:
    """Return the share of a disc of radius 1 on the far side of a line at ``edge`` from its centre."""
    x = float(np.clip(edge, -1.0, 1.0))
    return float((np.arccos(x) - x * np.sqrt(1.0 - x * x)) / np.pi)


def test_clouds_hide_the_sun(mi: Any) -> None:
    """An overcast of level tops at 16 km is a larger Earth: the Sun's disc stands above it as a segment, 3 %."""
    zenith = 90.0 + np.degrees(np.arccos(6371.0 / 6871.0)) - 0.1
    base = {
        "atmosphere": {"profile": "none"},
        "earth": {"shape": "sphere", "radius_km": 6371.0},
        "sun": {"zenith_deg": float(zenith), "azimuth_deg": 270.0},
        "surface": {"albedo": 0.0},
        "camera": {"file": "test", "mount_roll_deg": float(180.0 - zenith)},
    }
    overcast = {"cover": 1.0, "top_km": 16.0, "mean_top_km": 15.99, "seed": 1, "albedo": 0.0}
    spec = _camera(fov_deg=2.0)
    free = render_frame(_scene(**base), spec).radiance["vis"].sum(dtype=float)
    hidden = render_frame(_scene(**base, clouds=overcast), spec).radiance["vis"].sum(dtype=float)
    radius = np.degrees(truth_of(_scene(**base), spec).sun_angular_radius_rad)
    centre = zenith - 90.0

    def share(height_km: float) -> float:
        return _disc_above((centre - np.degrees(np.arccos((6371.0 + height_km) / 6871.0))) / radius)

    assert share(0.0) > 0.7
    assert hidden / free == pytest.approx(share(16.0) / share(0.0), abs=0.03)


@pytest.mark.parametrize("radius_px", [20.0, 300.0])
def test_coverage_of_a_disc_is_its_exact_area(mi: Any, radius_px: float) -> None:
    """2e-4 of a cell at 20 px radius (the quadrature it is held against is good to 1e-5), 3e-5 at 300 px."""
    rng = np.random.default_rng(np.random.SeedSequence(7))
    angle, offset = rng.uniform(0, 2 * np.pi, 2000), rng.uniform(-0.75, 0.75, 2000)
    u, v = (radius_px + offset) * np.cos(angle), (radius_px + offset) * np.sin(angle)
    share, _, _ = cell_coverage(lambda x, y: radius_px - dr.sqrt(x * x + y * y), mi.Float64(u), mi.Float64(v), 1.0)
    x = u[:, None] + (np.arange(4000) + 0.5) / 4000 - 0.5
    half = np.sqrt(np.maximum(radius_px**2 - x**2, 0.0))
    low, high = np.maximum(v[:, None] - 0.5, -half), np.minimum(v[:, None] + 0.5, half)
    exact = np.maximum(high - low, 0.0).mean(axis=1)
    assert np.abs(np.array(share) - exact).max() < (2e-4 if radius_px < 100 else 3e-5)


def test_geodetic_height_in_the_kernel_equals_geometry(mi: Any) -> None:
    """1 mm up to the top of the atmosphere, poles and equator included."""
    rng = np.random.default_rng(np.random.SeedSequence(3))
    direction = rng.normal(size=(500, 3))
    direction[:3] = np.eye(3)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    r = direction * (6.36e6 + rng.uniform(0.0, 1e5, 500))[:, None]
    height, _ = Planet(WGS84.a_m, WGS84.b_m).height_and_normal(tuple(mi.Float64(r[:, k].copy()) for k in range(3)))
    assert np.abs(np.array(height) - geodetic_height(r, WGS84)).max() < 1e-3


@pytest.mark.parametrize(
    "zenith_deg", [40.0, *(pytest.param(low, marks=pytest.mark.slow) for low in (80.0, 88.0)), 95.0, 98.0]
)
def test_march_has_converged(mi: Any, zenith_deg: float) -> None:
    """Against eight times the default nodes: 0.3 %, 1 % in dark pixels by day; at 98 deg towards the Sun."""

    def render(nodes: int) -> np.ndarray:
        sun = {"zenith_deg": zenith_deg, "azimuth_deg": 60.0 if zenith_deg < 96 else 300.0}
        # airglow, known to a factor of two, has half the nodes
        tables = {"sun": sun, "render": {"nodes": nodes}, "night": {"airglow": False}}
        scene = _scene(**tables, atmosphere={"refraction": False})
        return render_frame(scene, _camera(width=48, height=36)).radiance["vis"].astype(float)

    fine = render(1024)
    error = np.abs(render(128) / np.maximum(fine, 1e-30) - 1.0)
    for share, limit in ((0.05, 3e-3), (1e-3, 1e-2 if zenith_deg < 90 else 3e-3)):
        bright = fine > share * fine.max()
        assert bright.sum() > 100
        assert error[bright].max() < limit
