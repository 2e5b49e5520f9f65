"""Suites that expand: names, numbers, and mistakes."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.core.errors import UserError
from horizonval.suites.record import figure_plans
from horizonval.suites.suite import load_suite

HEAD = """
[suite]
name = "s"
seed = 7
estimators = ["ideal"]
[defaults]
camera.file = "c.toml"
platform.altitude_km = 500.0
"""
CAMERA = (
    '[camera]\nwidth = 64\nheight = 48\nfov_deg = 60.0\n[[band]]\nname="v"\nkind="solar"\nlo_um=0.5\nhi_um=0.7\n'
    '[detector]\nkind = "cmos"\npixel_pitch_um = 5.5\nexposure_s = 2.2e-4\nquantum_efficiency = 0.6\n'
    "full_well_e = 13500.0\nread_noise_e = 13.0\nbits = 10\nblack_level_dn = 32.0\n"
)
ORBIT = '[[cases]]\nname = "o"\n[cases.orbit]\nepoch_utc = 2026-03-20T00:00:00Z\nn = 8\n'
TLE = (
    "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927",
    "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537",
)


@pytest.fixture
def load(tmp_path):
    def build(text: str):
        (tmp_path / "c.toml").write_text(CAMERA)
        (tmp_path / "s.toml").write_text(HEAD + text)
        return load_suite(tmp_path / "s.toml")

    return build


def test_a_grid_takes_every_value_with_every_other(load):
    suite = load(
        '[[cases]]\nname = "g"\n[cases.grid]\nattitude.yaw_deg = { from = -10.0, to = 10.0, step = 10.0 }\n'
        '"camera.detector.exposure_s" = [1e-4, 1e-3]\ncamera.band.v.nodes = [2]\n'
    )
    assert [c.name for c in suite.cases][:2] == [
        "g_yaw_deg_-10_exposure_s_0.0001_nodes_2",
        "g_yaw_deg_-10_exposure_s_0.001_nodes_2",
    ]
    assert [(c.scene.attitude.yaw_deg, c.camera.detector.exposure_s) for c in suite.cases] == [
        (yaw, t) for yaw in (-10.0, 0.0, 10.0) for t in (1e-4, 1e-3)
    ]
    assert {c.camera.band[0].nodes for c in suite.cases} == {2}


def test_steps_and_counts_give_round_numbers(load):
    suite = load(
        '[[cases]]\nname = "g"\n[cases.grid]\n'
        'platform.altitude_km = { from = 400.0, to = 1600.0, n = 3, scale = "log" }\n'
        "attitude.roll_deg = { from = 0.0, to = 0.3, step = 0.1 }\n"
    )
    assert sorted({c.scene.platform.altitude_km for c in suite.cases}) == [400.0, 800.0, 1600.0]
    assert sorted({c.scene.attitude.roll_deg for c in suite.cases}) == [0.0, 0.1, 0.2, 0.3]


def test_a_list_and_a_grid_multiply(load):
    suite = load(
        '[[cases]]\nname = "l"\n'
        'list = [{ scene.name = "low", platform.altitude_km = 300.0 }, { attitude.pitch_deg = 2.0 }]\n'
        "grid = { attitude.yaw_deg = [0.0, 90.0] }\n"
    )
    assert [c.name for c in suite.cases] == [
        "l_low_yaw_deg_0",
        "l_low_yaw_deg_90",
        "l_002_yaw_deg_0",
        "l_002_yaw_deg_90",
    ]
    assert [c.scene.platform.altitude_km for c in suite.cases] == [300.0, 300.0, 500.0, 500.0]


def test_sobol_points_fill_their_ranges_and_repeat(load):
    text = (
        '[[cases]]\nname = "q"\n[cases.sobol]\nn = 64\n[cases.sobol.ranges]\n'
        'platform.latitude_deg = { from = -90.0, to = 90.0, scale = "sine" }\nplatform.longitude_deg = [-180, 180]\n'
        "platform.epoch_utc = [2026-01-01T00:00:00Z, 2027-01-01T00:00:00Z]\n"
    )
    first, again = load(text), load(text)
    assert first.cases == again.cases
    other = load(text.replace("n = 64", "n = 64\nseed = 1"))
    assert first.cases[0].scene.platform != other.cases[0].scene.platform
    sines = np.sin(np.radians([c.scene.platform.latitude_deg for c in first.cases]))
    # 64 points of a Sobol sequence: one in each 64th of every range.
    assert sorted(np.floor((sines + 1) * 32).astype(int)) == list(range(64))
    assert len({c.scene.platform.epoch_utc.month for c in first.cases}) == 12


def test_an_orbit_becomes_places_epochs_and_attitudes(load):
    suite = load(
        ORBIT + "altitude_km = 500.0\nsun_synchronous = true\nltan_h = 10.5\nattitude.offset_deg = [0, 10.0, 0]\n"
    )
    places = [c.scene.platform for c in suite.cases]
    assert [c.name for c in suite.cases] == [f"o_{i:03d}" for i in range(8)]
    # The node is passed at 10.5 h local time: at 0 h UTC over 157.5 deg east.
    assert (places[0].latitude_deg, places[0].longitude_deg) == pytest.approx((0.0, 157.5), abs=1e-6)
    assert places[0].heading_deg == pytest.approx(-7.402, abs=0.001)
    # After a quarter of a revolution the satellite is where it turns: 180 - i.
    assert places[2].latitude_deg == pytest.approx(180 - 97.402, abs=0.2)
    assert all(500 <= p.altitude_km < 522 for p in places)
    assert (places[4].epoch_utc - places[0].epoch_utc).total_seconds() == pytest.approx(5677 / 2, abs=10)
    assert {c.scene.attitude.pitch_deg for c in suite.cases} == {10.0}


def test_two_lines_fly_with_sgp4(load):
    suite = load(f'[[cases]]\nname = "iss"\n[cases.orbit]\nn = 16\ntle = ["{TLE[0]}", "{TLE[1]}"]\n')
    places = [c.scene.platform for c in suite.cases]
    assert places[0].epoch_utc.strftime("%Y-%m-%d %H:%M") == "2008-09-20 12:25"
    assert all(325 < p.altitude_km < 375 for p in places)
    # 16 samples of a revolution pass within 11 deg of its highest point.
    assert 50.6 < max(p.latitude_deg for p in places) < 51.9


def test_a_pointing_error_is_common_to_all_points_of_a_grid(load):
    suite = load(
        ORBIT + "altitude_km = 500.0\ninclination_deg = 51.6\nattitude.error = { rms_deg = [1.0, 1.0, 1.0] }\n"
        "[cases.grid]\ncamera.detector.exposure_s = [1e-4, 1e-3]\n"
    )
    attitudes = [c.scene.attitude for c in suite.cases]
    assert attitudes[:8] == attitudes[8:]
    assert len({a.roll_deg for a in attitudes}) == 8


SHARES = (
    '[[cases]]\nname = "a"\nsobol = { share = 0.75, ranges = { attitude.yaw_deg = [-5.0, 5.0] } }\n'
    '[[cases]]\nname = "b"\nlist = [{ }, { attitude.roll_deg = 1.0 }]\n'
    "sobol = { share = 0.25, ranges = { attitude.yaw_deg = [-5.0, 5.0] } }\n"
)


def test_one_number_sets_the_size_of_a_suite(tmp_path):
    (tmp_path / "c.toml").write_text(CAMERA)
    (tmp_path / "s.toml").write_text(HEAD.replace("seed = 7", "seed = 7\nframes = 40") + SHARES)
    few, many = load_suite(tmp_path / "s.toml"), load_suite(tmp_path / "s.toml", frames=400)
    for suite, n in ((few, 40), (many, 400)):
        assert len(suite.cases) == suite.frames == n
        assert sum(case.name.startswith("a_") for case in suite.cases) == 3 * n // 4
    yaws = [
        [case.scene.attitude.yaw_deg for case in suite.cases if case.name.startswith("a_")] for suite in (few, many)
    ]
    # Fewer points are the first of more: a short run looks at what a long one looks at first.
    assert yaws[1][:30] == yaws[0]


def test_a_size_is_for_suites_that_share_it(tmp_path):
    (tmp_path / "c.toml").write_text(CAMERA)
    (tmp_path / "s.toml").write_text(HEAD + ORBIT + "altitude_km = 500.0\nsun_synchronous = true\n")
    with pytest.raises(UserError, match="--frames"):
        load_suite(tmp_path / "s.toml", frames=4)


def test_a_table_names_the_methods_that_run_on_it(tmp_path):
    (tmp_path / "c.toml").write_text(CAMERA)
    table = '[[cases]]\nname = "{}"\ngrid = {{ attitude.yaw_deg = [5.0] }}\n'
    text = table.format("all") + table.format("one") + 'estimators = ["altitude-free"]\n'
    text += table.format("both") + 'estimators = ["altitude-free", "ideal"]\n'
    text += '[[frame]]\nscene.name = "f"\nestimators = ["altitude-free"]\n'
    (tmp_path / "s.toml").write_text(HEAD.replace('["ideal"]', '["ideal", "altitude-free"]') + text)
    cases = load_suite(tmp_path / "s.toml").cases
    # In the suite's order, so that the order in a table changes nothing.
    assert [(case.name, case.estimators) for case in cases] == [
        ("f", ("altitude-free",)),
        ("all_yaw_deg_5", None),
        ("one_yaw_deg_5", ("altitude-free",)),
        ("both_yaw_deg_5", ("ideal", "altitude-free")),
    ]


def test_what_a_name_is_made_of_is_kept_beside_it(load):
    suite = load(
        '[[frame]]\nscene.name = "alone"\n'
        '[[cases]]\nname = "t"\nlist = [{ scene.name = "low" }, {}]\n[cases.grid]\nattitude.yaw_deg = [0, 5]\n'
        + ORBIT.replace("[cases.orbit]", "list = [{ scene.name = 'a_b' }]\n[cases.orbit]").replace("n = 8", "n = 2")
        + "altitude_km = 500.0\ninclination_deg = 50.0\nraan_deg = 0.0\n"
    )
    assert [(c.name, c.table, c.variant, c.sample) for c in suite.cases] == [
        ("alone", None, "", ""),
        ("t_low_yaw_deg_0", "t", "low_yaw_deg_0", ""),
        ("t_low_yaw_deg_5", "t", "low_yaw_deg_5", ""),
        ("t_002_yaw_deg_0", "t", "002_yaw_deg_0", ""),
        ("t_002_yaw_deg_5", "t", "002_yaw_deg_5", ""),
        ("o_a_b_000", "o", "a_b", "000"),
        ("o_a_b_001", "o", "a_b", "001"),
    ]


def test_a_figure_of_a_table_leaves_out_the_tables_whose_names_begin_alike(load):
    tables = "".join(f'[[cases]]\nname = "{name}"\ngrid.attitude.yaw_deg = [0]\n' for name in ("sun", "sun_far"))
    suite = load('[[figure]]\nkind = "sweep"\ncases = "sun"\nx = "platform.altitude_km"\n' + tables)
    assert list(figure_plans(suite)[0]["cases"]) == ["sun_yaw_deg_0"]
