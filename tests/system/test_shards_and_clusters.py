"""The same bytes from one process, from shards, and from a cluster that loses a worker."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from conftest import MINI_CAMERA, assert_one_line, outcome_of

from horizonval.core.progress import Silent
from horizonval.jobs.pool import Execution
from horizonval.scoring.row import read_results
from horizonval.store.store import Store
from horizonval.store.verify import verify_folder
from horizonval.suites.run import run_suite
from horizonval.suites.suite import load_suite

SUITE = """
[suite]
name = "small"
estimators = ["altitude-free", "ideal"]
[defaults]
camera = { file = "mini-camera.toml", mount_roll_deg = 65.0 }
render = { orders = "single", nodes = 32, subsamples = 1 }
[[cases]]
name = "one-method"
estimators = ["altitude-free"]
[cases.orbit]
epoch_utc = 2026-03-20T00:00:00Z
altitude_km = 500.0
sun_synchronous = true
ltan_h = 10.5
n = 4
[[cases]]
name = "all-methods"
[cases.orbit]
epoch_utc = 2026-03-20T00:00:00Z
altitude_km = 500.0
sun_synchronous = true
ltan_h = 6.0
n = 2
"""


@pytest.fixture(scope="module")
def suite_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    (folder / "mini-camera.toml").write_text(MINI_CAMERA.replace("96", "64").replace("80", "64"))
    (folder / "small.toml").write_text(SUITE)
    return folder / "small.toml"


@pytest.fixture(scope="module")
def whole(here, suite_file, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    out = tmp_path_factory.mktemp("whole") / "out"
    assert not run_suite(load_suite(suite_file), out, execution=Execution(1)).failed
    return outcome_of(out)


def test_a_table_runs_the_methods_it_names(whole, suite_file, tmp_path_factory):
    out = next(tmp_path_factory.getbasetemp().glob("whole*")) / "out"
    ran = {(row.case.rpartition("_")[0], row.estimator) for row in read_results(out / "results.parquet")}
    assert ran == {("one-method", "altitude-free"), ("all-methods", "altitude-free"), ("all-methods", "ideal")}


def test_shards_make_the_whole(suite_file, whole, tmp_path):
    suite = load_suite(suite_file)
    first = run_suite(suite, tmp_path / "a", execution=Execution(workers=1, shard=(1, 2)))
    assert (first.missing, first.report) == (3, None)
    run_suite(suite, tmp_path / "b", execution=Execution(workers=1, shard=(2, 2)))
    done = run_suite(suite, tmp_path / "a", execution=Execution(workers=1, merge=(tmp_path / "b",)))
    assert done.missing == 0
    assert outcome_of(tmp_path / "a") == whole
    assert verify_folder(tmp_path / "a") == []
    assert {finding.problem for finding in verify_folder(tmp_path / "b")} == {"unfinished"}
    # The other folder's index is not taken over, its entries are.
    archive = Store(tmp_path / "a" / "archive")
    assert list((archive.index.known() or {}).values()) == list(archive.entries())


class _Killer(Silent):
    """Kills a worker of the cluster as soon as the first case is done."""

    def done(self, name: str, *, failed: str | None = None) -> None:
        import distributed

        if not getattr(self, "killed", None):
            pids = distributed.get_client().run(os.getpid)
            self.killed = next(iter(pids.values()))
            os.kill(self.killed, signal.SIGKILL)


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_makes_the_same(suite_file, whole, tmp_path):
    killer = _Killer()
    done = run_suite(load_suite(suite_file), tmp_path / "out", progress=killer, execution=Execution(dask="local:2"))
    assert killer.killed
    assert not done.failed
    assert outcome_of(tmp_path / "out") == whole


def test_dask_mistakes_are_one_line(horizonval, suite_file, monkeypatch):
    assert_one_line(horizonval("run", suite_file, "--out", "o1", "--dask", "local:x"), "--dask", "local:N")
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    assert_one_line(horizonval("run", suite_file, "--out", "o2", "--dask", "local:2"), "not installed", "cluster")
