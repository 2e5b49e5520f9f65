"""The bytes of a frame depend on nothing but its scene: not on threads, on frames before it, on who made its tables."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from table_and_march import GREEN, NIR, angle_of_limb_deg, camera_of, scene_of

from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.renderer.table_store import TABLES
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

LIMB = angle_of_limb_deg(500.0)
CAMERA = camera_of(GREEN, NIR, width=48, height=40)
NARROW = camera_of(GREEN, NIR, width=32, height=32, fov_deg=4.0)

Frame = tuple[SceneSpec, CameraSpec]

FRAMES: dict[str, Frame] = {
    "day": (scene_of(86.0, azimuth_deg=20.0), CAMERA),
    "terminator": (scene_of(94.0, azimuth_deg=70.0, clouds={"cover": 0.4}, surface={"kind": "earth"}), CAMERA),
    "night": (scene_of(130.0, moon={"zenith_deg": 60.0, "azimuth_deg": 10.0}), CAMERA),
    "bent": (scene_of(93.0, atmosphere={"refraction": True}), CAMERA),
}


def _digest(scene: SceneSpec, camera: CameraSpec) -> str:
    frame = render_frame(scene, camera)
    return hashlib.sha256(b"".join(frame.radiance[band].tobytes() for band in sorted(frame.radiance))).hexdigest()


def _turned(scene: SceneSpec, azimuth_deg: float, tilt_deg: float) -> SceneSpec:
    attitude = scene.attitude.model_copy(
        update={"yaw_deg": scene.attitude.yaw_deg + azimuth_deg, "pitch_deg": tilt_deg, "roll_deg": 11.0}
    )
    return scene.model_copy(update={"attitude": attitude})


@pytest.fixture(scope="module", autouse=True)
def _backend() -> None:
    activate()


@cache
def _alone(name: str) -> str:
    """Return the digest of a frame that is rendered first of all after the tables were dropped."""
    TABLES.clear()
    return _digest(*FRAMES[name])


BY_NAME = ["day", *(pytest.param(name, marks=pytest.mark.slow) for name in FRAMES if name != "day")]
"""The others' frames are compared in other orders below."""


@pytest.mark.parametrize("name", BY_NAME)
def test_other_views_from_the_same_place_change_no_bit(name: str) -> None:
    """Frames before it that made some of its tiles, all, or others: turned about the vertical, down, up, narrow."""
    (scene, camera), alone = FRAMES[name], _alone(name)
    TABLES.clear()
    for azimuth_deg, tilt_deg, lens in ((25.0, LIMB, CAMERA), (0.0, LIMB, NARROW), (170.0, 10.0, CAMERA)):
        render_frame(_turned(scene, azimuth_deg, tilt_deg), lens)
        assert _digest(scene, camera) == alone


@pytest.mark.slow
def test_the_order_of_frames_changes_no_bit() -> None:
    alone = {name: _alone(name) for name in FRAMES}
    for order in (list(FRAMES), list(FRAMES)[::-1]):
        TABLES.clear()
        assert {name: _digest(*FRAMES[name]) for name in order} == alone


@pytest.mark.parametrize("name", BY_NAME)
def test_a_fresh_process_gives_the_same_bytes(name: str) -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import test_view_table_bytes as t\n"
        "t.activate()\n"
        f"print('result', t._digest(*t.FRAMES[{name!r}]))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split("result")[1].strip() == _alone(name)
