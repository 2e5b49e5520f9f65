"""Positions of a satellite from the angles of ground stations."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Annotated

import typer

from horizonval.cli.options import Json
from horizonval.cli.output import check_target, print_json, written


def locate(
    angles: Annotated[
        Path,
        typer.Argument(
            help="CSV: time_utc, station, longitude_deg, latitude_deg, height_m, azimuth_deg, elevation_deg."
        ),
    ],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="CSV of positions; printed without it.")] = None,
    smooth: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Gaussian mean of the directions: standard deviation.")
    ] = None,
    forgetting: Annotated[
        float | None, typer.Option(metavar="FACTOR", help="Adaptive Kalman filter: forgetting factor, such as 0.3.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Locate a satellite by the directions in which two or more ground stations see it.

    One row for each instant and station. Azimuth counts from north through east; angles are without refraction.
    """
    from horizonval.api.locate import locate as located
    from horizonval.api.locate import read_angles

    if out is not None:
        check_target(out, angles)
    degrees, stations, times = read_angles(angles)
    rows = list(located(degrees, stations, times, smooth_s=smooth, forgetting=forgetting).rows())
    if as_json:
        print_json(rows)
    if out is not None:
        with written(out) as path, path.open("w", newline="", encoding="utf-8") as file:
            _write(file, rows)
    elif not as_json:
        _write(sys.stdout, rows)


def _write(file: IO[str], rows: Sequence[dict[str, str | float]]) -> None:
    writer = csv.DictWriter(file, [*rows[0]], lineterminator="\n")
    writer.writeheader()
    writer.writerows({key: x if isinstance(x, str) else f"{x:.6f}" for key, x in row.items()} for row in rows)
