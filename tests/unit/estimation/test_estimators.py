"""Estimators by name, the ideal sensor, and what methods claim."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.limb.cone import cone_uncertainty
from horizonval.estimation.limb.crossing import row_noise, sub_pixel_crossing
from horizonval.estimation.methods import ideal
from horizonval.estimation.methods.altitude_free import ESTIMATOR as ALTITUDE_FREE
from horizonval.estimation.methods.altitude_free import fit_of_cone, solve
from horizonval.estimation.methods.ideal import ESTIMATOR as IDEAL
from horizonval.estimation.methods.ideal import ReadingStatus, horizon_sensor
from horizonval.estimation.methods.linear_heads import HeadRow, fit_crossings, head_rows
from horizonval.estimation.observation import Estimator, Fit, Observation, OraclePose
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.frames import nadir_of_roll_pitch, roll_pitch_of_nadir
from horizonval.geometry.horizon import fit_cone
from horizonval.plugins import registry

RADIUS_M = 6_371_008.8
R = np.array([RADIUS_M + 500e3, 0.0, 0.0])
RHO = np.arcsin(RADIUS_M / R[0])


def _attitude(elevation_rad: float, roll_rad: float = 0.0) -> np.ndarray:
    """Return a camera whose boresight is ``elevation`` above the horizon and whose right axis is level, then rolled."""
    nadir, side = np.array([-1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    off = RHO + elevation_rad
    forward = np.cos(off) * nadir + np.sin(off) * side
    up = np.sin(off) * -nadir + np.cos(off) * side
    right = np.cross(forward, up)
    down = -up
    itrs_from_cam = np.stack([right, down, forward], axis=1)
    roll = Rotation.from_euler("z", roll_rad)
    return (roll * Rotation.from_matrix(itrs_from_cam).inv()).as_quat()


def test_ideal_sensor_reads_zero_on_the_level_horizon() -> None:
    reading = horizon_sensor(R, _attitude(0.0), RADIUS_M)
    assert reading.status is ReadingStatus.DEFINED
    assert abs(reading.roll_error_rad) < 1e-9
    assert abs(reading.pitch_error_rad) < 1e-9
    assert reading.horizon_cam == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)


@pytest.mark.parametrize("elevation_rad", [-0.3, -1e-4, 1e-4, 0.2])
def test_pitch_error_is_the_signed_height_above_the_horizon(elevation_rad: float) -> None:
    reading = horizon_sensor(R, _attitude(elevation_rad), RADIUS_M)
    assert reading.pitch_error_rad == pytest.approx(elevation_rad, abs=1e-9)


@pytest.mark.parametrize("roll_rad", [-0.4, 0.4])
def test_roll_error_changes_sign_with_the_roll(roll_rad: float) -> None:
    reading = horizon_sensor(R, _attitude(0.0, roll_rad), RADIUS_M)
    assert abs(reading.roll_error_rad) == pytest.approx(0.4, abs=1e-9)
    other = horizon_sensor(R, _attitude(0.0, -roll_rad), RADIUS_M)
    assert other.roll_error_rad == pytest.approx(-reading.roll_error_rad, abs=1e-9)


def test_boresight_at_nadir_zenith_and_inside_are_statuses() -> None:
    down = Rotation.align_vectors([[0.0, 0.0, 1.0]], [[-1.0, 0.0, 0.0]])[0].as_quat()
    up = Rotation.align_vectors([[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])[0].as_quat()
    assert horizon_sensor(R, down, RADIUS_M).status is ReadingStatus.BORESIGHT_AT_NADIR
    assert horizon_sensor(R, up, RADIUS_M).status is ReadingStatus.BORESIGHT_AT_ZENITH
    assert horizon_sensor(R / 2, up, RADIUS_M).status is ReadingStatus.INSIDE_EARTH


def _observation(**changes: object) -> Observation:
    values = {"image": np.zeros((48, 64)), "camera": CameraModel(64, 48, 55.0, 55.0, 31.5, 23.5)} | changes
    return Observation(**values)  # type: ignore[arg-type]


def test_newton_recovers_exact_points_to_rounding() -> None:
    nadir = nadir_of_roll_pitch(0.9, -0.4)
    basis = np.linalg.svd(nadir[None, :])[2][1:]
    angle = np.linspace(0.3, 1.8, 200)
    los = np.cos(RHO) * nadir + np.sin(RHO) * (np.cos(angle)[:, None] * basis[0] + np.sin(angle)[:, None] * basis[1])
    found, rho, steps = solve(los)
    assert found == pytest.approx(nadir, abs=1e-11)
    assert rho == pytest.approx(RHO, abs=1e-11)
    assert steps[-1][:2] == pytest.approx([0.9, -0.4], abs=1e-11)


def _noise() -> np.ndarray:
    return np.random.default_rng(np.random.SeedSequence(11)).normal(100.0, 20.0, (48, 64))


HOPELESS = {
    "black": np.zeros((48, 64)),
    "white": np.full((48, 64), 1023.0),
    "nan": np.full((48, 64), np.nan),
    "noise": _noise(),
    "checkerboard": 1000.0 * ((np.indices((48, 64)) // 6).sum(axis=0) % 2),
    "wrong size": np.zeros((10, 10)),
    "one pixel": np.zeros((1, 1)),
}


@pytest.mark.parametrize("name", HOPELESS)
def test_hopeless_images_are_refused(name: str) -> None:
    result = registry.run_safely(ALTITUDE_FREE, _observation(image=HOPELESS[name], full_scale=1023.0))
    assert isinstance(result, Refusal)
    assert result.status is not Outcome.VALID
    assert result.reason


def _broken(kind: str) -> Estimator:
    def run(observation: Observation) -> Fit | Refusal:
        if kind == "raises":
            raise ZeroDivisionError("no points")
        if kind == "nan":
            return Fit(np.full(3, np.nan), np.zeros((3, 3)), 0.0, 0.0)
        return "valid"  # type: ignore[return-value]

    return Estimator("broken", "Broken", run)


@pytest.mark.parametrize("kind", ["raises", "nan", "garbage"])
def test_a_broken_plug_in_becomes_a_refusal(kind: str) -> None:
    result = registry.run_safely(_broken(kind), _observation())
    assert isinstance(result, Refusal)
    assert result.status is Outcome.CRASHED
    assert ("ZeroDivisionError: no points" in result.output) == (kind == "raises")


@pytest.mark.parametrize("from_pole_rad", [1e-3, 1e-6, 1e-9])
def test_the_oracles_pitch_is_exact_next_to_ninety_degrees(from_pole_rad: float) -> None:
    """The arc sine would lose half of the digits there: 1e-8 rad."""
    pitch = np.pi / 2 - from_pole_rad
    nadir = nadir_of_roll_pitch(0.3, pitch)
    q = Rotation.align_vectors([nadir], [[-1.0, 0.0, 0.0]])[0]
    fit = IDEAL.run(_observation(oracle=OraclePose(np.array([7e6, 0.0, 0.0]), q.as_quat(), RADIUS_M)))
    assert isinstance(fit, Fit)
    # a few roundings of unit vectors
    assert fit.pitch_rad == pytest.approx(pitch, abs=1e-14)


CAMERA = CameraModel(64, 48, 55.0, 55.0, 31.5, 23.5)


@pytest.mark.parametrize("seed", range(12))
def test_the_ideal_sensor_reads_the_nearest_point_of_the_horizon(seed: int) -> None:
    """Against 20 000 points of the horizon; its angles turn the level camera at that point into the real one."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3)
    r = direction / np.linalg.norm(direction) * (RADIUS_M + 10 ** rng.uniform(4.5, 7.5))
    q = Rotation.random(rng=rng)
    reading = horizon_sensor(r, q.as_quat(), RADIUS_M)
    assert reading.status is ReadingStatus.DEFINED
    nadir = q.apply(-r / np.linalg.norm(r))
    rho = math.asin(RADIUS_M / np.linalg.norm(r))
    turn = np.linspace(0.0, 2 * np.pi, 20_000)[:, None]
    first = np.cross(nadir, [0.3, -0.5, 0.8])
    first /= np.linalg.norm(first)
    ring = np.cos(rho) * nadir + np.sin(rho) * (np.cos(turn) * first + np.sin(turn) * np.cross(nadir, first))
    nearest = ring[np.argmax(ring[:, 2])]
    assert reading.horizon_cam == pytest.approx(nearest, abs=5e-4)
    assert reading.horizon_cam @ nadir == pytest.approx(math.cos(rho), abs=1e-12)
    assert abs(reading.pitch_error_rad) == pytest.approx(math.acos(reading.horizon_cam[2]), abs=1e-7)
    above = math.acos(nadir[2]) > rho
    assert (reading.pitch_error_rad > 0) == above, "positive where the boresight points above the horizon"
    up = (reading.horizon_cam @ nadir) * reading.horizon_cam - nadir
    level_right = np.cross(reading.horizon_cam, up / np.linalg.norm(up))
    assert math.cos(reading.roll_error_rad) == pytest.approx(level_right[0], abs=1e-9)
    assert np.sign(reading.roll_error_rad) == np.sign(up[0])


def test_the_oracle_knows_its_pose() -> None:
    r = np.array([0.0, RADIUS_M + 700e3, 0.0])
    mounting = Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    attitude = Rotation.random(rng=np.random.default_rng(3))
    pose = OraclePose(r_itrs=r, q_cam_from_itrs=attitude.as_quat(), radius_m=RADIUS_M)
    seen = Observation(np.zeros((48, 64)), CAMERA, q_cam_from_body=mounting.as_quat(), oracle=pose)
    fit = ideal.run(seen)
    assert isinstance(fit, Fit)
    nadir = attitude.apply([0.0, -1.0, 0.0])
    assert fit.nadir_cam == pytest.approx(nadir, abs=1e-14)
    assert (fit.roll_rad, fit.pitch_rad) == pytest.approx(roll_pitch_of_nadir(mounting.inv().apply(nadir)), abs=1e-12)
    assert fit.altitude_m == pytest.approx(700e3 + RADIUS_M - seen.prior.sphere_radius_m, abs=1e-6)
    assert math.sin(fit.angular_radius_rad or 0.0) == pytest.approx(RADIUS_M / (RADIUS_M + 700e3))
    assert np.linalg.eigvalsh(fit.covariance_nadir_cam) == pytest.approx([0.0, 1e-24, 1e-24], abs=1e-27)
    for inside in (0.0, RADIUS_M * 0.999, np.nan):
        hidden = replace(seen, oracle=replace(pose, r_itrs=np.array([0.0, inside, 0.0])))
        assert not isinstance(ideal.run(hidden), Fit)
    without_pose = ideal.run(replace(seen, oracle=None))
    assert isinstance(without_pose, Refusal)
    assert without_pose.status is Outcome.BAD_INPUT


def arc(nadir: np.ndarray, rho: float, width_rad: float = 1.2, n: int = 150) -> np.ndarray:
    """Points of a cone about the one nearest to the boresight."""
    towards = np.array([0.0, 0.0, 1.0]) - nadir[2] * nadir
    e1 = towards / np.linalg.norm(towards)
    angle = np.linspace(-width_rad / 2, width_rad / 2, n)[:, None]
    return np.cos(rho) * nadir + np.sin(rho) * (np.cos(angle) * e1 + np.sin(angle) * np.cross(nadir, e1))


@pytest.mark.parametrize("tilt_deg", [5.0, 30.0, 60.0, 75.0, 88.0])
@pytest.mark.parametrize("rho_deg", [20.0, 63.0, 75.0])
@pytest.mark.parametrize("around_deg", [0.0, 130.0, 250.0])
def test_newton_ends_at_the_cone_that_closes_round_the_earth(
    tilt_deg: float, rho_deg: float, around_deg: float
) -> None:
    """Also where it goes by way of the mirrored cone; its iterates start at the guess and end at the answer."""
    tilt, around = math.radians(tilt_deg), math.radians(around_deg)
    nadir = np.array([math.sin(tilt) * math.cos(around), math.sin(tilt) * math.sin(around), math.cos(tilt)])
    found, rho, iterates = solve(arc(nadir, math.radians(rho_deg)))
    assert found == pytest.approx(nadir, abs=1e-8)
    assert rho == pytest.approx(math.radians(rho_deg), abs=1e-8)
    assert len(iterates) >= 2
    roll, pitch = roll_pitch_of_nadir(nadir)
    assert np.cos(iterates[-1, :2] - [roll, pitch]) == pytest.approx([1.0, 1.0], abs=1e-12)


def test_the_altitude_is_as_uncertain_as_the_angular_radius_makes_it() -> None:
    rng = np.random.default_rng(8)
    nadir, rho = np.array([0.0, math.sin(0.9), math.cos(0.9)]), 1.15
    los = arc(nadir, rho, 1.5, 400) + rng.normal(0.0, 1e-4, (400, 3))
    los /= np.linalg.norm(los, axis=1)[:, None]
    cone = fit_cone(los)
    uncertainty = cone_uncertainty(los, cone.axis_cam, cone.rho_rad)
    seen = Observation(np.zeros((48, 64)), CAMERA)
    uv = np.zeros((400, 2))
    model = np.diag([1e-8, 2e-8, 9e-8])
    step = 1e-6
    heights = [
        fit_of_cone(los, uv, cone.axis_cam, cone.rho_rad + k * step, uncertainty, seen).altitude_m or 0.0
        for k in (-1, 1)
    ]
    slope = abs(heights[1] - heights[0]) / (2 * step)
    assert (heights[0] + heights[1]) / 2 == pytest.approx(
        seen.prior.sphere_radius_m / math.sin(cone.rho_rad) - seen.prior.sphere_radius_m, rel=1e-6
    )
    for extra in (None, model):
        fit = fit_of_cone(los, uv, cone.axis_cam, cone.rho_rad, uncertainty, seen, model=extra)
        variance = uncertainty.covariance[2, 2] + (0.0 if extra is None else 9e-8)
        assert fit.sigma_altitude_m == pytest.approx(slope * math.sqrt(variance), rel=1e-4)
        assert fit.residuals_rad == pytest.approx(np.arccos(los @ cone.axis_cam) - cone.rho_rad, abs=1e-7)
    assert fit.systematic_nadir_cam is not None
    assert np.linalg.eigvalsh(fit.systematic_nadir_cam) == pytest.approx([0.0, 1e-8, 2e-8], abs=1e-14)


def four_rows(nadir_body: np.ndarray, rho: float) -> tuple[list[HeadRow], np.ndarray]:
    """Heads a quarter turn apart that look at a horizon, and where it crosses their rows."""
    line = CameraModel(160, 1, 570.0, 570.0, 79.5, 0.0)
    mean = 1.1
    heads, columns = {}, []
    for k in range(4):
        azimuth = math.radians(45.0 + 90.0 * k)
        out = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        boresight = math.sin(mean) * out + math.cos(mean) * np.array([0.0, 0.0, 1.0])
        right = math.cos(mean) * out - math.sin(mean) * np.array([0.0, 0.0, 1.0])
        body_from_cam = np.column_stack([right, np.cross(boresight, right), boresight])
        q = Rotation.from_matrix(body_from_cam).inv().as_quat()
        heads[f"h{k}"] = Observation(np.zeros((1, 160)), line, q_cam_from_body=q)
        fine = np.linspace(0.0, 159.0, 16_000)
        los = np.column_stack([(fine - 79.5) / 570.0, np.zeros(16_000), np.ones(16_000)])
        los = (los / np.linalg.norm(los, axis=1)[:, None]) @ body_from_cam.T
        inside = los @ nadir_body - math.cos(rho)
        order = np.argsort(inside)
        columns.append(np.interp(0.0, inside[order], fine[order]))
    rows = head_rows(replace(heads["h0"], heads=heads))
    assert isinstance(rows, list)
    return rows, np.array(columns)


def test_four_crossings_claim_their_scatter() -> None:
    """Nadir in the axes of the first head and altitude, over 600 draws of unlike crossings."""
    rng = np.random.default_rng(4)
    nadir = np.array([0.02, -0.01, 1.0])
    nadir /= np.linalg.norm(nadir)
    rows, columns = four_rows(nadir, 1.1)
    sigma = np.array([0.05, 0.1, 0.02, 0.08])
    exact = fit_crossings(rows, columns, sigma)
    assert isinstance(exact, Fit)
    turn = Rotation.from_quat(rows[0].observation.q_cam_from_body)
    assert exact.nadir_cam == pytest.approx(turn.apply(nadir), abs=1e-6)
    assert exact.angular_radius_rad == pytest.approx(1.1, abs=1e-6)
    off, heights = [], []
    for _ in range(600):
        fit = fit_crossings(rows, columns + sigma * rng.normal(size=4), sigma)
        assert isinstance(fit, Fit)
        off.append(fit.nadir_cam - exact.nadir_cam)
        heights.append(fit.altitude_m)
    scatter = np.cov(np.array(off).T)
    claimed = exact.covariance_nadir_cam
    assert np.linalg.norm(claimed - scatter) < 0.15 * np.linalg.norm(claimed)
    assert exact.sigma_altitude_m == pytest.approx(np.std(heights), rel=0.15)
    assert exact.points == pytest.approx(np.column_stack([columns, np.zeros(4)]))


@pytest.mark.parametrize("sigma", [1.5, 12.0])
def test_a_rows_noise_is_measured_beside_its_edge(sigma: float) -> None:
    rng = np.random.default_rng(2)
    pixels = np.arange(400.0)
    scene = 0.5 * pixels + np.where(pixels < 200, 900.0, 20.0)
    found = [row_noise(scene + rng.normal(0.0, sigma, 400), 200) for _ in range(40)]
    # The larger of two sides: a little more than the truth.
    assert np.mean(found) == pytest.approx(1.06 * sigma, rel=0.07)
    quiet_left = np.where(pixels < 200, 0.0, rng.normal(0.0, sigma, 400))
    assert row_noise(scene + quiet_left, 200) == pytest.approx(sigma, rel=0.2)
    assert row_noise(scene + quiet_left[::-1], 200) == pytest.approx(sigma, rel=0.2)
    assert row_noise(np.rint(np.where(pixels < 200, 900.0, 20.0)), 200) == pytest.approx(1 / math.sqrt(12.0))
    assert row_noise(np.where(pixels < 200, 900.3, 20.1), 200) == 0.0
    assert row_noise(scene[190:215] + 0.5, 10) == 0.0, "too short to know"


@pytest.mark.parametrize("scale", [0.5, 40.0])
def test_a_crossing_does_not_depend_on_gain_and_offset(scale: float) -> None:
    pixels = np.arange(120.0)
    noise = np.random.default_rng(0).normal(0.0, 3.0, 120)
    for width in (0.4, 6.0):
        row = 900.0 / (1.0 + np.exp((pixels - 61.3) / (width / 2.5))) + noise
        plain, scaled = sub_pixel_crossing(row), sub_pixel_crossing(scale * row + 0.123)
        assert scaled.column == pytest.approx(plain.column, abs=1e-6)  # type: ignore[union-attr]
        assert scaled.sigma_px == pytest.approx(plain.sigma_px, rel=1e-6)  # type: ignore[union-attr]
        assert scaled.kind == plain.kind == ("area" if width < 1 else "half-level")  # type: ignore[union-attr]
