"""What is known beside the image: values with their sigmas, and the mistakes that are found in them."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.core.errors import UserError
from horizonval.estimation.prior import Prior

TURN = [0.5, 0.5, 0.5, 0.5]


def test_nothing_is_known_without_being_given() -> None:
    prior = Prior()
    assert prior.known == ()
    assert repr(prior) == "<Prior of nothing>"
    assumed = {name for name, value in vars(prior).items() if value is not None}
    assert assumed == {
        "limb_scale_height_m",
        "limb_scale_height_sigma_m",
        "air_height_sigma_m",
        "lens_blur_px",
        "accept_rad",
    }
    assert prior.angular_radius is None
    # (2 a + b) / 3 of WGS84's 6378137.0 and 6356752.3142 m.
    assert prior.sphere_radius_m == pytest.approx((2 * 6378137.0 + 6356752.3142) / 3, abs=0.1)
    assert prior.flattening == pytest.approx(1 / 298.257223563)


def test_an_altitude_predicts_the_angular_radius() -> None:
    """From the geostationary orbit the Earth measures 17.4 deg; the variance is that of a finite difference."""
    prior = Prior(shape="sphere", radius_m=6.371e6, altitude_m=35_786e3, altitude_sigma_m=5e3)
    assert prior.angular_radius is not None
    rho, variance = prior.angular_radius
    assert math.degrees(2 * rho) == pytest.approx(17.38, abs=0.01)
    higher = replace(prior, altitude_m=35_786e3 + 5e3).angular_radius
    assert higher is not None
    # Second order: half of 5 km in 42 000 km.
    assert math.sqrt(variance) == pytest.approx(rho - higher[0], rel=2e-4)


def test_a_time_is_utc() -> None:
    noon = datetime(2026, 3, 20, 12, 0, tzinfo=UTC)
    assert Prior(epoch_utc=noon.replace(tzinfo=None)).epoch_utc == noon
    east = noon.astimezone(timezone(timedelta(hours=5)))
    moved = Prior(epoch_utc=east).epoch_utc
    assert moved is not None
    assert (moved, moved.tzinfo) == (noon, UTC)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"altitude_m": 5e5}, "altitude_m without altitude_sigma_m"),
        ({"altitude_sigma_m": 1e3}, "altitude_sigma_m without altitude_m"),
        ({"r_itrs": [7e6, 0.0, 0.0]}, "r_itrs without position_sigma_m"),
        ({"q_cam_from_itrs": TURN}, "q_cam_from_itrs without attitude_sigma_rad"),
        ({"limb_height_m": 2e4}, "limb_height_m without limb_height_sigma_m"),
        ({"altitude_m": 5e5, "altitude_sigma_m": 0.0}, "above 0"),
        ({"altitude_m": 5e5, "altitude_sigma_m": -1.0}, "above 0"),
        ({"altitude_m": -5e5, "altitude_sigma_m": 1.0}, "above 0"),
        ({"altitude_m": math.nan, "altitude_sigma_m": 1.0}, "finite"),
        ({"altitude_m": "high", "altitude_sigma_m": 1.0}, "finite number"),
        ({"sun_sigma_rad": -0.1}, "sun_sigma_rad: found -0.1"),
        ({"r_itrs": [7e6, 0.0], "position_sigma_m": 1e3}, "3 finite numbers"),
        ({"r_itrs": [7e6, 0.0, math.inf], "position_sigma_m": 1e3}, "3 finite numbers"),
        ({"r_itrs": "here", "position_sigma_m": 1e3}, "3 finite numbers"),
        ({"q_cam_from_itrs": [1.0, 0.0, 0.0, 1.0], "attitude_sigma_rad": [1, 1, 1]}, "length of 1.41421"),
        ({"q_cam_from_itrs": TURN, "attitude_sigma_rad": [0.1, 0.0, 0.1]}, "angles above 0"),
        ({"q_cam_from_itrs": TURN, "attitude_sigma_rad": 0.1}, "3 finite numbers"),
        ({"shape": "flat"}, "'wgs84' or 'sphere'"),
        ({"nadir_cam": [0.0, 1.0, 0.0]}, "nadir_cam without attitude_sigma_rad"),
        ({"nadir_cam": [0.0, 0.0, 0.0], "attitude_sigma_rad": [1, 1, 1]}, "a vector other than 0"),
        ({"nadir_cam": [0, 1, 0], "q_cam_from_itrs": TURN, "attitude_sigma_rad": [1, 1, 1]}, "one of the two"),
        ({"limb_scale_height_m": -1.0}, "a number of 0 or more"),
        ({"limb_scale_height_m": None}, "limb_scale_height_m: found None"),
        ({"limb_relief_m": -1.0}, "a number of 0 or more"),
        ({"accept_rad": 0.0}, "accept_rad: found 0.0"),
        ({"radius_m": 6e6}, "shape = 'sphere'"),
        ({"shape": "wgs84", "radius_m": 6e6}, "shape = 'sphere'"),
    ],
)
def test_a_mistake_is_one_line(values: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=r"^Prior: ") as found:
        Prior(**values)
    assert message in found.value.line()


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.0, 0.0, 6.35e6)])
def test_a_place_inside_the_planet_is_refused(place: tuple[float, float, float]) -> None:
    with pytest.raises(UserError, match=r"r_itrs: found a place .* km from the Earth's centre; expected one outside"):
        Prior(r_itrs=np.array(place), position_sigma_m=1e3)


def test_a_rough_nadir_is_stated_or_follows_from_attitude_and_position() -> None:
    stated = Prior(nadir_cam=[0.0, 3.0, 4.0], attitude_sigma_rad=[0.1, 0.2, 0.3])
    assert stated.known == ("nadir_cam",)
    assert stated.rough_nadir is not None
    assert stated.rough_nadir[0] == pytest.approx([0.0, 0.6, 0.8])
    assert stated.rough_nadir[1] == 0.3
    turn = Rotation.from_euler("xyz", [0.3, -1.0, 2.0])
    place = np.array([7e6, -1e6, 2e5])
    posed = Prior(
        r_itrs=place, position_sigma_m=1e3, q_cam_from_itrs=turn.as_quat(), attitude_sigma_rad=[0.1, 0.1, 0.1]
    )
    assert posed.rough_nadir is not None
    assert posed.rough_nadir[0] == pytest.approx(turn.apply(-place / np.linalg.norm(place)))
    assert Prior().rough_nadir is None
