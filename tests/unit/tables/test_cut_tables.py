"""Tables that are cut down to a mission: size, stated error, and the same numbers in C."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from horizonval.api.estimate import mission_table
from horizonval.core.errors import UserError
from horizonval.estimation.fit.heights import everywhere
from horizonval.estimation.fit.templates import load_templates, shipped_templates
from horizonval.tables.mission import sun_angles, write_table
from horizonval.tables.onboard import LimbPlaces, cut_down

WHOLE = shipped_templates("thermal", (14.0, 16.3))


def places(lowest_m: float = -40e3) -> LimbPlaces:
    rng = np.random.default_rng(3)
    return LimbPlaces(np.radians(rng.uniform(-25.0, 55.0, 40)), rng.uniform(2.0, 5.0, 40), lowest_m)


@pytest.mark.parametrize("error", [0.002, 0.02])
def test_a_cut_table_keeps_the_error_that_was_asked_for(error):
    """Against the whole table, by numpy's own interpolation over heights."""
    assert WHOLE is not None
    # lengths that tell which modes are left
    whole = replace(WHOLE, correlation_rad=everywhere(1.0 + np.arange(len(WHOLE.mode_kinds)), len(WHOLE.axes[0])))
    met = places()
    cut = cut_down(whole, met, error)
    mean, modes, _ = whole.at(met.first, met.second)
    found, found_modes, _ = cut.table.at(met.first, met.second)
    kinds = (cut.table.correlation_rad[0, :, 0] - 1.0).astype(int)
    inside = whole.height_m >= -40e3
    worst = 0.0
    for k in range(len(mean)):
        top = mean[k].max()
        rows = zip([mean[k], *modes[k][kinds]], [found[k], *found_modes[k]], strict=True)
        for whole_row, row in rows:
            off = np.interp(whole.height_m, cut.table.height_m, row) - whole_row
            worst = max(worst, float(np.abs(off[inside]).max() / top))
    # the mean's thinning and a mode's rounding to a 127th of itself, at most a tenth of the mean here
    assert worst <= error + 5e-4
    assert worst == pytest.approx(cut.error, rel=0.05)


def test_a_larger_error_makes_a_smaller_table():
    assert WHOLE is not None
    fine, coarse = (cut_down(WHOLE, places(), error) for error in (0.001, 0.02))
    assert coarse.bytes < fine.bytes < 100e3
    assert len(coarse.table.height_m) < len(fine.table.height_m)
    # of the latitudes stay those around -25 to 55 deg, of the heights those from below -40 km
    assert np.degrees(fine.table.axes[0]).min() >= -31.0
    assert np.degrees(fine.table.axes[0]).max() <= 61.0
    assert -50e3 < fine.table.height_m[0] <= -40e3


def test_what_cannot_be_cut_is_refused():
    assert WHOLE is not None
    with pytest.raises(UserError, match="no limb"):
        cut_down(WHOLE, LimbPlaces(np.empty(0), np.empty(0), 0.0), 0.01)
    with pytest.raises(UserError, match="--error"):
        cut_down(WHOLE, places(), 0.0)
    with pytest.raises(UserError, match="--band"):
        mission_table("infrared-horizon-stability", None, 0.005)
    with pytest.raises(UserError, match="study"):
        mission_table("limb-camera", None, 0.005)


def test_sun_angles_are_those_of_the_local_frame():
    up, ahead = np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]])
    for zenith, azimuth in ((0.3, 0.0), (1.2, 2.0), (1.7, 3.1)):
        sun = np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])
        found = sun_angles(up, ahead, sun)
        np.testing.assert_allclose([found[0][0], found[1][0]], [zenith, azimuth], atol=1e-9)


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_the_header_holds_the_numbers_of_the_table(tmp_path):
    made = mission_table("limb-night-ir", None, 0.005)
    write_table(made, tmp_path / "table.h")
    write_table(made, tmp_path / "table.npz")
    source = r"""
#include <stdio.h>
#include "table.h"
int main(void) {
    for (int n = 0; n < LIMB_A * LIMB_B; ++n)
        for (int h = 0; h < LIMB_H; ++h) {
            printf("%.9g", limb_mean_scale[n] * limb_mean[n * LIMB_H + h]);
            for (int k = 0; k < LIMB_K; ++k)
                printf(" %.9g", limb_modes_scale[n * (LIMB_K + 1) + k]
                                    * limb_modes[(n * (LIMB_K + 1) + k) * LIMB_H + h]);
            printf("\n");
        }
    return 0;
}
"""
    (tmp_path / "print.c").write_text(source)
    subprocess.run(
        ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-unused-const-variable", "print.c", "-o", "print"],
        cwd=tmp_path,
        check=True,
    )
    printed = subprocess.run([tmp_path / "print"], capture_output=True, text=True, check=True).stdout
    numbers = np.array([[float(v) for v in line.split()] for line in printed.splitlines()])
    table = load_templates(tmp_path / "table.npz")
    a, b, k, h = table.modes.shape
    np.testing.assert_allclose(numbers[:, 0].reshape(a, b, h), table.mean, rtol=1e-6, atol=1e-9)
    wanted = table.modes * table.prior_sigmas
    np.testing.assert_allclose(np.moveaxis(numbers[:, 1:].reshape(a, b, h, k), 3, 2), wanted, rtol=1e-6, atol=1e-9)


def test_another_ending_is_refused(tmp_path):
    made = mission_table("limb-night-ir", None, 0.005)
    with pytest.raises(UserError, match="npz"):
        write_table(made, tmp_path / "table.txt")
    with pytest.raises(UserError):
        write_table(made, tmp_path / "none" / "table.h")
