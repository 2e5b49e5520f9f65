"""A conical scanner on Earths with hard edges: crossings, lags and attitudes against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from horizonval.systems.f.electronics import (
    ScanEdges,
    ScannerElectronics,
    Threshold,
    find_edges,
    first_order_lag,
    level_crossings,
)
from horizonval.systems.f.errors import ScannerFit, attitude_over_ellipsoid, worst_error_deg
from horizonval.systems.f.scan_cone import ScanCone, distance_to_clouds, ellipsoid_crossings

from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.clouds.relief import BASE_M, CloudField, top_m
from horizonval.geometry.ellipsoid import WGS84, geodetic_height, sphere, surface_normal
from horizonval.geometry.frames import body_from_lvlh, inverse, nadir_of_roll_pitch, rotate
from horizonval.geometry.horizon import limb_side
from horizonval.systems.weather_viewpoints import WeatherPlace

CONE = ScanCone.to_the_right(math.radians(45.0), math.radians(12.0))
DAY = WeatherPlace(37.0, -20.0, 71.0, 1, 0, 0)


def _itrs_from_body(roll: float, pitch: float) -> np.ndarray:
    lvlh_from_body = inverse(body_from_lvlh(0.0, pitch, roll))
    return rotate(inverse(DAY.lvlh()), rotate(lvlh_from_body, np.eye(3))).T


def _sphere_crossings(nadir: np.ndarray, rho: float) -> tuple[float, float]:
    """Closed form: cos(p - q) = (cos rho - cos g (s . n)) / (A sin g), with A and q those of the nadir across."""
    across = np.array([CONE.start @ nadir, CONE.quarter @ nadir])
    gap = math.cos(rho) - math.cos(CONE.half_angle_rad) * float(CONE.axis @ nadir)
    half = math.acos(gap / (math.hypot(*across) * math.sin(CONE.half_angle_rad)))
    middle = math.atan2(across[1], across[0])
    return middle - half, middle + half


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.05, -0.03), (-0.1, 0.2)])
def test_crossings_of_a_sphere_are_the_textbooks(roll: float, pitch: float) -> None:
    r = DAY.position(800.0)
    found = _sphere_crossings(nadir_of_roll_pitch(roll, pitch), math.asin(WGS84.a_m / np.linalg.norm(r)))
    exact = ellipsoid_crossings(CONE, _itrs_from_body(roll, pitch), r, sphere(WGS84.a_m))
    assert exact == pytest.approx(found, abs=1e-10)


def test_crossings_of_the_ellipsoid_lie_on_its_horizon_earth_in_between() -> None:
    to_itrs, r = _itrs_from_body(0.03, -0.05), DAY.position(700.0)
    found = ellipsoid_crossings(CONE, to_itrs, r, WGS84)
    assert found is not None
    d = CONE.directions(np.array([*found, 0.5 * sum(found)])) @ to_itrs.T
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
    narrow = ScannerElectronics(1e-6, math.radians(45.0), rate, (lag,))
    late = narrow.step_delays(fraction, math.radians(0.01))
    expected = -lag * rate * math.log(1.0 - fraction), -lag * rate * math.log(fraction)
    assert late == pytest.approx(expected, abs=math.radians(2e-3))


def test_beam_and_two_lags_leave_nothing_of_a_hard_edge() -> None:
    assert worst_error_deg() < 1e-3


def _fit(entered: float, left: float) -> ScannerFit:
    fit = attitude_over_ellipsoid(CONE, entered, left, DAY.position(800.0), DAY.lvlh(), WGS84, (1e-4, 2e-4))
    assert isinstance(fit, ScannerFit)
    return fit


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.08, -0.05)])
def test_attitudes_come_back_from_exact_crossings_with_their_covariance(roll: float, pitch: float) -> None:
    crossed = ellipsoid_crossings(CONE, _itrs_from_body(roll, pitch), DAY.position(800.0), WGS84)
    assert crossed is not None
    fit = _fit(*crossed)
    assert (fit.roll_rad, fit.pitch_rad) == pytest.approx((roll, pitch), abs=1e-9)
    # what one standard deviation of each phase does to the attitude, by central differences
    ends = [[_fit(*(np.array(crossed) + side * step)) for side in (1.0, -1.0)] for step in np.diag([1e-4, 2e-4])]
    effect = np.array([[(u.roll_rad - d.roll_rad) / 2, (u.pitch_rad - d.pitch_rad) / 2] for u, d in ends]).T
    assert fit.covariance == pytest.approx(effect @ effect.T, rel=1e-3, abs=1e-4 * fit.covariance.max())


def test_refusals_are_typed() -> None:
    nothing = ScannerElectronics(0.01, 0.8, 12.0, (1e-3,)).respond(np.linspace(-2, 2, 2000), np.zeros(2000))
    fixed = find_edges(nothing, Threshold(0.4, level=1.0), 0.8)
    assert isinstance(fixed, Refusal)
    assert fixed.status is Outcome.NO_LIMB
    away = attitude_over_ellipsoid(CONE, -3.0, 0.2, DAY.position(800.0), DAY.lvlh(), WGS84, (1e-4, 1e-4))
    assert isinstance(away, Refusal)


def test_a_cold_cloud_is_counted_and_does_not_end_the_earth() -> None:
    phase = np.linspace(-1.5, 1.5, 6001)
    radiance = np.where(np.abs(phase) < 0.9, 5.0, 0.0)
    radiance[np.abs(phase - 0.2) < 0.05] = 1.0
    signal = ScannerElectronics(1e-3, math.radians(45.0), 12.0, (1e-4,)).respond(phase, radiance)
    found = find_edges(signal, Threshold(0.4, level=2.0), math.radians(45.0))
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
