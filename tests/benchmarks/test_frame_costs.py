"""What parts of a frame cost, as ratios of processor time in one run with warm kernels; memory of large frames."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from measuring import camera_of, least_s, run_apart, scene_of, spent_s

from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.renderer.table_store import TABLES
from horizonval.sensor.observe import observe

pytestmark = pytest.mark.benchmark

Record = Callable[[str, float], None]
MOST_BYTES = 2.0e9
PROGRAM = Path(sys.executable).with_name("horizonval")
VISIBLE = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.7, "nodes": 4}
GREEN = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 1}
CO2 = {"name": "co2", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}
COLOURS = [
    {"name": name, "kind": "solar", "lo_um": low, "hi_um": high, "nodes": 4}
    for name, low, high in (("blue", 0.44, 0.50), ("green", 0.52, 0.58), ("red", 0.60, 0.67))
]
PLAIN: dict[str, Any] = {"aerosol": "none", "refraction": False}


def test_refraction_costs_less_than_the_march_again() -> None:
    activate()
    camera = camera_of(512, GREEN | {"nodes": 4})
    sun, render = {"zenith_deg": 60.0}, {"orders": "single"}
    scenes = {bent: scene_of(atmosphere={"refraction": bent}, sun=sun, render=render) for bent in (False, True)}
    spent = [least_s({"": lambda s=scene: render_frame(s, camera)}, 2)[""] for scene in scenes.values()]  # type: ignore[misc]
    assert spent[1] / spent[0] < 1.7, f"{spent[1]:.2f} s against {spent[0]:.2f} s"


def test_observing_with_all_stages_costs_less_than_half_the_rendering() -> None:
    activate()
    scene = scene_of(
        camera={"file": "test", "mount_roll_deg": 75.0, "mount_yaw_deg": 90.0},
        platform={"altitude_km": 500.0, "heading_deg": 90.0},
        sun={"zenith_deg": 95.0, "azimuth_deg": 90.0},
        render={"orders": "single"},
    )
    optics = {
        "f_number": 4.0,
        "psf_sigma_px": 0.7,
        "diffraction": True,
        "scatter": {"tis": 0.01, "l_rad": 0.005, "s": -2.0},
        "ghost": [{"ratio": 1e-5, "scale": -0.8, "blur_px": 5.0}],
    }
    detector = {"kind": "cmos", "pixel_pitch_um": 5.5, "exposure_s": 2.2e-4, "quantum_efficiency": 0.6}
    detector |= {"full_well_e": 13500, "read_noise_e": 13, "bits": 10}
    camera = camera_of(1024, GREEN, optics=optics, detector=detector)
    frame = render_frame(scene, camera)
    assert frame.radiance["vis"].max() > 1e4 * np.median(frame.radiance["vis"])  # The Sun is in it.
    rendering, observing = (
        least_s({"": run}, 2)[""] for run in (lambda: render_frame(scene, camera), lambda: observe(frame, camera))
    )
    assert observing / rendering < 0.5, f"{observing:.2f} s against {rendering:.2f} s"


def orders_s(pixels: int, repeats: int = 3) -> tuple[float, float]:
    """Return the processor time of a frame of three bands with one order of scattering and with all."""
    activate()
    camera = camera_of(pixels, *COLOURS)
    scenes = {orders: scene_of(render={"orders": orders, "subsamples": 2}) for orders in ("single", "all")}
    spent = least_s({orders: lambda s=s: render_frame(s, camera) for orders, s in scenes.items()}, repeats)  # type: ignore[misc]
    return spent["single"], spent["all"]


def test_all_orders_cost_little_more_than_one() -> None:
    single, every = orders_s(512)
    assert every / single < 1.4, f"{single:.2f} s with one order, {every:.2f} s with all"


@pytest.mark.slow
def test_a_large_frame_with_all_orders_stays_below_two_gigabytes() -> None:
    """Tables of the scattering included."""
    text, peak = run_apart("test_frame_costs", "orders_s(1024, 1)")
    single, every = (float(v) for v in text.strip("()").split(","))
    assert every / single < 1.4
    assert peak < MOST_BYTES


def thermal_s(band: dict[str, Any], pixels: int = 1024, new_position: bool = True) -> float:
    """Return the processor time of a marched frame, air and ground varying with latitude."""
    activate()
    scene = scene_of(
        20.0,
        atmosphere={"profile": "by_latitude_month"},
        surface={"kind": "earth"},
        sun={"zenith_deg": 60.0},
        render={"method": "march"},
    )

    def run() -> None:
        if new_position:
            TABLES.clear()
        render_frame(scene, camera_of(pixels, band))

    return least_s({"": run})[""]


def test_another_look_from_the_same_position_finds_its_tables(record_property: Record) -> None:
    first, again = thermal_s(CO2, 140), thermal_s(CO2, 140, new_position=False)
    record_property("shared", round(again / first, 2))
    assert again / first < 0.4, f"{again:.2f} s against {first:.2f} s"


def test_a_thermal_band_costs_little_more_than_a_visible_wavelength(record_property: Record) -> None:
    """48 g points from a new position against one visible wavelength that is marched cell by cell."""
    visible, thermal = thermal_s(GREEN), thermal_s(CO2)
    record_property("ratio", round(thermal / visible, 2))
    assert thermal / visible < 0.5, f"{thermal:.2f} s against {visible:.2f} s"


def test_a_large_thermal_frame_stays_below_two_gigabytes() -> None:
    assert run_apart("test_frame_costs", "thermal_s(t.CO2)")[1] < MOST_BYTES


def gained_by_tables(record_property: Record, sun_zenith_deg: float = 50.0, **tables: Any) -> tuple[float, float]:
    """Return how many times cheaper than the march 1024 x 1024 are from a new position, and at a new attitude."""
    activate()
    camera, small = camera_of(1024, *COLOURS), camera_of(16, *COLOURS)
    sun = {"zenith_deg": sun_zenith_deg}

    def frame(method: str, latitude_deg: float, turn: int, lens: Any = camera) -> float:
        scene = scene_of(latitude_deg, turn=turn, sun=sun, render={"method": method}, **tables)
        return spent_s(lambda: render_frame(scene, lens))

    frame("table", 0.0, 0)
    frame("table", 0.0, 1)
    position = statistics.median(frame("table", 10.0 + 0.5 * k, 0) for k in range(3))
    attitude = statistics.median(frame("table", 11.0, 1 + k) for k in range(3))
    frame("march", 0.0, 0, small)  # compiles its kernels
    march = frame("march", 10.0, 0)
    gains = march / position, march / attitude
    for name, value in zip(("march", "new position", "new attitude"), (march, *gains), strict=True):
        record_property(name, round(value, 2))
    return gains


def test_a_frame_by_tables_is_many_times_cheaper(record_property: Record) -> None:
    position, attitude = gained_by_tables(record_property)
    assert position >= 15.0
    assert attitude >= 40.0


def by_tables() -> float:
    """Render large frames by tables from two positions."""
    activate()
    for latitude_deg in (0.0, 10.0):
        render_frame(scene_of(latitude_deg, render={"method": "table"}), camera_of(1024, *COLOURS))
    return 0.0


def test_a_large_frame_by_tables_stays_below_two_gigabytes() -> None:
    assert run_apart("test_frame_costs", "by_tables()")[1] < MOST_BYTES


MOST = {
    "refraction": (2.7, 1.5),
    "haze": (2.1, 1.4),
    "local light": (3.0, 1.6),
    "clouds": (7.1, 9.2),
    "thin layer": (4.0, 2.3),
    "everything": (15.0, 12.0),
}
"""Times a frame with nothing, from a new position and at a new attitude: a quarter more than was measured."""
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


def ratios(
    band: dict[str, Any], cases: dict[str, dict[str, Any]], pixels: int, record_property: Record
) -> dict[str, tuple[float, float]]:
    """Return times to the first case, from a new position, where every table is made, and at a new attitude there.

    New positions are on one parallel: thin layers change with latitude, and the light scattered more than once, which
    takes many seconds to solve, with them.
    """
    activate()
    camera = camera_of(pixels, band)
    for tables in cases.values():
        for turn in (0, 1):
            render_frame(scene_of(10.0, -20.0, turn, **tables), camera)
    spent: dict[str, list[list[float]]] = {name: [[], []] for name in cases}
    for k in range(3):
        for name, tables in cases.items():
            TABLES.clear()
            for turn in (0, 1):
                scene = scene_of(10.0, -19.0 + 0.5 * k, turn, **tables)
                spent[name][turn].append(spent_s(lambda scene=scene: render_frame(scene, camera)))  # type: ignore[misc]
    base = [min(times) for times in next(iter(spent.values()))]
    found = {name: (min(a) / base[0], min(b) / base[1]) for name, (a, b) in spent.items()}
    for name, pair in found.items():
        for kind, ratio in zip(("position", "attitude"), pair, strict=True):
            record_property(f"{name}, {kind}", round(ratio, 2))
    return found


def test_what_the_earth_as_it_is_costs(record_property: Record) -> None:
    found = ratios(VISIBLE, CASES, 512, record_property)
    for name, most in MOST.items():
        assert found[name][0] < most[0], name
        assert found[name][1] < most[1], name


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


def test_what_everything_costs_by_the_command(tmp_path: Path, record_property: Record) -> None:
    """By the clock, with warm caches on disk: kernels, tables of multiple scattering, the coarse map of clouds."""
    (tmp_path / "camera.toml").write_text(COMMAND_CAMERA)
    spent: dict[str, list[float]] = {name: [] for name in COMMAND_CASES}
    for name, tables in COMMAND_CASES.items():
        (tmp_path / f"{name}.toml").write_text(COMMAND_SCENE + tables)
    for k in range(4):
        for name, times in spent.items():
            command = [str(PROGRAM), "render", f"{name}.toml", "-o", f"{name}-{k}.exr"]
            start = time.monotonic()
            subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
            times.append(time.monotonic() - start)
    ratio = min(spent["everything"][1:]) / min(spent["nothing"][1:])
    record_property("everything by the command", round(ratio, 2))
    assert ratio < 3.5
