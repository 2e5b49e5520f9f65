"""Which samples count for an expected outcome, and how well they determine the nadir."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from synthetic import SOLAR_CAMERA, THERMAL_CAMERA, truth_at

from horizonval.core.outcome import Outcome
from horizonval.earth.limb_heights import Relief
from horizonval.geometry.horizon import fit_cone
from horizonval.scoring import expected as module
from horizonval.scoring import limits
from horizonval.scoring.expected import Expected, examine, exclusion_angle_deg, expected_of_heads, expected_outcome

CLOUDS = {"clouds": {"cover": 0.5}}


def determined(camera: dict, scene: dict | None = None, **pose: float) -> float:
    truth = truth_at(camera, **({"roll_deg": 66.0} | pose))
    found = expected_outcome(dataclasses.replace(truth, scene=truth.scene | (scene or {}))).determined_deg
    return found


@pytest.mark.parametrize(
    ("camera", "own", "foreign"),
    [
        (SOLAR_CAMERA, "CLOUD_RELIEF_SOLAR", "CLOUD_RELIEF_THERMAL"),
        (THERMAL_CAMERA, "CLOUD_RELIEF_THERMAL", "CLOUD_RELIEF_SOLAR"),
    ],
)
def test_clouds_count_in_their_own_part_of_the_spectrum_and_where_there_are_some(
    monkeypatch: pytest.MonkeyPatch, camera: dict, own: str, foreign: str
) -> None:
    clear, cloudy = determined(camera), determined(camera, CLOUDS)
    assert cloudy > clear
    assert determined(camera, {"clouds": {"cover": 0.0}}) == clear
    # without a cover they are those of the climate
    assert determined(camera, {"clouds": {}}) == cloudy
    monkeypatch.setattr(module, foreign, Relief(50e3, 0.5))
    assert determined(camera, CLOUDS) == cloudy
    monkeypatch.setattr(module, own, Relief(60e3, 0.3))
    assert determined(camera, CLOUDS) > 1.2 * cloudy


@pytest.mark.parametrize("camera", [SOLAR_CAMERA, THERMAL_CAMERA])
def test_the_air_of_its_own_part_of_the_spectrum_counts(monkeypatch: pytest.MonkeyPatch, camera: dict) -> None:
    before = determined(camera)
    own, foreign = ("SOLAR_RELIEF", "THERMAL_RELIEF") if camera is SOLAR_CAMERA else ("THERMAL_RELIEF", "SOLAR_RELIEF")
    monkeypatch.setattr(module, foreign, (Relief(50e3, 0.5),))
    assert determined(camera) == before
    monkeypatch.setattr(module, own, (Relief(20e3, 0.5),))
    assert determined(camera) > 2 * before


def test_single_points_scatter_the_nadir_as_drawn_points_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """With nothing else uncertain: fits to points of the limb in view, one for every pixel, of the stated scatter."""
    for name in ("SOLAR_RELIEF", "THERMAL_RELIEF"):
        monkeypatch.setattr(module, name, (Relief(1e-3, 0.1),))
    monkeypatch.setattr(limits, "POINT_SIGMA_PX", 1.0)
    round_earth = truth_at(SOLAR_CAMERA, roll_deg=66.0)
    round_earth = dataclasses.replace(round_earth, ellipsoid_b_m=round_earth.ellipsoid_a_m)
    seen = examine(round_earth)
    view, camera = seen.view, seen.camera
    los = view.los_cam[view.in_view]
    rng = np.random.default_rng(1)
    n = round(seen.expected.usable_arc_px)
    nadir = fit_cone(los).axis_cam
    off = []
    for _ in range(300):
        some = los[np.sort(rng.choice(len(los), n))]
        outwards = some * (some @ nadir)[:, None] - nadir
        outwards /= np.linalg.norm(outwards, axis=1)[:, None]
        noisy = some + outwards * rng.normal(0.0, 1.0 / min(camera.fx, camera.fy), n)[:, None]
        off.append(fit_cone(noisy / np.linalg.norm(noisy, axis=1)[:, None]).axis_cam - nadir)
    scatter = math.degrees(math.sqrt(np.linalg.eigvalsh(np.cov(np.array(off).T))[-1]))
    assert seen.expected.determined_deg == pytest.approx(scatter, rel=0.25)


def head(outcome: Outcome, borderline: bool = False, *, sun: bool = False, moon: bool = False) -> Expected:
    numbers = {f.name: 0.0 for f in dataclasses.fields(Expected) if f.type == "float"}
    return Expected(
        **numbers, outcome=outcome, lit_fraction=None, sun_in_frame=sun, moon_in_frame=moon, borderline=borderline
    )


@pytest.mark.parametrize(
    ("heads", "outcome", "borderline"),
    [
        ([(Outcome.VALID, False), (Outcome.VALID, False)], Outcome.VALID, False),
        ([(Outcome.VALID, False), (Outcome.VALID, True)], Outcome.VALID, True),
        ([(Outcome.VALID, True), (Outcome.DARK, False)], Outcome.DARK, False),
        ([(Outcome.VALID, False), (Outcome.DARK, True)], Outcome.DARK, True),
        ([(Outcome.NO_LIMB, True), (Outcome.DARK, False)], Outcome.DARK, False),
        ([(Outcome.NO_LIMB, False), (Outcome.DARK, False)], Outcome.NO_LIMB, False),
    ],
)
def test_heads_are_expected_to_answer_together(
    heads: list[tuple[Outcome, bool]], outcome: Outcome, borderline: bool
) -> None:
    told = expected_of_heads([head(*one) for one in heads])
    assert (told.outcome, told.borderline) == (outcome, borderline)


def test_sun_and_moon_are_in_the_frame_of_any_head() -> None:
    plain = head(Outcome.VALID)
    assert not expected_of_heads([plain, plain]).sun_in_frame
    assert not expected_of_heads([plain, plain]).moon_in_frame
    for both in ([plain, head(Outcome.VALID, sun=True)], [head(Outcome.VALID, sun=True), plain]):
        assert expected_of_heads(both).sun_in_frame
        assert not expected_of_heads(both).moon_in_frame
    assert expected_of_heads([plain, head(Outcome.VALID, moon=True)]).moon_in_frame


@pytest.mark.parametrize(
    ("right", "angle"),
    [
        ([True, True, True, True], 0.0),
        ([False, False, True, True], 20.0),
        ([True, False, True, True], 20.0),
        ([True, True, True, False], None),
    ],
)
def test_everything_beyond_is_right(right, angle):
    assert exclusion_angle_deg([0.0, 10.0, 20.0, 30.0], right) == angle


def test_one_wrong_frame_among_several_at_an_angle_spoils_it():
    assert exclusion_angle_deg([10.0, 10.0, 20.0], [True, False, True]) == 20.0
