"""The page of a night: one file that opens anywhere and asks for nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from horizonval.report import page, plots
from horizonval.studies.regression import trend_plots
from horizonval.studies.regression.baseline import history
from horizonval.studies.regression.formatting import figure, scenes

GLYPHS = {"PASS": "●", "FAIL": "✖", "IMPROVED": "▲", "INCONCLUSIVE": "○"}
KINDS = {"PASS": "valid", "FAIL": "false", "IMPROVED": "valid", "INCONCLUSIVE": "missed"}
MOST_LISTED = 40


def write_page(
    path: Path,
    verdict: Mapping[str, Any],
    nights: Sequence[Mapping[str, Any]],
    shown: Mapping[str, Any] | None = None,
) -> None:
    """Write ``index.html``, whole or not at all.

    ``shown``: sentences and images that it opens with (:mod:`horizonval.studies.regression.frames`).
    """
    shown = shown or {"sentences": (), "frames": (), "kept": 0, "estimators": ()}
    text = page.render(
        "night.html",
        title=f"{verdict['suite']}, night {verdict['night']}: {verdict['verdict']}",
        heading="Accuracy regression",
        version=verdict["environment"]["version"],
        about=[f"suite {verdict['suite']}", f"night {verdict['night']}"],
        folder=Path(__file__).parent,
        filters={"figure": figure, "scenes": scenes, "short": _short},
        v=verdict,
        glyphs=GLYPHS,
        kinds=KINDS,
        headline=headline(verdict),
        groups=_groups(verdict),
        systems=_systems(verdict["published"]),
        trends=_trends(nights),
        nights=nights,
        most=MOST_LISTED,
        **shown,
    )
    page.write(path, text)


def headline(verdict: Mapping[str, Any]) -> str:
    """Return the night in one sentence: what failed, else what is open, else how many gates hold."""
    failed = [f"{g['name']} (against the {g['against']} baseline)" for g in verdict["gates"] if g["verdict"] == "FAIL"]
    failed += [f"anchor {a['name']}" for a in verdict["anchors"] if a["verdict"] == "FAIL"]
    failed += [f"system {one['system']}, {one['name']}" for one in verdict["published"] if one["verdict"] == "FAIL"]
    if failed:
        return "Regression: " + ", ".join(failed) + "."
    if verdict["problems"]:
        return "Incomplete: " + verdict["problems"][0] + "."
    open_gates = [g["name"] for g in verdict["gates"] if g["verdict"] == "INCONCLUSIVE"]
    if open_gates:
        return "Not enough was seen to decide: " + ", ".join(open_gates) + "."
    better = [g["name"] for g in verdict["gates"] if g["verdict"] == "IMPROVED"]
    if better:
        return "Better than the baseline: " + ", ".join(better) + ". Accept a new one to hold what was won."
    hold = f"All {len(verdict['gates'])} comparisons and {len(verdict['anchors'])} physics anchors hold"
    count = len(verdict["published"])
    return f"{hold}, and {count} figures of the published systems are as accepted." if count else f"{hold}."


def _short(unit: str) -> str:
    return "pp" if unit == "percentage points" else unit


def _groups(verdict: Mapping[str, Any]) -> list[dict[str, Any]]:
    groups = []
    for about in verdict["comparisons"]:
        gates = [g for g in verdict["gates"] if g["against"] == about["name"]]
        picture = (
            plots.figure(
                f"Changes over their margins, against the {about['name']} baseline",
                "Estimate and 95 % bounds. The shaded strip passes; FAIL also needs certainty at 1 %, adjusted over "
                "all gates (Holm); pp are percentage points.",
                trend_plots.gates_in_margins(gates),
                8.6,
                1.5 + 0.34 * len(gates),
                wide=True,
            )
            if gates
            else None
        )
        groups.append({"about": about, "gates": gates, "picture": picture})
    return groups


def _systems(published: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return by system how many figures there are, and those that changed."""
    letters = sorted({one["system"] for one in published})
    own = {letter: [one for one in published if one["system"] == letter] for letter in letters}
    return [
        {"system": letter, "n": len(all_of), "changed": [one for one in all_of if one["verdict"] != "PASS"]}
        for letter, all_of in own.items()
    ]


def _trends(nights: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    verdicts = {line["night"]: line["verdict"] for line in nights}
    found = []
    for name, one in history.series(nights).items():
        unit = "" if one["unit"] == "1" else one["unit"]
        last = f"{figure(one['values'][-1])} {unit}".rstrip()
        text = f"Last night {last}, n = {one['n'][-1]}. Lines: levels between steps. Marks: the night's verdict."
        title = f"{name} [{unit}]" if unit else name
        found.append(plots.figure(title, text, trend_plots.trend(name, one, verdicts), 5.6, 3.2))
    return found
