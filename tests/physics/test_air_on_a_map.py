"""Thermal rays through columns on a map: the march, a frame's tables and the truth against an integral of its own.

The places are the worst for latitudes and longitudes: beside the pole, and across the date line.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from thermal_model import model_of

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.column import OpticalModel
from horizonval.earth.surface.ground_emission import uniform_ground
from horizonval.earth.weather.field import ColumnMap, latitude_longitude_deg
from horizonval.geometry.ellipsoid import WGS84, geodetic_from_itrs, itrs_from_geodetic
from horizonval.renderer.rays import thermal_radiance
from horizonval.truth.infrared_horizon import infrared_horizon
from horizonval.truth.infrared_radiance import angle_of_height, directions

Z_M = np.linspace(0.0, 1e5, 201)
PLACES = [(84.0, 100.0), (-30.0, 179.0)]


def lattice(latitude_deg: float, longitude_deg: float, step_deg: float = 3.0) -> ColumnMap:
    centre = itrs_from_geodetic(math.radians(latitude_deg), math.radians(longitude_deg), 0.0)
    normal = np.array([centre[0] / WGS84.a_m**2, centre[1] / WGS84.a_m**2, centre[2] / WGS84.b_m**2])
    return ColumnMap.around(normal / np.linalg.norm(normal), math.radians(40.0), math.radians(step_deg))


def strange_air(place: ColumnMap) -> OpticalModel:
    """Grey air in two g points whose opacity and temperature wave with latitude and longitude."""
    latitude, longitude = (np.radians(v) for v in latitude_longitude_deg(place.normals()))
    wave = np.cos(latitude) * np.cos(2.0 * longitude) + 0.4 * np.sin(3.0 * latitude)
    kelvin = 240.0 + 15.0 * wave[:, None] * np.exp(-(((Z_M - 30e3) / 15e3) ** 2)) - 20.0 * np.sin(Z_M / 2e4)
    ln_k = np.log([1e-4, 2e-3])[:, None, None] - Z_M / 7e3 + 0.3 * wave[None, :, None]
    band = EmittingBand(
        name="b",
        wavelength_um=np.full(2, 15.0),
        altitude_m=Z_M,
        sin_latitude=np.zeros(1),
        level_m=Z_M,
        ln_extinction=ln_k,
        temperature_k=kelvin,
        source_wavenumber_per_cm=np.array([667.0]),
        source_weight_per_cm=np.ones((2, 1)),
        sun_radiance=np.zeros(2),
        column_map=place,
    )
    return OpticalModel(Z_M, 1e5, (), 0.0, thermal=(band,), emission=uniform_ground(280.0, 1.0))


def brute_force(band: EmittingBand, origin: FloatArray, d: FloatArray, ground_k: float | None) -> float:
    """Return the radiance along one ray in steps of 200 m; the map read by angle and bearing from its centre."""
    place = band.column_map
    assert place is not None
    along = -float(origin @ d)
    nearest = origin + along * d
    reach = math.sqrt((WGS84.a_m + 1.01e5) ** 2 - float(nearest @ nearest))
    if ground_k is None:
        t = np.arange(along - reach, along + reach, 200.0)
    else:
        a, b = WGS84.a_m, WGS84.b_m
        scale = np.array([1.0 / a, 1.0 / a, 1.0 / b])
        o, v = origin * scale, d * scale
        first = (-(o @ v) - math.sqrt((o @ v) ** 2 - (v @ v) * (o @ o - 1.0))) / (v @ v)
        t = np.linspace(along - reach, first, round((first - along + reach) / 50.0))
    latitude, longitude, height = geodetic_from_itrs(origin + t[:, None] * d, WGS84)
    normal = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
    )
    e, f, c = place.axes
    angle = np.arctan2(np.linalg.norm(np.cross(normal, c), axis=1), normal @ c)
    bearing = np.arctan2(normal @ f, normal @ e)
    step = 2.0 * place.half / (place.count - 1)
    x, y = ((np.tan(0.5 * angle) * g(bearing) + place.half) / step for g in (np.cos, np.sin))
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    extinction, source = band.columns()
    level = height / (Z_M[1] - Z_M[0])
    k = np.clip(np.floor(level).astype(int), 0, len(Z_M) - 2)
    total = []
    for values in (extinction, source):
        value = np.zeros((len(values), len(t)))
        for di in (0, 1):
            for dj in (0, 1):
                for dk in (0, 1):
                    w = np.abs(1 - di - (x - i)) * np.abs(1 - dj - (y - j)) * np.abs(1 - dk - (level - k))
                    value += w * values[:, (j + dj) * place.count + i + di, k + dk]
        total.append(value)
    kappa, s = total[0] * ((height >= -1.0) & (height <= 1e5)), total[1]
    depth = 0.5 * (kappa[:, 1:] + kappa[:, :-1]) * np.diff(t)
    before = np.concatenate([np.zeros((len(kappa), 1)), np.cumsum(depth, axis=1)], axis=1)
    e = np.exp(-before)
    # half of the emission from either end of a step, exact to depth^2 / 12, 3e-5 for the thickest
    air = np.sum(-e[:, :-1] * np.expm1(-depth) * 0.5 * (s[:, :-1] + s[:, 1:]), axis=1)
    behind = 0.0 if ground_k is None else band.source(ground_k) * e[:, -1]
    return float(np.sum(air + behind))


@pytest.mark.parametrize("place", PLACES)
def test_the_march_equals_brute_force(place: tuple[float, float]) -> None:
    """0.06 %: rays of six azimuths, to the ground and past it."""
    model = strange_air(lattice(*place))
    band = model.thermal[0]
    origin = itrs_from_geodetic(math.radians(place[0]), math.radians(place[1]), 700e3)
    height = np.array([-40e3, 12e3, 30e3, 45e3])
    azimuth = np.arange(6) * math.pi / 3 + 0.2
    angle = angle_of_height(origin, WGS84, azimuth[:, None], height)
    d = directions(origin, azimuth[:, None], angle).reshape(-1, 3)
    found = thermal_radiance(model, WGS84.a_m, np.broadcast_to(origin, d.shape).copy(), d, polar_radius_m=WGS84.b_m)[
        "b"
    ]
    ground = np.tile(height < 0.0, len(azimuth))
    expected = np.array([brute_force(band, origin, v, 280.0 if g else None) for v, g in zip(d, ground, strict=True)])
    np.testing.assert_allclose(found, expected, rtol=6e-4)
    # and the air does differ all round
    limb = expected.reshape(6, 4)[:, 2]
    assert limb.max() / limb.min() > 1.05


def on_a_map(model: OpticalModel, place: ColumnMap) -> OpticalModel:
    """Return zonal air, read at the columns of a map."""
    (band,) = model.thermal
    sine = place.normals()[:, 2]
    x = np.clip((sine - band.sin_latitude[0]) / (band.sin_latitude[1] - band.sin_latitude[0]), 0, None)
    i = np.minimum(x.astype(int), len(band.sin_latitude) - 2)
    w = np.minimum(x - i, 1.0)[:, None]
    ln_k = band.ln_extinction[:, i] * (1.0 - w) + band.ln_extinction[:, i + 1] * w
    kelvin = band.temperature_k[i] * (1.0 - w) + band.temperature_k[i + 1] * w
    moved = replace(band, sin_latitude=np.zeros(1), ln_extinction=ln_k, temperature_k=kelvin, column_map=place)
    return replace(model, thermal=(moved,))


def zonal(latitude_deg: float) -> OpticalModel:
    platform = {"altitude_km": 700.0, "latitude_deg": latitude_deg}
    atmosphere = {"profile": "by_latitude_month", "month": 1}
    return model_of({"b": (15.0, 16.3)}, atmosphere=atmosphere, platform=platform, surface={"temperature_k": 270.0})


@pytest.mark.slow
def test_the_truth_of_zonal_air_is_the_same_on_a_map() -> None:
    """15 m of the horizon's height: columns 1.5 deg apart against rows of latitude 0.6 to 1.6 deg apart.

    With columns 3 deg apart it is 31 m, where two climates meet: the bend of the blend between columns.
    """
    origin = itrs_from_geodetic(math.radians(70.0), math.radians(179.0), 700e3)
    model = zonal(70.0)
    rows = infrared_horizon(model, origin, WGS84, azimuths=12)["b"]
    columns = infrared_horizon(on_a_map(model, lattice(70.0, 179.0, 1.5)), origin, WGS84, azimuths=12)["b"]
    np.testing.assert_allclose(columns["half_plateau_height_m"], rows["half_plateau_height_m"], rtol=0, atol=15.0)
    np.testing.assert_allclose(columns["plateau_radiance"], rows["plateau_radiance"], rtol=1e-3)


def test_truth_and_march_agree_all_round() -> None:
    """Half of the plateau lies where the march has it: 15 m, the locator's own step being 50."""
    place = PLACES[0]
    model = strange_air(lattice(*place))
    origin = itrs_from_geodetic(math.radians(place[0]), math.radians(place[1]), 700e3)
    stored: dict[str, Any] = infrared_horizon(model, origin, WGS84, azimuths=8)["b"]
    azimuth = np.radians(stored["azimuth_deg"])
    height = np.append(np.arange(10e3, 24.1e3, 500.0), np.arange(25e3, 80e3, 250.0))
    d = directions(origin, azimuth[:, None], angle_of_height(origin, WGS84, azimuth[:, None], height))
    found = thermal_radiance(
        model, WGS84.a_m, np.broadcast_to(origin, d.shape).reshape(-1, 3).copy(), d.reshape(-1, 3),
        polar_radius_m=WGS84.b_m,
    )["b"].reshape(d.shape[:2])  # fmt: skip
    for row, half, plateau in zip(found, stored["half_plateau_height_m"], stored["plateau_radiance"], strict=True):
        assert row[height <= 24e3].max() == pytest.approx(plateau, rel=1e-3)
        last = int(np.flatnonzero(row >= 0.5 * plateau)[-1])
        crossing = np.interp(-0.5 * plateau, -row[last : last + 2], height[last : last + 2])
        assert crossing == pytest.approx(half, abs=15.0)
    assert np.ptp(stored["half_plateau_height_m"]) > 500.0


def test_a_map_has_no_seams() -> None:
    """A field that is smooth on the sphere is read with the error of the second difference, poles included."""

    def smooth(n: FloatArray) -> FloatArray:
        return n @ np.array([0.3, -0.5, 0.2]) + (n @ np.array([0.1, 0.2, 0.9])) ** 3

    rng = np.random.default_rng(5)
    for latitude, longitude in [(90.0, 0.0), (-89.0, 30.0), (10.0, 180.0)]:
        place = lattice(latitude, longitude)
        n = place.axes[2] + 0.5 * rng.normal(size=(400, 3)) / math.sqrt(3.0)
        n = n / np.linalg.norm(n, axis=1, keepdims=True)
        n = n[n @ place.axes[2] > math.cos(math.radians(39.0))]
        assert (place.count - 1) % 4 == 0
        x, y = place.plane(n)
        read = sum(smooth(place.normals())[i] * w for i, w in place.corners(x, y))
        # (3 deg)^2 / 8 of a second derivative of up to 6
        np.testing.assert_allclose(read, smooth(n), rtol=0, atol=2.5e-3)
