"""The fit in C and `limb-profile` on the same frames, with the same cut table and priors: the same answer.

Where the residuals of broken clouds have two explanations, by noise or by lens and air, the two may end in either.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from onboard import BANDS, answer, band_of, by_c, by_python, drawn, kept, make_program, make_tables, sent

from horizonval.estimation.observation import Fit, Observation

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")

MOST_SIGMA = 0.1
"""Distance of the nadirs, in standard deviations that `limb-profile` claims: the limb cannot distinguish them."""
ATTITUDE_SIGMA = 14
"""Its place in the line that the program reads."""
SIGMA_SHARE = 0.1
"""Largest difference of the claims: the noise of some thousand residuals has parts that take each other's place."""


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    folder = tmp_path_factory.mktemp("onboard")
    return folder, make_tables(folder)


@pytest.fixture(scope="module")
def programs(tables):
    folder, _ = tables
    return {band: make_program(folder / band) for band in BANDS}


def distance(observation: Observation, table: Path, program: Path) -> tuple[float, float] | None:
    """Return the distance of the nadirs in claimed sigmas and the ratio of the claims; None where one refuses."""
    python, c = by_python(observation, table), by_c(observation, program)
    if not isinstance(python, Fit) or c["status"] != "valid":
        return None
    variance, axes = np.linalg.eigh(python.total_covariance_nadir_cam)
    # the smallest is along the nadir, which has no error there
    off = axes[:, 1:].T @ (np.array(c["nadir_cam"]) - python.nadir_cam) / np.sqrt(variance[1:])
    claimed = np.radians(c["sigma_nadir_arcsec"] / 3600.0)
    return float(np.linalg.norm(off)), claimed / float(np.sqrt(variance[1:].sum()))


def test_rendered_frames_of_every_band_give_the_same_nadir(tables, programs):
    _, table_of = tables
    found = {}
    for name, observation in kept():
        band = band_of(observation)
        found[name] = distance(observation, table_of[band], programs[band])
    off, ratio = np.array(list(found.values())).T
    # Eight images know their median to a factor of two.
    assert np.median(off) < 2.0 * MOST_SIGMA, found
    assert np.median(np.abs(ratio - 1.0)) < SIGMA_SHARE, found


@pytest.mark.parametrize("count", [8, pytest.param(200, marks=pytest.mark.slow)])
def test_images_drawn_from_the_tables_give_the_same_nadir(tables, programs, count):
    _, table_of = tables
    frames, found = list(kept()), []
    for seed in range(count):
        _, observation = frames[seed % len(frames)]
        band = band_of(observation)
        seen, _ = drawn(observation, table_of[band], np.random.default_rng(1000 + seed))
        found.append(distance(seen, table_of[band], programs[band]))
    off, ratio = np.array([one for one in found if one is not None]).T
    assert len(off) > 0.95 * count
    # Eight images, one of every frame, know their median to a factor of two.
    most = MOST_SIGMA if count > len(frames) else 2.0 * MOST_SIGMA
    assert np.median(off) < most, off
    assert np.quantile(off, 0.9) < 3.0 * most, off
    assert np.median(np.abs(ratio - 1.0)) < SIGMA_SHARE, ratio


def test_a_gain_that_nobody_knows_may_be_said_as_0(programs):
    observation = next(one for _, one in kept() if band_of(one) == "co2")
    unknown = replace(observation, radiance_per_dn=None)
    known = sent(unknown)
    assert known[-3:-1] == [1.0, 0.0]
    one, none = (answer(programs["co2"], [*known[:-3], gain, 0.0, known[-1]], unknown.image) for gain in (1.0, 0.0))
    assert one["status"] == none["status"] == "valid"
    assert np.allclose(one["nadir_cam"], none["nadir_cam"], rtol=0.0, atol=np.radians(1.0 / 3600.0))


@pytest.mark.parametrize("wrong", [0.0, -1.0, float("inf"), float("nan")])
def test_sigmas_that_are_none_are_refused(programs, wrong):
    observation = next(one for _, one in kept() if band_of(one) == "co2")
    known = sent(observation)
    known[ATTITUDE_SIGMA] = wrong
    assert answer(programs["co2"], known, observation.image)["status"] == "bad_input"


def test_no_place_is_left_and_nothing_undefined_done(tables, tmp_path):
    folder, _ = tables
    shutil.copy(folder / "vis" / "table.h", tmp_path)
    program = make_program(tmp_path, "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    name, observation = next(one for one in kept() if band_of(one[1]) == "vis")
    assert by_c(observation, program)["status"] == "valid", name
