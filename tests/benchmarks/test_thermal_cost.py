"""What a thermal band costs: 48 g points against one visible wavelength, 1024 x 1024, in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest
from peak_memory import run_apart

from horizonval.renderer.plugin.backend import activate
from horizonval.renderer.scene.frame import render_frame
from horizonval.spec.scene import SceneSpec
from horizonval.spec.sensor.camera import CameraSpec

MOST_RATIO = 6.0
MOST_BYTES = 2e9
VISIBLE = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 1}
CO2 = {"name": "co2", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}


def _seconds(band: dict[str, Any]) -> float:
    """Return the CPU seconds of the quicker of two warm renders, air and ground varying with latitude."""
    scene = SceneSpec.model_validate(
        {
            "camera": {"file": "test", "mount_roll_deg": 66.0},
            "platform": {"altitude_km": 500.0, "latitude_deg": 20.0},
            "atmosphere": {"profile": "by_latitude_month"},
            "surface": {"kind": "earth"},
            "sun": {"zenith_deg": 60.0},
        }
    )
    camera = CameraSpec.model_validate({"camera": {"width": 1024, "height": 1024, "fov_deg": 60.0}, "band": [band]})
    taken = []
    for _ in range(3):
        start = time.process_time()
        render_frame(scene, camera)
        taken.append(time.process_time() - start)
    return min(taken[1:])


@pytest.mark.benchmark
def test_a_thermal_band_costs_little_more_than_a_visible_wavelength(
    record_property: Callable[[str, float], None],
) -> None:
    activate()
    visible, thermal = _seconds(VISIBLE), _seconds(CO2)
    record_property("ratio", round(thermal / visible, 2))
    assert thermal / visible < MOST_RATIO, f"{thermal:.2f} s against {visible:.2f} s"


def frames() -> float:
    """Render thermal frames in a process of its own, and return the seconds of one."""
    activate()
    return _seconds(CO2)


@pytest.mark.benchmark
def test_a_large_thermal_frame_stays_below_two_gigabytes() -> None:
    _, peak = run_apart("test_thermal_cost", "frames()")
    assert peak < MOST_BYTES
