"""What a cone cannot say: the covariance of oblateness and relief against exact horizons and drawn heights."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.earth.limb_heights import Relief, systematic_covariance
from horizonval.geometry.ellipsoid import WGS84, geocentric_nadir, geodetic_nadir, itrs_from_geodetic
from horizonval.geometry.horizon import fit_cone, horizon_by_azimuth
from horizonval.geometry.rotation import tangent_basis
from horizonval.truth.infrared_radiance import directions

R = 6371008.8
FLATTENING = 1 / 298.257223563


def arc(rho: float, half_rad: float, n: int = 121) -> np.ndarray:
    azimuth = np.linspace(-half_rad, half_rad, n)
    return np.column_stack([np.sin(rho) * np.cos(azimuth), np.sin(rho) * np.sin(azimuth), np.full(n, np.cos(rho))])


@pytest.mark.parametrize(("estimates", "nadir_of"), [("geocentric", None), ("geodetic", WGS84)])
@pytest.mark.parametrize(("altitude_m", "half_deg"), [(500e3, 25.0), (500e3, 180.0), (3000e3, 60.0)])
def test_oblateness_is_that_of_exact_horizons(estimates, nadir_of, altitude_m, half_deg):
    """Cones fitted to the exact WGS84 horizon of places and headings drawn evenly over the Earth.

    400 draws have a standard error of 4 %; second orders of the flattening and of the altitude's share of the geodetic
    angle are 1 %. Where next to nothing is left (a full circle from near by), 0.01 deg.
    """
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(400):
        r = itrs_from_geodetic(math.asin(rng.uniform(-1, 1)), 0.3, altitude_m, WGS84)
        azimuth = rng.uniform(0, 2 * math.pi) + np.radians(np.linspace(-half_deg, half_deg, 181)[:-1])
        los = directions(r, azimuth, horizon_by_azimuth(r, WGS84, azimuth))
        cone = fit_cone(los)
        nadir = geocentric_nadir(r) if nadir_of is None else geodetic_nadir(r, WGS84)
        middle = los[90] - cone.axis_cam * (los[90] @ cone.axis_cam)
        middle /= np.linalg.norm(middle)
        across = np.column_stack([middle, np.cross(cone.axis_cam, middle)])
        errors.append(across.T @ (cone.axis_cam - nadir))
    covariance = systematic_covariance(
        los,
        cone.axis_cam,
        cone.rho_rad,
        flattening=FLATTENING,
        reliefs=(),
        earth_radius_m=R,
        estimates=estimates,
    )
    turn = across.T @ tangent_basis(cone.axis_cam)
    stated = np.degrees(np.sqrt(np.diag(turn @ covariance[:2, :2] @ turn.T)))
    found = np.degrees(np.sqrt(np.mean(np.square(errors), axis=0)))
    assert stated == pytest.approx(found, rel=0.12, abs=0.01)


def test_relief_is_that_of_drawn_heights():
    """Heights drawn with the stated covariance, laid on a limb and fitted with a cone: 2000 draws, 5 %."""
    rho, relief = math.radians(68.0), Relief(1000.0, 0.2)
    los = arc(rho, 0.4)
    azimuth = np.arctan2(los[:, 1], los[:, 0])
    correlation = np.exp(-0.5 * ((azimuth[:, None] - azimuth[None, :]) / relief.correlation_rad) ** 2)
    root = np.linalg.cholesky(correlation + 1e-9 * np.eye(len(los)))
    height = relief.sigma_m * root @ np.random.default_rng(2).standard_normal((len(los), 2000))
    errors = []
    for h in height.T:
        angle = rho + h * math.tan(rho) / R
        moved = np.column_stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])
        errors.append(fit_cone(moved).axis_cam[:2])
    nadir = np.array([0.0, 0.0, 1.0])
    covariance = systematic_covariance(los, nadir, rho, flattening=0.0, reliefs=(relief,), earth_radius_m=R)
    basis = tangent_basis(nadir)
    stated = np.sqrt(np.diag((basis @ covariance[:2, :2] @ basis.T)[:2, :2]))
    assert stated == pytest.approx(np.std(errors, axis=0), rel=0.08)


def test_a_constant_height_moves_no_nadir_and_points_do_not_help():
    los = arc(math.radians(68.0), 0.4)
    nadir = np.array([0.0, 0.0, 1.0])
    same = {"flattening": 0.0, "earth_radius_m": R}
    level = systematic_covariance(los, nadir, math.radians(68.0), reliefs=(Relief(1e3, 1e3),), **same)
    assert math.degrees(math.sqrt(np.linalg.eigvalsh(level[:2, :2])[-1])) < 1e-4
    few = systematic_covariance(los, nadir, math.radians(68.0), reliefs=(Relief(1e3, 0.3),), **same)
    dense = arc(math.radians(68.0), 0.4, 1201)
    many = systematic_covariance(dense, nadir, math.radians(68.0), reliefs=(Relief(1e3, 0.3),), **same)
    assert many == pytest.approx(few, rel=0.05, abs=1e-9)
