"""Methods that see all heads in a night: rendered, frozen and put together again, in every lane; and their faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from nights import Night, key_of, plainly, rendered
from scipy import ndimage

from horizonval.core.outcome import Outcome, Refusal
from horizonval.jobs.progress import Stopwatch
from horizonval.store.folder import RunFolder, read_json
from horizonval.studies.regression.accept import accept
from horizonval.studies.regression.baseline import read_baseline
from horizonval.studies.regression.night import Wanted, run_night
from horizonval.studies.regression.units import digest_of_heads, frozen_together
from horizonval.suites.plan import plan_of, units_of
from horizonval.suites.suite import load_suite
from horizonval.suites.units.case import records_of

DEFAULTS = """
[defaults]
camera = { file = "vis-pair-1024-60deg", mount_roll_deg = 0.0, camera = { width = 64, height = 64, fov_deg = 60.0 } }
platform = { epoch_utc = 2026-03-20T12:00:00Z, latitude_deg = 40.0, heading_deg = 350.0, altitude_km = 500.0 }
sun = { zenith_deg = 10.0, azimuth_deg = 40.0 }
render = { subsamples = 1, nodes = 32, orders = "single" }
"""
TWO = f"""
[suite]
name = "two"
seed = 3
keep = "none"
estimators = ["altitude-free", "video-vertical"]

{DEFAULTS}
[[cases]]
name = "pair"
estimators = ["altitude-free", "video-vertical"]
sobol = {{ n = 1, ranges = {{ "attitude.roll_deg" = [-2.0, 2.0] }} }}

[regression]
replicates = 2
"""
SCENES = 8
SUITE = f"""
[suite]
name = "pairs"
seed = 3
keep = "none"
estimators = ["video-vertical"]

{DEFAULTS}
[[cases]]
name = "pair"
sobol = {{ n = {SCENES}, ranges = {{ "attitude.roll_deg" = [-2.0, 2.0], "attitude.pitch_deg" = [-2.0, 2.0] }} }}

[regression]
replicates = 1
"""


def heads_of(base) -> dict[str, str]:
    """The cases of the heads of the one scene."""
    ((_, about),) = base.together.items()
    return dict(about["heads"])


@pytest.fixture(scope="module")
def accepted(here, tmp_path_factory):
    """A first night in this process, accepted."""
    folder = tmp_path_factory.mktemp("heads")
    (folder / "two.toml").write_text(TWO)
    wanted = Wanted(str(folder / "two.toml"), folder / "out", folder / "base" / "two.json", "2026-11-01", workers=1)
    run_night(wanted)
    accept(wanted.out, wanted.baseline, "The first one, nothing before it", release=True)
    return wanted


@pytest.fixture(scope="module")
def base(accepted):
    return read_baseline(accepted.baseline, "two")


@pytest.fixture(scope="module")
def suite(accepted):
    return load_suite(accepted.suite)


def test_rows_of_all_heads_go_under_the_name_of_the_scene(base, suite):
    (unit,) = units_of(suite.cases, plan_of(suite))
    keys = {(row.case, row.replicate, row.estimator) for row in base.results.rows}
    alone = {(case.name, k, "altitude-free") for case in unit.cases for k in (0, 1)}
    assert keys == alone | {(unit.name, k, "video-vertical") for k in (0, 1)}
    together = {k: digest_of_heads(heads) for k, heads in frozen_together(base.images, heads_of(base))}
    for row in base.results.rows:
        if row.case == unit.name:
            assert (row.image_address, row.table) == (together[row.replicate], "pair")
    assert len({row.image_address for row in base.results.rows}) == 6
    assert {row.case for row in base.results.fresh} == {f"0/{name}" for name in unit.names}
    assert set(base.scenes) == {case.name for case in unit.cases}
    assert base.together[unit.name]["heads"] == [[case.head, case.name] for case in unit.cases]


def test_the_first_images_are_those_of_a_run(base, suite, tmp_path):
    """The same noise, answer, error, bound and expected outcome as in the records of `horizonval run`."""
    plan = plan_of(suite)
    (unit,) = units_of(suite.cases, plan)
    records = records_of(unit, plan, RunFolder(tmp_path), Stopwatch())
    rows = {(r["case"], r["estimator"]): r for record in records.values() for r in record["rows"]}
    mine = {(row.case, row.estimator): row for row in base.results.rows if row.replicate == 0}
    assert set(rows) == set(mine)
    for key, row in rows.items():
        assert (mine[key].status, mine[key].false_valid) == (row["status"], row["false_valid"])
        assert mine[key].nadir_error_arcsec == pytest.approx(row["nadir_error_arcsec"], abs=1e-3)
        assert mine[key].bound_arcsec == pytest.approx(row["bound_arcsec"], rel=1e-6)
    together = rows[unit.name, "video-vertical"]
    assert together["status"] == "valid", "or errors would not be compared"
    about = base.together[unit.name]["bands"]["vis"]
    assert about["expected"] == together["expected"]


def test_every_lane_repeats_them(accepted, base):
    out = accepted.out.with_name("second")
    verdict = run_night(replace(accepted, out=out))
    about = next(one for one in verdict["comparisons"] if one["name"] == "accepted")
    assert (about["replayed"], about["n_changed"]) == (6, 0)
    assert (about["rendered"], about["n_images_changed"]) == (2, 0)
    assert (verdict["verdict"], verdict["problems"]) == ("PASS", []), "with a single scene"
    night = read_json(out / "night.json")
    assert night["rows"] == [row.to_dict() for row in sorted(base.results.rows, key=lambda row: row.key)]
    assert night["fresh"] == [row.to_dict() for row in base.results.fresh]


@pytest.fixture(scope="module")
def pairs(tmp_path_factory) -> Night:
    made = rendered(tmp_path_factory.mktemp("pairs") / "pairs.toml", SUITE)
    assert (len(made.made), len(made.frames)) == (SCENES, 2 * SCENES)
    return made


def together(pairs: Night) -> dict[str, list[str]]:
    """The cases of the heads of every scene, in their order."""
    about = {name: one for record, _ in pairs.made.values() for name, one in record["together"].items()}
    return {name: [case for _, case in one["heads"]] for name, one in about.items()}


def test_without_a_fault_all_is_quiet(pairs):
    images = pairs.unchanged()
    assert all(one["same_radiance"] and one["same_images"] == one["n_images"] == 1 for one in images.values())
    assert pairs.failed(pairs.fresh(plainly), images) == {}


@pytest.mark.parametrize("which", [0, 1])
def test_half_a_pixel_in_one_head_is_caught_by_rendering_again(pairs, which):
    cases = {heads[which] for heads in together(pairs).values()}

    def shifted(scene, camera):
        frame = pairs.frames[key_of(scene)]
        if scene.camera.head != pairs.suite.cases[which].head:
            return frame
        moved = ndimage.shift(frame.radiance["vis"].astype(float), (0.5, 0.5), order=1, mode="nearest")
        return replace(frame, radiance={"vis": moved.astype(np.float32)})

    found = pairs.failed(images=pairs.again(render=shifted))
    assert found["limb_displacement"] == cases, "the other head stays where it was"


def test_a_worse_method_of_all_heads_is_caught(pairs):
    """Every answer is pushed away from the first head's true nadir by 300 arcsec."""
    first = [heads[0] for heads in together(pairs).values()]
    order = iter([np.array(pairs.scenes[case]["truth"]["nadir_geocentric_cam"]) for case in first])

    def worse(name, observation):
        fit, true = plainly(name, observation), next(order)
        assert not isinstance(fit, Refusal)
        off = fit.nadir_cam - true
        pushed = fit.nadir_cam + np.radians(300.0 / 3600.0) * off / np.linalg.norm(off)
        return replace(fit, nadir_cam=pushed / np.linalg.norm(pushed))

    assert pairs.failed(pairs.fresh(worse))["nadir_error"] == set(pairs.made)


def test_a_method_that_loses_its_heads_is_caught(pairs):
    """Where all answers are lost no error is left to compare: availability must say so."""

    def lost(name, observation):
        return Refusal(Outcome.NO_LIMB, "one head was not looked at")

    assert pairs.failed(pairs.fresh(lost)) == {"availability": set(pairs.made)}
