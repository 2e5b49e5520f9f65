"""What the lens costs: the wings over a whole frame against the rendering of that frame, in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from horizonval.renderer.backend import activate
from horizonval.renderer.frame import render_frame
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

MOST_RATIO = 0.5


def _seconds(run: Callable[[], object]) -> float:
    """Return the CPU seconds of the quicker of two warm runs."""
    taken = []
    for _ in range(3):
        start = time.process_time()
        run()
        taken.append(time.process_time() - start)
    return min(taken[1:])


@pytest.mark.benchmark
def test_observing_with_all_stages_costs_less_than_half_the_rendering() -> None:
    activate()
    scene = SceneSpec.model_validate(
        {
            "camera": {"file": "test", "mount_roll_deg": 75.0, "mount_yaw_deg": 90.0},
            "platform": {"altitude_km": 500.0, "heading_deg": 90.0},
            "sun": {"zenith_deg": 95.0, "azimuth_deg": 90.0},
            "render": {"orders": "single"},
        }
    )
    camera = CameraSpec.model_validate(
        {
            "camera": {"width": 1024, "height": 1024, "fov_deg": 60.0},
            "band": [{"name": "vis", "kind": "solar", "lo_um": 0.5, "hi_um": 0.6, "nodes": 1}],
            "optics": {
                "f_number": 4.0,
                "psf_sigma_px": 0.7,
                "diffraction": True,
                "scatter": {"tis": 0.01, "l_rad": 0.005, "s": -2.0},
                "ghost": [{"ratio": 1e-5, "scale": -0.8, "blur_px": 5.0}],
            },
            "detector": {
                "kind": "cmos",
                "pixel_pitch_um": 5.5,
                "exposure_s": 2.2e-4,
                "quantum_efficiency": 0.6,
                "full_well_e": 13500,
                "read_noise_e": 13,
                "bits": 10,
            },
        }
    )
    frame = render_frame(scene, camera)
    assert frame.radiance["vis"].max() > 1e4 * np.median(frame.radiance["vis"])  # The Sun is in it.
    rendering, observing = _seconds(lambda: render_frame(scene, camera)), _seconds(lambda: observe(frame, camera))
    ratio = observing / rendering
    assert ratio < MOST_RATIO, f"{observing:.2f} s against {rendering:.2f} s"
