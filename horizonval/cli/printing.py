"""What several commands print."""

from __future__ import annotations

import json
from typing import Any


def print_json(data: object) -> None:
    """Print one JSON object."""
    print(json.dumps(data, indent=1, allow_nan=False))


def print_summary(summary: dict[str, Any]) -> None:
    """Print the table of a run: one line for every estimator and camera."""
    head = ("estimator", "camera", "frames", "available", "nadir rms", "median", "p95", "false valid")
    several_draws = any(g["nees_noise"]["n"] for g in summary["groups"])
    rows = [(*head, "noise NEES / 2") if several_draws else head]
    for g in summary["groups"]:
        error, available, false = g["nadir_error_arcsec"], g["availability"], g["false_valid"]
        rows.append(
            (
                g["estimator"],
                g["camera"],
                str(g["n"]),
                f"{available['n']}/{available['of']}",
                *(_arcsec(error[key]) for key in ("rms", "median", "p95")),
                f"{false['n']}/{false['of']}",
                *([_noise_nees(g["nees_noise"])] if several_draws else []),
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def print_shard(shard: str | None, missing: int) -> None:
    """Print that a shard is done, and what the whole still lacks."""
    print(f"shard {shard} is done, {missing} results of others are missing; run without --shard to conclude")


def _arcsec(value: float | None) -> str:
    return "-" if value is None else f'{value:.1f}"'


def _noise_nees(nees: dict[str, Any]) -> str:
    """Return the mean per degree of freedom with its standard error, 1 if the claimed noise is honest."""
    if not nees["n"]:
        return "-"
    error = nees["standard_error"]
    spread = "" if error is None else f" +- {error / nees['expected']:.2f}"
    return f"{nees['mean'] / nees['expected']:.2f}{spread} ({nees['n']} frames)"
