"""How many images a second a server and a session give, and that a server's memory stays flat over ten thousand."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from measuring import spent_s

import horizonval as hv

PROGRAM = Path(sys.executable).with_name("horizonval")
IMAGES = 60
MEMORY_IMAGES = 10_000
MOST_GROWTH_BYTES = 16 << 20
SCENE = """
[scene]
name = "loop"
[camera]
file = "{camera}"
mount_roll_deg = 65.0
[platform]
altitude_km = 550.0
latitude_deg = 10.0
"""


@contextmanager
def _served(folder: Path, camera: str) -> Iterator[tuple[hv.Client, psutil.Process]]:
    (folder / "scene.toml").write_text(SCENE.format(camera=camera))
    words = [str(PROGRAM), "serve", "--scene", "scene.toml", "--socket", "s.sock"]
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        try:
            with hv.Client(f"ipc://{folder}/s.sock") as client:
                yield client, psutil.Process(process.pid)
        finally:
            process.terminate()


def _roll_deg(k: int) -> float:
    """Return the attitude of a camera that scans 6 deg and back."""
    return 0.1 * (k % 60 if k % 120 < 60 else 60 - k % 60)


def _processor_s(process: psutil.Process) -> float:
    spent = process.cpu_times()
    return spent.user + spent.system


@pytest.mark.benchmark
@pytest.mark.parametrize(("camera", "least"), [("ir-bolometer-160-57deg", 30.0), ("vis-cmos-512-60deg", 6.0)])
def test_images_a_second(
    camera: str, least: float, tmp_path: Path, record_property: Callable[[str, float], None]
) -> None:
    with _served(tmp_path, camera) as (client, process):
        for k in range(IMAGES):
            client.image(roll_deg=_roll_deg(k), seed=k, truth=True)
        start, spent = time.perf_counter(), _processor_s(process)
        for k in range(IMAGES):
            client.image(roll_deg=_roll_deg(k), seed=k, truth=True)
        rate = IMAGES / (time.perf_counter() - start)
        record_property("images_per_second", round(rate, 1))
        record_property("processor_ms", round(1e3 * (_processor_s(process) - spent) / IMAGES, 1))
    assert rate >= least, f"{rate:.1f} images/s"


@pytest.mark.benchmark
def test_memory_is_flat(tmp_path: Path, record_property: Callable[[str, float], None]) -> None:
    with _served(tmp_path, "ir-bolometer-160-57deg") as (client, process):
        tenth, start = 0, time.perf_counter()
        for k in range(MEMORY_IMAGES):
            client.image(roll_deg=_roll_deg(k), seed=k, truth=True, radiance=True)
            if k == MEMORY_IMAGES // 10:
                tenth = process.memory_info().rss
        rate = MEMORY_IMAGES / (time.perf_counter() - start)
        end = process.memory_info().rss
        record_property("mb_after_a_tenth", round(tenth / (1 << 20), 1))
        record_property("mb_at_the_end", round(end / (1 << 20), 1))
        record_property("images_per_second", round(rate, 1))
    assert end - tenth < MOST_GROWTH_BYTES, f"{(end - tenth) / (1 << 20):.1f} MiB more"


PLACE: dict[str, Any] = {"altitude_km": 550, "latitude_deg": 10, "epoch_utc": "2026-03-20T12:00Z", "mount_roll_deg": 65}
SESSION_IMAGES = 24


def _attitude(k: int) -> tuple[float, float, float]:
    """Return the attitude of a camera that scans 6 deg and back."""
    return 0.5 * (k if k < SESSION_IMAGES // 2 else SESSION_IMAGES - k), 0.05 * k, 0.0


@pytest.mark.benchmark
@pytest.mark.parametrize(("camera", "most_ratio"), [("ir-bolometer-160-57deg", 0.3), ("vis-cmos-512-60deg", 0.15)])
def test_an_image_of_a_session_costs_a_part_of_one_of_another_place(
    camera: str, most_ratio: float, record_property: Callable[[str, float], None]
) -> None:
    session = hv.Session(camera, **PLACE)

    def elsewhere(*latitudes_deg: float) -> None:
        for latitude_deg in latitudes_deg:
            scene = session.scene.changed(latitude_deg=latitude_deg, render={"method": "march"})
            hv.render(scene, progress=False).observe(seed=1)

    def here() -> None:
        for k in range(SESSION_IMAGES):
            session.image(_attitude(k), seed=k)

    elsewhere(29.0)
    anew = spent_s(lambda: elsewhere(30.0, 31.0, 32.0)) / 3
    here()
    image = spent_s(here) / SESSION_IMAGES
    record_property("processor_ms", round(1e3 * image, 1))
    record_property("ratio", round(image / anew, 3))
    assert image / anew < most_ratio, f"{1e3 * image:.1f} ms against {1e3 * anew:.1f} ms of a frame anew"
