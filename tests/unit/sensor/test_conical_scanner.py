"""A conical scanner: crossings against closed forms, electronics against its equations, attitudes from edges."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.clouds.earth_pattern import BASE_M
from horizonval.earth.clouds.relief import CloudField, top_m
from horizonval.geometry.ellipsoid import WGS84, geodetic_height, sphere, surface_normal
from horizonval.geometry.frames import body_from_lvlh, inverse, nadir_of_roll_pitch, rotate
from horizonval.geometry.horizon import limb_side
from horizonval.sensor.conical_scanner import (
    ConicalScanner,
    ScanEdges,
    ScannerFit,
    first_order_lag,
    level_crossings,
)
from horizonval.systems.f.experiment import distance_to_clouds
from horizonval.systems.weather_viewpoints import WeatherPlace

SCANNER = ConicalScanner(tilt_rad=math.radians(12.0))
DAY = WeatherPlace(37.0, -20.0, 71.0, 1, 0, 0)


def _itrs_from_body(roll: float, pitch: float, day: WeatherPlace = DAY) -> np.ndarray:
    lvlh_from_body = inverse(body_from_lvlh(0.0, pitch, roll))
    return rotate(inverse(day.lvlh()), rotate(lvlh_from_body, np.eye(3))).T


def _sphere_crossings(nadir: np.ndarray, rho: float) -> tuple[float, float]:
    """Closed form: cos(p - q) = (cos rho - cos g (s . n)) / (A sin g), with A and q those of the nadir across."""
    axis, start, quarter = SCANNER.axes
    across = np.array([start @ nadir, quarter @ nadir])
    gap = math.cos(rho) - math.cos(SCANNER.half_angle_rad) * float(axis @ nadir)
    half = math.acos(gap / (math.hypot(*across) * math.sin(SCANNER.half_angle_rad)))
    middle = math.atan2(across[1], across[0])
    return middle - half, middle + half


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.05, -0.03), (-0.1, 0.2)])
def test_crossings_of_a_sphere_are_the_textbooks(roll: float, pitch: float) -> None:
    r = DAY.position(800.0)
    found = _sphere_crossings(nadir_of_roll_pitch(roll, pitch), math.asin(WGS84.a_m / np.linalg.norm(r)))
    exact = SCANNER.crossings(_itrs_from_body(roll, pitch), r, sphere(WGS84.a_m))
    assert exact == pytest.approx(found, abs=1e-10)


def test_crossings_of_the_ellipsoid_are_on_its_horizon_earth_in_between() -> None:
    to_itrs, r = _itrs_from_body(0.03, -0.05), DAY.position(700.0)
    found = SCANNER.crossings(to_itrs, r)
    assert found is not None
    d = SCANNER.directions(np.array([*found, 0.5 * sum(found)])) @ to_itrs.T
    assert limb_side(d, r)[:2] == pytest.approx(0.0, abs=1e-12)
    assert limb_side(d, r)[2] > 0.1


def test_the_lag_of_a_step_is_exact_whatever_the_steps_of_time() -> None:
    lag = 3e-3
    for step in (1e-5, 7e-4, 5e-3):
        # at rest on 0, then 1 from the second sample on: linear in between
        t = step * np.arange(400)
        out = first_order_lag(np.where(t > 0.0, 1.0, 0.0), step, lag)
        ramp = 1.0 - lag / step * (1.0 - math.exp(-step / lag))
        expected = 1.0 - (1.0 - ramp) * np.exp(-(t[1:] - step) / lag)
        assert out[0] == 0.0
        assert out[1:] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("fraction", [0.4, 0.5, 0.7])
def test_delays_of_steps_are_the_logarithms(fraction: float) -> None:
    lag, rate = 2e-3, 4.0 * math.pi
    late = ConicalScanner(beam_rad=1e-6, lags_s=(lag,), fraction=fraction).step_delays(math.radians(0.01))
    expected = -lag * rate * math.log(1.0 - fraction), -lag * rate * math.log(fraction)
    assert late == pytest.approx(expected, abs=math.radians(2e-3))


@pytest.mark.parametrize("latitude_deg", [0.0, 40.0, 70.0])
def test_beam_and_two_lags_leave_nothing_of_a_hard_edge(latitude_deg: float) -> None:
    """An Earth without air, whose edges are known in closed form: roll and pitch to a thousandth of a degree."""
    day, step = WeatherPlace(latitude_deg, 0.0, 30.0, 1, 0, 0), math.radians(0.05)
    r = day.position(800.0)
    for tilt, roll, pitch in itertools.product((0.0, 20.0), (-3.0, 3.0), (-3.0, 0.0)):
        scanner = ConicalScanner(tilt_rad=math.radians(tilt))
        exact = scanner.crossings(_itrs_from_body(math.radians(roll), math.radians(pitch), day), r)
        assert exact is not None
        phase = np.arange(exact[0] - 0.5, exact[1] + 1.0, step)
        # A sample is the share of its own step that is on the Earth: a finer edge would be lost between samples.
        share = np.clip((np.minimum(phase - exact[0], exact[1] - phase)) / step + 0.5, 0.0, 1.0)
        edges = scanner.edges(scanner.signal(phase, share))
        assert isinstance(edges, ScanEdges)
        fit = scanner.attitude(edges, r, day.lvlh())
        assert isinstance(fit, ScannerFit)
        assert np.degrees([fit.roll_rad, fit.pitch_rad]) == pytest.approx([roll, pitch], abs=1e-3)


def _fit(entered: float, left: float) -> ScannerFit:
    edges = ScanEdges(entered, left, (1.0, -0.5), (1.0, 1.0), 0)
    fit = SCANNER.attitude(edges, DAY.position(800.0), DAY.lvlh(), noise=1e-4)
    assert isinstance(fit, ScannerFit)
    return fit


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.08, -0.05)])
def test_attitudes_come_back_from_exact_crossings_with_their_covariance(roll: float, pitch: float) -> None:
    crossed = SCANNER.crossings(_itrs_from_body(roll, pitch), DAY.position(800.0))
    assert crossed is not None
    fit = _fit(*crossed)
    assert (fit.roll_rad, fit.pitch_rad) == pytest.approx((roll, pitch), abs=1e-9)
    # what one standard deviation of each phase does to the attitude, by central differences
    ends = [[_fit(*(np.array(crossed) + side * step)) for side in (1.0, -1.0)] for step in np.diag([1e-4, 2e-4])]
    effect = np.array([[(u.roll_rad - d.roll_rad) / 2, (u.pitch_rad - d.pitch_rad) / 2] for u, d in ends]).T
    assert fit.covariance == pytest.approx(effect @ effect.T, rel=1e-3, abs=1e-4 * fit.covariance.max())


def test_refusals_are_typed() -> None:
    scanner = replace(SCANNER, level=1.0)
    fixed = scanner.edges(scanner.signal(np.linspace(-2, 2, 2000), np.zeros(2000)))
    assert isinstance(fixed, Refusal)
    assert fixed.status is Outcome.NO_LIMB
    away = ScanEdges(-3.0, 0.2, (1.0, 1.0), (1.0, 1.0), 0)
    assert isinstance(SCANNER.attitude(away, DAY.position(800.0), DAY.lvlh()), Refusal)


def test_a_cold_cloud_is_counted_and_does_not_end_the_earth() -> None:
    phase = np.linspace(-1.5, 1.5, 6001)
    radiance = np.where(np.abs(phase) < 0.9, 5.0, 0.0)
    radiance[np.abs(phase - 0.2) < 0.05] = 1.0
    scanner = ConicalScanner(beam_rad=1e-3, rate_rad_s=12.0, lags_s=(1e-4,), level=2.0)
    signal = scanner.signal(phase, radiance)
    found = scanner.edges(signal)
    assert isinstance(found, ScanEdges)
    assert (found.entered_rad, found.left_rad) == pytest.approx((-0.9, 0.9), abs=5e-3)
    assert found.spare == 2
    assert len(level_crossings(signal, 2.0)[0]) == 2


def test_rays_end_on_the_relief() -> None:
    field = CloudField(1.0, 12e3, 6e3, 400e3, 5, 0.8)
    observer = np.array([WGS84.a_m + 800e3, 0.0, 0.0])
    eta = np.radians(np.linspace(1.0, 61.0, 25))
    direction = np.stack([-np.cos(eta), 0.6 * np.sin(eta), 0.8 * np.sin(eta)], axis=-1)
    away = distance_to_clouds(field, observer, direction)
    assert np.isfinite(away).all()
    place = observer + away[:, None] * direction
    top = top_m(field, surface_normal(place))
    assert top.min() > BASE_M
    assert geodetic_height(place) == pytest.approx(top, abs=400.0)
    nothing = distance_to_clouds(field, observer, np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert np.isnan(nothing).all()
