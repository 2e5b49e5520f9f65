"""Expected outcomes of frames whose geometry can be said in words."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from synthetic import SOLAR_CAMERA, THERMAL_CAMERA, truth_at

from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome
from horizonval.earth.limb_heights import Relief
from horizonval.frame import FrameTruth
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.horizon import fit_cone
from horizonval.scoring import expected as module
from horizonval.scoring import limits
from horizonval.scoring.bound import Bound
from horizonval.scoring.expected import Expected, examine, exclusion_angle_deg, expected_of_heads, expected_outcome

BALL = sphere(6371008.8)
LIMB_ROLL_DEG = 68.0
"""At 500 km the horizon is 68 deg off the nadir: this roll puts it through the image's centre."""


def test_daylight_limb_is_valid():
    e = expected_outcome(truth_at(roll_deg=LIMB_ROLL_DEG))
    assert e.outcome == Outcome.VALID
    assert e.lit_fraction == 1
    assert not e.sun_in_frame
    # It runs from side to side of a 640 pixel wide image, bent.
    assert 640 < e.horizon_arc_px < 700
    assert e.sun_zenith_deg == pytest.approx(30, abs=1e-9)


@pytest.mark.parametrize(("roll_deg", "what"), [(0.0, "ground"), (150.0, "space")])
def test_no_horizon_in_view(roll_deg, what):
    e = expected_outcome(truth_at(roll_deg=roll_deg))
    assert e.outcome == Outcome.NO_LIMB, what
    assert e.lit_fraction is None
    assert e.horizon_arc_px == 0
    assert e.horizon_fraction_in_view == 0


def test_a_cut_corner_is_a_short_arc():
    # The image is 60 deg wide and 47 deg high; yaw of the mount would turn it. Move the limb out over the top edge.
    rolls = np.arange(40.0, 47.0, 0.25)
    arcs = [(expected_outcome(truth_at(roll_deg=float(r), ellipsoid=BALL))) for r in rolls]
    outcomes = [e.outcome for e in arcs]
    assert outcomes[0] == Outcome.NO_LIMB
    assert outcomes[-1] == Outcome.VALID
    assert Outcome.SHORT_ARC in outcomes
    # Too short in pixels, or too short to say where the nadir is.
    assert all(
        e.usable_arc_px < 0.25 * 480 or e.bound_deg is None or e.bound_deg > 0.2
        for e in arcs
        if e.outcome == Outcome.SHORT_ARC
    )
    # Between the certain refusals and the certain answers lie frames that may go either way.
    grey = [e.borderline for e in arcs]
    assert any(grey)
    assert not grey[0]
    assert not grey[-1]


def test_a_narrow_field_sees_a_straight_line():
    narrow = {**SOLAR_CAMERA, "camera": {"name": "tele", "width": 640, "height": 480, "fov_deg": 1.0}}
    e = expected_outcome(truth_at(narrow, roll_deg=LIMB_ROLL_DEG, ellipsoid=BALL))
    # The limb crosses the whole image and bends by half a pixel; some hundred metres of air bend it as much.
    assert e.horizon_arc_px == pytest.approx(640, rel=0.01)
    assert e.outcome == Outcome.SHORT_ARC
    assert e.bound_deg > 0.2


def test_a_full_disc_in_view():
    e = expected_outcome(truth_at(THERMAL_CAMERA, altitude_km=35786.0, ellipsoid=BALL))
    assert e.outcome == Outcome.VALID
    assert e.horizon_fraction_in_view == 1
    rho = math.asin(6371008.8 / (6371008.8 + 35786e3))
    focal = 80 / math.tan(math.radians(28.5))
    # A circle about the boresight of a pinhole camera, as a polygon of more than 20000 sides.
    assert e.horizon_arc_px == pytest.approx(2 * math.pi * focal * math.tan(rho), rel=1e-6)


def test_night_is_dark_for_the_eye_and_valid_for_heat():
    night = {"roll_deg": LIMB_ROLL_DEG, "sun_zenith_deg": 150.0, "sun_visible_fraction": 0.0}
    assert expected_outcome(truth_at(SOLAR_CAMERA, **night)).outcome == Outcome.DARK
    e = expected_outcome(truth_at(THERMAL_CAMERA, **night))
    assert e.outcome == Outcome.VALID
    assert e.lit_fraction == 1


def test_terminator_along_the_view():
    """The Sun on the horizon of the point below and 90 deg to the side of the view: half the arc in view is lit."""
    e = expected_outcome(
        truth_at(roll_deg=LIMB_ROLL_DEG, latitude_deg=0.0, sun_zenith_deg=90.0, sun_azimuth_deg=0.0, ellipsoid=BALL)
    )
    assert e.lit_fraction == pytest.approx(0.5, abs=0.01)
    # What is left of the arc may or may not be enough for a sensor.
    assert e.borderline


def test_the_suns_disc_in_the_frame_is_glare():
    # The view is towards azimuth 270, its centre at zenith 112: the Sun at 100 stands 12 deg above it.
    sun = {"roll_deg": LIMB_ROLL_DEG, "sun_zenith_deg": 100.0, "sun_azimuth_deg": 270.0}
    e = expected_outcome(truth_at(**sun, ellipsoid=BALL))
    assert e.sun_in_frame
    assert e.outcome == Outcome.SUN_GLARE
    # The horizon's zenith angle is 180 deg - rho.
    horizon = 180 - math.degrees(math.asin(6371008.8 / 6871008.8))
    assert e.sun_limb_distance_deg == pytest.approx(horizon - 100, abs=1e-9)
    thermal = expected_outcome(truth_at(THERMAL_CAMERA, **sun))
    assert thermal.sun_in_frame
    assert thermal.outcome == Outcome.VALID
    assert not expected_outcome(truth_at(**{**sun, "sun_azimuth_deg": 90.0})).sun_in_frame


def test_a_sun_behind_the_earth_is_not_in_the_frame():
    e = expected_outcome(
        truth_at(roll_deg=LIMB_ROLL_DEG, sun_zenith_deg=116.0, sun_azimuth_deg=270.0, sun_visible_fraction=0.0)
    )
    assert not e.sun_in_frame
    assert e.sun_limb_distance_deg < 0


def test_only_the_edge_of_the_disc_in_the_frame_counts():
    """The Sun's centre 0.2 deg above the top edge (disc radius 0.267 deg) shows; 0.3 deg above it does not."""
    plain = {**SOLAR_CAMERA, "camera": {"name": "plain", "width": 640, "height": 480, "fov_deg": 60.0}}
    half_height = math.degrees(math.atan(math.tan(math.radians(30)) * 480 / 640))
    top = 180 - LIMB_ROLL_DEG - half_height
    for above, seen in ((0.2, True), (0.3, False)):
        truth = truth_at(
            plain, roll_deg=LIMB_ROLL_DEG, sun_zenith_deg=top - above, sun_azimuth_deg=270.0, ellipsoid=BALL
        )
        assert expected_outcome(truth).sun_in_frame is seen


def test_a_method_that_is_given_the_pose_can_always_answer():
    e = expected_outcome(truth_at(roll_deg=150.0), needs="pose")
    assert e.outcome == Outcome.VALID
    assert e.horizon_arc_px == 0


def test_bands_are_told_apart_by_name():
    both = {**SOLAR_CAMERA, "band": [*SOLAR_CAMERA["band"], *THERMAL_CAMERA["band"]]}
    truth = truth_at(both, roll_deg=LIMB_ROLL_DEG, sun_zenith_deg=150.0, sun_visible_fraction=0.0)
    assert expected_outcome(truth).outcome == Outcome.DARK
    assert expected_outcome(truth, "lwir").outcome == Outcome.VALID
    with pytest.raises(UserError, match="no band 'uv'"):
        expected_outcome(truth, "uv")


def bound(camera: dict, scene: dict | None = None, **pose: float) -> float:
    truth = truth_at(camera, **({"roll_deg": 66.0} | pose))
    return expected_outcome(dataclasses.replace(truth, scene=truth.scene | (scene or {}))).bound_deg


def test_what_the_prior_says_decides_what_the_frame_determines() -> None:
    """A field of 12 deg sees a short piece of the limb: enough with a position, too little without one."""
    narrow = {**THERMAL_CAMERA, "camera": {"name": "narrow", "width": 80, "height": 60, "fov_deg": 12.0}}
    known = {"position_sigma_km": 1.0, "attitude_sigma_deg": (0.1, 0.1, 0.1)}
    alone, helped = (expected_outcome(prior_of(narrow, prior)) for prior in ({}, known))
    assert (alone.outcome, helped.outcome) == (Outcome.SHORT_ARC, Outcome.VALID)
    assert helped.bound_deg < 0.2 < alone.bound_deg
    for accept_deg, outcome, borderline in (
        (0.5 * helped.bound_deg - 1e-4, Outcome.SHORT_ARC, False),
        (0.9 * helped.bound_deg, Outcome.SHORT_ARC, True),
        (1.1 * helped.bound_deg, Outcome.VALID, True),
        (1.4 * helped.bound_deg, Outcome.VALID, False),
    ):
        found = expected_outcome(prior_of(narrow, known | {"accept_deg": accept_deg}))
        assert (found.outcome, found.borderline) == (outcome, borderline), accept_deg


def prior_of(camera: dict, prior: dict) -> FrameTruth:
    truth = truth_at(camera, roll_deg=LIMB_ROLL_DEG)
    return dataclasses.replace(truth, scene=truth.scene | {"prior": prior})


def test_the_bound_of_the_image_goes_before_the_predicted_one() -> None:
    truth = truth_at(THERMAL_CAMERA, roll_deg=LIMB_ROLL_DEG)
    assert expected_outcome(truth).outcome == Outcome.VALID
    for known_deg, outcome in ((None, Outcome.SHORT_ARC), (0.5, Outcome.SHORT_ARC), (0.1, Outcome.VALID)):
        known = Bound(None, None if known_deg is None else math.radians(known_deg), None)
        assert expected_outcome(truth, bound=known).outcome == outcome
    heads = [head(Outcome.VALID), head(Outcome.VALID)]
    for known_deg, outcome, borderline in (
        (None, Outcome.SHORT_ARC, False),
        (0.5, Outcome.SHORT_ARC, False),
        (0.3, Outcome.SHORT_ARC, True),
        (0.16, Outcome.VALID, True),
        (0.1, Outcome.VALID, False),
    ):
        known = Bound(None, None if known_deg is None else math.radians(known_deg), None)
        found = expected_of_heads(heads, truth, known)
        assert (found.outcome, found.borderline) == (outcome, borderline)


@pytest.mark.parametrize("camera", [SOLAR_CAMERA, THERMAL_CAMERA])
def test_the_relief_of_its_own_part_of_the_spectrum_counts(monkeypatch: pytest.MonkeyPatch, camera: dict) -> None:
    before = bound(camera, ellipsoid=BALL)
    own, foreign = ("SOLAR_RELIEF", "THERMAL_RELIEF") if camera is SOLAR_CAMERA else ("THERMAL_RELIEF", "SOLAR_RELIEF")
    monkeypatch.setattr(module, foreign, (Relief(50e3, 0.5),))
    assert bound(camera, ellipsoid=BALL) == before
    monkeypatch.setattr(module, own, (Relief(1e-3, 0.5),))
    assert bound(camera, ellipsoid=BALL) < 0.7 * before


def test_single_points_scatter_the_nadir_as_drawn_points_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """With nothing else uncertain: fits to points of the limb in view, one for every pixel, of the stated scatter."""
    for name in ("SOLAR_RELIEF", "THERMAL_RELIEF"):
        monkeypatch.setattr(module, name, (Relief(1e-3, 0.1),))
    monkeypatch.setattr(limits, "EDGE_FLOOR_PX", 1.0)
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
    scatter = math.degrees(math.sqrt(np.trace(np.cov(np.array(off).T))))
    assert seen.expected.bound_deg == pytest.approx(scatter, rel=0.25)


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
    told = expected_of_heads([head(*one) for one in heads], truth_at())
    assert (told.outcome, told.borderline) == (outcome, borderline)


def test_sun_and_moon_are_in_the_frame_of_any_head() -> None:
    plain = head(Outcome.VALID)
    assert not expected_of_heads([plain, plain], truth_at()).sun_in_frame
    assert not expected_of_heads([plain, plain], truth_at()).moon_in_frame
    for both in ([plain, head(Outcome.VALID, sun=True)], [head(Outcome.VALID, sun=True), plain]):
        assert expected_of_heads(both, truth_at()).sun_in_frame
        assert not expected_of_heads(both, truth_at()).moon_in_frame
    assert expected_of_heads([plain, head(Outcome.VALID, moon=True)], truth_at()).moon_in_frame


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
