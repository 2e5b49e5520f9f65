"""What frames share is told from their scenes: attitude, lens and clouds do not count, place, Sun, air and bands do."""

from __future__ import annotations

from typing import Any

import pytest

from horizonval.renderer.frame_cost import shared_view, viewpoint_key
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import load_scene
from horizonval.spec.scene import SceneSpec


def _with(scene: SceneSpec, table: str, **values: Any) -> SceneSpec:
    return scene.model_copy(update={table: getattr(scene, table).model_copy(update=values)})


ALIKE = [
    ("scene", {"name": "other", "seed": 7}),
    ("attitude", {"yaw_deg": 30.0}),
    ("platform", {"heading_deg": 77.0}),
    ("camera", {"mount_roll_deg": 3.0}),
    ("clouds", {"seed": 9}),
]
APART = [
    ("platform", {"latitude_deg": 1.0}),
    ("platform", {"altitude_km": 700.0}),
    ("atmosphere", {"profile": "tropical", "ozone": False}),
    ("sun", {"zenith_deg": 12.0}),
    ("render", {"nodes": 99}),
]


@pytest.fixture(scope="module")
def shipped() -> Any:
    scene, camera = load_scene("broken-clouds")
    assert scene.clouds is not None
    return scene.model_copy(update={"sun": load_scene("sun-behind-limb")[0].sun}), camera


def _same(key: Any, scene: SceneSpec, camera: CameraSpec, table: str, values: dict[str, Any]) -> bool:
    changed = _with(scene, table, **values)
    assert changed != scene
    return bool(key(changed, camera) == key(scene, camera))


def test_scenes_that_share_their_tables(shipped: Any) -> None:
    assert [change for change in ALIKE if not _same(shared_view, *shipped, *change)] == []
    assert [change for change in APART if _same(shared_view, *shipped, *change)] == []


def test_scenes_of_one_viewpoint(shipped: Any) -> None:
    scene, camera = shipped
    assert [change for change in (*APART, ALIKE[-1]) if _same(viewpoint_key, *shipped, *change)] == []
    seeded = _with(scene, "clouds", seed=3)
    assert [change for change in ALIKE[:-1] if not _same(viewpoint_key, seeded, camera, *change)] == []
    drawn_by_name = _with(scene, "clouds", seed=None)
    assert not _same(viewpoint_key, drawn_by_name, camera, "scene", {"name": "other"})


def test_lens_and_bands(shipped: Any) -> None:
    scene, camera = shipped
    lens = camera.model_copy(update={"camera": camera.camera.model_copy(update={"fov_deg": 33.0})})
    band = camera.model_copy(update={"band": [camera.band[0].model_copy(update={"name": "other"})]})
    assert shared_view(scene, lens) == shared_view(scene, camera)
    assert shared_view(scene, band) != shared_view(scene, camera)
    assert viewpoint_key(scene, lens) != viewpoint_key(scene, camera)
