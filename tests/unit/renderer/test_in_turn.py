"""Frames of one place that a campaign takes from one viewpoint have the bytes of frames that are rendered alone."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.renderer import frame
from horizonval.spec.load import load_scene


@pytest.fixture(autouse=True)
def _nothing_kept():
    frame._last.clear()
    yield
    frame._last.clear()


def test_the_place_is_kept_and_the_bytes_are_those_of_a_frame_alone(monkeypatch: pytest.MonkeyPatch):
    scene, camera = load_scene("day-limb")
    small = camera.camera.model_copy(update={"width": 24, "height": 16})
    camera = camera.model_copy(update={"camera": small})
    quick = scene.render.model_copy(update={"orders": "single", "subsamples": 1, "nodes": 16})
    scene = scene.model_copy(update={"render": quick})
    turned = scene.model_copy(update={"attitude": scene.attitude.model_copy(update={"yaw_deg": 20.0, "roll_deg": 3.0})})
    higher = scene.model_copy(update={"platform": scene.platform.model_copy(update={"altitude_km": 777.0})})
    described = []
    describe = frame.describe
    monkeypatch.setattr(frame, "describe", lambda *arguments: described.append(1) or describe(*arguments))
    frames = [frame.render_in_turn(one, camera) for one in (scene, turned, higher, scene)]
    assert len(described) == 3
    for made, one in zip(frames, (scene, turned, higher, scene), strict=True):
        alone = frame.render_frame(one, camera)
        assert made.truth == alone.truth
        assert made.render == alone.render
        for kind in ("radiance", "energy_radiance", "maps"):
            for name, values in getattr(alone, kind).items():
                np.testing.assert_array_equal(getattr(made, kind)[name], values)
