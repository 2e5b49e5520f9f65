"""What the page of a night shows of its images, on frozen ones and on tonight's."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from horizonval.frame import FrameTruth
from horizonval.geometry.camera import unproject
from horizonval.geometry.frames import inverse, nadir_of_roll_pitch, roll_pitch_of_nadir, rotate
from horizonval.studies.regression.baseline import read_baseline
from horizonval.studies.regression.page import shown_of

BASELINE = Path(__file__).parents[4] / "results" / "baseline" / "nightly.json"


@pytest.fixture(scope="module")
def base():
    return read_baseline(BASELINE, "nightly")


@pytest.fixture(scope="module")
def three(base):
    """Rows of three scenes: with valid claims, with false ones, and in the infrared."""
    return [
        row for row in base.results.rows if row.case in ("day_000", "hard_000", "infrared_000") and row.replicate < 2
    ]


def shown(base, rows):
    images = {(image.scene, image.band, image.replicate): image for image in base.images.images}
    return shown_of(rows, base.images.truths, images.get)


def test_every_scene_has_an_image_with_its_numbers_and_outcomes(base, three):
    found = shown(base, three)
    told = found["frames"]
    assert [one["name"].split(",")[0] for one in told] == list(dict.fromkeys(row.case for row in three))
    assert found["kept"] == len(told)
    assert set(found["estimators"]) == {row.estimator for row in three}
    for one in told:
        scene, seed = re.fullmatch(r"(\w+), seed (\d+)", one["name"]).groups()
        own = {r.estimator: r for r in three if r.case == scene and r.replicate == int(seed)}
        assert set(one["rows"]) == set(own)
        for name, row in own.items():
            kind = one["rows"][name]["kind"]
            assert (kind == "false") == row.false_valid
            assert (one["rows"][name]["error"] != "") == row.is_claim


def test_of_a_scene_the_seed_with_the_worst_outcome_is_shown(base, three):
    rows = [row for row in three if row.case == "day_000"]
    rows = [replace(row, false_valid=row.replicate == 1) for row in rows]
    assert shown(base, rows)["frames"][0]["name"] == "day_000, seed 1"


def test_the_limb_of_a_claim_is_a_circle_about_the_claimed_nadir(base, three):
    row = next(row for row in three if row.case == "day_000" and row.is_claim)
    row = replace(row, roll_error_arcsec=7200.0, pitch_error_arcsec=-3600.0)
    one = shown(base, [row])["frames"][0]
    points = [tuple(map(float, pair)) for pair in re.findall(r"([-\d.]+) ([-\d.]+)", one["layers"][0]["limb"])]
    assert len(points) > 50
    truth = FrameTruth.from_dict(dict(base.images.truths["day_000"]))
    d = np.array([unproject(truth.camera_model, point) for point in points])
    true = np.asarray(truth.nadir_geocentric_cam)
    roll, pitch = roll_pitch_of_nadir(rotate(inverse(truth.q_cam_from_body), true))
    claimed = rotate(truth.q_cam_from_body, nadir_of_roll_pitch(roll + math.radians(2.0), pitch - math.radians(1.0)))
    # The digits of path data are 0.01 px.
    off = np.arccos(d @ claimed) - truth.angular_radius_rad
    assert np.abs(off).max() < 0.02 * math.radians(110.0) / truth.camera_model.width


def test_a_night_without_images_shows_none():
    assert shown_of([], {}, lambda key: None) == {"sentences": [], "frames": [], "kept": 0, "estimators": ()}
