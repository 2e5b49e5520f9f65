"""The Parquet table: same rows in any order, same bytes; every value comes back."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import replace

import duckdb
import numpy as np
import pytest
from synthetic import THERMAL_CAMERA, estimator, fit_of, result_row, truth_at

from horizonval.api.run import Run
from horizonval.core import sealed
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.scoring.errors import score
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.row import COLUMNS, Row, make_row, read_results, write_results
from horizonval.truth.infrared_horizon import visible_height_m


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


def test_the_columns_are_what_they_were():
    """Tables of earlier runs must stay readable: names, order and types are fixed."""
    text = "\n".join(f"{column.name} {column.sql_type}" for column in COLUMNS)
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == "84268075247e3fc9"


def test_a_row_is_its_plain_data(rows):
    data = rows[0].to_dict()
    assert list(data) == [column.name for column in COLUMNS]
    assert Row.from_dict(json.loads(json.dumps(data))) == rows[0]


def test_the_infrared_horizon_in_view(rows):
    """40 km in the north, 38 in the south: an image of the southern horizon has what lies there."""
    assert rows[0].ir_horizon_km is None
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
        found.append(row.ir_horizon_km)
    # The arc in view spans some 60 deg of azimuth: the mean of the cosine over it is 0.95.
    assert sorted(found) == pytest.approx([38.05, 39.95], abs=0.03)
    away = replace(truth_at(THERMAL_CAMERA, roll_deg=180.0), infrared_horizon={"lwir": stored})
    assert visible_height_m(away, "lwir") is None


def test_values_come_back_bit_by_bit_sorted_and_in_the_same_bytes(rows, tmp_path):
    back = read_results(write_results(rows, tmp_path / "results.parquet"))
    assert [(r.case, r.estimator) for r in back] == [(c, e) for c in "abc" for e in ("one", "two")]
    assert back == sorted(rows, key=lambda r: (r.case, r.estimator))
    assert back[0].image_address is None
    assert back[0].false_valid is False
    first = write_results(rows, tmp_path / "one.parquet").read_bytes()
    second = write_results(rows[::-1], tmp_path / "two.parquet").read_bytes()
    assert hashlib.sha256(first).digest() == hashlib.sha256(second).digest()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one.parquet", "results.parquet", "two.parquet"]


def test_types_are_fixed_even_without_rows(tmp_path):
    path = write_results([], tmp_path / "empty.parquet")
    assert read_results(path) == []
    with duckdb.connect() as connection:
        types = connection.read_parquet(str(path)).types
    assert [str(t) for t in types] == [column.sql_type for column in COLUMNS]


def test_missing_entries_are_null(tmp_path):
    path = write_results([result_row()], tmp_path / "r.parquet")
    with duckdb.connect() as connection:
        stored = connection.read_parquet(str(path)).fetchall()[0]
    given = {"case", "camera", "band", "estimator", "expected", "status", "n_points", "false_valid", "without_sigma"}
    assert {column.name for column, value in zip(COLUMNS, stored, strict=True) if value is not None} == given
    assert read_results(path) == [result_row()]


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
        {"status": None},
        {"n_points": None},
    ],
)
def test_a_wrong_row_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Row.from_dict(result_row().to_dict() | wrong)


def write_sealed(path, query, connection):
    connection.execute(f"COPY ({query}) TO '{path}' (FORMAT parquet, KV_METADATA {{'{sealed.KEY}': '{sealed.BLANK}'}})")
    path.write_bytes(sealed.fill_in(path.read_bytes()))


NAMES = ["g[1]", "a*", "q?", "it's", 'd"q', "[!a]*", "x=1", "~", "{a,b}", "new\nline", "back\\slash", "%20", "ü"]


@pytest.mark.skipif(os.name == "nt", reason="names that Windows does not have")
@pytest.mark.parametrize("name", NAMES)
def test_a_path_is_never_a_pattern(tmp_path, name):
    """Beside every folder lies one that the name would match if it were a pattern."""
    for folder, case in ((name, "right"), ("g1", "wrong"), ("ab", "wrong"), ("qq", "wrong")):
        (tmp_path / folder).mkdir()
        write_results([result_row(case=case)], tmp_path / folder / "results.parquet")
    path = tmp_path / name / "results.parquet"
    assert [row.case for row in read_results(path)] == ["right"]
    relation = Run(tmp_path / name, "suite").rows()
    assert relation.columns == [column.name for column in COLUMNS]
    assert [row[0] for row in relation.project('"case"').fetchall()] == ["right"]


@pytest.mark.skipif(os.name == "nt", reason="names that Windows does not have")
def test_a_path_that_duckdb_cannot_be_told_is_refused(tmp_path):
    (tmp_path / "a\\b*").mkdir()
    with pytest.raises(UserError, match="another name"):
        read_results(write_results([], tmp_path / "a\\b*" / "results.parquet"))


@pytest.mark.parametrize("step", [211, pytest.param(7, marks=pytest.mark.slow)])
def test_every_bit_of_a_table_counts(tmp_path, step):
    path = write_results([result_row()], tmp_path / "r.parquet")
    data = path.read_bytes()
    for position in range(0, len(data), step):
        other = bytearray(data)
        other[position] ^= 1 << (position % 8)
        path.write_bytes(other)
        with pytest.raises(DamagedFileError, match="make the run again"):
            read_results(path)
    path.write_bytes(data)
    assert read_results(path) == [result_row()]


def test_a_foreign_value_in_a_table_is_damage(tmp_path):
    path = write_results([result_row()], tmp_path / "r.parquet")
    with duckdb.connect() as connection:
        query = f"SELECT * REPLACE ('nan'::DOUBLE AS limb_snr) FROM read_parquet('{path}')"
        write_sealed(tmp_path / "other.parquet", query, connection)
    with pytest.raises(DamagedFileError, match="limb_snr"):
        read_results(tmp_path / "other.parquet")


def test_what_a_row_says_of_its_answer():
    claim, refusal = result_row(sigma_nadir_arcsec=3.0, sigma_systematic_arcsec=4.0), result_row(status="dark")
    assert (claim.is_claim, claim.is_right, claim.is_due, claim.is_failure) == (True, True, True, False)
    assert (refusal.is_claim, refusal.is_right, refusal.is_failure) == (False, False, True)
    assert claim.sigma_total_arcsec == 5.0
    assert refusal.sigma_total_arcsec is None
    assert not result_row(borderline=True).is_due
    assert not result_row(false_valid=True).is_right
    assert result_row(false_valid=True).is_failure
    assert result_row(expected="dark").is_failure
    assert not result_row(expected="dark", status="no_limb").is_failure


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
        with pytest.raises(DamagedFileError, match="has no seal"):
            read_results(foreign)
        write_sealed(foreign, "SELECT 1 AS x", connection)
    with pytest.raises(UserError, match="columns differ"):
        read_results(foreign)
