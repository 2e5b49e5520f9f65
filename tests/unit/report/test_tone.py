"""Colour pictures: exposure, colour and darkness."""

from __future__ import annotations

import numpy as np

from horizonval.report.figures.tone import tone_mapped


def test_a_grey_scene_stays_grey_and_its_brightest_part_is_white() -> None:
    ramp = np.linspace(0.0, 1.0, 2001)[:, None, None] * np.ones((1, 4, 3)) * 3e-5
    picture = tone_mapped(ramp)
    assert (picture.rgb.max(axis=-1) == picture.rgb.min(axis=-1)).all()
    assert picture.rgb[-1, 0, 0] == 255
    assert picture.rgb[0, 0, 0] == 0
    assert 0.99 * 3e-5 < picture.white < 3e-5
    assert (np.diff(picture.rgb[:, 0, 0].astype(int)) >= 0).all()


def test_three_decades_below_white_are_still_seen_and_keep_their_colour() -> None:
    scene = np.ones((40, 40, 3))
    scene[0, 0] = (0.5e-3, 0.5e-3, 1e-3)
    dark = tone_mapped(scene).rgb[0, 0]
    assert dark[2] > dark[0] == dark[1] > 0


def test_black_is_black() -> None:
    assert not tone_mapped(np.zeros((3, 3, 3))).rgb.any()
