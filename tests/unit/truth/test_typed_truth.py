"""What a truth says of its camera and scene is read in one place, and stays out of its plain data."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace

from synthetic import SOLAR_CAMERA, THERMAL_CAMERA, truth_at

from horizonval.frame import FrameTruth
from horizonval.geometry.camera import camera_from_spec
from horizonval.spec.camera import CameraSpec


def test_the_camera_is_validated_once():
    truth = truth_at(SOLAR_CAMERA)
    assert truth.camera_spec == CameraSpec.model_validate(truth.camera)
    assert truth.camera_spec is truth.camera_spec
    assert truth.camera_model == camera_from_spec(truth.camera_spec.camera)


def test_another_camera_is_another_specification():
    truth = truth_at(SOLAR_CAMERA)
    assert truth.camera_spec.camera.width == 640
    other = replace(truth, camera=truth_at(THERMAL_CAMERA).camera)
    assert (other.camera_spec.camera.width, other.camera_model.width) == (160, 160)


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
