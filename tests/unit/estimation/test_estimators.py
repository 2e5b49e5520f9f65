"""Registry, ideal sensor, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.methods.altitude_free import ESTIMATOR as ALTITUDE_FREE
from horizonval.estimation.methods.ideal import ESTIMATOR as IDEAL
from horizonval.estimation.methods.ideal import ReadingStatus, ideal_horizon_sensor
from horizonval.estimation.observation import Estimator, Fit, Observation, OraclePose
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.plugins import registry

RADIUS_M = 6_371_008.8
R = np.array([RADIUS_M + 500e3, 0.0, 0.0])


def test_boresight_at_nadir_zenith_and_inside_are_statuses() -> None:
    down = Rotation.align_vectors([[0.0, 0.0, 1.0]], [[-1.0, 0.0, 0.0]])[0].as_quat()
    up = Rotation.align_vectors([[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])[0].as_quat()
    assert ideal_horizon_sensor(R, down, RADIUS_M).status is ReadingStatus.BORESIGHT_AT_NADIR
    assert ideal_horizon_sensor(R, up, RADIUS_M).status is ReadingStatus.BORESIGHT_AT_ZENITH
    assert ideal_horizon_sensor(R / 2, up, RADIUS_M).status is ReadingStatus.INSIDE_EARTH


def _observation(**changes: object) -> Observation:
    values = {"image": np.zeros((48, 64)), "camera": CameraModel(64, 48, 55.0, 55.0, 31.5, 23.5)} | changes
    return Observation(**values)  # type: ignore[arg-type]


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


def test_unknown_estimator_names_the_nearest_first() -> None:
    assert {"altitude-free", "ideal", "linear-heads", "video-vertical"} <= set(registry.names())
    with pytest.raises(UserError, match="one of altitude-free,"):
        registry.get("altitude_fre")


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
