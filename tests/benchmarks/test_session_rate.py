"""How many images a second a session gives: processor time of an image, and its ratio to a frame made anew."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

import horizonval as hv

CORES = 2
PLACE: dict[str, Any] = {"altitude_km": 550, "latitude_deg": 10, "epoch_utc": "2026-03-20T12:00Z", "mount_roll_deg": 65}
IMAGES = 24


def _seconds(run: Callable[[int], object], count: int) -> float:
    """Return the processor time of one call."""
    start = time.process_time()
    for k in range(count):
        run(k)
    return (time.process_time() - start) / count


def _attitude(k: int) -> tuple[float, float, float]:
    """Return the attitude of a camera that scans 6 deg and back."""
    return 0.5 * (k if k < IMAGES // 2 else IMAGES - k), 0.05 * k, 0.0


@pytest.mark.benchmark
@pytest.mark.parametrize(
    ("camera", "most_ratio"),
    [("ir-bolometer-160-57deg", 0.3), ("vis-cmos-512-60deg", 0.15)],
)
def test_an_image_of_a_session_costs_a_part_of_one_of_another_place(
    camera: str, most_ratio: float, record_property: Callable[[str, float], None]
) -> None:
    session = hv.Session(camera, **PLACE)

    def elsewhere(k: int) -> hv.Image:
        scene = session.scene.changed(latitude_deg=30.0 + k, render={"method": "march"})
        return hv.render(scene, progress=False).observe(seed=k)

    elsewhere(-1)
    anew = _seconds(elsewhere, 3)
    _seconds(lambda k: session.image(_attitude(k), seed=k), IMAGES)
    image = _seconds(lambda k: session.image(_attitude(k), seed=k), IMAGES)
    record_property("images_per_second", round(CORES / image, 1))
    record_property("processor_ms", round(1e3 * image, 1))
    record_property("ratio", round(image / anew, 3))
    assert image / anew < most_ratio, f"{1e3 * image:.1f} ms against {1e3 * anew:.1f} ms of a frame anew"
