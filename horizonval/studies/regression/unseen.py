"""Changes that the gates of a suite let through, as ``horizonval check`` prints them."""

from __future__ import annotations

from horizonval.spec.load import Suite
from horizonval.spec.suite import IMAGE_METRICS, STANDING, Lane, Metric, RegressionSpec
from horizonval.studies.regression.gates import PERCENT, SAME_SIGMA, margin_of
from horizonval.studies.regression.partners import Group
from horizonval.studies.regression.words import figure
from horizonval.suites.record import camera_name

ANGLES: dict[str, Metric] = {
    "mean of roll or pitch": "roll_mean",
    "scatter": "roll_scatter",
    "nadir error": "nadir_error",
    "its median": "nadir_error_median",
    "altitude's mean": "altitude_mean",
    "altitude error": "altitude_error",
}


def unseen(suite: Suite) -> dict[str, str]:
    """Return by table, camera and band the largest changes that pass; empty for a suite without ``[regression]``."""
    spec = suite.regression
    if spec is None:
        return {}
    groups: dict[Group, int] = {}
    for case in suite.cases:
        for band in case.camera.band:
            for name in suite.estimators if case.estimators is None else case.estimators:
                group = Group(name, case.table or "", camera_name(case), band.name)
                groups[group] = groups.get(group, 0) + spec.replicates
    lines: dict[str, dict[str, list[str]]] = {}
    for group, n in groups.items():
        subject = f"a night lets through in {group.cases} ({group.camera}, {group.band})"
        lines.setdefault(subject, {}).setdefault(_of_method(spec, group, n), []).append(group.estimator)
    found = {
        subject: "; ".join(
            text if len(texts) == 1 else f"{', '.join(dict.fromkeys(names))}: {text}" for text, names in texts.items()
        )
        for subject, texts in lines.items()
    }
    anywhere = Group("", "", "", "")
    found["a night lets through in images"] = ", ".join(
        f"{metric.replace('_', ' ')} {_margin(spec, 'rerender', metric, anywhere)}" for metric in IMAGE_METRICS
    )
    found["a night does not compare"] = "angular radius and limb points of answers; time and memory"
    for gate in spec.gate:
        standing, of_base = STANDING[gate.metric].margin, 0.0
        if gate.lane == "fresh" and (fresh := STANDING[gate.metric].fresh) is not None:
            standing, of_base = fresh
        if standing is not None and gate.margin > standing and not of_base:
            found[f"gate {gate.name} loosens {gate.metric}"] = (
                f"{figure(gate.margin)} {gate.unit} in place of {figure(standing)}: {gate.reason}"
            )
    return found


def _of_method(spec: RegressionSpec, group: Group, n: int) -> str:
    lost, false, sigmas = (
        int((margin_of(spec, "replay", metric, group, 0.0)[0] or 0.0) / PERCENT * n)
        for metric in ("availability", "false_valid", "claimed_sigma")
    )
    crashes = figure(margin_of(spec, "replay", "crashes", group, 0.0)[0])
    angles = ", ".join(f"{name} by {_margin(spec, 'replay', metric, group)}" for name, metric in ANGLES.items())
    return (
        f"of {n} images {lost} lost answers, {false} new false claims, {crashes} new crashes, {sigmas} claimed sigmas "
        f"that change by more than a factor of {SAME_SIGMA}; {angles}, squared error over claim "
        f"by a {_margin(spec, 'replay', 'honesty', group)}"
    )


def _margin(spec: RegressionSpec, lane: Lane, metric: Metric, group: Group) -> str:
    margin, reason = margin_of(spec, lane, metric, group, 0.0)
    standing = STANDING[metric]
    text = f"{figure(margin)} {standing.unit}" if standing.unit != "factor" else f"factor of {figure(margin)}"
    return f"{text} or {PERCENT * standing.of_base:.0f} %" if reason is None and standing.of_base else text
