"""Several draws of the noise of one frame: what estimators see, and what the row says of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Fit
from horizonval.jobs.progress import Stopwatch
from horizonval.plugins.answer import crash
from horizonval.scoring.summary import noise_nees
from horizonval.sensor.observe import observe
from horizonval.spec.load import Case, load_suite
from horizonval.store.folder import RunFolder
from horizonval.suites.plan import CasePlan, units_of
from horizonval.suites.units import case as module
from horizonval.suites.units import scored

SIGMA = 1e-4


class Scripted:
    """A supervisor whose answers are given beforehand, in the order of the questions."""

    spent_s = None

    def __init__(self, answers):
        self.answers, self.seen = list(answers), []

    def run(self, name, observation):
        self.seen.append(observation)
        return self.answers[len(self.seen) - 1]


def fits_about(nadir_cam, offs, sigma=SIGMA):
    """Fits off by so many radians along one direction, which claim ``sigma`` in every one."""
    nadir = np.array(nadir_cam)
    across = np.cross(nadir, [1.0, 0.0, 0.0])
    made = []
    for off in offs:
        moved = nadir + off * across / np.linalg.norm(across)
        made.append(Fit(moved / np.linalg.norm(moved), sigma**2 * np.eye(3), 0.0, 0.0))
    return made


REFUSAL = Refusal(Outcome.DARK, "dark")


@pytest.fixture
def take(make_frame, monkeypatch, tmp_path):
    """Take one case whose frame is made by hand, with scripted answers; its row, what was seen, the frame."""
    frame = make_frame()
    camera = frame.truth.camera_spec
    monkeypatch.setattr(module, "_frame", lambda *_: (frame, None))
    (tmp_path / "s.toml").write_text(
        '[suite]\nname = "s"\nestimators = ["altitude-free"]\n[[frame]]\nscene.name = "f"\n'
        'camera.file = "vis-cmos-512-60deg"\nplatform.altitude_km = 500.0\n'
    )
    scene = load_suite(tmp_path / "s.toml").cases[0].scene

    def run(offs, draws, sigma=SIGMA):
        answers = [
            REFUSAL if off is None else fits_about(frame.truth.nadir_geocentric_cam, [off], sigma)[0] for off in offs
        ]
        processes = Scripted(answers)
        monkeypatch.setattr(scored, "supervisor_of", lambda _: processes)
        plan, watch = CasePlan(("altitude-free",), draws=draws), Stopwatch()
        taken = module._make(Case(scene, camera), plan, RunFolder(tmp_path), watch).observed
        return taken, processes.seen, frame, camera, watch

    return run


def test_every_draw_is_another_seed_and_the_first_one_is_the_row(take):
    taken, seen, frame, camera, watch = take([1e-3, 1.1e-3, 1.3e-3], 3)
    for seed, observation in enumerate(seen):
        assert np.array_equal(observation.image, observe(frame, camera, seed=seed).dn)
    assert not np.array_equal(seen[0].image, seen[1].image)
    (row,) = taken.rows
    # 1.0, 1.1 and 1.3 mrad vary by 7/300 mrad2, by (0.1 mrad)2 claimed: 7/3, whatever all are off by.
    assert (row.nees_noise, row.noise_draws) == (pytest.approx(7 / 3, rel=1e-4), 3)
    (one,) = take([1e-3], 1)[0].rows
    assert (one.nees_noise, one.noise_draws) == (None, None)
    assert replace(row, nees_noise=None, noise_draws=None) == one
    assert np.array_equal(taken.images["vis"].dn, seen[0].image)
    assert "draws" in watch.seconds


def test_refused_draws_are_left_out(take):
    (row,) = take([0.0, None, 2e-4, None], 4)[0].rows
    assert (row.nees_noise, row.noise_draws) == (pytest.approx(2.0, rel=1e-4), 2)
    (refused,) = take([None, 0.0, 2e-4], 3)[0].rows
    assert (refused.status, refused.noise_draws) == ("dark", 2)
    assert refused.nees_noise == pytest.approx(2.0, rel=1e-4)
    (lonely,) = take([0.0, None, None], 3)[0].rows
    assert (lonely.nees_noise, lonely.noise_draws) == (None, 1)


def test_a_method_that_claims_perfection_has_none(take):
    (row,) = take([0.0, 0.0], 2, sigma=0.0)[0].rows
    assert (row.nees_noise, row.noise_draws) == (None, 2)


def test_heads_are_drawn_together(make_frame, monkeypatch, tmp_path):
    (tmp_path / "s.toml").write_text(
        '[suite]\nname = "s"\nestimators = ["video-vertical"]\n[[frame]]\nscene.name = "f"\n'
        'camera.file = "vis-pair-1024-60deg"\nplatform.altitude_km = 500.0\n'
    )
    suite = load_suite(tmp_path / "s.toml")
    plan = CasePlan(suite.estimators, draws=3)
    (unit,) = units_of(suite.cases, plan)
    frame = make_frame()
    camera = frame.truth.camera_spec
    taken = {}
    for head, one in enumerate(unit.cases):
        images = [observe(frame, camera, seed=10 * head + seed) for seed in range(3)]
        band = one.camera.band[0].name
        taken[str(one.scene.camera.head)] = scored.Observed({band: images[0]}, {band: images[1:]})
    fits = fits_about(frame.truth.nadir_geocentric_cam, [0.0, 1e-4, 3e-4])
    processes = Scripted(fits)
    monkeypatch.setattr(scored, "supervisor_of", lambda _: processes)
    (row,) = scored.score_together(taken, unit.name, plan.together(unit.cases[0]), plan, Stopwatch()).rows
    assert (row.nees_noise, row.noise_draws) == (pytest.approx(noise_nees(fits).mean()), 3)
    for seed, observation in enumerate(processes.seen):
        for head, own in enumerate(observation.heads.values()):
            assert np.array_equal(own.image, observe(frame, camera, seed=10 * head + seed).dn)


def test_a_crash_under_any_draw_is_the_rows_outcome(take, monkeypatch):
    """The others' fits would hide it; what was printed last stays in the record."""
    taken, *_ = take([1e-5, 2e-5, None], 3)
    assert taken.rows[0].status == "valid"
    monkeypatch.setitem(globals(), "REFUSAL", crash("gone", "last words"))
    taken, *_ = take([1e-5, 2e-5, None], 3)
    assert (taken.rows[0].status, taken.rows[0].reason, taken.rows[0].noise_draws) == ("crashed", "gone", 2)
    assert taken.details["altitude-free"]["output"] == "last words"
