"""What multiple scattering costs a large frame: against single scattering in the same run, tables cached."""

from __future__ import annotations

import time

import pytest
from peak_memory import run_apart

from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

MOST_RATIO = 1.4
MOST_BYTES = 2.0e9
BANDS = {"blue": (0.44, 0.50), "green": (0.52, 0.58), "red": (0.60, 0.67)}


def seconds(pixels: int, repeats: int = 3) -> tuple[float, float]:
    """Return the CPU seconds of the quickest warm render with one order and with all, taken in turns.

    Three bands of four nodes, four subsamples.
    """
    activate()
    bands = [{"name": n, "kind": "solar", "lo_um": a, "hi_um": b, "nodes": 4} for n, (a, b) in BANDS.items()]
    camera = CameraSpec.model_validate({"camera": {"width": pixels, "height": pixels, "fov_deg": 60.0}, "band": bands})
    scenes = {
        orders: SceneSpec.model_validate(
            {
                "camera": {"file": "test", "mount_roll_deg": 65.0},
                "platform": {"altitude_km": 500.0},
                "sun": {"zenith_deg": 50.0},
                "render": {"orders": orders, "subsamples": 2},
            }
        )
        for orders in ("single", "all")
    }
    taken: dict[str, list[float]] = {orders: [] for orders in scenes}
    for _ in range(1 + repeats):
        for orders, scene in scenes.items():
            start = time.process_time()
            render_frame(scene, camera)
            taken[orders].append(time.process_time() - start)
    return min(taken["single"][1:]), min(taken["all"][1:])


@pytest.mark.benchmark
def test_all_orders_cost_little_more_than_one() -> None:
    single, every = seconds(512)
    print(f"\n512 x 512: {single:.2f} s of processor time with one order, {every:.2f} s with all")  # noqa: T201
    assert every / single < MOST_RATIO


def both() -> str:
    """Return the seconds of a large frame with one order and with all, as text."""
    return "{} {}".format(*seconds(1024, 1))


@pytest.mark.benchmark
@pytest.mark.slow
def test_a_large_frame_with_all_orders_stays_below_two_gigabytes() -> None:
    """1024 x 1024 in a process of its own, interpreter, compiler and the making of the tables included."""
    text, peak = run_apart("test_multiple_scattering_cost", "both()")
    single, every = (float(v) for v in text.split())
    print(f"\n1024 x 1024: {single:.1f} s, {every:.1f} s of processor time; peak {peak / 1e9:.2f} GB")  # noqa: T201
    assert every / single < MOST_RATIO
    assert peak < MOST_BYTES
