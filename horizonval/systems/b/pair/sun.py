"""The Sun in the frame: is it the Sun's own light in the lens that washes the picture out?

As the Sun sinks towards the limb two things change at once: its glare comes into the forward camera's frame, and the
ground goes dark. So every view is observed twice from the same frames, with the same seed: with the Sun's own light in
the lens, and without it (:mod:`horizonval.systems.b.pair.frames`). What is lost between the two is the work of the
Sun's image, its ghosts, the veil and the scatter of the lens, and of nothing else. Every view also has a twin with the
same height of the Sun and the same attitude and the Sun on the other side of the sky, outside both frames. All are seen
through two lenses and with two exposures:

- the good lens of the shipped camera with all its stages, and an ordinary one, which scatters, reflects and lets in
  stray light as small satellites' lenses without coating or baffle do;
- the fixed exposure of the shipped camera, and one that the camera chooses for 99 % of its pixels.

Views are draws: height and azimuth of the Sun, pitch and roll, each even over its range. The difference of the shares
of views without a right answer, with the Sun's light minus without it, has the score interval of paired shares (T.
Tango, Statistics in Medicine 17, 891, 1998), which also says something where the two differ nowhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.systems.b.pair.applicability import LIMIT_DEG, PUBLISHED
from horizonval.systems.b.pair.frames import ALTITUDE_KM, glare_optics, pair, scene, views
from horizonval.systems.published import page_text
from horizonval.systems.result import Cell, Claim, ComparisonRow, Status, Table
from horizonval.systems.task_cache import TaskCache

SHOWN_ZENITH_DEG = (60.0, 80.0, 98.0, 106.0, 110.0)
"""Zenith angles of the pictures, from the upper part of the forward frame down to just above the limb."""
LIMB_ZENITH_DEG = 180.0 - math.degrees(math.asin(MEAN_RADIUS_M / (MEAN_RADIUS_M + ALTITUDE_KM * 1e3)))
"""Zenith angle of the hard horizon, to a tenth of a degree for the ellipsoid."""
VIEWS = {"inside": 24, "outside": 12}
"""Drawn; those outside are the first of those inside, with the Sun turned away."""
ZENITH_DEG = (60.0, 111.0)
HEADING_DEG = 90.0
AZIMUTH_DEG = (60.0, 120.0)
"""The forward camera looks to 90 deg, the left one to 0; each sees 50 deg to either side."""
TURNED_DEG = {"inside": 0.0, "outside": 135.0}
"""Added to the azimuth: outside both frames for all of them."""
TILT_DEG = 4.0
"""Largest pitch and roll."""
WIDTH_PX = 512
GOOD, ORDINARY = LENSES = "good lens", "ordinary lens"
FIXED, AUTOMATIC = EXPOSURES = "fixed exposure", "automatic exposure"
ORDINARY_SHARES = {"scattered": 0.05, "ghost": 1e-3, "stray": 10.0}
"""Fixed before any frame was rendered: 5 % scatter (good lens: 0.3 %), ghosts of 1e-3 (1e-4), ten times the stray
light."""
AUTO = {"min_s": 2e-6, "max_s": 5e-3}
CONFIDENCE = 0.95
DRAWS = 10_000


@dataclass(frozen=True)
class DrawnView:
    """Where the Sun of one view stands and how the satellite does, degrees."""

    zenith_deg: float
    azimuth_deg: float
    pitch_deg: float
    roll_deg: float


@dataclass(frozen=True)
class Paired:
    """Results of the same views with (``lit``) and without (``dark``) the Sun's light."""

    lit: tuple[JsonObject, ...]
    dark: tuple[JsonObject, ...]

    def right(self, lit: bool, searched: bool = False) -> NDArray[np.bool_]:
        """Return whether each view was answered within the limit, shape (views,)."""
        return np.array([_error_deg(one, searched) <= LIMIT_DEG for one in (self.lit if lit else self.dark)])

    def refused(self, lit: bool, searched: bool = False) -> NDArray[np.bool_]:
        """Return whether each view was refused, shape (views,)."""
        return np.array([math.isinf(_error_deg(one, searched)) for one in (self.lit if lit else self.dark)])

    def lost_and_gained(self, searched: bool = False) -> tuple[int, int]:
        """Return how many views are right without the light alone, and with it alone."""
        lit, dark = self.right(True, searched), self.right(False, searched)
        return int(np.sum(dark & ~lit)), int(np.sum(lit & ~dark))

    def change_deg(self, rng: np.random.Generator) -> tuple[float, float, float] | None:
        """Return the median change of the error [deg] of views that both answer, and its 95 % interval (bootstrap)."""
        lit, dark = (np.array([_error_deg(one) for one in side]) for side in (self.lit, self.dark))
        both = np.isfinite(lit) & np.isfinite(dark)
        if not both.any():
            return None
        change: FloatArray = lit[both] - dark[both]
        drawn = np.median(change[rng.integers(0, len(change), (DRAWS, len(change)))], axis=1)
        tail = 50.0 * (1.0 - CONFIDENCE)
        low, high = np.percentile(drawn, (tail, 100.0 - tail))
        return float(np.median(change)), float(low), float(high)


@dataclass(frozen=True)
class SunOutcome:
    """Pairs by lens, exposure and side of the sky; ``shown``: by lens and exposure, both ways, by height."""

    skies: tuple[DrawnView, ...]
    pairs: dict[tuple[str, str, str], Paired]
    shown: dict[tuple[str, str], Paired]


def difference(lost: int, gained: int, n: int) -> tuple[float, float, float]:
    """Return the difference of two paired shares, ``(lost - gained) / n``, and Tango's 95 % interval of it."""
    low, high = score_interval(lost, gained, n, CONFIDENCE)
    return (lost - gained) / n, low, high


def sun_in_frame(cache: TaskCache) -> SunOutcome:
    """Do the experiment."""
    cameras = {f"{lens}, {exposure}": _camera(lens, exposure) for lens, exposure in product(LENSES, EXPOSURES)}
    skies = drawn_skies(cache.rng("skies"))
    items = {
        f"shown, Sun at {zenith:g} deg": _item(cameras, DrawnView(zenith, 80.0, 0.0, 0.0), cache.seed, True)
        for zenith in SHOWN_ZENITH_DEG
    }
    for place, turned in TURNED_DEG.items():
        for number, sky in enumerate(skies[: VIEWS[place]]):
            away = DrawnView(sky.zenith_deg, sky.azimuth_deg + turned, sky.pitch_deg, sky.roll_deg)
            items[f"view {number}, Sun {place}"] = _item(cameras, away, cache.seed, False)
    found = list(cache.each("B: Sun inside and outside the frame", views, items).values())
    shown, drawn = found[: len(SHOWN_ZENITH_DEG)], found[len(SHOWN_ZENITH_DEG) :]
    halves = {"inside": drawn[: VIEWS["inside"]], "outside": drawn[VIEWS["inside"] :]}
    pairs = {
        (lens, exposure, place): paired(halves[place], lens, exposure)
        for lens, exposure, place in product(LENSES, EXPOSURES, TURNED_DEG)
    }
    pictures = {(lens, exposure): paired(shown, lens, exposure) for lens, exposure in product(LENSES, EXPOSURES)}
    return SunOutcome(skies, pairs, pictures)


def drawn_skies(rng: np.random.Generator) -> tuple[DrawnView, ...]:
    """Return the views: all even over their ranges."""
    low, high = np.array([ZENITH_DEG, AZIMUTH_DEG, (-TILT_DEG, TILT_DEG), (-TILT_DEG, TILT_DEG)]).T
    return tuple(DrawnView(*map(float, row)) for row in rng.uniform(low, high, (VIEWS["inside"], 4)))


def paired(seen: list[JsonObject], lens: str, exposure: str) -> Paired:
    """Return what one lens and exposure made of some views."""
    ours = [one[f"{lens}, {exposure}"] for one in seen]
    return Paired(tuple(one["with"] for one in ours), tuple(one["without"] for one in ours))


def _error_deg(one: JsonObject, searched: bool = False) -> float:
    return float((one["searched"] if searched else one)["error_deg"].get("SIGHT", math.inf))


def _item(cameras: JsonObject, sky: DrawnView, seed: int, picture: bool) -> JsonObject:
    tables = {
        "platform": {"altitude_km": ALTITUDE_KM, "heading_deg": HEADING_DEG},
        "sun": {"zenith_deg": sky.zenith_deg, "azimuth_deg": sky.azimuth_deg},
        "attitude": {"pitch_deg": sky.pitch_deg, "roll_deg": sky.roll_deg},
    }
    return {"cameras": cameras, "scene": scene("sun", air=True, **tables), "seed": seed, "picture": picture}


def _camera(lens: str, exposure: str) -> JsonObject:
    optics = glare_optics(**(ORDINARY_SHARES if lens == ORDINARY else {}))
    camera = pair(WIDTH_PX, tables={"optics": optics})
    if exposure == AUTOMATIC:
        camera["detector"] = {**camera["detector"], "auto_exposure": AUTO}
    return camera


TEXT = page_text("B")
HEIGHTS_DEG = ((0.0, 10.0), (10.0, 25.0), (25.0, 52.0))
"""Heights of the Sun over the limb: the lines of the second table."""
WASHED_OUT = 0.5
"""Share of views lost from which on a picture is called washed out; below it in all cases is contradicted."""


def sun_rows(found: SunOutcome) -> list[ComparisonRow]:
    """Return the cost of the Sun's light, with its interval, for every lens, exposure and side of the sky.

    The criterion, for the ordinary lens with the Sun in the frame and both exposures: the interval's lower end is above
    0.
    """
    rows = []
    for (lens, exposure, place), one in found.pairs.items():
        n = len(one.lit)
        lost, gained = one.lost_and_gained()
        change, low, high = difference(lost, gained, n)
        barred = lens == ORDINARY and place == "inside"
        rows.append(
            TEXT.row(
                "sun",
                low if barred else change,
                PUBLISHED.figures["sun"].value if barred else None,
                limit=0.0 if barred else None,
                at_least=barred,
                lens=lens,
                exposure=exposure,
                place=TEXT.phrase(place),
                what=TEXT.phrase("lower_end" if barred else "difference"),
                change=change,
                low=low,
                high=high,
                lost=lost,
                gained=gained,
                views=n,
                with_light=n - int(one.right(True).sum()),
                without=n - int(one.right(False).sum()),
            )
        )
    return rows


def sun_claim(rows: Sequence[ComparisonRow], found: SunOutcome) -> Claim:
    """Return the judged claim that the Sun in the frame washes the picture out."""
    barred = [row for row in rows if row.holds is not None]
    ends = {
        exposure: difference(*one.lost_and_gained(), len(one.lit))
        for (lens, exposure, place), one in found.pairs.items()
        if lens == ORDINARY and place == "inside"
    }
    if all(row.holds for row in barred):
        status = Status.REPRODUCED
    elif any(row.holds for row in barred):
        status = Status.BOUNDED
    elif all(high < WASHED_OUT for _, _, high in ends.values()):
        status = Status.CONTRADICTED
    else:
        status = Status.NOT_DETERMINABLE
    measured = "; ".join(
        TEXT.phrase("sun_measured", exposure=exposure, change=change, low=low, high=high)
        for exposure, (change, low, high) in ends.items()
    )
    return TEXT.claim(
        "sun", str(PUBLISHED.figures["sun"].value), status, measured=measured, views=VIEWS["inside"], share=WASHED_OUT
    )


def sun_table(found: SunOutcome, rng: np.random.Generator) -> Table:
    """Return what became of all views, with the Sun's light and without."""
    lines: list[tuple[Cell, ...]] = []
    for (lens, exposure, place), one in found.pairs.items():
        for searched in (False, True):
            lost, gained = one.lost_and_gained(searched)
            change, low, high = difference(lost, gained, len(one.lit))
            error = None if searched else one.change_deg(rng)
            cells: list[Cell] = [lens, exposure, TEXT.phrase(place), TEXT.phrase("searched" if searched else "longest")]
            cells += [_counts(one, searched, lit) for lit in (False, True)]
            cells += [f"{lost}, {gained}", f"{change:+.2f} ({low:+.2f} to {high:+.2f})"]
            cells.append("–" if error is None else "{:+.3f} ({:+.3f} to {:+.3f})".format(*error))
            lines.append(tuple(cells))
    return TEXT.table("sun", lines, inside=VIEWS["inside"], outside=VIEWS["outside"], limit=LIMIT_DEG)


def height_table(found: SunOutcome) -> Table:
    """Return what is right at which height of the Sun, with its light and without, Sun in the frame and outside."""
    over = LIMB_ZENITH_DEG - np.array([sky.zenith_deg for sky in found.skies])
    lines: list[tuple[Cell, ...]] = []
    for (lens, exposure, place), one in found.pairs.items():
        cells: list[Cell] = [lens, exposure, TEXT.phrase(place)]
        for low, high in HEIGHTS_DEG:
            here = (over[: len(one.lit)] >= low) & (over[: len(one.lit)] < high)
            cells.append(f"{one.right(False)[here].sum()} → {one.right(True)[here].sum()} of {here.sum()}")
        lines.append(tuple(cells))
    heads = {f"band{k}": f"{low:g} to {high:g} deg" for k, (low, high) in enumerate(HEIGHTS_DEG)}
    return TEXT.table("sun_heights", lines, **heads)


def _counts(one: Paired, searched: bool, lit: bool) -> str:
    right, refused = int(one.right(lit, searched).sum()), int(one.refused(lit, searched).sum())
    return f"{right}, {len(one.lit) - right - refused}, {refused}"


def score_interval(lost: float, gained: float, n: float, confidence: float) -> tuple[float, float]:
    """Return the score interval of ``(lost - gained) / n``; counts over a design effect may be fractional."""
    z = float(stats.norm.ppf(0.5 + confidence / 2))
    estimate = (lost - gained) / n

    def excess(delta: float, sign: float) -> float:
        return sign * _score(lost, gained, n, delta) - z

    edge = 1.0 - 1e-12
    low = high = estimate
    if estimate > -edge:
        low = -1.0 if excess(-edge, 1.0) < 0 else optimize.brentq(excess, -edge, estimate, args=(1.0,), xtol=1e-12)
    if estimate < edge:
        high = 1.0 if excess(edge, -1.0) < 0 else optimize.brentq(excess, estimate, edge, args=(-1.0,), xtol=1e-12)
    return float(low), float(high)


def _score(lost: float, gained: float, n: float, delta: float) -> float:
    """Return Tango's statistic for a true difference ``delta``: positive where more is lost than that.

    ``q`` is the likeliest share of gained frames under that difference, the root of a quadratic.
    """
    b = -lost - gained + (2.0 * n - lost + gained) * delta
    c = -gained * delta * (1.0 - delta)
    q = (math.sqrt(max(b * b - 8.0 * n * c, 0.0)) - b) / (4.0 * n)
    variance = n * (2.0 * q + delta * (1.0 - delta))
    deviation = lost - gained - n * delta
    if variance <= 0.0:
        return 0.0 if deviation == 0.0 else math.copysign(math.inf, deviation)
    return deviation / math.sqrt(variance)
