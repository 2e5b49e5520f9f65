"""System D: the printed tables as typed in, and rendered rows against them and the exact horizon."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.systems.d.experiment import HARD, QUANTUM_DEG, READ, SOFT, SYSTEM, TABLES, aim, read


def test_all_54_readings_are_there_on_whole_steps_with_their_printed_moments() -> None:
    """Printed to four digits: moments of rounded readings. No four whole pixels give an odd sum of both axes' steps."""
    steps = {key: np.array(SYSTEM.entry["table_{}_{}".format(*key)].printed) / QUANTUM_DEG for key in READ}
    assert sum(map(len, steps.values())) == 54
    assert max(np.abs(one - np.rint(one)).max() for one in steps.values()) * QUANTUM_DEG < 1e-4
    assert all(not (np.rint(steps[n, "roll"] + steps[n, "pitch"]) % 2).any() for n in TABLES)
    for number, axis in READ:
        if (entry := SYSTEM.entry.get(f"errors_{number}_{axis}")) is not None:
            errors = steps[number, axis] * QUANTUM_DEG - [pose[f"{axis}_deg"] for pose in TABLES[number]]
            assert [errors.mean(), errors.std(ddof=1)] == pytest.approx(entry.printed, abs=1.5e-4)


def test_rows_of_both_limbs() -> None:
    """Hard: within two whole-pixel steps of the print, by area within 0.02 px of the exact horizon (12 bits, and the
    lens's fall-off across the window), and 0.005 deg of the truth. Infrared: as well with the heads at its plateau."""
    pose = TABLES["2"][1]
    hard = read({"planet": HARD, "pose": pose})
    whole, sub = hard["published"], hard["sub_pixel"]
    assert [whole["roll"], whole["pitch"]] == pytest.approx([-0.0354, -1.0253], abs=2.0 * QUANTUM_DEG + 1e-4)
    assert [sub["roll"], sub["pitch"]] == pytest.approx([0.0, -1.0], abs=0.005)
    assert sub["px"] == pytest.approx(hard["exact_px"], abs=0.02)
    found = aim({"planet": SOFT, "pose": {"altitude_km": 400.0}})
    # A limb 41 km above the sphere.
    assert found["aim_deg"] == pytest.approx(np.degrees(np.arcsin((6378.137 + 41.0) / 6778.137)), abs=0.1)
    soft = read({"planet": SOFT, "pose": pose, **found})["sub_pixel"]
    assert [soft["roll"], soft["pitch"]] == pytest.approx([0.0, -1.0], abs=0.005)
