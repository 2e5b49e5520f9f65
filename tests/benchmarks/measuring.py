"""Processor time and peak memory, and the frames that are measured."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec


def spent_s(run: Callable[[], object]) -> float:
    """Return the processor time of a call."""
    start = time.process_time()
    run()
    return time.process_time() - start


def least_s(runs: dict[str, Callable[[], object]], repeats: int = 3) -> dict[str, float]:
    """Return the processor time of the quickest warm call of each, taken in turns after one that warms up."""
    taken: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(1 + repeats):
        for name, run in runs.items():
            taken[name].append(spent_s(run))
    return {name: min(times[1:]) for name, times in taken.items()}


def camera_of(pixels: int, *bands: dict[str, Any], **tables: Any) -> CameraSpec:
    """Return a square camera of 60 deg."""
    geometry = {"width": pixels, "height": pixels, "fov_deg": 60.0}
    return CameraSpec.model_validate({"camera": geometry, "band": list(bands), **tables})


def scene_of(latitude_deg: float = 0.0, longitude_deg: float = 0.0, turn: int = 0, **tables: Any) -> SceneSpec:
    """Return a limb from 500 km with the Sun 50 deg from the zenith; ``turn`` counts attitudes."""
    defaults = {
        "camera": {"file": "test", "mount_roll_deg": 65.0},
        "platform": {"altitude_km": 500.0, "latitude_deg": latitude_deg, "longitude_deg": longitude_deg},
        "attitude": {"yaw_deg": 2.0 * turn, "roll_deg": 0.7 * turn, "pitch_deg": -0.4 * turn},
        "sun": {"zenith_deg": 50.0},
    }
    return SceneSpec.model_validate(defaults | tables)


def peak_bytes() -> int:
    """Return the peak resident memory of this process, interpreter and compiler included."""
    # On Linux getrusage also counts what the parent held when it started this process.
    status = Path("/proc/self/status")
    if status.exists():
        return int(status.read_text().split("VmHWM:")[1].split()[0]) * 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def run_apart(module: str, call: str) -> tuple[str, int]:
    """Return what a call of a module of this folder gives, as text, and the peak memory of the process that made it."""
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        f"import {module} as t; from measuring import peak_bytes\n"
        f"print('result', t.{call}, 'peak', peak_bytes())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    result, peak = run.stdout.split("result")[1].split("peak")
    return result.strip(), int(peak)
