"""What a campaign costs beside the rendering, as ratios measured in one run."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from horizonval.jobs.pool import available_cpus
from horizonval.suites.mistakes import refuse_mistakes
from horizonval.suites.plan import plan_of, units_of
from horizonval.suites.suite import load_suite
from horizonval.truth.frame_truth import truth_of

pytestmark = pytest.mark.benchmark

SUITE = """
[suite]
name = "long"
estimators = ["ideal"]
[defaults]
camera = {{ file = "vis-cmos-512-60deg", mount_roll_deg = 65.0 }}
[[cases]]
name = "leo"
[cases.orbit]
epoch_utc = 2026-03-20T00:00:00Z
altitude_km = 500.0
inclination_deg = 51.6
n = {n}
"""


def test_a_long_suite_starts_in_less_than_a_frames_truth_per_case(tmp_path: Path):
    (tmp_path / "long.toml").write_text(SUITE.format(n=1000))
    start = time.process_time()
    suite = load_suite(tmp_path / "long.toml")
    plan = plan_of(suite)
    refuse_mistakes(suite, plan)
    units = units_of(suite.cases, plan)
    per_case = (time.process_time() - start) / len(units)
    truths = []
    for case in suite.cases[:20]:
        start = time.process_time()
        truth_of(case.scene, case.camera)
        truths.append(time.process_time() - start)
    # A truth takes 5 ms and more; loading and checking a case a tenth of that.
    assert per_case < 0.5 * float(np.median(truths))


def _frames_per_second(folder: Path, n: int, workers: int, cpus: set[int]) -> float:
    """Of a run on given processors, start-up, table and report included."""
    folder.mkdir()
    (folder / "long.toml").write_text(SUITE.format(n=n) + "\n[cases.base.render]\nsubsamples = 1\nnodes = 64\n")
    start = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", PINNED, *(str(cpu) for cpu in sorted(cpus)), str(workers)], cwd=folder, check=True
    )
    return n / (time.perf_counter() - start)


PINNED = """
import os, sys
*cpus, workers = map(int, sys.argv[1:])
os.sched_setaffinity(0, cpus)
from horizonval.cli import main
sys.argv = ["horizonval", "run", "long.toml", "--out", "out", "--workers", str(workers)]
main()
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity") or available_cpus() < 2, reason="needs two processors to pin")
def test_workers_add_up(tmp_path: Path):
    cpus = set(sorted(os.sched_getaffinity(0))[: available_cpus()])
    alone = _frames_per_second(tmp_path / "one", 24, 1, {min(cpus)})
    together = _frames_per_second(tmp_path / "all", 24 * len(cpus), len(cpus), cpus)
    # Start, table and report are not shared out, and the processors share caches and memory.
    assert together > 0.8 * len(cpus) * alone, f"{together:.2f} frames/s on {len(cpus)}, {alone:.2f} on one"
