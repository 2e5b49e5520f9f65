"""What frames share is told from their scenes: attitude, lens and clouds do not count, place, Sun, air and bands do."""

from __future__ import annotations

from typing import Any

import pytest

from horizonval.renderer.frame_cost import shared_view, viewpoint_key
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


@pytest.mark.parametrize(("table", "values"), ALIKE)
def test_alike(shipped, table, values):
    scene, camera = shipped
    changed = _with(scene, table, **values)
    assert changed != scene
    assert shared_view(changed, camera) == shared_view(scene, camera)


@pytest.mark.parametrize(("table", "values"), APART)
def test_apart(shipped, table, values):
    scene, camera = shipped
    assert shared_view(_with(scene, table, **values), camera) != shared_view(scene, camera)


def test_lens_and_bands(shipped):
    scene, camera = shipped
    lens = camera.camera.model_copy(update={"fov_deg": 33.0})
    band = camera.band[0].model_copy(update={"name": "other"})
    assert shared_view(scene, camera.model_copy(update={"camera": lens})) == shared_view(scene, camera)
    assert shared_view(scene, camera.model_copy(update={"band": [band]})) != shared_view(scene, camera)


@pytest.mark.parametrize(("table", "values"), [*APART, ("clouds", {"seed": 9})])
def test_another_viewpoint(shipped, table, values):
    scene, camera = shipped
    assert viewpoint_key(_with(scene, table, **values), camera) != viewpoint_key(scene, camera)


def test_a_viewpoint_turns_and_has_one_lens(shipped):
    scene, camera = shipped
    scene = _with(scene, "clouds", seed=3)
    for table, values in ALIKE[:-1]:
        assert viewpoint_key(_with(scene, table, **values), camera) == viewpoint_key(scene, camera)
    lens = camera.camera.model_copy(update={"fov_deg": 33.0})
    assert viewpoint_key(scene, camera.model_copy(update={"camera": lens})) != viewpoint_key(scene, camera)


def test_clouds_that_the_name_draws_are_other_clouds_under_another_name(shipped):
    scene, camera = shipped
    scene = _with(scene, "clouds", seed=None)
    assert viewpoint_key(_with(scene, "scene", name="other"), camera) != viewpoint_key(scene, camera)
