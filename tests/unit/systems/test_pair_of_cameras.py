"""The pair's experiments on made-up results: region, orbit, verdict and figures, without rendering."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import optimize, stats

from horizonval.geometry.camera import project
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.systems.b import experiment as video_vertical
from horizonval.systems.b.pair.applicability import Map, grid
from horizonval.systems.b.pair.frames import pair, scene
from horizonval.systems.b.pair.orbit import COASTS, INCLINATION_DEG, INFRARED, LINEAR, VISIBLE, Lap, place
from horizonval.systems.b.pair.sun import (
    AUTOMATIC,
    EXPOSURES,
    HEADING_DEG,
    LENSES,
    ORDINARY,
    TURNED_DEG,
    ZENITH_DEG,
    DrawnView,
    Paired,
    SunOutcome,
    difference,
    drawn_skies,
    height_table,
    score_interval,
    sun_claim,
    sun_rows,
    sun_table,
)
from horizonval.systems.result import Status


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


def made_pairs(lost: int, gained: int, alike: int) -> Paired:
    right, wrong = found(0.9, 0.9), found(None, 1.1)
    lit = (*[wrong] * lost, *[right] * gained, *[right] * alike)
    return Paired(lit, (*[right] * lost, *[wrong] * gained, *[right] * alike))


def made_suns(lost: int, gained: int = 0) -> SunOutcome:
    skies = tuple(DrawnView(zenith, 90.0, 0.0, 0.0) for zenith in np.linspace(*ZENITH_DEG, 20))
    quiet, loud = made_pairs(0, 0, 20), made_pairs(lost, gained, 20 - lost - gained)
    keys = [(lens, exposure, place) for lens in LENSES for exposure in EXPOSURES for place in TURNED_DEG]
    return SunOutcome(skies, {key: loud if key[0] == ORDINARY and key[2] == "inside" else quiet for key in keys}, {})


def test_the_interval_is_that_of_a_difference_of_pairs() -> None:
    """Five of five differ to one side: the score interval excludes 0, as its test does (5^2 / 5 > 3.84)."""
    assert difference(5, 0, 20)[1] > 0.0
    assert difference(3, 0, 20)[1] < 0.0
    assert difference(0, 5, 20)[2] < 0.0
    change, low, high = difference(9, 3, 20)
    assert change == pytest.approx(0.3)
    assert low < change < high
    # where nothing differs, what may is below chi^2 / (n + chi^2)
    assert difference(0, 0, 20) == pytest.approx((0.0, -3.8415 / 23.8415, 3.8415 / 23.8415), abs=1e-3)


def test_views_with_and_without_the_light_belong_together() -> None:
    one = made_pairs(6, 1, 3)
    assert one.lost_and_gained() == (6, 1)
    assert one.lost_and_gained(searched=True) == (6, 1)
    assert list(one.refused(True)) == [True] * 6 + [False] * 4
    assert not one.refused(True, searched=True).any()
    # of the three that are answered both times nothing changes
    assert one.change_deg(np.random.default_rng(1)) == (0.0, 0.0, 0.0)
    assert made_pairs(2, 0, 0).change_deg(np.random.default_rng(1)) is None


@pytest.mark.parametrize(
    ("lost", "gained", "status"),
    [(6, 0, Status.REPRODUCED), (0, 0, Status.CONTRADICTED), (0, 8, Status.CONTRADICTED), (10, 9, Status.CONTRADICTED)],
)
def test_the_sun_washes_out_where_both_intervals_exclude_zero(lost: int, gained: int, status: Status) -> None:
    suns = made_suns(lost, gained)
    rows = sun_rows(suns)
    assert [row.holds for row in rows].count(None) == 6
    assert sun_claim(rows, suns).status is status
    assert len(sun_table(suns, np.random.default_rng(2)).rows) == 16
    assert len(height_table(suns).rows) == 8


def test_one_exposure_alone_bounds_the_claim_and_wide_intervals_decide_nothing() -> None:
    suns = made_suns(6)
    key = (ORDINARY, AUTOMATIC, "inside")
    one = replace(suns, pairs={**suns.pairs, key: made_pairs(0, 0, 20)})
    assert sun_claim(sun_rows(one), one).status is Status.BOUNDED
    few = replace(suns, pairs={k: made_pairs(2, 0, 3) for k in suns.pairs})
    assert sun_claim(sun_rows(few), few).status is Status.NOT_DETERMINABLE


def test_the_drawn_views_have_the_sun_in_one_frame_and_its_twin_in_none() -> None:
    camera = CameraSpec.model_validate(pair())
    for sky in drawn_skies(np.random.default_rng(4)):
        for side, turned in TURNED_DEG.items():
            seen = [
                in_frame(camera, head.name, replace(sky, azimuth_deg=sky.azimuth_deg + turned)) for head in camera.head
            ]
            assert seen == [False, side == "inside"]


def in_frame(camera: CameraSpec, head: str, sky: DrawnView) -> bool:
    from horizonval.truth.frame_truth import truth_of

    tables = {
        "platform": {"altitude_km": 500.0, "heading_deg": HEADING_DEG},
        "sun": {"zenith_deg": sky.zenith_deg, "azimuth_deg": sky.azimuth_deg},
        "attitude": {"pitch_deg": sky.pitch_deg, "roll_deg": sky.roll_deg},
        "camera": {"file": "pair", "head": head},
    }
    truth = truth_of(SceneSpec.model_validate(scene("sun", air=True, **tables)), camera, infrared=False)
    uv, ahead = project(truth.camera_model, np.array(truth.sun_cam))
    return bool(ahead and (uv >= 0.0).all() and (uv < 1023.0).all())


@pytest.mark.parametrize(
    ("lost", "gained", "n", "confidence", "low", "high", "digits"),
    [
        # Airway reactivity before and after stem cell transplantation (Bentur 2009), in Fagerland, Lydersen and Laake,
        # Statistics in Medicine 33, 2850 (2014), table VI: asymptotic score.
        (1, 7, 21, 0.95, -0.517, -0.026, 3),
        # PropCIs::scoreci.mp in R, 48 and 41 of 549, 90 %.
        (48, 41, 549, 0.90, -0.0157, 0.0414, 4),
    ],
)
def test_score_interval_as_published(lost, gained, n, confidence, low, high, digits):
    assert score_interval(lost, gained, n, confidence) == pytest.approx((low, high), abs=0.5 * 10**-digits)


@pytest.mark.parametrize(("lost", "gained", "n"), [(12, 2, 50), (3, 0, 400), (0, 0, 480), (9, 11, 90), (40, 0, 40)])
def test_score_interval_by_its_definition(lost, gained, n):
    """At its ends the score statistic, with the variance maximised over the likelihood numerically, is z."""
    z = float(stats.norm.ppf(0.975))

    def statistic(delta):
        def minus_log_likelihood(q):
            cells = ((lost, q + delta), (gained, q), (n - lost - gained, 1 - 2 * q - delta))
            return -sum(count * math.log(max(p, 1e-300)) for count, p in cells if count)

        lowest, highest = max(0.0, -delta), (1 - delta) / 2
        q = optimize.minimize_scalar(
            minus_log_likelihood, bounds=(lowest, highest), method="bounded", options={"xatol": 1e-13}
        ).x
        return (lost - gained - n * delta) / math.sqrt(n * (2 * q + delta - delta**2))

    low, high = score_interval(lost, gained, n, 0.95)
    if low > -1 + 1e-9:
        assert statistic(low) == pytest.approx(z, rel=2e-4)
    if high < 1 - 1e-9:
        assert statistic(high) == pytest.approx(-z, rel=2e-4)
