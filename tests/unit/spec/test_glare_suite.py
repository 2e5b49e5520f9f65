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


@pytest.mark.parametrize(("name", "half_field_deg"), [("cmos", 30.0), ("ccd", 30.0), ("rgb", 20.7)])
def test_the_sun_is_where_the_names_say(name: str, half_field_deg: float) -> None:
    """Half a degree, less than the disc is wide, is counted from the disc's rim; the others from its centre."""
    centre = CASES[f"{name}-centre"]
    assert sun_row_and_angle(centre)[0] == pytest.approx((centre.camera.camera.height - 1) / 2, abs=1)
    assert sun_row_and_angle(CASES[f"{name}-edge"])[0] == pytest.approx(-0.5, abs=1)
    outside = {key: case for key, case in CASES.items() if key.startswith(f"{name}-outside-")}
    assert outside
    for key, case in outside.items():
        degrees = float(key.removeprefix(f"{name}-outside-").removesuffix("deg").replace("-", "."))
        beyond = sun_row_and_angle(case)[1] - half_field_deg
        assert beyond == pytest.approx(degrees + (0.27 if degrees < 1 else 0.0), abs=0.02)


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
