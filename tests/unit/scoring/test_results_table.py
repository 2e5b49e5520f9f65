"""The Parquet table: same rows in any order, same bytes; every value comes back."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import duckdb
import numpy as np
import pytest
from synthetic import THERMAL_CAMERA, estimator, fit_of, truth_at

from horizonval.core.errors import DamagedFileError, UserError
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.scoring.errors import score
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.table import COLUMNS, make_row, read_results, write_results
from horizonval.truth.infrared_horizon.curve import visible_height_m


@pytest.fixture
def rows():
    made = []
    for case in ("b", "a", "c"):
        truth = truth_at(name=case, roll_deg=66.0)
        for name in ("two", "one"):
            fit = fit_of(truth, error_rad=(1 / 3 * 1e-3, 0.0), altitude_m=5e5)
            made.append(
                make_row(
                    case=case,
                    camera="cam",
                    band="red",
                    estimator=name,
                    truth=truth,
                    expected=expected_outcome(truth),
                    score=score(truth, estimator(), fit),
                    frame_address="0" * 64,
                )
            )
    return made


def test_rows_have_every_column_in_order(rows):
    assert list(rows[0]) == list(COLUMNS)


def test_the_infrared_horizon_in_view(rows):
    """40 km in the north, 38 in the south: an image of the southern horizon has what lies there."""
    assert rows[0]["ir_horizon_km"] is None
    place = truth_at(THERMAL_CAMERA).r_itrs
    azimuth = np.arange(36) * 10.0
    height = 39e3 + 1e3 * np.cos(np.radians(azimuth))
    hard = horizon_by_azimuth(place, WGS84, np.radians(azimuth))
    stored = {
        "azimuth_deg": azimuth.tolist(),
        "geometric_angle_rad": hard.tolist(),
        "half_plateau_height_m": height.tolist(),
        "half_plateau_angle_rad": (hard + height / 2.57e6).tolist(),
    }
    found = []
    for yaw in (90.0, -90.0):
        truth = replace(truth_at(THERMAL_CAMERA, roll_deg=66.0, yaw_deg=yaw), infrared_horizon={"lwir": stored})
        row = make_row(
            case="c",
            camera="cam",
            band="lwir",
            estimator="e",
            truth=truth,
            expected=expected_outcome(truth),
            score=score(truth, estimator(), fit_of(truth)),
        )
        found.append(row["ir_horizon_km"])
    # The arc in view spans some 60 deg of azimuth: the mean of the cosine over it is 0.95.
    assert sorted(found) == pytest.approx([38.05, 39.95], abs=0.03)
    away = replace(truth_at(THERMAL_CAMERA, roll_deg=180.0), infrared_horizon={"lwir": stored})
    assert visible_height_m(away, "lwir") is None


def test_values_come_back_bit_by_bit_and_sorted(rows, tmp_path):
    back = read_results(write_results(rows, tmp_path / "results.parquet"))
    assert [(r["case"], r["estimator"]) for r in back] == [(c, e) for c in "abc" for e in ("one", "two")]
    assert back == sorted(rows, key=lambda r: (r["case"], r["estimator"]))
    assert back[0]["image_address"] is None
    assert back[0]["false_valid"] is False


def test_same_rows_same_bytes(rows, tmp_path):
    first = write_results(rows, tmp_path / "one.parquet").read_bytes()
    second = write_results(rows[::-1], tmp_path / "two.parquet").read_bytes()
    assert hashlib.sha256(first).digest() == hashlib.sha256(second).digest()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one.parquet", "two.parquet"]


def test_types_are_fixed_even_without_rows(tmp_path):
    path = write_results([], tmp_path / "empty.parquet")
    assert read_results(path) == []
    with duckdb.connect() as connection:
        types = connection.read_parquet(str(path)).types
    assert [str(t) for t in types] == list(COLUMNS.values())


def test_missing_entries_are_null(tmp_path):
    path = write_results([{"case": "a", "estimator": "e"}], tmp_path / "r.parquet")
    assert read_results(path)[0] == dict.fromkeys(COLUMNS) | {"case": "a", "estimator": "e"}


@pytest.mark.parametrize(
    "wrong",
    [
        {"nadir_error": 1.0},
        {"nadir_error_arcsec": float("nan")},
        {"nadir_error_arcsec": "1"},
        {"nadir_error_arcsec": True},
        {"n_points": 1.5},
        {"false_valid": 1},
        {"case": None},
    ],
)
def test_a_wrong_row_is_refused(wrong, tmp_path):
    with pytest.raises(ValueError, match="row 0"):
        write_results([{"case": "a", "estimator": "e"} | wrong], tmp_path / "r.parquet")
    assert list(tmp_path.iterdir()) == []


def test_unreadable_tables(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        read_results(tmp_path / "none.parquet")
    damaged = tmp_path / "damaged.parquet"
    damaged.write_bytes(b"PAR1 not quite")
    with pytest.raises(DamagedFileError, match=r"damaged\.parquet"):
        read_results(damaged)
    foreign = tmp_path / "foreign.parquet"
    with duckdb.connect() as connection:
        connection.sql("SELECT 1 AS x").write_parquet(str(foreign))
    with pytest.raises(UserError, match="columns differ"):
        read_results(foreign)
