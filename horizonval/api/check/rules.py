"""Rules that turn the predicted view of a camera into findings.

A rule looks at one band of one frame. Its findings are about that frame, or counted over the frames of a camera or
design. In a single scene every problem is a warning. Suites contain hopeless frames on purpose, and a third of an
orbit lies in the Earth's shadow: there the share of frames decides between a warning and a note (:data:`MOSTLY`,
:data:`SOME`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from horizonval.api.check.findings import Finding, Level, gravity, percent
from horizonval.api.check.limb import LimbView
from horizonval.core.outcome import Outcome
from horizonval.scoring import limits

TARGET_LEVEL = 0.7
"""Level of the brightest limb with a proposed exposure; the prediction is within 30 %."""
HIGH_LEVEL = limits.STRICT.filling
DIM_LEVEL = 0.05
"""Level below which 95 % of the converter's range is unused."""
NEAR_DEG = 10.0
"""Angle outside the image within which lenses scatter sunlight and few baffles reject it."""

LARGEST_SPACING_M = 7.5e3
"""Largest distance of rays at a thermal limb, a scale height of the air. With wider rays errors of fits double."""
MOST_SUBSAMPLES = 16

MOSTLY, SOME = 0.5, 0.2
"""Shares of frames from which a problem is a warning: caused by the Sun's position, and by the design."""


Views: TypeAlias = Sequence[LimbView]
"""Frames with a problem, the worst first."""
Problem: TypeAlias = tuple[float | None, float | None, str]
"""A value, its limit, and their unit."""


@dataclass(frozen=True)
class Rule:
    """One problem that a frame can have.

    ``share``: share of frames from which it is a warning; None for a note. ``find``: returns the problem of a frame, or
    None. ``text``, ``fix``: finding and advice, or functions of the frames with the problem.
    """

    code: str
    share: float | None
    find: Callable[[LimbView], Problem | None]
    text: str | Callable[[Views], str]
    fix: str | Callable[[Views], str] = ""


def findings_of(views: Views, subject: str, *, total: int | None = None, single: bool = False) -> list[Finding]:
    """Return the findings of one band of all examined frames of ``subject``, a camera or a design.

    ``total``: number of all frames, if not all were examined. ``single``: one scene, whose problems are warnings.
    """
    findings = []
    for rule in RULES:
        troubled = [(problem, view) for view in views if (problem := rule.find(view)) is not None]
        if not troubled:
            continue
        troubled.sort(key=lambda pair: gravity(*pair[0][:2]), reverse=True)
        (value, limit, unit), members = troubled[0][0], [view for _, view in troubled]
        grave = rule.share is not None and (single or len(members) / len(views) >= rule.share)
        findings.append(
            Finding(
                level=Level.WARNING if grave else Level.NOTE,
                code=rule.code,
                text=rule.text if isinstance(rule.text, str) else rule.text(members),
                value=value,
                limit=limit,
                unit=unit,
                fix=rule.fix if isinstance(rule.fix, str) else rule.fix(members),
                subject=subject,
                frames=len(members),
                of=len(views),
                total=len(views) if total is None else total,
            )
        )
    return findings


def _saturated(view: LimbView) -> Problem | None:
    clipped = view.outcome is Outcome.SATURATED or view.saturated_share >= 1.0
    return (view.highest, 1.0, "full scale") if clipped and view.highest is not None else None


def _partly_saturated(view: LimbView) -> Problem | None:
    above = view.highest is not None and view.highest > 1.0 and _saturated(view) is None
    return (view.highest, 1.0, "full scale") if above else None


def _nearly_saturated(view: LimbView) -> Problem | None:
    near = view.highest is not None and HIGH_LEVEL < view.highest <= 1.0
    return (view.highest, HIGH_LEVEL, "full scale") if near else None


def _eclipse(view: LimbView) -> Problem | None:
    hidden = view.band.kind == "solar" and view.outcome is Outcome.DARK and view.sun_visible_fraction <= 0.0
    return (view.expected.lit_fraction, None, "share of the limb") if hidden else None


def _unlit(view: LimbView) -> Problem | None:
    if view.band.kind != "solar" or view.outcome is not Outcome.DARK or _eclipse(view) is not None:
        return None
    lit = view.expected.lit_fraction
    return (lit, None, "share of the limb") if (lit or 0.0) < 0.5 else None


def _dark(view: LimbView) -> Problem | None:
    why = view.outcome is Outcome.DARK and _eclipse(view) is None and _unlit(view) is None
    return (view.snr, limits.NOMINAL.snr, "SNR") if why else None


def _noisy(view: LimbView) -> Problem | None:
    noisy = view.outcome is Outcome.VALID and view.snr is not None and view.snr < limits.STRICT.snr
    return (view.snr, limits.STRICT.snr, "SNR") if noisy else None


def _dim(view: LimbView) -> Problem | None:
    lit = view.band.kind == "thermal" or (view.expected.lit_fraction or 0.0) >= 0.5
    dim = view.level is not None and lit and view.outcome is not Outcome.DARK and view.level < DIM_LEVEL
    return (view.level, DIM_LEVEL, "full scale") if dim else None


def _no_limb(view: LimbView) -> Problem | None:
    return (0.0, view.shortest_px, "px") if view.outcome is Outcome.NO_LIMB else None


def _short_arc(view: LimbView) -> Problem | None:
    if view.outcome is not Outcome.SHORT_ARC:
        return None
    if view.arc_px < view.shortest_px:
        return view.arc_px, view.shortest_px, "px"
    return view.expected.bound_deg, view.accept_deg, "deg"


def _sun_in_frame(view: LimbView) -> Problem | None:
    return (0.0, None, "deg") if view.expected.sun_in_frame else None


def _sun_near(view: LimbView) -> Problem | None:
    near = view.band.kind == "solar" and view.sun_outside_deg is not None and view.sun_outside_deg < NEAR_DEG
    return (view.sun_outside_deg, NEAR_DEG, "deg") if near else None


def _veiled(view: LimbView) -> Problem | None:
    glare = view.outcome is Outcome.SUN_GLARE and not view.expected.sun_in_frame
    return (view.expected.veil_fraction, limits.NOMINAL.veil, "full scale") if glare else None


def _moon(view: LimbView) -> Problem | None:
    return (0.0, None, "deg") if view.expected.moon_in_frame and view.band.kind == "solar" else None


def _borderline(view: LimbView) -> Problem | None:
    return (None, None, "") if view.expected.borderline and view.outcome is Outcome.VALID else None


def _coarse_rays(view: LimbView) -> Problem | None:
    thermal = view.band.kind == "thermal" and view.outcome is not Outcome.NO_LIMB
    coarse = thermal and view.ray_spacing_m > LARGEST_SPACING_M
    return (view.ray_spacing_m / 1e3, LARGEST_SPACING_M / 1e3, "km") if coarse else None


def _level_text(views: Views) -> str:
    """Return "limb at 140 % of full scale" of one frame, or the range over several."""
    highest = [view.highest for view in views if view.highest is not None]
    low, high = percent(min(highest)), percent(max(highest))
    text = f"limb at {high if low == high else f'{low} to {high}'} of full scale"
    return text + (" over clouds or snow" if all(view.patchy for view in views) else "")


def _exposure_fix(views: Views) -> str:
    """Return the exposure that puts the brightest of several limbs at :data:`TARGET_LEVEL`."""
    known = [(view.highest, view) for view in views if view.highest is not None and view.highest > 0.0]
    if not known:
        return ""
    highest, brightest = max(known, key=lambda pair: pair[0])
    if brightest.band.kind == "thermal":
        return f"detector.scene_max_k above {brightest.plateau_k:.0f} K" if brightest.plateau_k else ""
    if brightest.exposure_s is None:
        return "lower detector.auto_exposure.target or min_s"
    wanted = float(f"{brightest.exposure_s * TARGET_LEVEL / highest:.2g}")
    level = highest * wanted / brightest.exposure_s
    return f"exposure {_duration(brightest.exposure_s)} -> {_duration(wanted)} puts it at {percent(level)}"


def _duration(seconds: float) -> str:
    for unit, scale in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} us"


def _short_arc_text(views: Views) -> str:
    view, bound = views[0], views[0].expected.bound_deg
    arc = f"{view.arc_deg:.0f} deg, {view.arc_px:.0f} px of horizon in view"
    if view.arc_px < view.shortest_px:
        return f"{arc}, at least {view.shortest_px:.0f} px are needed"
    if bound is None:
        return f"{arc} do not determine the nadir"
    return f"{arc} determine the nadir to {bound:.3g} deg, {view.accept_deg:g} deg are needed"


def _snr_text(views: Views) -> str:
    return f"limb SNR {views[0].snr:.2g} a pixel" if views[0].snr is not None else "no light at the limb"


RULES: tuple[Rule, ...] = (
    Rule("no-limb", SOME, _no_limb, "no horizon in view", "turn the camera's mount towards it"),
    Rule(
        "short-arc",
        SOME,
        _short_arc,
        _short_arc_text,
        "a wider field, a mount that lays the limb across the image, or a [prior] with what is known of the position",
    ),
    Rule("saturated", SOME, _saturated, lambda v: f"{_level_text(v)}: saturated", _exposure_fix),
    Rule(
        "eclipse",
        MOSTLY,
        _eclipse,
        "in the Earth's shadow, no sunlit limb: nothing can be determined",
        "another epoch, or a thermal camera",
    ),
    Rule(
        "unlit-limb",
        MOSTLY,
        _unlit,
        lambda v: (
            f"the Sun stands over {percent(v[0].expected.lit_fraction or 0.0)} of the limb in view: too little is lit"
        ),
        "another epoch or mount, or a thermal camera",
    ),
    Rule(
        "dark",
        SOME,
        _dark,
        lambda v: f"{_snr_text(v)}, {limits.NOMINAL.snr:g} is needed: too dark",
        lambda v: _exposure_fix(v) if v[0].band.kind == "solar" else "a smaller detector.netd_k or a faster lens",
    ),
    Rule(
        "sun-in-frame",
        MOSTLY,
        _sun_in_frame,
        "the Sun is in the frame",
        lambda v: "another mount or epoch" if v[0].band.kind == "solar" else "",
    ),
    Rule(
        "veiled",
        MOSTLY,
        _veiled,
        lambda v: f"the Sun's veil reaches {percent(v[0].expected.veil_fraction)} of full scale at the limb: sun_glare",
        "a better baffle (optics.stray), or another mount",
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
    Rule("noisy", None, _noisy, lambda v: f"{_snr_text(v)}, below {limits.STRICT.snr:g} not every method sees it"),
    Rule("sun-near", None, _sun_near, lambda v: f"the Sun is {v[0].sun_outside_deg:.1f} deg outside the image"),
    Rule(
        "coarse-rays",
        None,
        _coarse_rays,
        lambda v: (
            f"rays meet the limb {v[0].ray_spacing_m / 1e3:.0f} km apart, above {LARGEST_SPACING_M / 1e3:g} km they "
            "misplace it in its pixels: fits of it are then worse than on real images"
        ),
        f"render.subsamples up to {MOST_SUBSAMPLES}",
    ),
    Rule("moon-in-frame", None, _moon, "the Moon is in the frame"),
    Rule(
        "borderline",
        None,
        _borderline,
        "close to a threshold of what can be determined: neither answer nor refusal will count against a method",
    ),
)
"""All rules, in the order of findings of the same level."""

CODES = (*(rule.code for rule in RULES), "doubtful-orbit", "cannot-run")
"""All codes of findings."""
