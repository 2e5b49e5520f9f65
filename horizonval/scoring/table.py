"""The table of results: one row per case and estimator, stored as Parquet.

The columns and their types are fixed here; a row is a plain dict in which a missing or ``None`` entry means "does not
apply". The same rows give the same bytes, in whatever order they come: rows are sorted, and nothing of the clock or
the machine is stored.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import duckdb

from horizonval.core import atomic
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.frame import FrameTruth
from horizonval.scoring.errors import Score
from horizonval.scoring.expected import Expected
from horizonval.truth.infrared_horizon.curve import visible_height_m

Row = dict[str, Any]

COLUMNS = {
    "case": "VARCHAR",
    "camera": "VARCHAR",
    "band": "VARCHAR",
    "estimator": "VARCHAR",
    "expected": "VARCHAR",
    "borderline": "BOOLEAN",
    "status": "VARCHAR",
    "reason": "VARCHAR",
    "nadir_error_arcsec": "DOUBLE",
    "roll_error_arcsec": "DOUBLE",
    "pitch_error_arcsec": "DOUBLE",
    "altitude_error_km": "DOUBLE",
    "altitude_error_geodetic_km": "DOUBLE",
    "angular_radius_error_arcsec": "DOUBLE",
    "sigma_nadir_arcsec": "DOUBLE",
    "nees_nadir": "DOUBLE",
    "sigma_systematic_arcsec": "DOUBLE",
    "nees_nadir_total": "DOUBLE",
    "nees_noise": "DOUBLE",
    "noise_draws": "INTEGER",
    "n_points": "INTEGER",
    "false_valid": "BOOLEAN",
    "epoch_utc": "VARCHAR",
    "altitude_km": "DOUBLE",
    "roll_deg": "DOUBLE",
    "pitch_deg": "DOUBLE",
    "yaw_deg": "DOUBLE",
    "sun_zenith_deg": "DOUBLE",
    "sun_visible_fraction": "DOUBLE",
    "sun_in_frame": "BOOLEAN",
    "sun_boresight_deg": "DOUBLE",
    "horizon_arc_px": "DOUBLE",
    "lit_fraction": "DOUBLE",
    "limb_snr": "DOUBLE",
    "veil_fraction": "DOUBLE",
    "determined_deg": "DOUBLE",
    "moon_in_frame": "BOOLEAN",
    "ir_horizon_km": "DOUBLE",
    "frame_address": "VARCHAR",
    "image_address": "VARCHAR",
}
"""Columns in order, with their SQL types.

``sun_boresight_deg``: from the optical axis to the Sun's centre, behind the Earth or not; of several heads the nearest.
``nees_noise``: of ``noise_draws`` fits of the frame under other draws of the noise, about their own mean
(:mod:`horizonval.scoring.repeats`); both empty where the suite asks for one draw, the first with fewer than two fits.
``ir_horizon_km``: mean height of the infrared horizon (half plateau, clear sky) in view; empty in solar bands.
"""

SORT_KEY = ("case", "estimator", "camera", "band")

_PYTHON_TYPES: dict[str, tuple[type, ...]] = {
    "VARCHAR": (str,),
    "DOUBLE": (float, int),
    "INTEGER": (int,),
    "BOOLEAN": (bool,),
}


def claimed_sigma_arcsec(row: Mapping[str, Any]) -> float | None:
    """Return the standard deviation that a row claims, noise and model error together; None without a claim."""
    noise = row["sigma_nadir_arcsec"]
    return None if noise is None else math.hypot(noise, row.get("sigma_systematic_arcsec") or 0.0)


def make_row(
    *,
    case: str,
    camera: str,
    band: str,
    estimator: str,
    truth: FrameTruth,
    expected: Expected,
    score: Score,
    nees_noise: float | None = None,
    noise_draws: int | None = None,
    frame_address: str | None = None,
    image_address: str | None = None,
) -> Row:
    """Return the row of one estimator on one image, with every column of :data:`COLUMNS`."""
    infrared = visible_height_m(truth, band)
    return {
        "case": case,
        "camera": camera,
        "band": band,
        "estimator": estimator,
        "expected": str(expected.outcome),
        "borderline": expected.borderline,
        "status": score.status,
        "reason": score.reason or None,
        "nadir_error_arcsec": score.nadir_error_arcsec,
        "roll_error_arcsec": score.roll_error_arcsec,
        "pitch_error_arcsec": score.pitch_error_arcsec,
        "altitude_error_km": score.altitude_error_km,
        "altitude_error_geodetic_km": score.altitude_error_geodetic_km,
        "angular_radius_error_arcsec": score.angular_radius_error_arcsec,
        "sigma_nadir_arcsec": score.sigma_nadir_arcsec,
        "nees_nadir": score.nees_nadir,
        "sigma_systematic_arcsec": score.sigma_systematic_arcsec,
        "nees_nadir_total": score.nees_nadir_total,
        "nees_noise": nees_noise,
        "noise_draws": noise_draws,
        "n_points": score.n_points,
        "false_valid": score.false_valid,
        "epoch_utc": truth.epoch_utc,
        "altitude_km": truth.altitude_m / 1e3,
        "roll_deg": math.degrees(truth.roll_rad),
        "pitch_deg": math.degrees(truth.pitch_rad),
        "yaw_deg": math.degrees(truth.yaw_rad),
        "sun_zenith_deg": expected.sun_zenith_deg,
        "sun_visible_fraction": truth.sun_visible_fraction,
        "sun_in_frame": expected.sun_in_frame,
        "sun_boresight_deg": math.degrees(math.acos(max(-1.0, min(1.0, truth.sun_cam[2])))),
        "horizon_arc_px": expected.horizon_arc_px,
        "lit_fraction": expected.lit_fraction,
        "limb_snr": expected.limb_snr,
        "veil_fraction": expected.veil_fraction,
        "determined_deg": expected.determined_deg,
        "moon_in_frame": expected.moon_in_frame,
        "ir_horizon_km": None if infrared is None else infrared / 1e3,
        "frame_address": frame_address,
        "image_address": image_address,
    }


def write_results(rows: Iterable[Mapping[str, Any]], path: Path) -> Path:
    """Write rows to a Parquet file; the file appears whole or not at all.

    Raises
    ------
    ValueError
        A row has a column that does not exist, or a value of the wrong type or not finite: a defect of the caller.
    """
    checked = [_checked(row, i) for i, row in enumerate(rows)]
    checked.sort(key=lambda row: tuple(row[key] or "" for key in SORT_KEY))
    columns = ", ".join(f'unnest(${i + 1}::{kind}[]) AS "{name}"' for i, (name, kind) in enumerate(COLUMNS.items()))
    # One thread keeps row order and row groups, hence the bytes, independent of the machine.
    with atomic.replacing(path) as temporary, duckdb.connect(config={"threads": 1}) as connection:
        values = [[row[name] for row in checked] for name in COLUMNS]
        connection.execute(f"CREATE TABLE results AS SELECT {columns}", values)
        connection.table("results").write_parquet(str(temporary), compression="zstd")
    return path


def read_results(path: Path) -> list[Row]:
    """Read rows back, in the stored order; every row has every column of :data:`COLUMNS`.

    Raises
    ------
    UserError
        There is no such file, or its columns are not ours.
    DamagedFileError
        The file is not readable as Parquet.
    """
    if not path.is_file():
        raise UserError("no such file", where=str(path), expected="results.parquet of a run")
    try:
        with duckdb.connect(config={"threads": 1}) as connection:
            relation = connection.read_parquet(str(path))
            names = relation.columns
            records = relation.fetchall()
    except duckdb.Error as error:
        first_line = str(error).splitlines()[0]
        raise DamagedFileError(f"cannot be read as Parquet ({first_line})", where=str(path)) from error
    if names != list(COLUMNS):
        different = sorted(set(names) ^ set(COLUMNS))
        raise UserError(
            f"columns differ: {different or 'order'}",
            where=str(path),
            expected="the columns of this version",
            fix="make the run again",
        )
    return [dict(zip(names, record, strict=True)) for record in records]


def _checked(row: Mapping[str, Any], index: int) -> Row:
    if unknown := sorted(set(row) - set(COLUMNS)):
        raise ValueError(f"row {index}: unknown columns {unknown}")
    for name in SORT_KEY[:2]:
        if row.get(name) is None:
            raise ValueError(f"row {index}: {name} is empty")
    for name, kind in COLUMNS.items():
        value = row.get(name)
        if value is None:
            continue
        right = isinstance(value, _PYTHON_TYPES[kind]) and (kind == "BOOLEAN" or not isinstance(value, bool))
        if not right or (kind == "DOUBLE" and not math.isfinite(value)):
            raise ValueError(f"row {index}: {name} = {value!r} is not a finite {kind}")
    return {name: row.get(name) for name in COLUMNS}
