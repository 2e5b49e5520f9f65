"""Heights at which made-up limb profiles drop."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from synthetic import truth_at

from horizonval.frame import FrameTruth
from horizonval.truth.infrared_horizon import locate, profile_heights_m

HEIGHT = profile_heights_m(100e3)


def profile(middle_m: float, width_m: float, plateau: float = 5.0) -> np.ndarray:
    """A smooth step: half at its middle, where it is also steepest."""
    return plateau / (1.0 + np.exp((HEIGHT - middle_m) / width_m))


def test_an_opaque_band() -> None:
    found = locate(HEIGHT, np.stack([profile(40e3, 3e3), profile(37e3, 3e3)]), np.array([5.2, 8.0]))
    assert found.kind == "opaque"
    # The plateau at 10 km is exp(-10) short of 5; the spline's steps are a sixth of the width.
    np.testing.assert_allclose(found.plateau, 5.0, rtol=2e-4)
    np.testing.assert_allclose(found.half_plateau_m, [40e3, 37e3], rtol=0, atol=5.0)
    np.testing.assert_allclose(found.maximum_gradient_m, [40e3, 37e3], rtol=0, atol=20.0)


def test_a_window() -> None:
    found = locate(HEIGHT, profile(4e3, 1e3, plateau=30.0)[None], np.array([32.0]))
    assert found.kind == "window"
    assert found.plateau[0] == 32.0
    # 16 of 30 / (1 + exp(x)): x = ln(30 / 16 - 1)
    assert found.half_plateau_m[0] == pytest.approx(4e3 + 1e3 * np.log(30 / 16 - 1), abs=10.0)
    assert found.maximum_gradient_m[0] == pytest.approx(4e3, abs=20.0)


def test_the_highest_of_several_crossings() -> None:
    bump = profile(38e3, 2e3) * (1.0 - 0.8 * np.exp(-(((HEIGHT - 26e3) / 2e3) ** 2)))
    assert locate(HEIGHT, bump[None], np.array([5.0])).half_plateau_m[0] == pytest.approx(38e3, abs=10.0)


def test_a_limb_darker_than_half_the_ground() -> None:
    found = locate(HEIGHT, profile(10e3, 2e3, plateau=1.0)[None], np.array([20.0]))
    assert (found.kind, found.half_plateau_m[0]) == ("window", 0.0)


def test_the_kind_is_one_for_the_band() -> None:
    radiance = np.stack([profile(40e3, 3e3)] * 2)
    assert locate(HEIGHT, radiance, np.array([5.0, 9.0])).kind == "opaque"
    assert locate(HEIGHT, radiance, np.array([5.0, 15.0])).kind == "window"


def test_heights_end_below_the_top() -> None:
    assert HEIGHT[0] == 0.0
    assert np.all(np.diff(HEIGHT) > 0.0)
    assert profile_heights_m(50e3)[-1] <= 49.5e3


def test_what_was_read_stays_out_of_the_plain_data():
    truth = truth_at()
    before = json.dumps(truth.to_dict())
    assert truth.camera_spec is not None
    assert json.dumps(truth.to_dict()) == before
    assert truth == FrameTruth.from_dict(json.loads(before)) == pickle.loads(pickle.dumps(truth))


def test_names_of_scene_camera_and_head():
    truth = truth_at(name="pass")
    assert (truth.scene_name, truth.head, truth.camera_name) == ("pass", None, "vis-640x480")
    scene = {**truth.scene, "camera": {"file": "rigs/pair.toml", "head": "left"}}
    nameless = {**truth.camera, "camera": {**truth.camera["camera"], "name": ""}}
    other = replace(truth, scene=scene, camera=nameless)
    assert (other.head, other.camera_file, other.camera_name) == ("left", "rigs/pair.toml", "pair")
