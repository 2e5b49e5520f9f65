"""Settings of the plugins, in process and from a scene file; which scenes share tables and viewpoints."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import emission_models
import numpy as np
import pytest

import horizonval.renderer  # noqa: F401  (names the LLVM library before Dr.Jit is imported)
from horizonval.renderer import plugins
from horizonval.renderer.description import Described, describe
from horizonval.renderer.frame_cost import shared_view, viewpoint_key
from horizonval.renderer.plugins import LimbSettings, mitsuba_scene
from horizonval.renderer.reference import reference
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import load_scene
from horizonval.spec.scene import SceneSpec

BAND = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 2}
CAMERA = emission_models.camera(BAND, width=16, height=12)
SCENE = emission_models.scene(
    platform=emission_models.PACIFIC,
    moon={"zenith_deg": 110.6, "azimuth_deg": 97.0},
    clouds={"cover": 0.3},
    render={"subsamples": 1, "orders": "single"},
)


@pytest.fixture(scope="module")
def described() -> Described:
    return describe(SCENE, CAMERA)


def test_a_scene_file_has_the_same_settings_and_the_same_image(described: Described) -> None:
    import mitsuba as mi

    reference.register_plugins()
    properties = {
        "integrator": reference.limb_properties(SCENE, CAMERA),
        "sensor": plugins.camera_properties(described.sensor),
    }
    scene = mi.load_dict({"type": "scene", **properties})
    settings = scene.integrator().settings
    assert settings.tables_digest == described.limb.tables_digest
    assert (settings.ground, settings.moon) == (described.limb.ground, described.limb.moon)
    direct = np.array(mi.render(mitsuba_scene(described.limb, described.sensor), spp=1))
    assert direct.any()
    assert np.array_equal(np.array(mi.render(scene, spp=1)), direct)


def test_tables_are_made_once_for_the_same_content(described: Described, monkeypatch: pytest.MonkeyPatch) -> None:
    limb = described.limb
    tables = plugins.prepare(limb)

    def refuse(*_: Any) -> None:
        raise AssertionError("tables were made again")

    node, *others = limb.model.nodes

    def scaled(factor: float) -> LimbSettings:
        nodes = (replace(node, extinction_per_m=node.extinction_per_m * factor), *others)
        return replace(limb, model=replace(limb.model, nodes=nodes), nodes=32, sun_itrs=(1.0, 0.0, 0.0))

    monkeypatch.setattr(plugins, "_make_tables", refuse)
    assert plugins.prepare(scaled(1.0)) is tables
    with pytest.raises(AssertionError, match="made again"):
        plugins.prepare(scaled(1.0 + 1e-15))


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


def test_scenes_that_share_their_tables_and_viewpoints(shipped: Any) -> None:
    assert [change for change in ALIKE if not _same(shared_view, *shipped, *change)] == []
    assert [change for change in APART if _same(shared_view, *shipped, *change)] == []
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
