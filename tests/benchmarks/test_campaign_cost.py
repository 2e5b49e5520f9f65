"""What a campaign costs beside the rendering, as ratios measured in one run."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from horizonval.campaign.check import check_suite
from horizonval.campaign.plan import plan_of, units_of
from horizonval.campaign.suite import load_suite
from horizonval.truth import truth_of

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
    check_suite(suite, plan)
    units = units_of(suite.cases, plan)
    per_case = (time.process_time() - start) / len(units)
    truths = []
    for case in suite.cases[:20]:
        start = time.process_time()
        truth_of(case.scene, case.camera)
        truths.append(time.process_time() - start)
    # A truth takes 5 ms and more; loading and checking a case a tenth of that.
    assert per_case < 0.5 * float(np.median(truths))
