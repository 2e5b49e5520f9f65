"""No guarded method claims an attitude of a picture that is not the Earth: :mod:`not_the_earth` draws them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache

import not_the_earth
import numpy as np
import pytest
from not_the_earth import ALTITUDE_M, FOCAL_PX, FULL_SCALE, HEIGHT, NADIR_OFF_DEG, WIDTH
from scipy.spatial.transform import Rotation

from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel
from horizonval.plugins import registry

CAMERA = CameraModel(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
GUARDED = (
    "guarded-altitude-free",
    "guarded-limb-sphere",
    "guarded-limb-ellipsoid",
    "guarded-limb-profile",
    "guarded-video-vertical",
)
BANDS_UM = {"solar": (0.45, 0.75), "thermal": (14.0, 16.25)}


def _known() -> tuple[Prior, np.ndarray]:
    """The orbit and the attitude of the pictures that contradict them, and the nadir [camera axes]."""
    off = np.radians(NADIR_OFF_DEG)
    nadir = np.array([0.0, np.sin(off), np.cos(off)])
    turn, _ = Rotation.align_vectors([nadir, [1.0, 0.0, 0.0]], [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    prior = Prior(
        shape="wgs84",
        altitude_m=ALTITUDE_M,
        altitude_sigma_m=5e3,
        r_itrs=[6378137.0 + ALTITUDE_M, 0.0, 0.0],
        position_sigma_m=2e3,
        q_cam_from_itrs=turn.as_quat(),
        epoch_utc=datetime(2026, 3, 20, 12, tzinfo=UTC),
        attitude_sigma_rad=np.radians([1.0, 1.0, 2.0]),
    )
    return prior, nadir


@cache
def _pictures() -> tuple[not_the_earth.Picture, ...]:
    return tuple(not_the_earth.pictures())


def _seen(picture: not_the_earth.Picture, band: str) -> Observation:
    prior, nadir = _known()
    one = Observation(
        picture.image,
        CAMERA,
        full_scale=FULL_SCALE,
        band_kind=band,
        band_um=BANDS_UM[band],
        prior=prior if picture.known else Prior(),
    )
    other = replace(one, q_cam_from_body=Rotation.from_rotvec(np.pi / 2.0 * nadir).as_quat())
    return replace(one, heads={"forward": one, "side": other})


def test_there_are_more_than_forty_half_of_them_with_knowledge_and_the_same_every_time() -> None:
    drawn = _pictures()
    assert len({picture.name for picture in drawn}) == len(drawn) > 40
    assert 0.4 < np.mean([picture.known for picture in drawn]) < 0.6
    again = tuple(not_the_earth.pictures())
    assert all(np.array_equal(one.image, other.image) for one, other in zip(drawn, again, strict=True))


@pytest.mark.parametrize("name", GUARDED)
def test_none_of_a_third_of_them_is_claimed(name: str) -> None:
    """Another third for every next method."""
    _none_is_claimed(name, "solar", _pictures()[GUARDED.index(name) % 3 :: 3])


@pytest.mark.slow
@pytest.mark.parametrize("band", BANDS_UM)
@pytest.mark.parametrize("name", GUARDED)
def test_none_of_them_is_claimed(name: str, band: str) -> None:
    _none_is_claimed(name, band, _pictures())


def _none_is_claimed(name: str, band: str, pictures: Sequence[not_the_earth.Picture]) -> None:
    estimator = registry.get(name)
    claimed = [one.name for one in pictures if isinstance(registry.run_safely(estimator, _seen(one, band)), Fit)]
    assert claimed == []
