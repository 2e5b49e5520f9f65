"""The pair's experiments on made-up results: region, orbit, verdict and figures, without rendering."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from horizonval.spec.sensor.camera import CameraSpec
from horizonval.systems.b import experiment as video_vertical
from horizonval.systems.b.pair import figures
from horizonval.systems.b.pair.applicability import Map, grid, rms
from horizonval.systems.b.pair.frames import pair
from horizonval.systems.b.pair.orbit import COASTS, INCLINATION_DEG, INFRARED, LINEAR, VISIBLE, Lap, place
from horizonval.systems.b.pair.sun import GlareOutcome, is_right


def found(error_deg: float | None, searched_deg: float | None = None) -> dict[str, Any]:
    own = {} if error_deg is None else {"SIGHT": error_deg}
    asked = {} if searched_deg is None else {"SIGHT": searched_deg}
    return {"status": "valid" if own else "dark", "error_deg": own, "searched": {"error_deg": asked}}


def made_map(wrong: dict[tuple[float, float], float | None]) -> Map:
    points = grid(10.0)
    results = [found(wrong.get((float(p), float(y)), 0.02)) for p, y in points]
    return Map(points[:, 0], points[:, 1], results)


def made_lap() -> Lap:
    arguments = [15.0 * k for k in range(24)]
    lit = [0.0 if 110.0 < u < 250.0 else 1.0 for u in arguments]
    visible = [found(0.1 if k % 3 else 20.0, 0.1) if sun else found(None) for k, sun in enumerate(lit)]
    infrared = [found(0.12, 0.12) for _ in lit]
    sensors = {VISIBLE: visible, COASTS: visible, INFRARED: infrared, LINEAR: infrared}
    return Lap(arguments, lit, sensors)


@pytest.mark.parametrize(
    ("wrong", "half_side"),
    [({}, 40.0), ({(30.0, 0.0): None}, 20.0), ({(-10.0, 40.0): 1.5}, 30.0), ({(0.0, 0.0): None}, 0.0)],
)
def test_the_region_is_the_largest_square_without_a_miss(
    wrong: dict[tuple[float, float], float | None], half_side: float
) -> None:
    assert made_map(wrong).half_side_deg() == half_side


def test_the_finer_points_are_the_middles_of_the_inner_cells() -> None:
    points = grid(10.0, finer_within_deg=20.0)
    assert len(points) == 81 + 16
    assert len(np.unique(points, axis=0)) == 97
    assert np.abs(points[81:]).max() == 15.0


def test_the_orbit_reaches_its_inclination_and_crosses_the_equator_at_its_node() -> None:
    # the textbook's spherical triangle: highest latitude 180 deg - i, azimuth at the node 90 deg - i
    assert place(90.0)["latitude_deg"] == pytest.approx(180.0 - INCLINATION_DEG, abs=1e-9)
    assert place(0.0)["latitude_deg"] == pytest.approx(0.0, abs=1e-12)
    assert place(0.0)["heading_deg"] == pytest.approx(90.0 - INCLINATION_DEG, abs=1e-9)
    assert place(180.0)["heading_deg"] % 360.0 == pytest.approx(90.0 + INCLINATION_DEG, abs=1e-9)


def test_the_cameras_axes_are_perpendicular_to_each_other_and_to_the_longitudinal_axis() -> None:
    from horizonval.geometry.frames import cam_from_body, inverse, rotate

    camera = CameraSpec.model_validate(pair())
    axes = [
        rotate(
            inverse(cam_from_body(*(math.radians(a) for a in (h.mount_yaw_deg, h.mount_pitch_deg, h.mount_roll_deg)))),
            [0.0, 0.0, 1.0],
        )
        for h in camera.head
    ]
    assert np.abs([axes[0] @ axes[1], axes[0][2], axes[1][2]]).max() < 1e-12


def test_the_verdict_follows_the_figures() -> None:
    lap = made_lap()
    assert video_vertical.verdict(lap)["comparable"]
    lap.by_sensor[VISIBLE][0]["searched"]["error_deg"]["SIGHT"] = 30.0
    assert not video_vertical.verdict(lap)["comparable"]


def test_rows_of_the_orbit_count_shadow_and_claims() -> None:
    rows = {row.name: row for row in video_vertical.orbit_rows(made_lap())}
    shadow = next(row for name, row in rows.items() if name.startswith("shadowed"))
    assert shadow.measured == 1.0
    assert shadow.holds
    wrong = next(row for name, row in rows.items() if name.startswith("lit segment"))
    lit = [k for k, sun in enumerate(made_lap().lit) if sun]
    assert wrong.measured == pytest.approx(sum(k % 3 == 0 for k in lit) / len(lit))
    assert len(video_vertical.orbit_table(made_lap()).rows) == 7


def test_the_rms_leaves_out_what_is_missing() -> None:
    assert rms(np.array([3.0, np.nan, 4.0])) == pytest.approx(math.sqrt(12.5))


def test_the_figures_draw() -> None:
    assert len(figures.maps({"one": made_map({(30.0, 0.0): None}), "two": made_map({(0.0, 0.0): 3.0})}).axes) == 3
    assert figures.orbit(made_lap()).axes[0].get_yscale() == "log"


def test_twins_belong_together_and_the_interval_is_of_their_difference() -> None:
    """Half of the views fail inside and none outside; where both fail alike nothing is left for the glare."""
    rng = np.random.default_rng(3)
    glare = GlareOutcome(np.tile([1.0, 0.0], 20), np.ones(40), {})
    low, high = glare.interval(rng)
    assert glare.difference == pytest.approx(0.5)
    assert 0.3 < low < 0.5 < high < 0.7
    dark = GlareOutcome(np.tile([1.0, 0.0], 20), np.tile([1.0, 0.0], 20), {})
    assert dark.difference == 0.0
    assert dark.interval(rng) == (0.0, 0.0)
    assert is_right(found(0.9))
    assert not is_right(found(1.1))
    assert not is_right(found(None))
