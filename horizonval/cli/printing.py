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
    rows = [head]
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
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def print_shard(shard: str | None, missing: int) -> None:
    """Print that a shard is done, and what the whole still lacks."""
    print(f"shard {shard} is done, {missing} results of others are missing; run without --shard to conclude")


def _arcsec(value: float | None) -> str:
    return "-" if value is None else f'{value:.1f}"'
