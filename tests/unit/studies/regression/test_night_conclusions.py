"""What a night concludes from its units, and its page of images."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import nights
import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.core.progress import Silent
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import unproject
from horizonval.geometry.frames import inverse, nadir_of_roll_pitch, roll_pitch_of_nadir, rotate
from horizonval.jobs.engine import Done
from horizonval.spec.suite import GateSpec
from horizonval.studies.regression import night as module
from horizonval.studies.regression.baseline import (
    Baseline,
    FrozenFrame,
    FrozenImage,
    Pack,
    read_baseline,
    write_baseline,
)
from horizonval.studies.regression.gates import GateInputs
from horizonval.studies.regression.night import Night, Wanted, check_folder, checked, verdict_of
from horizonval.studies.regression.page import headline, shown_of
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.units import Task
from horizonval.studies.regression.unseen import unseen
from horizonval.suites.suite import load_suite

SUITE = """
[suite]
name = "tiny"
seed = 3
estimators = ["altitude-free"]
[defaults]
camera = { file = "vis-cmos-512-60deg", mount_roll_deg = 55.0 }
platform = { epoch_utc = 2026-03-20T12:00:00Z, altitude_km = 500.0 }
[[cases]]
name = "day"
sobol.n = 8
sobol.ranges = { "sun.zenith_deg" = [10.0, 40.0] }
[[cases]]
name = "fixed"
grid = { attitude.roll_deg = [1.0] }
[regression]
replicates = 2
most_batches = 3
"""


CAMERA = "vis-cmos-512-60deg"


def row(scene: str, replicate: int, error: float | None, image: str, **columns: Any) -> ReplicateRow:
    about = {"replicate": replicate, "image": image, "estimator": "altitude-free", "table": "", "due": False}
    return nights.row(scene, error, **(about | columns))


def rendered(task: Task, rows: list[ReplicateRow], images: list[str], radiance: str = "same") -> dict[str, Any]:
    assert task.unit is not None
    (case,) = task.unit.cases
    about = {"radiance_sha256": radiance, "expected": "valid", "borderline": False, "full_scale": 1023}
    about |= {"images": images, "radiance_per_dn": [None] * len(images), "noise_dn": 1.0, "bound_arcsec": None}
    scene = {"table": case.table, "camera": CAMERA, "truth": {}, "bands": {"vis": about}}
    return {"scenes": {case.name: scene}, "together": {}, "rows": [r.to_dict() for r in rows]}


class Bench:
    """A night whose units are answered by hand: by default nothing has changed since the baseline."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.file = folder / "tiny.toml"
        self.file.write_text(SUITE)
        self.suite = load_suite(self.file)
        self.spec, self.plan = checked(self.suite)
        self.scenes = [case.name for case in self.suite.cases]
        self.wanted = Wanted(str(self.file), folder / "out", folder / "base.json", "2026-11-01")
        self.asked: list[list[str]] = []
        self.shift = dict.fromkeys(("replay", "render", "fresh"), 0.0)
        self.noise = 2.0
        self.broken: set[str] = set()
        self.changed_images: set[str] = set()
        patch.setattr(module, "do", self.do)
        patch.setattr(module, "environment", lambda: {"version": "1", "commit": "c"})

    def error(self, scene: str, replicate: int) -> float:
        return 50.0 + 3.0 * self.scenes.index(scene) + replicate

    def image(self, scene: str, replicate: int) -> str:
        return self.pixels(scene, replicate).sha256

    def pixels(self, scene: str, replicate: int) -> FrozenImage:
        dn = np.full((8, 8), 10 * self.scenes.index(scene) + replicate, dtype=np.uint16)
        return FrozenImage(scene, "vis", replicate, 1023, dn)

    def accepted(self) -> Baseline:
        rows = [
            row(s, k, self.error(s, k), self.image(s, k), table="day", due=True) for s in self.scenes for k in (0, 1)
        ]
        fresh = [row(f"0/{s}", 0, 50.0 + k, "x", table="day") for k, s in enumerate(self.scenes[:8])]
        head = {"suite": "tiny", "night": "n0", "version": "0", "reason": "r", "environment": {}}
        head |= {"accepted_utc": "u", "replicates": 2, "gates": [], "past": []}
        about = {"radiance_sha256": "same", "noise_dn": 1.0, "expected": "valid", "borderline": False}
        about |= {"bound_arcsec": None, "full_scale": 1023, "radiance_per_dn": [None, None]}
        scenes = {
            s: {
                "table": "day",
                "camera": CAMERA,
                "bands": {"vis": {**about, "images": [self.image(s, k) for k in (0, 1)]}},
            }
            for s in self.scenes
        }
        images = tuple(self.pixels(s, k) for s in self.scenes for k in (0, 1))
        frames = tuple(FrozenFrame(s, "vis", "same", np.ones((8, 8)), np.zeros((8, 8), np.uint8)) for s in self.scenes)
        write_baseline(
            self.wanted.baseline,
            head,
            GateInputs(rows, fresh=fresh, fresh_night="n0"),
            scenes,
            Pack(images, frames, {}),
            {},
        )
        return read_baseline(self.wanted.baseline, "tiny")

    def do(self, work: Any, tasks: list[Task], *_: Any) -> Mapping[str, Done[Any]]:
        self.asked.append([task.name for task in tasks])
        return {t.name: Done(None, "broke") if t.name in self.broken else Done(self.made(t)) for t in tasks}

    def made(self, task: Task) -> dict[str, Any]:
        if task.unit is None:
            s = task.scene
            found = [row(s, k, self.error(s, k) + self.shift["replay"], self.image(s, k)) for k in (0, 1)]
            return {"rows": [r.to_dict() for r in found]}
        name = task.unit.name
        if task.batch is not None:
            side = 1.0 if self.scenes.index(name) % 2 else -1.0
            return rendered(
                task, [row(name, 0, max(53.5 + self.shift["fresh"] + side * self.noise, 0.0), "y", table="day")], ["y"]
            )
        images = [self.image(name, k) for k in (0, 1)]
        rows = []
        if name in self.changed_images:
            images[1] = "new"
            rows = [row(name, 1, self.error(name, 1) + self.shift["render"], "new", table="day", due=True)]
        return rendered(task, rows, images)

    def night(self, accepted: Baseline | None = None, **changes: Any) -> Night:
        wanted = replace(self.wanted, **changes)
        gathered = Night(self.suite, self.spec, self.plan, wanted, accepted, Silent())
        gathered.work_first()
        return gathered


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(tmp_path, monkeypatch)


def verdicts(found: dict[str, Any], metric: str = "nadir_error") -> dict[str, str]:
    """Return the verdicts of a metric by lane; a table is enough."""
    return {gate["lane"]: gate["verdict"] for gate in found["gates"] if gate["metric"] == metric}


def test_a_night_without_changes_passes_on_the_rows_of_its_replay(bench: Bench) -> None:
    gathered = bench.night(bench.accepted())
    rows = gathered.all_rows()
    assert [(r.case, r.replicate) for r in rows] == sorted((s, k) for s in bench.scenes for k in (0, 1))
    assert all(r.nadir_error_arcsec == bench.error(r.case, r.replicate) and r.is_due for r in rows)
    found = verdict_of(gathered, None, None)
    assert (found["verdict"], found["exit_status"], found["complete"], found["problems"]) == ("PASS", 0, True, [])
    (about,) = found["comparisons"]
    assert (about["replayed"], about["n_changed"], about["rendered"], about["n_images_changed"]) == (18, 0, 9, 0)
    assert found["levels"]["fixed altitude-free: availability"]["value"] == 100.0
    names = {name for asked in bench.asked for name in asked}
    assert {*(f"replay/{s}" for s in bench.scenes), *(f"rerender/{s}" for s in bench.scenes)} <= names
    fresh = {name for name in names if name.startswith("fresh/0/")}
    assert len(fresh) == 8, "what the seed does not change is not drawn anew"


def test_each_lane_fails_for_its_own_reason(bench: Bench) -> None:
    accepted = bench.accepted()
    bench.shift["replay"] = 400.0
    found = verdict_of(bench.night(accepted), None, None)
    assert verdicts(found)["replay"] == "FAIL"
    assert (found["verdict"], found["exit_status"]) == ("FAIL", 1)
    assert found["comparisons"][0]["n_changed"] == 18
    bench.shift["replay"] = 0.0
    bench.changed_images, bench.shift["render"] = set(bench.scenes), 900.0
    found = verdict_of(bench.night(accepted), None, None)
    assert (verdicts(found)["replay"], verdicts(found)["rerender"]) == ("PASS", "FAIL")
    assert {gate["n"] for gate in found["gates"] if gate["lane"] == "rerender" and gate["estimator"]} == {9}
    assert found["comparisons"][0]["n_images_changed"] == 9
    assert found["comparisons"][0]["images_changed"][0]["same_images"] == 1
    bench.changed_images, bench.shift["fresh"] = set(), 500.0
    found = verdict_of(bench.night(accepted), None, None)
    assert (verdicts(found)["fresh"], found["verdict"]) == ("FAIL", "FAIL")


def test_undecided_fresh_gates_get_more_scenes_and_no_end_of_them(bench: Bench) -> None:
    accepted = bench.accepted()
    bench.noise = 150.0
    gathered = bench.night(accepted)
    assert gathered.batches == 1
    found = verdict_of(gathered, None, None)
    assert 1 < found["fresh"]["batches"] <= 3
    assert found["fresh"]["scenes"] == 8 * found["fresh"]["batches"]
    assert gathered.batches == found["fresh"]["batches"]
    assert (verdicts(found)["fresh"], found["fresh"]["verdict"]) == ("INCONCLUSIVE", "INCONCLUSIVE")
    assert (found["verdict"], found["exit_status"]) == ("PASS", 0), "other scenes stand apart from the facts"
    false = next(gate for gate in found["gates"] if (gate["lane"], gate["metric"]) == ("fresh", "false_valid"))
    assert (false["before"], false["now"]) == (0.0, 0.0)
    alone = verdict_of(bench.night(accepted, lanes=("fresh",)), None, None)
    assert (alone["verdict"], alone["exit_status"]) == ("INCONCLUSIVE", 3)
    with_reference = bench.night(accepted)
    reference = GateInputs(fresh=with_reference.fresh, fresh_night="2026-11-01")
    again = verdict_of(with_reference, None, reference)
    assert again["fresh"]["batches"] == 1, "pairs of another version's night are of its first batch"
    assert verdicts(again)["fresh"] == "PASS"
    assert all(gate["estimate"] is None for gate in again["gates"]), "the same scenes are facts"


def test_what_was_not_looked_at_has_not_passed(bench: Bench) -> None:
    found = verdict_of(bench.night(), None, None)
    assert (found["verdict"], found["exit_status"]) == ("INCOMPLETE", 2)
    assert "no accepted baseline" in found["problems"][0]
    accepted = bench.accepted()
    bench.broken = {f"rerender/{bench.scenes[0]}"}
    found = verdict_of(bench.night(accepted), None, None)
    assert (found["verdict"], found["exit_status"]) == ("INCOMPLETE", 2)
    assert found["problems"] == [f"rerender/{bench.scenes[0]}: broke"]
    bench.shift["replay"] = 400.0
    failed = verdict_of(bench.night(accepted), None, None)
    assert (failed["verdict"], failed["exit_status"]) == ("FAIL", 1), "a proven failure outweighs what is missing"


def figure_of(system: str, verdict: str = "PASS") -> dict[str, Any]:
    about = {"system": system, "name": "roll", "unit": "deg", "accepted": 1.0, "measured": 1.0, "verdict": verdict}
    return about


def test_a_published_figure_that_changed_fails_the_night_by_name(bench: Bench) -> None:
    accepted = bench.accepted()
    bench.spec = bench.spec.model_copy(update={"published": True})

    def night(*figures: dict[str, Any], **changes: Any) -> tuple[Night, dict[str, Any]]:
        gathered = bench.night(accepted, **changes)
        (gathered.wanted.out / module.WORK).mkdir(parents=True, exist_ok=True)
        gathered.compute_published(lambda folder, _: list(figures) if folder.is_dir() else [])
        return gathered, verdict_of(gathered, None, None)

    gathered, quiet = night(figure_of("A"), figure_of("G"))
    assert (quiet["verdict"], len(quiet["published"])) == ("PASS", 2)
    assert not (gathered.wanted.out / module.WORK / module.PUBLISHED).exists(), "nothing is left for the next night"
    _, loud = night(figure_of("A"), figure_of("G", "FAIL"))
    assert (loud["verdict"], loud["exit_status"]) == ("FAIL", 1)
    assert headline(loud) == "Regression: system G, roll."
    _, left_out = night(figure_of("G", "FAIL"), lanes=("replay",))
    assert (left_out["verdict"], left_out["published"]) == ("PASS", [])


def test_published_figures_that_cannot_be_computed_leave_the_night_incomplete(bench: Bench) -> None:
    accepted = bench.accepted()
    bench.spec = bench.spec.model_copy(update={"published": True})
    gathered = bench.night(accepted)
    (gathered.wanted.out / module.WORK).mkdir(parents=True)

    def missing(*_: Any) -> list[dict[str, Any]]:
        raise UserError("no such page", where="A.json")

    gathered.compute_published(missing)
    found = verdict_of(gathered, None, None)
    assert (found["verdict"], found["exit_status"]) == ("INCOMPLETE", 2)
    assert found["problems"][0].startswith("published: ")


def test_lanes_that_are_left_out_are_not_asked_for(bench: Bench) -> None:
    accepted = bench.accepted()
    found = verdict_of(bench.night(accepted, lanes=("replay",)), None, None)
    assert set(verdicts(found)) == {"replay"}
    assert {name.partition("/")[0] for asked in bench.asked for name in asked} == {"replay"}
    bench.asked.clear()
    rendered_only = verdict_of(bench.night(accepted, lanes=("rerender",)), None, None)
    assert {gate["lane"] for gate in rendered_only["gates"]} == {"rerender"}
    assert {name.partition("/")[0] for asked in bench.asked for name in asked} == {"rerender"}


def test_a_release_is_compared_by_the_whole_chain_and_not_twice(bench: Bench) -> None:
    accepted = bench.accepted()
    same = verdict_of(bench.night(accepted), accepted, None)
    assert [about["name"] for about in same["comparisons"]] == ["accepted", "release"]
    assert same["comparisons"][1]["same_as_accepted"] is True
    older = replace(accepted, head={**accepted.head, "night": "n-1"})
    bench.changed_images, bench.shift["render"] = set(bench.scenes), 900.0
    found = verdict_of(bench.night(accepted), older, None)
    failed = {(g["against"], g["lane"]) for g in found["gates"] if g["verdict"] == "FAIL"}
    assert failed == {("accepted", "rerender"), ("release", "rerender")}
    assert found["comparisons"][1]["replayed"] == 0


def test_what_was_accepted_since_the_release_fails_no_night(bench: Bench) -> None:
    accepted = bench.accepted()
    before = [replace(row, nadir_error_arcsec=0.25 * (row.nadir_error_arcsec or 0.0)) for row in accepted.results.rows]
    older = replace(accepted, head={**accepted.head, "night": "n-1"}, results=replace(accepted.results, rows=before))
    found = verdict_of(bench.night(accepted), older, None)
    assert found["verdict"] == "PASS"
    assert "accepted with a reason since the last release" in {gate["reason"] for gate in found["gates"]}


def test_what_the_suite_no_longer_has_leaves_the_night_incomplete(bench: Bench) -> None:
    """Also in the replay lane alone, whose images and rows are all there."""
    accepted = bench.accepted()
    bench.suite = replace(bench.suite, cases=bench.suite.cases[:4])
    found = verdict_of(bench.night(accepted, lanes=("replay",)), None, None)
    assert (found["verdict"], found["exit_status"]) == ("INCOMPLETE", 2)
    assert found["problems"][0].startswith(f"not compared: scenes {bench.scenes[4]}, {bench.scenes[5]}")
    bench.spec = bench.spec.model_copy(update={"replicates": 1})
    problems = verdict_of(bench.night(accepted, lanes=("replay",)), None, None)["problems"]
    assert any("replicate 1 " in problem for problem in problems)


def test_a_check_says_what_the_gates_let_through(bench: Bench) -> None:
    found = unseen(bench.suite)
    day = found[f"a night lets through in day ({CAMERA}, vis)"]
    assert day.startswith(
        "of 16 images 0 lost answers, 0 new false claims, 0 new crashes, 0 claimed sigmas that change by"
    )
    loose = {"name": "wide", "lane": "replay", "margin": 20.0, "reason": "because it is tested"}
    gates = [
        GateSpec(**loose, metric="availability", unit="percentage points", cases=["day"]),
        GateSpec(**loose | {"name": "tight", "margin": 5.0}, metric="roll_mean", unit="arcsec"),
    ]
    assert bench.suite.regression is not None
    spec = bench.suite.regression.model_copy(update={"gate": gates})
    found = unseen(replace(bench.suite, regression=spec))
    assert "of 16 images 3 lost" in found[f"a night lets through in day ({CAMERA}, vis)"]
    assert "of 2 images 0 lost" in found[f"a night lets through in fixed ({CAMERA}, vis)"]
    assert "mean of roll or pitch by 5 arcsec" in found[f"a night lets through in fixed ({CAMERA}, vis)"]
    assert [key for key in found if key.startswith("gate")] == ["gate wide loosens availability"]
    assert unseen(replace(bench.suite, regression=None)) == {}


def test_a_night_goes_into_a_new_folder_or_its_own(tmp_path: Path) -> None:
    out = tmp_path / "out"
    check_folder(out)
    out.mkdir()
    check_folder(out)
    (out / "mine").touch()
    with pytest.raises(UserError, match=r"is not empty; expected .* or one of this command"):
        check_folder(out)
    for name in ("night.json", ".work", "history.jsonl"):
        (out / name).touch()
        check_folder(out)
        (out / name).unlink()
    for place, why in {
        "mine": "mine: is a file",
        "mine/x": "mine: is a file",
        "none/x": "none: no such folder",
    }.items():
        with pytest.raises(UserError, match=why):
            check_folder(out / place)


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
