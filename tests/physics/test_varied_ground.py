"""Light scattered over a ground that varies, against Monte Carlo over chequered grounds."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from varied_ground import DATA, frame_radiance

TABLE = DATA / "varied_ground_montecarlo_550nm.csv"


def rows(square_km: float, view: str, sza_deg: float | None = None) -> list[dict[str, str]]:
    with Path(TABLE).open(newline="") as file:
        table = list(csv.DictReader(file))
    wanted = [r for r in table if float(r["square_km"]) == square_km and r["view"] == view]
    return [r for r in wanted if sza_deg is None or float(r["sza_deg"]) == sza_deg]


def deviations(table: list[dict[str, str]], method: str = "table") -> list[float]:
    """Return by how much frames are off, less two standard errors of the Monte Carlo."""
    out = []
    for row in table:
        expected, se = float(row["total_per_sr"]), float(row["se_per_sr"])
        off = abs(frame_radiance(row, method) / expected - 1.0)
        out.append(max(off - 2.0 * se / expected, 0.0))
    return out


@pytest.mark.parametrize("sza_deg", [20.0, 60.0])
def test_limb_over_squares_of_100_km(sza_deg: float) -> None:
    """3 %."""
    assert max(deviations(rows(100.0, "limb", sza_deg))) < 0.03


def test_disc_over_squares_of_100_km() -> None:
    """3 %; the worst are dark squares beside a border."""
    assert max(deviations(rows(100.0, "disc"))) < 0.03


def test_halves_of_the_globe() -> None:
    """3 %, a hundred kilometres from the border and on either side; one mean albedo for all is 25 to 46 % off there."""
    assert max(deviations(rows(20_000.0, "disc", 60.0) + rows(20_000.0, "limb", 60.0))) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("view", ["disc", "limb"])
@pytest.mark.parametrize("square_km", [50.0, 300.0, 1000.0, 20_000.0])
def test_squares_of_every_size(square_km: float, view: str) -> None:
    """3 %."""
    assert max(deviations(rows(square_km, view))) < 0.03


def test_the_march_is_the_table() -> None:
    """1e-3, the limit of view tables by day."""
    for row in (rows(100.0, "disc")[0], rows(100.0, "limb")[0]):
        np.testing.assert_allclose(frame_radiance(row), frame_radiance(row, "march"), rtol=1e-3)
