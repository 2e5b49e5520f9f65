"""What a line says of an estimator, from rows small enough to be counted by hand."""

from __future__ import annotations

from typing import Any

import pytest
from synthetic import result_row

from horizonval.report.words import DEG
from horizonval.report.words import headline as words_of
from horizonval.scoring import summary as module
from horizonval.scoring.row import Row
from horizonval.scoring.summary import condition_of, headline, summarise


def row(case: str, status: str, error_deg: float | None = None, **changes: Any) -> Row:
    lit = {"epoch_utc": "2026-03-20T12:00:00Z", "lit_fraction": 1.0, "sun_in_frame": False, "borderline": False}
    error = None if error_deg is None else 3600.0 * error_deg
    return result_row(**(lit | {"case": case, "status": status, "nadir_error_arcsec": error} | changes))


ORBIT = [
    row("o1", "valid", 0.1),
    row("o2", "valid", 0.2),
    row("o3", "valid", 6.6, lit_fraction=0.4, false_valid=True),
    row("o4", "dark", expected="dark", lit_fraction=0.0),
    row("o5", "dark", expected="dark", lit_fraction=0.0),
]
OTHERS = [
    row("sun", "sun_glare", expected="sun_glare", sun_in_frame=True),
    row("space", "crashed", expected="no_limb", lit_fraction=None),
    row("bright", "valid", 0.3, expected="saturated"),
]


@pytest.mark.parametrize(
    ("changes", "condition"),
    [
        ({}, module.CLEAR),
        ({"lit_fraction": 0.5}, module.TERMINATOR),
        ({"lit_fraction": 0.0}, module.NIGHT),
        ({"lit_fraction": None}, module.NO_LIMB),
        ({"expected": "short_arc"}, module.NO_LIMB),
        ({"sun_in_frame": True, "lit_fraction": 0.5}, module.SUN),
        ({"expected": "saturated"}, module.SATURATED),
        ({"epoch_utc": None, "lit_fraction": None}, module.NOT_MADE),
    ],
)
def test_what_was_in_view_has_words(changes, condition):
    assert condition_of(row("a", "dark", **changes)) == condition


def test_what_does_not_work_counts_along_the_orbit_whatever_was_to_be_expected():
    line = headline(ORBIT + OTHERS, {"o1", "o2", "o3", "o4", "o5"})
    assert (line["orbit"]["n"], line["orbit"]["of"]) == (2, 5)
    assert (line["due"]["n"], line["due"]["of"]) == (2, 3)
    assert line["false"] == [[module.TERMINATOR, 1, 1]]
    assert line["crashed"] == [[module.NO_LIMB, 1, 1]]
    assert line["silent"] == [[module.NIGHT, 2, 2], [module.SUN, 1, 1]]
    assert (line["worst_arcsec"], line["n"]) == (6.6 * 3600.0, 4)


def test_a_line_says_it_in_degrees():
    (group,) = summarise(ORBIT + OTHERS, orbit={"o1", "o2", "o3", "o4", "o5"})["groups"]
    assert words_of(group, DEG) == (
        "works 40 % of the orbit (2 of 5 frames); crashes with too little limb in view (1 of 1); false at the "
        "terminator (1 of 1); no answer on the night side (2 of 2) and with the Sun in the frame (1 of 1); "
        "worst 6.60° (n = 4)."
    )


def test_who_is_told_the_pose_is_counted_apart():
    told = [row(case, "valid", 0.0, estimator="told") for case in "abcd"]
    summary = summarise([*ORBIT, *told], given_pose=["told"])
    assert (summary["rates"]["false_valid"]["n"], summary["rates"]["false_valid"]["of"]) == (1, 3)
    assert [group["given_pose"] for group in summary["groups"]] == [False, True]
