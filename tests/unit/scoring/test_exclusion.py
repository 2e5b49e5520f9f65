"""The exclusion angle, from cases that can be counted on fingers."""

from __future__ import annotations

import pytest

from horizonval.scoring.expected import exclusion_angle_deg


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
