"""The Sun in the frame: is it the Sun's own light in the lens that washes the picture out?

As the Sun sinks towards the limb two things change at once: its glare comes into the forward camera's frame, and the
ground goes dark. So every view is observed twice from the same frames, with the same seed: with the Sun's own light in
the lens, and without it (:mod:`horizonval.systems.b.pair.sun_light`). What is lost between the two is the work of the
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
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.studies.regression.statistics import score_interval
from horizonval.systems.b.pair.applicability import LIMIT_DEG
from horizonval.systems.b.pair.frames import ALTITUDE_KM, glare_optics, pair, scene, views
from horizonval.systems.task_cache import TaskCache

SHOWN_ZENITH_DEG = (60.0, 80.0, 98.0, 106.0, 110.0)
"""Of the pictures, from the upper part of the forward frame down to just above the limb."""
LIMB_ZENITH_DEG = 180.0 - math.degrees(math.asin(MEAN_RADIUS_M / (MEAN_RADIUS_M + ALTITUDE_KM * 1e3)))
"""Of the hard horizon, to a tenth of a degree for the ellipsoid."""
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
"""Written down before any frame was seen: scatter of 5 % (the good one has 0.3 %), ghosts of 1e-3 (1e-4), ten times the
stray light."""
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
    """The same views with and without the Sun's own light: of one lens, one exposure and one side of the sky.

    Attributes
    ----------
    lit, dark : tuple of dict
        What the method makes of every view with that light, and without it.
    """

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
    """The whole experiment: pairs by lens, exposure and side of the sky, views by number, and the shown ones.

    ``shown``: by lens and exposure, with and without the Sun's light, for every shown height.
    """

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
