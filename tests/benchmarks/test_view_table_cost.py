"""What a frame costs by view tables against the march, in the same run: 1024 x 1024, three bands of four nodes.

Warm: kernels are compiled and the tables of multiple scattering are there. From a new position every table is made; at
the same position a turned camera finds most of them.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import pytest
from peak_memory import run_apart

from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

LEAST_AT_A_NEW_POSITION, LEAST_AT_A_NEW_ATTITUDE = 15.0, 40.0
MOST_BYTES = 2.0e9
BANDS = {"blue": (0.44, 0.50), "green": (0.52, 0.58), "red": (0.60, 0.67)}
REPEATS = 3
COVERED: dict[str, Any] = {"clouds": {"cover": 0.5, "seed": 3}, "surface": {"kind": "earth"}}


def _camera(pixels: int) -> CameraSpec:
    bands = [{"name": n, "kind": "solar", "lo_um": a, "hi_um": b, "nodes": 4} for n, (a, b) in BANDS.items()]
    return CameraSpec.model_validate({"camera": {"width": pixels, "height": pixels, "fov_deg": 60.0}, "band": bands})


def _scene(method: str, latitude_deg: float, turn: int, sun_zenith_deg: float, tables: dict[str, Any]) -> SceneSpec:
    return SceneSpec.model_validate(
        {
            "camera": {"file": "test", "mount_roll_deg": 65.0},
            "platform": {"altitude_km": 500.0, "latitude_deg": latitude_deg},
            "attitude": {"yaw_deg": 2.0 * turn, "roll_deg": 0.7 * turn, "pitch_deg": -0.4 * turn},
            "sun": {"zenith_deg": sun_zenith_deg},
            "render": {"method": method},
            **tables,
        }
    )


def seconds(pixels: int, sun_zenith_deg: float = 50.0, repeats: int = REPEATS, **tables: Any) -> dict[str, float]:
    """Return the processor time of a march, and the medians of tables from new positions and at new attitudes."""
    activate()
    camera = _camera(pixels)

    def spent(method: str, latitude_deg: float, turn: int) -> float:
        start = time.process_time()
        render_frame(_scene(method, latitude_deg, turn, sun_zenith_deg, tables), camera)
        return time.process_time() - start

    spent("table", 0.0, 0)
    spent("table", 0.0, 1)
    position = statistics.median(spent("table", 10.0 + 0.5 * k, 0) for k in range(repeats))
    attitude = statistics.median(spent("table", 10.0 + 0.5 * (repeats - 1), 1 + k) for k in range(repeats))
    small = _camera(16)
    # compiles the march's kernels
    render_frame(_scene("march", 0.0, 0, sun_zenith_deg, tables), small)
    return {"march": spent("march", 10.0, 0), "position": position, "attitude": attitude}


Record = Callable[[str, float], None]


def _report(times: dict[str, float], record_property: Record) -> tuple[float, float]:
    """Return how many times cheaper a frame is from a new position, and at a new attitude."""
    position, attitude = times["march"] / times["position"], times["march"] / times["attitude"]
    for name, value in (*times.items(), ("new position", position), ("new attitude", attitude)):
        record_property(name, round(value, 2))
    march, made, found = (times[key] for key in ("march", "position", "attitude"))
    print(f"\nmarch {march:.1f} s, new position {made:.2f} s ({position:.1f} x), "  # noqa: T201
          f"new attitude {found:.2f} s ({attitude:.1f} x)")  # fmt: skip
    return position, attitude


@pytest.mark.benchmark
def test_a_frame_by_tables_is_many_times_cheaper(record_property: Record) -> None:
    position, attitude = _report(seconds(1024), record_property)
    assert position >= LEAST_AT_A_NEW_POSITION
    assert attitude >= LEAST_AT_A_NEW_ATTITUDE


@pytest.mark.benchmark
@pytest.mark.parametrize(("sun_zenith_deg", "tables"), [(90.0, {}), (50.0, COVERED)], ids=["terminator", "clouds"])
def test_where_less_is_gained(sun_zenith_deg: float, tables: dict[str, Any], record_property: Record) -> None:
    """The shadow's edge takes small patches; rays that end on clouds are marched."""
    _report(seconds(1024, sun_zenith_deg, **tables), record_property)


def frames() -> float:
    """Render by tables in a process of its own, from two positions."""
    activate()
    for latitude_deg in (0.0, 10.0):
        render_frame(_scene("table", latitude_deg, 0, 50.0, {}), _camera(1024))
    return 0.0


@pytest.mark.benchmark
def test_a_large_frame_by_tables_stays_below_two_gigabytes() -> None:
    _, peak = run_apart("test_view_table_cost", "frames()")
    assert peak < MOST_BYTES
