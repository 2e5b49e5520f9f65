"""Settings of the plugins: objects in process, the same from a scene file; tables found by their digest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import horizonval.renderer  # noqa: F401  (names the LLVM library before Dr.Jit is imported)
from horizonval.renderer import plugins
from horizonval.renderer.description import Described, describe
from horizonval.renderer.plugins import LimbSettings, mitsuba_scene
from horizonval.renderer.reference import reference
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

CAMERA = CameraSpec.model_validate(
    {
        "camera": {"width": 16, "height": 12, "fov_deg": 60.0},
        "band": [{"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 2}],
    }
)


SCENE = SceneSpec.model_validate(
    {
        "camera": {"file": "test", "mount_roll_deg": 66.0},
        "platform": {"altitude_km": 500.0, "latitude_deg": 20.0, "longitude_deg": -160.0},
        "sun": {"zenith_deg": 40.0, "azimuth_deg": 60.0},
        "moon": {"zenith_deg": 110.6, "azimuth_deg": 97.0},
        "clouds": {"cover": 0.3},
        "render": {"subsamples": 1, "orders": "single"},
    }
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
