"""Results of a night: a page in a single file, and JUnit XML for CI services.

For every scene and band the page shows the image of the seed with the worst outcome. A night stores roll and pitch of
claims but no limb points: the claimed limb is drawn as a circle about the claimed nadir.

In JUnit XML every method on a table, camera and band is a test case, every published figure, and completeness. FAIL is
a failure; INCONCLUSIVE is ``skipped`` with its reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from horizonval.core import junit
from horizonval.core.junit import TestCase
from horizonval.frame import FrameTruth
from horizonval.geometry import frames
from horizonval.report import page, plots, viewer
from horizonval.report.load import CaseView
from horizonval.report.plots import Draw
from horizonval.report.words import VERDICTS, verdict_of
from horizonval.scoring.bound import ARCSEC, Bound
from horizonval.scoring.expected import expected_outcome
from horizonval.scoring.row import Row
from horizonval.studies.regression import history
from horizonval.studies.regression.baseline import Baseline, FrozenImage
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.statistics import Verdict
from horizonval.studies.regression.units import arrays_of, frozen_image
from horizonval.studies.regression.words import (
    LANE_WORDS,
    by_subject,
    figure,
    gate_sentence,
    scenes,
    subject,
    subject_sentence,
)

GLYPHS = {"PASS": "●", "FAIL": "✖", "IMPROVED": "▲", "INCONCLUSIVE": "○", "INCOMPLETE": "◐"}
KINDS = {"PASS": "valid", "FAIL": "false", "IMPROVED": "valid", "INCONCLUSIVE": "missed", "INCOMPLETE": "missed"}
MOST_LISTED = 40
MOST_HEADLINES = 6
LOOKS = {
    "PASS": ("#0072b2", "o", "full"),
    "FAIL": ("#b34700", "X", "full"),
    "IMPROVED": ("#009e73", "^", "full"),
    "INCONCLUSIVE": ("#8a6100", "o", "none"),
    "INCOMPLETE": ("#8a6100", "s", "none"),
}
"""Colour and mark of each verdict; the marks distinguish them without colour."""
MOST_LABELS = 12
Key = tuple[str, str, int]
"""Scene, band, replicate."""


def write_page(
    path: Path,
    verdict: Mapping[str, Any],
    nights: Sequence[Mapping[str, Any]],
    shown: Mapping[str, Any] | None = None,
) -> None:
    """Write ``index.html``; ``shown`` are its images (:func:`of_night`, :func:`of_baseline`)."""
    shown = shown or {"frames": (), "kept": 0, "estimators": ()}
    text = page.render(
        "night.html",
        title=f"{verdict['suite']}, night {verdict['night']}: {verdict['verdict']}",
        heading="Accuracy regression",
        version=verdict["environment"]["version"],
        about=[f"suite {verdict['suite']}", f"night {verdict['night']}"],
        folder=Path(__file__).parent,
        filters={"figure": figure, "scenes": scenes, "sentence": gate_sentence, "capitalize_first": _capital},
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


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def headline(verdict: Mapping[str, Any]) -> str:
    """Return the night in one sentence: failures, else what is incomplete, else how many methods hold."""
    subjects = by_subject(verdict["gates"])
    of = {word: [first for first, one, _ in subjects if one == word] for word in Verdict}
    failed = [f"{subject(g)}{' since the last release' * (g['against'] == 'release')}" for g in of[Verdict.FAIL]]
    failed += [f"system {one['system']}, {one['name']}" for one in verdict["published"] if one["verdict"] == "FAIL"]
    if failed:
        names = list(dict.fromkeys(failed))
        more = len(names) - MOST_HEADLINES
        return "Regression: " + "; ".join(names[:MOST_HEADLINES]) + (f"; and {more} more." if more > 0 else ".")
    if verdict["problems"]:
        return "Incomplete: " + verdict["problems"][0] + "."
    better = [subject(first) for first in of[Verdict.IMPROVED]]
    if better:
        return "Better than the baseline: " + "; ".join(dict.fromkeys(better)) + ". Accept a new one to hold it."
    facts = [first for first, _, _ in subjects if first["lane"] != "fresh"]
    if not facts and of[Verdict.INCONCLUSIVE]:
        return "Too few scenes to decide: " + "; ".join(subject(first) for first in of[Verdict.INCONCLUSIVE]) + "."
    hold = f"Nothing is worse: {len(facts) or len(subjects)} methods and image sets are within their margins"
    count = len(verdict["published"])
    return f"{hold}, and {count} figures of the published systems are as accepted." if count else f"{hold}."


def _groups(verdict: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return every comparison with its lanes, each a list of subjects with their verdict and sentence."""
    groups = []
    for about in verdict["comparisons"]:
        subjects = by_subject(gate for gate in verdict["gates"] if gate["against"] == about["name"])
        own = {
            lane: [
                {"subject": subject(first), "verdict": str(one), "deciding": deciding, "gates": _gates(verdict, first)}
                for first, one, deciding in subjects
                if first["lane"] == lane
            ]
            for lane in LANE_WORDS
        }
        groups.append({"about": about, "lanes": {lane: found for lane, found in own.items() if found}})
    return groups


def _gates(verdict: Mapping[str, Any], first: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    keys = ("against", "lane", "estimator", "cases", "camera", "band")
    return [gate for gate in verdict["gates"] if all(gate[key] == first[key] for key in keys)]


def _systems(published: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return by system the number of figures, and the changed ones."""
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
        found.append(plots.figure(title, text, trend(name, one, verdicts), 5.6, 3.2))
    return found


def trend(name: str, one: Mapping[str, Any], verdicts: Mapping[str, str]) -> Draw:
    """One figure over the nights, with the levels between steps and the verdict of each night."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        x = np.arange(len(one["values"]))
        for verdict, (colour, mark, fill) in LOOKS.items():
            own = [i for i, night in enumerate(one["nights"]) if verdicts.get(night) == verdict]
            if own:
                values = [one["values"][i] for i in own]
                axes.plot(
                    own, values, mark, color=colour, fillstyle=fill, linestyle="none", label=verdict, markersize=5
                )
        parts = history.pieces(one["values"])
        for part in parts:
            axes.plot([part.start - 0.4, part.stop - 0.6], [part.level] * 2, color="#1b1f24", linewidth=1.6)
        for part in parts[1:]:
            axes.axvline(part.start - 0.5, color="#1b1f24", linewidth=0.8, linestyle=":")
            axes.annotate(
                one["nights"][part.start],
                (part.start - 0.5, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(3, -9),
                textcoords="offset points",
                fontsize=8,
            )
        _label_nights(axes, one["nights"])
        axes.set_xlim(-0.8, max(len(x), 8) - 0.2)
        if len(set(one["values"])) == 1:
            pad = max(abs(one["values"][0]) * 0.05, 0.5)
            axes.set_ylim(one["values"][0] - pad, one["values"][0] + pad)
        elif len(parts) > 1:
            # Room at the top for the date of a step, clear of the marks of the higher level.
            low, high = axes.get_ylim()
            axes.set_ylim(low, high + 0.12 * (high - low))
        axes.set_ylabel("" if one["unit"] == "1" else one["unit"])
        figure.legend(loc="outside upper right", ncols=4, fontsize=8)

    return draw


def _label_nights(axes: Axes, nights: Sequence[str]) -> None:
    step = max(1, -(-len(nights) // MOST_LABELS))
    places = list(range(0, len(nights), step))
    axes.set_xticks(places, [nights[i] for i in places], rotation=35, ha="right", fontsize=8)


def of_night(rows: Sequence[ReplicateRow], scenes: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, Any]:
    """Return :func:`shown_of` tonight's images; ``units``: by scene the file of its unit's arrays."""

    def load(key: Key) -> FrozenImage:
        scene, band, replicate = key
        about = scenes[scene]["bands"][band]
        dn = arrays_of(Path(units[scene]), scene)[f"dn.{band}.{replicate}"]
        return FrozenImage(scene, band, replicate, about["full_scale"], dn, about["radiance_per_dn"][replicate])

    return shown_of(rows, {scene: record["truth"] for scene, record in scenes.items()}, load)


def of_baseline(accepted: Baseline, rows: Sequence[ReplicateRow]) -> dict[str, Any]:
    """Return :func:`shown_of` the frozen images of a baseline."""
    images = {(image.scene, image.band, image.replicate): image for image in accepted.images.images}
    return shown_of([row for row in rows if row.case not in accepted.together], accepted.images.truths, images.get)


def shown_of(
    rows: Sequence[ReplicateRow],
    truths: Mapping[str, Mapping[str, Any]],
    load: Callable[[Key], FrozenImage | None],
) -> dict[str, Any]:
    """Return the frames of rows as :func:`horizonval.report.viewer.striking_frames` does.

    ``truths``: by scene, plain. ``load``: returns the image of a scene, band and replicate, or None.
    """
    estimators = tuple(dict.fromkeys(row.estimator for row in rows))
    known = {scene: FrameTruth.from_dict(dict(truths[scene])) for scene in {row.case for row in rows} & set(truths)}
    bounds = {(row.case, row.band): row.bound_arcsec for row in rows if row.case in known}
    expected = {
        (case, band): expected_outcome(
            known[case], band, bound=None if arcsec is None else Bound(None, arcsec * ARCSEC, None)
        )
        for (case, band), arcsec in bounds.items()
    }
    by_image: dict[Key, dict[str, Row]] = {}
    for row in (row for row in rows if row.case in known):
        about, camera = expected[row.case, row.band], known[row.case].camera_spec.camera.name or ""
        full = replace(row, camera=camera, expected=str(about.outcome), borderline=about.borderline)
        by_image.setdefault((row.case, row.band, row.replicate), {})[row.estimator] = full
    rank = {key: min(VERDICTS.index(verdict_of(row)) for row in own.values()) for key, own in by_image.items()}
    views = []
    for place in expected:
        # The worst replicate of a scene, the first of equal ones.
        key = min((key for key in by_image if key[:2] == place), key=lambda key: (rank[key], key[2]))
        if (image := load(key)) is not None:
            truth, own = known[key[0]], by_image[key]
            claims = {name: {"fit": _claim(truth, row)} for name, row in own.items()}
            name = f"{key[0]}, seed {key[2]}"
            views.append(CaseView(name, key[1], own, claims, frozen_image(truth, image), "", False, ""))
    return viewer.striking_frames(views, estimators)


def _claim(truth: FrameTruth, row: Row) -> dict[str, Any] | None:
    """Return the claimed nadir and the true angular radius, for the limb of a claim."""
    if row.roll_error_arcsec is None or row.pitch_error_arcsec is None:
        return None
    true = frames.rotate(frames.inverse(truth.q_cam_from_body), np.asarray(truth.nadir_geocentric_cam))
    roll, pitch = frames.roll_pitch_of_nadir(true)
    errors = (math.radians(error / 3600.0) for error in (row.roll_error_arcsec, row.pitch_error_arcsec))
    claimed = frames.nadir_of_roll_pitch(*(angle + error for angle, error in zip((roll, pitch), errors, strict=True)))
    nadir = frames.rotate(truth.q_cam_from_body, claimed)
    return {"nadir_cam": nadir, "angular_radius_rad": truth.angular_radius_rad}


def published_sentence(one: Mapping[str, Any]) -> str:
    """Return a key figure of a published system, tonight and accepted."""
    if one["accepted"] is None:
        return f"{figure(one['measured'], 6)} {one['unit']}; its page has no such figure"
    return f"{figure(one['measured'], 6)} {one['unit']}, accepted {figure(one['accepted'], 6)}"


def write_junit(path: Path, verdict: Mapping[str, Any]) -> None:
    """Write a night's verdicts as JUnit XML; what is incomplete is an error."""
    name = f"horizonval.regress.{verdict['suite']}"
    environment = verdict["environment"]
    properties = {
        "night": verdict["night"],
        "verdict": verdict["verdict"],
        "version": environment["version"],
        "commit": environment["commit"] or "",
    }
    cases = []
    for first, one, deciding in by_subject(verdict["gates"]):
        title = f"{first['lane']}: {subject(first)}"
        cases.append(_case(f"{name}.{first['against']}", title, one, subject_sentence(first, deciding)))
    for one in verdict["published"]:
        title = f"{one['system']}: {one['name']}"
        cases.append(_case(f"{name}.published", title, one["verdict"], published_sentence(one)))
    problems = "; ".join(verdict["problems"])
    outcome: Literal["pass", "error"] = "error" if problems else "pass"
    cases.append(TestCase(name, "complete", outcome, "incomplete" if problems else "complete", problems))
    junit.write(path, name, properties, cases)


def _case(group: str, name: str, verdict: str, text: str) -> TestCase:
    outcomes: dict[str, Literal["failure", "skipped"]] = {
        Verdict.FAIL: "failure", Verdict.INCONCLUSIVE: "skipped",
    }  # fmt: skip
    return TestCase(group, name, outcomes.get(verdict, "pass"), verdict, text)
