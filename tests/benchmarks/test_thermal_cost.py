"""What a thermal band costs, in the same run.

48 g points from a new position against one visible wavelength that is marched cell by cell, 1024 x 1024; and another
look from the same position against the first, 160 x 120.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest
from peak_memory import run_apart

from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.renderer.table_store import TABLES
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

MOST_RATIO = 0.5
MOST_SHARED = 0.4
MOST_BYTES = 2e9
VISIBLE = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 1}
CO2 = {"name": "co2", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}


def _seconds(band: dict[str, Any], width: int = 1024, height: int = 1024, new_position: bool = True) -> float:
    """Return the CPU seconds of the quickest of three warm renders, air and ground varying with latitude."""
    scene = SceneSpec.model_validate(
        {
            "camera": {"file": "test", "mount_roll_deg": 66.0},
            "platform": {"altitude_km": 500.0, "latitude_deg": 20.0},
            "atmosphere": {"profile": "by_latitude_month"},
            "surface": {"kind": "earth"},
            "sun": {"zenith_deg": 60.0},
            "render": {"method": "march"},
        }
    )
    camera = CameraSpec.model_validate({"camera": {"width": width, "height": height, "fov_deg": 60.0}, "band": [band]})
    taken = []
    for _ in range(4):
        if new_position:
            TABLES.clear()
        start = time.process_time()
        render_frame(scene, camera)
        taken.append(time.process_time() - start)
    return min(taken[1:])


@pytest.mark.benchmark
def test_another_look_from_the_same_position_finds_its_tables(record_property: Callable[[str, float], None]) -> None:
    activate()
    first, again = _seconds(CO2, 160, 120), _seconds(CO2, 160, 120, new_position=False)
    record_property("shared", round(again / first, 2))
    assert again / first < MOST_SHARED, f"{again:.2f} s against {first:.2f} s"


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
