"""Methods that see all heads in a night: rendered, frozen and put together again, in every lane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import horizonval.renderer  # noqa: F401  (names the LLVM library before any test imports Dr.Jit)
from horizonval.core.outcome import Outcome, Refusal
from horizonval.jobs import engine
from horizonval.jobs.progress import Stopwatch
from horizonval.plugins import registry
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.studies.regression.accept import accept
from horizonval.studies.regression.baseline.baseline import pack_path, read_baseline
from horizonval.studies.regression.heads import digest_of_heads, estimate_frozen_heads, frozen_together
from horizonval.studies.regression.night import run_night
from horizonval.studies.regression.regions import ELSEWHERE, LIMB, displacement_px, regions_of
from horizonval.studies.regression.statistics.gates import changed, pairs_of
from horizonval.studies.regression.tonight.wanted import Wanted
from horizonval.suites.plan import plan_of, units_of
from horizonval.suites.suite import load_suite
from horizonval.suites.units.case import records_of

SUITE = """
[suite]
name = "two"
seed = 3
keep = "none"
estimators = ["altitude-free", "video-vertical"]

[defaults]
camera = { file = "vis-pair-1024-60deg", mount_roll_deg = 0.0, camera = { width = 64, height = 64, fov_deg = 60.0 } }
platform = { epoch_utc = 2026-03-20T12:00:00Z, latitude_deg = 40.0, heading_deg = 350.0, altitude_km = 500.0 }
sun = { zenith_deg = 10.0, azimuth_deg = 40.0 }
render = { subsamples = 1, nodes = 32, orders = "single" }

[[cases]]
name = "pair"
estimators = ["altitude-free", "video-vertical"]
sobol = { n = 1, ranges = { "attitude.roll_deg" = [-2.0, 2.0] } }

[regression]
replicates = 2

[[regression.gate]]
name = "accuracy"
lane = "replay"
metric = "nadir_error"
margin = 20.0
unit = "arcsec"
reason = "a fifth of what such sensors are specified to"
"""
ANCHOR = {"name": "stub", "verdict": "PASS", "found": 0.0, "limit": 1.0, "unit": "m", "n": 1, "what": "nothing"}


@pytest.fixture(scope="module")
def accepted(tmp_path_factory):
    """A first night in this process, accepted; its anchors are a stub, which have tests of their own."""
    folder = tmp_path_factory.mktemp("heads")
    (folder / "two.toml").write_text(SUITE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "run_in_processes", lambda work, items, *_, **__: ((one, work(one)) for one in items))
        patch.setattr("horizonval.studies.regression.anchors.anchors", lambda: [dict(ANCHOR)])
        wanted = Wanted(str(folder / "two.toml"), folder / "out", folder / "base" / "two.json", "2026-11-01", workers=1)
        run_night(wanted)
        accept(wanted.out, wanted.baseline, "The first one, nothing before it", release=True)
        yield wanted


@pytest.fixture(scope="module")
def base(accepted):
    return read_baseline(accepted.baseline, "two")


@pytest.fixture(scope="module")
def suite(accepted):
    return load_suite(accepted.suite)


def test_rows_of_all_heads_go_under_the_name_of_the_scene(base, suite):
    (unit,) = units_of(suite.cases, plan_of(suite))
    keys = {(row.scene, row.replicate, row.estimator) for row in base.results.rows}
    alone = {(case.name, k, "altitude-free") for case in unit.cases for k in (0, 1)}
    assert keys == alone | {(unit.name, k, "video-vertical") for k in (0, 1)}
    images = {(image.scene, image.replicate): image.sha256 for image in base.images.images}
    for row in base.results.rows:
        if row.scene == unit.name:
            assert row.image == digest_of_heads(images[case.name, row.replicate] for case in unit.cases)
            assert row.table == "pair"
    assert len({row.image for row in base.results.rows}) == 6
    assert {row.scene for row in base.results.fresh} == {f"0/{name}" for name in unit.names}
    assert set(base.scenes) == {case.name for case in unit.cases}
    assert base.together[unit.name]["heads"] == [[case.head, case.name] for case in unit.cases]


def test_the_first_images_are_those_of_a_run(base, suite, tmp_path):
    """The same noise, answer, error, bound and expected outcome as in the records of `horizonval run`."""
    plan = plan_of(suite)
    (unit,) = units_of(suite.cases, plan)
    records = records_of(unit, plan, RunFolder(tmp_path), Stopwatch())
    rows = {(r["case"], r["estimator"]): r for record in records.values() for r in record["rows"]}
    mine = {(row.scene, row.estimator): row for row in base.results.rows if row.replicate == 0}
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
    assert (about["rendered"], about["n_images_changed"], about["missing_scenes"]) == (2, 0, [])
    assert verdict["problems"] == []
    night = read_json(out / "night.json")
    assert night["rows"] == [row.to_dict() for row in sorted(base.results.rows, key=lambda row: row.key)]
    assert night["fresh"] == [row.to_dict() for row in base.results.fresh]


def test_a_baseline_from_before_methods_of_all_heads_is_read(accepted):
    """Heads alone are compared; what sees all of them is new, and estimated where it is rendered."""
    older = accepted.baseline.with_name("older.json")
    data = read_json(accepted.baseline, bound=False)
    del data["together"]
    write_json(older, data, bound=False)
    pack_path(older).write_bytes(pack_path(accepted.baseline).read_bytes())
    out = accepted.out.with_name("third")
    verdict = run_night(replace(accepted, out=out, baseline=older, lanes=("replay", "rerender")))
    (about,) = verdict["comparisons"]
    assert (about["replayed"], about["n_changed"], verdict["problems"]) == (4, 0, [])
    rows = read_json(out / "night.json")["rows"]
    assert sum(row["estimator"] == "video-vertical" for row in rows) == 2


def test_a_worse_method_of_all_heads_is_named(base, suite):
    plan, ((scene, about),) = plan_of(suite), base.together.items()
    ((_, images), *_) = frozen_together(base.images, dict(about["heads"]))
    nadir = np.array(next(iter(images.values())).truth.nadir_geocentric_cam)

    def pushed(name, observation):
        fit = registry.run_safely(registry.get(name), observation)
        assert not isinstance(fit, Refusal)
        moved = nadir + 1.1 * (fit.nadir_cam - nadir)
        return replace(fit, nadir_cam=moved / np.linalg.norm(moved))

    rows = estimate_frozen_heads(base.images, scene, dict(about["heads"]), plan, run=pushed)
    moved = changed(pairs_of(rows, base.results.rows))
    assert [(one["scene"], one["estimator"]) for one in moved] == [(scene, "video-vertical")] * 2
    before = {row.key: row for row in base.results.rows}
    for row in rows:
        assert row.status == Outcome.VALID
        assert row.nadir_error_arcsec == pytest.approx(1.1 * before[row.key].nadir_error_arcsec, rel=1e-3)


def test_a_row_of_elements_has_a_limb_that_can_move():
    """One pixel high: half an element is found, by the slope along the row alone."""
    elements = np.arange(160.0)
    height = (elements[None] - 79.5) * 4e3
    regions = regions_of(np.where(height > 0, 0, 1), height)
    assert LIMB in regions
    assert ELSEWHERE not in regions

    def edge(at):
        return (1.0 / (1.0 + np.exp((elements - at) / 4.0)))[None]

    assert displacement_px(edge(79.5), edge(79.5), regions == LIMB) == 0.0
    assert displacement_px(edge(79.5), edge(80.0), regions == LIMB) == pytest.approx(0.5, abs=0.05)
