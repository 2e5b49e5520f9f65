"""What refraction costs: the same frame with bent and with straight light, in the same run."""

from __future__ import annotations

import time

import pytest

from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

MOST_RATIO = 1.7


def _seconds(refraction: bool) -> float:
    """Return the CPU seconds of the quicker of two warm renders."""
    scene = SceneSpec.model_validate(
        {
            "camera": {"file": "test", "mount_roll_deg": 66.0},
            "platform": {"altitude_km": 500.0},
            "atmosphere": {"refraction": refraction},
            "sun": {"zenith_deg": 60.0},
            "render": {"orders": "single"},
        }
    )
    band = {"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 4}
    camera = CameraSpec.model_validate({"camera": {"width": 512, "height": 512, "fov_deg": 60.0}, "band": [band]})
    taken = []
    for _ in range(3):
        start = time.process_time()
        render_frame(scene, camera)
        taken.append(time.process_time() - start)
    return min(taken[1:])


@pytest.mark.benchmark
def test_refraction_costs_less_than_the_march_again() -> None:
    activate()
    straight, bent = _seconds(False), _seconds(True)
    ratio = bent / straight
    assert ratio < MOST_RATIO, f"{bent:.2f} s against {straight:.2f} s"
