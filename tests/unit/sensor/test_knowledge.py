"""What the platform knows of a frame: truth with errors of the stated size, the same whenever it is asked for."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import truth_at

from horizonval.core.errors import UserError
from horizonval.estimation.prior import Prior
from horizonval.frame import FrameTruth
from horizonval.geometry.ellipsoid import sphere
from horizonval.sensor.knowledge import (
    drawn_prior,
    method_radius_m,
    refuse_unknown_climate,
    stated_prior,
    sun_reading_cam,
)
from horizonval.spec.prior import PriorSpec

ALL = PriorSpec(
    altitude_sigma_km=2.0,
    position_sigma_km=1.0,
    attitude_sigma_deg=(0.5, 1.0, 2.0),
    sun_sigma_deg=1.0,
    climate="by_latitude_month",
)
TURN = (0.5, -0.5, 0.5, 0.5)
DRAWS = 1500


def named(number: int, **changes: Any) -> FrameTruth:
    return truth_at(name=f"frame-{number}", roll_deg=20.0, yaw_deg=-40.0, mount_roll_deg=50.0, **changes)


def errors(prior: Prior, truth: FrameTruth) -> np.ndarray:
    """Position [m], altitude [m], and the turn about the body's axes [deg], by scipy alone: shape (7,)."""
    cam_from_body = Rotation.from_quat(truth.q_cam_from_body)
    body_from_itrs = cam_from_body.inv() * Rotation.from_quat(truth.q_cam_from_itrs)
    believed = cam_from_body.inv() * Rotation.from_quat(prior.q_cam_from_itrs)
    turn = (believed * body_from_itrs.inv()).as_rotvec(degrees=True)
    return np.array([*(prior.r_itrs - truth.r_itrs), prior.altitude_m - truth.altitude_m, *turn])


def test_errors_have_the_stated_size_and_no_bias() -> None:
    """Over 1500 frames a standard deviation scatters by 1.8 % and a mean by 2.6 % of it: four and a half of those."""
    truth = named(0)
    found = []
    for number in range(DRAWS):
        one = replace(truth, scene=truth.scene | {"scene": {"name": f"frame-{number}", "seed": 0}})
        found.append(errors(drawn_prior(ALL, one), one))
    sigmas = np.array([1e3, 1e3, 1e3, 2e3, 0.5, 1.0, 2.0])
    scaled = np.array(found) / sigmas
    assert scaled.std(axis=0) == pytest.approx(np.ones(7), abs=0.085)
    assert scaled.mean(axis=0) == pytest.approx(np.zeros(7), abs=0.12)
    # Independent of each other: the correlation of 1500 pairs scatters by 2.6 %.
    assert np.abs(np.corrcoef(scaled.T) - np.eye(7)).max() < 0.12


def test_a_sun_sensor_is_off_by_its_sigma_across_the_direction() -> None:
    truth = named(0)
    sun = np.array(truth.sun_cam)
    angles = []
    for number in range(DRAWS):
        read = sun_reading_cam(0.02, replace(truth, scene={"scene": {"name": f"frame-{number}", "seed": 0}}))
        assert np.linalg.norm(read) == pytest.approx(1.0, abs=1e-15)
        angles.append(math.acos(min(1.0, read @ sun)))
    # Two directions: the mean square is twice that of one, and scatters by 2.6 %.
    assert np.mean(np.square(angles)) == pytest.approx(2 * 0.02**2, rel=0.12)
    assert sun_reading_cam(0.02, named(0, sun_visible_fraction=0.0)) is None


def test_what_is_drawn_is_the_same_whenever_it_is_asked_for() -> None:
    truth = named(7)
    # As it comes back from a file.
    again = FrameTruth.from_dict(truth.to_dict())
    assert (errors(drawn_prior(ALL, truth), truth) == errors(drawn_prior(ALL, again), again)).all()
    other = named(8)
    assert (errors(drawn_prior(ALL, truth), truth) != errors(drawn_prior(ALL, other), other)).all()


def test_an_error_goes_with_its_sigma_and_no_key_moves_anothers() -> None:
    """Common random numbers: designs that know more or less are compared with the same luck."""
    truth = named(3)
    alone = drawn_prior(PriorSpec(position_sigma_km=1.0), truth)
    beside = drawn_prior(ALL, truth)
    worse = drawn_prior(PriorSpec(position_sigma_km=10.0), truth)
    r = np.array(truth.r_itrs)
    assert (alone.r_itrs == beside.r_itrs).all()
    assert worse.r_itrs - r == pytest.approx(10.0 * (alone.r_itrs - r), rel=1e-6)


def test_scenes_of_one_draw_and_heads_of_one_housing_share_their_errors() -> None:
    one, other = named(1), named(2, altitude_km=800.0)
    for truth in (one, other):
        truth.scene["scene"]["draw"] = "condition-5"
    assert errors(drawn_prior(ALL, one), one) == pytest.approx(errors(drawn_prior(ALL, other), other), abs=1e-6)
    head = replace(one, q_cam_from_body=TURN, q_cam_from_itrs=_turned(one), scene=one.scene | {"camera": {"head": "b"}})
    assert errors(drawn_prior(ALL, head), head) == pytest.approx(errors(drawn_prior(ALL, one), one), abs=1e-6)
    body = [Rotation.from_quat(t.q_cam_from_body).inv().apply(sun_reading_cam(0.1, _sunlit(t))) for t in (one, head)]
    assert body[0] == pytest.approx(body[1], abs=1e-12)


def _turned(truth: FrameTruth) -> Any:
    """The attitude of a head of another mounting on the same body."""
    body = Rotation.from_quat(truth.q_cam_from_body).inv() * Rotation.from_quat(truth.q_cam_from_itrs)
    return tuple((Rotation.from_quat(TURN) * body).as_quat().tolist())


def _sunlit(truth: FrameTruth) -> FrameTruth:
    sun = Rotation.from_quat(truth.q_cam_from_itrs).apply(truth.sun_itrs)
    return replace(truth, sun_cam=tuple(sun.tolist()))


def test_nothing_is_known_that_is_not_stated() -> None:
    truth = named(0)
    assert drawn_prior(PriorSpec(), truth).known == ("shape",)
    assert drawn_prior(PriorSpec(altitude_sigma_km=1.0), truth).known == ("shape", "altitude_m")
    assert drawn_prior(PriorSpec(position_sigma_km=1.0), truth).known == ("shape", "r_itrs", "epoch_utc")
    assert drawn_prior(PriorSpec(attitude_sigma_deg=(1, 1, 2)), truth).known == (
        "shape",
        "q_cam_from_itrs",
        "epoch_utc",
    )
    assert drawn_prior(PriorSpec(sun_sigma_deg=1.0), truth).known == ("shape", "sun_sigma_rad")
    assert drawn_prior(PriorSpec(position_sigma_km=1.0), truth).epoch_utc == datetime(2026, 3, 20, 12, tzinfo=UTC)


def test_a_value_that_is_given_stands_as_it_is() -> None:
    given = PriorSpec(
        altitude_km=600.0,
        altitude_sigma_km=5.0,
        position_itrs_km=(1.0, -2.0, 7000.0),
        position_sigma_km=3.0,
        q_cam_from_itrs=TURN,
        attitude_sigma_deg=(1.0, 2.0, 3.0),
        epoch_utc=datetime(2020, 1, 2, tzinfo=UTC),
        limb_height_km=12.0,
        limb_height_sigma_km=2.0,
    )
    for prior in (drawn_prior(given, named(0)), stated_prior(given)):
        assert (prior.altitude_m, prior.altitude_sigma_m) == (600e3, 5e3)
        assert prior.r_itrs == pytest.approx([1e3, -2e3, 7e6])
        assert prior.q_cam_from_itrs == pytest.approx(TURN)
        assert prior.attitude_sigma_rad == pytest.approx(np.radians([1.0, 2.0, 3.0]))
        assert prior.epoch_utc == datetime(2020, 1, 2, tzinfo=UTC)
        assert (prior.limb_height_m, prior.limb_height_sigma_m) == (12e3, 2e3)


def test_the_planets_shape_is_the_scenes_or_what_is_stated() -> None:
    ball = truth_at(ellipsoid=sphere(6.0e6))
    assert (drawn_prior(PriorSpec(), ball).shape, drawn_prior(PriorSpec(), ball).radius_m) == ("sphere", 6.0e6)
    stated = PriorSpec(shape="sphere", radius_km=6400.0, altitude_sigma_km=1e-9)
    earth = truth_at()
    prior = drawn_prior(stated, earth)
    assert (prior.shape, prior.sphere_radius_m) == ("sphere", 6400e3)
    # The altitude is that above the stated shape.
    assert prior.altitude_m == pytest.approx(float(np.linalg.norm(earth.r_itrs)) - 6400e3, abs=1e-3)
    for spec, truth in ((PriorSpec(), ball), (stated, earth), (PriorSpec(), earth), (PriorSpec(shape="wgs84"), ball)):
        assert method_radius_m(spec, truth) == drawn_prior(spec, truth).sphere_radius_m


def test_an_altitude_is_never_below_the_ground() -> None:
    low = truth_at(altitude_km=30.0)
    for number in range(20):
        low.scene["scene"]["name"] = f"low-{number}"
        altitude = drawn_prior(PriorSpec(altitude_sigma_km=50.0), low).altitude_m
        assert altitude > 0.0


def test_a_thermal_limbs_height_is_drawn_about_that_of_half_the_plateau() -> None:
    truth = replace(truth_at(), infrared_horizon={"co2": {"half_plateau_height_m": [38e3, 42e3, 40e3]}})
    prior = drawn_prior(PriorSpec(limb_height_sigma_km=1e-6), truth, "co2")
    assert prior.limb_height_m == pytest.approx(40e3, abs=1.0)
    for band in ("vis", None):
        with pytest.raises(UserError, match="limb_height_km beside it"):
            drawn_prior(PriorSpec(limb_height_sigma_km=1.0), truth, band)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"altitude_sigma_km": 1.0}, ["altitude_sigma_km without altitude_km", "no truth"]),
        ({"position_sigma_km": 1.0}, ["position_sigma_km without position_itrs_km"]),
        ({"attitude_sigma_deg": (1.0, 1.0, 1.0)}, ["attitude_sigma_deg without q_cam_from_itrs"]),
        ({"limb_height_sigma_km": 1.0}, ["limb_height_sigma_km without limb_height_km"]),
        ({"sun_sigma_deg": 1.0}, ["no Sun sensor"]),
        (
            {"climate": "by_latitude_month", "position_sigma_km": 1.0, "position_itrs_km": (7e3, 0.0, 0.0)},
            ["without epoch_utc"],
        ),
    ],
)
def test_a_picture_has_no_truth_to_draw_from(keys: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(UserError, match=r"^p\.toml: ") as found:
        stated_prior(PriorSpec(**keys), "p.toml")
    for word in words:
        assert word in found.value.line()


@pytest.mark.parametrize("climate", [None, "tropical", "weather:ec2008-12", "none", "mine.csv", "mine.npz"])
def test_a_climate_is_a_name_or_a_file(climate: str | None) -> None:
    refuse_unknown_climate(PriorSpec(climate=climate))


def test_another_climate_is_a_mistake_with_the_nearest_names() -> None:
    with pytest.raises(UserError, match=r"prior\.climate: found 'tropicl'; .* one of tropical"):
        refuse_unknown_climate(PriorSpec(climate="tropicl"))
    with pytest.raises(UserError, match=r"prior\.climate: found 'tropicl'"):
        drawn_prior(PriorSpec(climate="tropicl"), named(0))
