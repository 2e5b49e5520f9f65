"""The suite `glare`: the Sun is where its frames' names say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.geometry.camera import camera_from_spec, project
from horizonval.spec.load import Case, load_suite
from horizonval.truth.frame_truth import truth_of

CASES = {case.name: case for case in load_suite("glare").cases}


def sun_row_and_angle(case: Case) -> tuple[float, float]:
    """Row of the Sun's centre, and its angle from the boresight [deg]."""
    sun = np.array(truth_of(case.scene, case.camera).sun_cam)
    (_, row), _ = project(camera_from_spec(case.camera.camera), sun)
    return float(row), math.degrees(math.acos(sun[2]))


@pytest.mark.parametrize("name", ["cmos", "ccd", "rgb"])
def test_middle_and_edge(name: str) -> None:
    row, _ = sun_row_and_angle(CASES[f"{name}-centre"])
    assert row == pytest.approx((CASES[f"{name}-centre"].camera.camera.height - 1) / 2, abs=1)
    row, _ = sun_row_and_angle(CASES[f"{name}-edge"])
    assert row == pytest.approx(-0.5, abs=1)


@pytest.mark.parametrize(("name", "half_field_deg"), [("cmos", 30.0), ("ccd", 30.0), ("rgb", 20.7)])
def test_so_many_degrees_outside(name: str, half_field_deg: float) -> None:
    """Half a degree, less than the disc is wide, is counted from the disc's rim; the others from its centre."""
    found = 0
    for case_name, case in CASES.items():
        if not case_name.startswith(f"{name}-outside-"):
            continue
        found += 1
        degrees = float(case_name.removeprefix(f"{name}-outside-").removesuffix("deg").replace("-", "."))
        _, angle = sun_row_and_angle(case)
        beyond = angle - half_field_deg
        assert beyond == pytest.approx(degrees + (0.27 if degrees < 1 else 0.0), abs=0.02)
    assert found >= 1


def test_behind_the_limb() -> None:
    for case in CASES.values():
        share = truth_of(case.scene, case.camera).sun_visible_fraction
        if case.name.endswith("rising"):
            assert 0.3 < share < 0.7
        else:
            assert share == pytest.approx(0.0 if case.name.endswith("behind-limb") else 1.0, abs=1e-9)


def test_beyond_the_circle_of_the_fisheye() -> None:
    angles = {name: sun_row_and_angle(CASES[f"fisheye-{name}"])[1] for name in ("over-limb", "rim", "outside-5deg")}
    assert angles == pytest.approx({"over-limb": 80.0, "rim": 95.0, "outside-5deg": 100.0}, abs=0.02)
