"""Several heads in a camera file: which one a scene means, how it is turned, what suites and commands make of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.geometry.frames import inverse, rotate
from horizonval.geometry.pose import pose_from_spec
from horizonval.spec.load import load_frames, load_scene, load_suite
from horizonval.truth.frame_truth import truth_of

CAMERA = """
[camera]
width = 160
height = 1
fov_deg = 16.0
[[band]]
name = "lwir"
kind = "thermal"
lo_um = 14.0
hi_um = 16.0
"""
HEADS = "".join(
    f'[[head]]\nname = "az{azimuth}"\nmount_yaw_deg = {azimuth}.0\nmount_pitch_deg = 60.0\n'
    for azimuth in (45, 135, 225, 315)
)
SCENE = '[scene]\nname = "s"\n[platform]\naltitude_km = 500.0\n[camera]\nfile = "c.toml"\n'
SUITE = """
[suite]
name = "suite"
estimators = ["ideal"]
[defaults]
platform.altitude_km = 500.0
camera.file = "c.toml"
[[frame]]
scene.name = "a"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "c.toml").write_text(CAMERA + HEADS)
    (tmp_path / "plain.toml").write_text(CAMERA)
    return tmp_path


def write(folder: Path, text: str) -> Path:
    (folder / "file.toml").write_text(text)
    return folder / "file.toml"


@pytest.mark.parametrize("azimuth", [45, 135, 225, 315])
def test_a_head_looks_where_its_angles_say(folder: Path, azimuth: int) -> None:
    """Yaw turns about the body's z, then pitch about y: 60 deg off the nadir, at the azimuth, its rows vertical."""
    scene, camera = load_scene(write(folder, SCENE + f'head = "az{azimuth}"\n'))
    q_body_from_cam = inverse(truth_of(scene, camera).q_cam_from_body)
    a, p = np.radians([azimuth, 60.0])
    boresight, right = rotate(q_body_from_cam, [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    assert boresight == pytest.approx([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], abs=1e-15)
    assert right == pytest.approx([np.cos(p) * np.cos(a), np.cos(p) * np.sin(a), -np.sin(p)], abs=1e-15)


def test_the_scene_turns_the_housing_and_the_head_turns_in_it(folder: Path) -> None:
    """A housing rolled by 90 deg carries every head's boresight with it: what was y of the housing is z of the body."""
    scene, camera = load_scene(write(folder, SCENE + 'head = "az135"\nmount_roll_deg = 90.0\n'))
    a, p = np.radians([135.0, 60.0])
    in_housing = np.array([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)])
    in_body = [in_housing[0], -in_housing[2], in_housing[1]]
    boresight = rotate(inverse(pose_from_spec(scene, camera).q_cam_from_body), [0.0, 0.0, 1.0])
    assert boresight == pytest.approx(in_body, abs=1e-15)


def test_a_frame_of_a_suite_is_one_of_every_head(folder: Path) -> None:
    """Under the scene's own name, so that the four look at the same clouds; each is a frame of its own."""
    suite = load_suite(write(folder, SUITE + '[[frame]]\nscene.name = "b"\ncamera.head = "az45"\n'))
    assert [case.name for case in suite.cases] == ["a.az45", "a.az135", "a.az225", "a.az315", "b"]
    four = suite.cases[:4]
    assert [case.scene.camera.head for case in four] == ["az45", "az135", "az225", "az315"]
    assert {case.scene.scene.name for case in four} == {"a"}
    assert len({truth_of(case.scene, case.camera).scene_id for case in four}) == 4
    with pytest.raises(UserError, match=r"two frames are named 'a\.az45'"):
        load_suite(write(folder, SUITE + '[[frame]]\nscene.name = "a.az45"\ncamera.head = "az45"\n'))


def test_all_heads_of_a_scene(folder: Path) -> None:
    path = write(folder, SCENE)
    assert [case.name for case in load_frames(path, "all")] == ["s.az45", "s.az135", "s.az225", "s.az315"]
    assert [case.name for case in load_frames(path, "az135")] == ["s"]
    assert load_scene(path, "az225")[0].camera.head == "az225"
    with pytest.raises(UserError, match="found 'all'"):
        load_scene(path, "all")


def test_a_pose_is_not_guessed_without_the_camera(folder: Path) -> None:
    scene, _ = load_scene(write(folder, SCENE + 'head = "az45"\n'))
    with pytest.raises(ValueError, match="head"):
        pose_from_spec(scene)
