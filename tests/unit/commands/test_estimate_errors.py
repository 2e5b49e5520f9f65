"""What ``estimate`` says of its errors comes from the truth in the file, which no estimator is given."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from synthetic import toy_image, truth_at

from horizonval.commands.estimate import estimate_file, estimator_of
from horizonval.estimation import registry
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.store import exr

OFF_RAD = math.radians(0.25)


def numbers(value: Any) -> list[float]:
    """Every number in a value, whatever holds it."""
    if dataclasses.is_dataclass(value):
        value = [getattr(value, f.name) for f in dataclasses.fields(value)]
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, np.ndarray):
        return [] if value.ndim > 1 else value.ravel().tolist()
    if isinstance(value, list | tuple):
        return [number for item in value for number in numbers(item)]
    return [float(value)] if isinstance(value, int | float) else []


@pytest.mark.parametrize("estimates", ["geocentric", "geodetic"])
def test_the_error_is_that_of_the_answer_and_the_truth_is_not_given(monkeypatch, tmp_path, estimates):
    truth = truth_at(roll_deg=66.0)
    exr.write_image(tmp_path / "a.exr", toy_image(truth))
    nadir = np.array(truth.nadir_geodetic_cam if estimates == "geodetic" else truth.nadir_geocentric_cam)
    across = np.cross(nadir, [0.0, 1.0, 0.0])
    answer = math.cos(OFF_RAD) * nadir + math.sin(OFF_RAD) * across / np.linalg.norm(across)
    given: list[Observation] = []

    def run(observation: Observation) -> Fit:
        given.append(observation)
        return Fit(nadir_cam=answer, covariance_nadir_cam=1e-6 * np.eye(3), roll_rad=1.0, pitch_rad=0.0)

    method = Estimator(name="told", title="told", run=run, estimates=estimates)
    monkeypatch.setattr(registry, "get", lambda name: method)
    report = estimate_file(tmp_path / "a.exr", estimator_of("told"), None)
    assert report["nadir_error_arcsec"] == pytest.approx(math.degrees(OFF_RAD) * 3600, rel=1e-9)
    assert report["false_valid"] is False
    assert given[0].oracle is None
    secret = {*truth.r_itrs, *truth.q_cam_from_itrs, *truth.nadir_geodetic_cam, *truth.nadir_geocentric_cam}
    assert not secret & set(numbers(given[0]))
