"""What several commands print."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any


def print_json(data: object) -> None:
    """Print one JSON object."""
    print(json.dumps(data, indent=1, allow_nan=False))


def print_dry_run(dry_run: Any, as_json: bool) -> None:
    """Print what a command would make."""
    if as_json:
        print_json(dry_run.to_dict())
    else:
        print(dry_run)


def print_summary(summary: dict[str, Any]) -> None:
    """Print the table of a run, one line for every estimator and camera, and what that says in words.

    Estimators that are told the true pose stand last: they test the scoring, and are counted in no other line.
    """
    from horizonval.report.words import headline, unit_of

    groups = sorted(summary["groups"], key=lambda group: bool(group["given_pose"]))
    judged = [group for group in groups if not group["given_pose"]]
    unit = unit_of(group["nadir_error_arcsec"]["max"] for group in judged)
    unit = replace(unit, sign=f" {unit.name}")
    head = (
        "estimator",
        "camera",
        "frames",
        "answered",
        f"rms [{unit.name}]",
        "median",
        "95 %",
        "worst",
        "false claims",
    )
    several_draws = any(group["nees_noise"]["n"] for group in groups)
    rows = [(*head, "noise NEES / 2") if several_draws else head]
    for group in groups:
        error, available, false = group["nadir_error_arcsec"], group["availability"], group["false_valid"]
        rows.append(
            (
                group["estimator"] + (" (told the pose)" if group["given_pose"] else ""),
                group["camera"],
                str(group["n"]),
                f"{available['n']} of {available['of']} due",
                *("-" if error[key] is None else unit.number(error[key]) for key in ("rms", "median", "p95", "max")),
                f"{false['n']} of {false['of']}",
                *([_noise_nees(group["nees_noise"])] if several_draws else []),
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    for group in judged:
        print(f"{group['estimator']}, {group['camera']}: {headline(group, unit)}")


def print_shard(shard: str | None, missing: int) -> None:
    """Print that a shard is done, and what the whole still lacks."""
    print(f"shard {shard} is done, {missing} results of others are missing; run without --shard to conclude")


def _noise_nees(nees: dict[str, Any]) -> str:
    """Return the mean per degree of freedom with its standard error, 1 if the claimed noise is honest."""
    if not nees["n"]:
        return "-"
    error = nees["standard_error"]
    spread = "" if error is None else f" +- {error / nees['expected']:.2f}"
    return f"{nees['mean'] / nees['expected']:.2f}{spread} ({nees['n']} frames)"
