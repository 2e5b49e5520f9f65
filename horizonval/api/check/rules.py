"""From what a camera will see to what its user ought to know: one rule for every problem a frame can have.

A rule looks at one band of one frame. What it finds there becomes a finding about that frame, or, counted over the
frames of a camera or a design, one finding about all of them.

In a single scene every problem is a warning. Among many frames some are meant to be hopeless, and a third of an orbit
lies in the Earth's shadow: there the share of frames decides between a warning and a note
(:data:`WARNING_SHARE`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from horizonval.api.check.findings import Finding, Level, gravity, percent
from horizonval.api.check.limb import LimbView
from horizonval.core.outcome import Outcome
from horizonval.scoring import limits

TARGET_LEVEL = 0.7
"""Level that a proposed exposure puts the brightest limb at: the prediction is good to 30 %."""
HIGH_LEVEL = limits.STRICT.filling
DIM_LEVEL = 0.05
"""Below it nineteen twentieths of the converter are unused."""
NEAR_DEG = 10.0
"""Angle outside the image at which lenses and baffles are not yet free of the Sun: the wings of a lens scatter it,
and few baffles of small cameras reject it that near."""

LARGEST_SPACING_M = 7.5e3
"""Between rays at a thermal limb, a scale height of the air. Errors of fits of the limb whose pixels have them 8 to 22
km apart were up to twice as large as with 2.5 to 7.5 km. Chosen after seeing those."""
MOST_SUBSAMPLES = 16

MOSTLY, SOME = 0.5, 0.2
"""Share of frames from which a problem of many frames is a warning: of what the Sun's place does, and of what the
design does, which can be mended."""


@dataclass(frozen=True)
class Problem:
    """What a rule found in a frame: value and limit in ``unit``."""

    value: float | None
    limit: float | None
    unit: str


@dataclass(frozen=True)
class Rule:
    """One problem that a frame can have.

    Attributes
    ----------
    code : str
    share : float or None
        Share of frames from which it is a warning; None for a note, whatever the share.
    find : callable
        The problem of a frame, or None.
    text, fix : callable
        Of the frames that have it, the worst first: what to say and what to change.
    """

    code: str
    share: float | None
    find: Callable[[LimbView], Problem | None]
    text: Callable[[Sequence[LimbView]], str]
    fix: Callable[[Sequence[LimbView]], str]


def findings_of(
    views: Sequence[LimbView], subject: str, *, total: int | None = None, single: bool = False
) -> list[Finding]:
    """Return the findings of frames that have a camera or a design in common.

    Parameters
    ----------
    views : sequence of LimbView
        One band of every frame.
    subject : str
        What they have in common.
    total : int, optional
        How many frames there are, where not all of them were looked at.
    single : bool
        Whether they are a scene of its own: its problems are warnings.
    """
    findings = []
    for rule in RULES:
        troubled = [(problem, view) for view in views if (problem := rule.find(view)) is not None]
        if not troubled:
            continue
        troubled.sort(key=lambda pair: gravity(pair[0].value, pair[0].limit), reverse=True)
        worst, members = troubled[0][0], [view for _, view in troubled]
        share = len(members) / len(views)
        grave = rule.share is not None and (single or share >= rule.share)
        findings.append(
            Finding(
                Level.WARNING if grave else Level.NOTE,
                rule.code,
                rule.text(members),
                worst.value,
                worst.limit,
                worst.unit,
                rule.fix(members),
                subject,
                len(members),
                len(views),
                len(views) if total is None else total,
            )
        )
    return findings


def _saturated(view: LimbView) -> Problem | None:
    clipped = view.outcome is Outcome.SATURATED or view.saturated_share >= 1.0
    return Problem(view.highest, 1.0, "full scale") if clipped and view.highest is not None else None


def _partly_saturated(view: LimbView) -> Problem | None:
    if view.highest is None or _saturated(view) is not None or view.highest <= 1.0:
        return None
    return Problem(view.highest, 1.0, "full scale")


def _nearly_saturated(view: LimbView) -> Problem | None:
    if view.highest is None or not HIGH_LEVEL < view.highest <= 1.0:
        return None
    return Problem(view.highest, HIGH_LEVEL, "full scale")


def _eclipse(view: LimbView) -> Problem | None:
    if view.kind != "solar" or view.outcome is not Outcome.DARK or view.sun_visible_fraction > 0.0:
        return None
    return Problem(view.lit_fraction, None, "share of the limb")


def _unlit(view: LimbView) -> Problem | None:
    if view.kind != "solar" or view.outcome is not Outcome.DARK or _eclipse(view) is not None:
        return None
    return Problem(view.lit_fraction, None, "share of the limb") if (view.lit_fraction or 0.0) < 0.5 else None


def _dark(view: LimbView) -> Problem | None:
    if view.outcome is not Outcome.DARK or _eclipse(view) is not None or _unlit(view) is not None:
        return None
    return Problem(view.snr, limits.NOMINAL.snr, "SNR")


def _noisy(view: LimbView) -> Problem | None:
    if view.outcome is not Outcome.VALID or view.snr is None or view.snr >= limits.STRICT.snr:
        return None
    return Problem(view.snr, limits.STRICT.snr, "SNR")


def _dim(view: LimbView) -> Problem | None:
    lit = view.kind == "thermal" or (view.lit_fraction or 0.0) >= 0.5
    if view.level is None or not lit or view.outcome is Outcome.DARK or view.level >= DIM_LEVEL:
        return None
    return Problem(view.level, DIM_LEVEL, "full scale")


def _no_limb(view: LimbView) -> Problem | None:
    return Problem(0.0, view.shortest_px, "px") if view.outcome is Outcome.NO_LIMB else None


def _short_arc(view: LimbView) -> Problem | None:
    if view.outcome is not Outcome.SHORT_ARC:
        return None
    if view.arc_px < view.shortest_px:
        return Problem(view.arc_px, view.shortest_px, "px")
    if view.sagitta_px < limits.MIN_ARC_SAGITTA_PX:
        return Problem(view.sagitta_px, limits.MIN_ARC_SAGITTA_PX, "px of sagitta")
    return Problem(view.determined_deg, _determined_limit_deg(), "deg")


def _sun_in_frame(view: LimbView) -> Problem | None:
    return Problem(0.0, None, "deg") if view.sun_in_frame else None


def _sun_near(view: LimbView) -> Problem | None:
    if view.kind != "solar" or view.sun_outside_deg is None or view.sun_outside_deg >= NEAR_DEG:
        return None
    return Problem(view.sun_outside_deg, NEAR_DEG, "deg")


def _veiled(view: LimbView) -> Problem | None:
    glare = view.outcome is Outcome.SUN_GLARE and not view.sun_in_frame
    return Problem(view.veil, limits.NOMINAL.veil, "full scale") if glare else None


def _moon(view: LimbView) -> Problem | None:
    return Problem(0.0, None, "deg") if view.moon_in_frame and view.kind == "solar" else None


def _borderline(view: LimbView) -> Problem | None:
    return Problem(None, None, "") if view.borderline and view.outcome is Outcome.VALID else None


def _coarse_rays(view: LimbView) -> Problem | None:
    if view.kind != "thermal" or view.outcome is Outcome.NO_LIMB or view.ray_spacing_m <= LARGEST_SPACING_M:
        return None
    return Problem(view.ray_spacing_m / 1e3, LARGEST_SPACING_M / 1e3, "km")


def _determined_limit_deg() -> float:
    return math.degrees(limits.NOMINAL.determined_rad)


def _level_text(views: Sequence[LimbView]) -> str:
    """Return "limb at 140 % of full scale" of one frame, or the range over several."""
    highest = [view.highest for view in views if view.highest is not None]
    low, high = percent(min(highest)), percent(max(highest))
    text = f"limb at {high if low == high else f'{low} to {high}'} of full scale"
    return text + (" over clouds or snow" if all(view.patchy for view in views) else "")


def _exposure_fix(views: Iterable[LimbView]) -> str:
    """Return which exposure lays the brightest of several limbs on the target."""
    known = [view for view in views if view.highest is not None and view.highest > 0.0]
    if not known:
        return ""
    brightest = max(known, key=lambda view: view.highest or 0.0)
    if brightest.kind == "thermal":
        return f"detector.scene_max_k above {brightest.plateau_k:.0f} K" if brightest.plateau_k else ""
    if brightest.exposure_s is None:
        return "lower detector.auto_exposure.target or min_s"
    assert brightest.highest is not None
    wanted = float(f"{brightest.exposure_s * TARGET_LEVEL / brightest.highest:.2g}")
    level = brightest.highest * wanted / brightest.exposure_s
    return f"exposure {duration(brightest.exposure_s)} -> {duration(wanted)} puts it at {percent(level)}"


def _short_arc_text(views: Sequence[LimbView]) -> str:
    view = views[0]
    arc = f"{view.arc_deg:.0f} deg, {view.arc_px:.0f} px of horizon in view"
    if view.arc_px < view.shortest_px:
        return f"{arc}, at least {view.shortest_px:.0f} px are needed"
    if view.sagitta_px < limits.MIN_ARC_SAGITTA_PX:
        return f"{arc} bend by {view.sagitta_px:.2f} px only, at least {limits.MIN_ARC_SAGITTA_PX:g} px are needed"
    if view.determined_deg is None:
        return f"{arc} do not determine the nadir"
    return (
        f"{arc} determine the nadir to {view.determined_deg:.2g} deg only, {_determined_limit_deg():g} deg are needed"
    )


def _snr_text(views: Sequence[LimbView]) -> str:
    return f"limb SNR {views[0].snr:.2g} a pixel" if views[0].snr is not None else "no light at the limb"


RULES: tuple[Rule, ...] = (
    Rule("no-limb", SOME, _no_limb, lambda v: "no horizon in view", lambda v: "turn the camera's mount towards it"),
    Rule(
        "short-arc",
        SOME,
        _short_arc,
        _short_arc_text,
        lambda v: "a wider field, or a mount that lays the limb across the image",
    ),
    Rule("saturated", SOME, _saturated, lambda v: f"{_level_text(v)}: saturated", _exposure_fix),
    Rule(
        "eclipse",
        MOSTLY,
        _eclipse,
        lambda v: "in the Earth's shadow, no sunlit limb: nothing can be determined",
        lambda v: "another epoch, or a thermal camera",
    ),
    Rule(
        "unlit-limb",
        MOSTLY,
        _unlit,
        lambda v: f"the Sun stands over {percent(v[0].lit_fraction or 0.0)} of the limb in view: too little is lit",
        lambda v: "another epoch or mount, or a thermal camera",
    ),
    Rule(
        "dark",
        SOME,
        _dark,
        lambda v: f"{_snr_text(v)}, {limits.NOMINAL.snr:g} is needed: too dark",
        lambda v: _exposure_fix(v) if v[0].kind == "solar" else "a smaller detector.netd_k or a faster lens",
    ),
    Rule(
        "sun-in-frame",
        MOSTLY,
        _sun_in_frame,
        lambda v: "the Sun is in the frame",
        lambda v: "another mount or epoch" if v[0].kind == "solar" else "",
    ),
    Rule(
        "veiled",
        MOSTLY,
        _veiled,
        lambda v: f"the Sun's veil reaches {percent(v[0].veil)} of full scale at the limb: sun_glare",
        lambda v: "a better baffle (optics.stray), or another mount",
    ),
    Rule(
        "partly-saturated",
        None,
        _partly_saturated,
        lambda v: (
            f"{_level_text(v)} at its brightest, up to {percent(max(one.saturated_share for one in v))} of it is "
            "saturated"
        ),
        _exposure_fix,
    ),
    Rule(
        "nearly-saturated", None, _nearly_saturated, lambda v: f"{_level_text(v)}, close to saturation", _exposure_fix
    ),
    Rule("dim", None, _dim, lambda v: f"limb at {percent(v[0].level or 0.0)} of full scale only", _exposure_fix),
    Rule(
        "noisy",
        None,
        _noisy,
        lambda v: f"{_snr_text(v)}, below {limits.STRICT.snr:g} not every method sees it",
        lambda v: "",
    ),
    Rule(
        "sun-near",
        None,
        _sun_near,
        lambda v: f"the Sun is {v[0].sun_outside_deg:.1f} deg outside the image",
        lambda v: "",
    ),
    Rule(
        "coarse-rays",
        None,
        _coarse_rays,
        lambda v: (
            f"rays meet the limb {v[0].ray_spacing_m / 1e3:.0f} km apart, above {LARGEST_SPACING_M / 1e3:g} km they "
            "misplace it in its pixels: fits of it are then worse than on real images"
        ),
        lambda v: f"render.subsamples up to {MOST_SUBSAMPLES}",
    ),
    Rule("moon-in-frame", None, _moon, lambda v: "the Moon is in the frame", lambda v: ""),
    Rule(
        "borderline",
        None,
        _borderline,
        lambda v: (
            "close to a threshold of what can be determined: neither answer nor refusal will count against a method"
        ),
        lambda v: "",
    ),
)
"""All rules, in the order in which findings of the same level are told."""

CODES = (*(rule.code for rule in RULES), "cannot-run")
"""All codes of findings."""


def duration(seconds: float) -> str:
    """Return a time as text, in s, ms or us."""
    for unit, scale in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} us"
