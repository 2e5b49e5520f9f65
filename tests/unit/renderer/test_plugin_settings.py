"""What the plugins are told: objects in process, the same as text in scene files, tables found by their digest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import horizonval.renderer  # noqa: F401  (names the LLVM library before Dr.Jit is imported)
from horizonval.core.arrays import FloatArray
from horizonval.renderer.plugin import integrator, model_text, scene_text
from horizonval.renderer.plugin.plugins import mitsuba_scene
from horizonval.renderer.plugin.settings import LimbSettings
from horizonval.renderer.scene.description import Described, describe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

CAMERA = CameraSpec.model_validate(
    {
        "camera": {"width": 16, "height": 12, "fov_deg": 60.0},
        "band": [{"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 2}],
    }
)


@pytest.fixture(scope="module")
def described() -> Described:
    scene = {
        "camera": {"file": "test", "mount_roll_deg": 66.0},
        "platform": {"altitude_km": 500.0, "latitude_deg": 20.0, "longitude_deg": -160.0},
        "sun": {"zenith_deg": 40.0, "azimuth_deg": 60.0},
        "moon": {"zenith_deg": 110.6, "azimuth_deg": 97.0},
        "clouds": {"cover": 0.3},
        "render": {"subsamples": 1, "orders": "single"},
    }
    return describe(SceneSpec.model_validate(scene), CAMERA)


def _image(mi: Any, scene: Any) -> FloatArray:
    return np.array(mi.render(scene, spp=1))


def test_text_and_objects_are_the_same_settings_and_the_same_image(described: Described) -> None:
    import mitsuba as mi

    scene = mi.load_dict(scene_text.scene_properties(described.limb, described.sensor))
    settings = scene.integrator().settings
    assert settings.tables_digest == described.limb.tables_digest
    assert (settings.ground, settings.moon) == (described.limb.ground, described.limb.moon)
    assert settings.moon is not None
    direct = _image(mi, mitsuba_scene(described.limb, described.sensor))
    assert direct.any()
    assert np.array_equal(_image(mi, scene), direct)


@pytest.mark.parametrize("method", ["table", "march"])
def test_the_method_goes_through_text(described: Described, method: str) -> None:
    import mitsuba as mi

    limb = replace(described.limb, method=method)
    assert mi.load_dict(scene_text.limb_properties(limb)).settings.method == method


def test_nothing_is_written_as_text_in_process(described: Described, monkeypatch: pytest.MonkeyPatch) -> None:
    import mitsuba as mi

    def refuse(*_: Any) -> None:
        raise AssertionError("the optical model was written as text")

    for module, name in ((model_text, "dump_model"), (scene_text, "dump_model"), (scene_text, "load_model")):
        monkeypatch.setattr(module, name, refuse)
    assert _image(mi, mitsuba_scene(described.limb, described.sensor)).any()


def test_tables_are_made_once_for_the_same_content(described: Described, monkeypatch: pytest.MonkeyPatch) -> None:
    limb = described.limb
    tables = integrator.prepare(limb)

    def refuse(*_: Any) -> None:
        raise AssertionError("tables were made again")

    node, *others = limb.model.nodes

    def scaled(factor: float) -> LimbSettings:
        nodes = (replace(node, extinction_per_m=node.extinction_per_m * factor), *others)
        return replace(limb, model=replace(limb.model, nodes=nodes), nodes=32, sun_itrs=(1.0, 0.0, 0.0))

    monkeypatch.setattr(integrator, "_make_tables", refuse)
    assert integrator.prepare(scaled(1.0)) is tables
    with pytest.raises(AssertionError, match="made again"):
        integrator.prepare(scaled(1.0 + 1e-15))
