"""The bytes of a frame depend neither on the number of threads nor on the frame that a campaign made before it."""

from __future__ import annotations

import hashlib
from typing import Any

import drjit as dr
import numpy as np
import pytest
from emission_models import PACIFIC, camera, scene

from horizonval.renderer import frame
from horizonval.renderer.backend import activate
from horizonval.renderer.table_store import TABLES
from horizonval.spec.load import load_scene

SOLAR = {"name": "b", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 2}
THERMAL = {"name": "b", "kind": "thermal", "lo_um": 10.0, "hi_um": 11.0}
CO2 = {"name": "b", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}
LENS = {"width": 320, "height": 320, "distortion": [-0.12, 0.03, 4e-4, -3e-4, -0.004]}
SMALL = {"width": 40, "height": 30}
EARTH = {"kind": "earth"}
CLOUDS = {"cover": 0.5, "seed": 5, "scale_km": 200.0}
CLIMATES = {"profile": "by_latitude_month"}
ONCE = {"orders": "single", "nodes": 128}

FRAMES: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    "sunlight": ({}, SOLAR, {}),
    "thermal": ({}, THERMAL, {}),
    "clouds over the Earth": ({"surface": EARTH, "clouds": CLOUDS, "render": ONCE}, SOLAR, SMALL),
    "clouds over the Earth, all orders": ({"surface": EARTH, "clouds": CLOUDS}, SOLAR, {}),
    "clouds over even ground": ({"surface": {"albedo": 0.2}, "clouds": CLOUDS, "render": ONCE}, SOLAR, SMALL),
    "thermal clouds": ({"clouds": CLOUDS}, CO2, SMALL),
    "whole pixels": ({"render": ONCE}, SOLAR, LENS),
    "whole pixels, marched": ({"render": ONCE | {"method": "march"}}, SOLAR, LENS),
    "climates under clouds": ({"atmosphere": CLIMATES, "surface": EARTH, "clouds": CLOUDS}, CO2, {}),
    "terminator": ({"sun": {"zenith_deg": 94.0}, "clouds": CLOUDS, "surface": EARTH}, SOLAR, {}),
    "moonlight": ({"sun": {"zenith_deg": 130.0}, "moon": {"zenith_deg": 60.0, "azimuth_deg": 10.0}}, SOLAR, {}),
    "refraction": ({"sun": {"zenith_deg": 93.0}, "atmosphere": {"refraction": True}}, SOLAR, {}),
}
SLOW = (
    "clouds over the Earth, all orders",
    "whole pixels, marched",
    "climates under clouds",
    "terminator",
    "moonlight",
    "refraction",
)


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in FRAMES])
def test_the_number_of_threads_changes_no_bit(name: str) -> None:
    activate()
    changes, band, size = FRAMES[name]
    specs = scene(platform=PACIFIC, **changes), camera(band, **({"width": 96, "height": 72} | size))
    seen, before = set(), dr.thread_count()
    try:
        for threads in (1, 2, 4):
            dr.set_thread_count(threads)
            TABLES.clear()
            made = frame.render_frame(*specs)
            seen.add(hashlib.sha256(made.radiance["b"].tobytes() + made.maps["hit"].tobytes()).hexdigest())
    finally:
        dr.set_thread_count(before)
    assert len(seen) == 1


def test_frames_of_one_viewpoint_have_the_bytes_of_frames_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, spec = load_scene("day-limb")
    spec = spec.model_copy(update={"camera": spec.camera.model_copy(update={"width": 24, "height": 16})})
    quick = seen.render.model_copy(update={"orders": "single", "subsamples": 1, "nodes": 16})
    seen = seen.model_copy(update={"render": quick})
    turned = seen.model_copy(update={"attitude": seen.attitude.model_copy(update={"yaw_deg": 20.0, "roll_deg": 3.0})})
    higher = seen.model_copy(update={"platform": seen.platform.model_copy(update={"altitude_km": 777.0})})
    described, describe = [], frame.describe
    monkeypatch.setattr(frame, "_last", {})
    monkeypatch.setattr(frame, "describe", lambda *arguments: described.append(1) or describe(*arguments))
    scenes = (seen, turned, higher, seen)
    frames = [frame.render_in_turn(one, spec) for one in scenes]
    assert len(described) == 3
    for made, one in zip(frames, scenes, strict=True):
        alone = frame.render_frame(one, spec)
        assert made.truth == alone.truth
        assert made.render == alone.render
        for kind in ("radiance", "energy_radiance", "maps"):
            for name, values in getattr(alone, kind).items():
                np.testing.assert_array_equal(getattr(made, kind)[name], values)
