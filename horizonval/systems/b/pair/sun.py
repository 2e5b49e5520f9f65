"""The Sun in the frame, with its control: is it the glare that washes the picture out, or the dark ground of a low Sun?

As the Sun sinks towards the limb two things change at once: its glare comes into the forward camera's frame, and the
ground goes dark. So every view has a twin: the same height of the Sun, the same attitude, and the Sun on the other side
of the sky, outside both frames. What the twin gets wrong too is not the glare's work. Both are seen through two lenses
and with two exposures:

- the good lens of the shipped camera with all its stages, and an ordinary one, which scatters, reflects and lets in
stray
  light as small satellites' lenses without coating or baffle do;
- the fixed exposure of the shipped camera, and one that the camera chooses for 99 % of its pixels.

The difference of the shares of views without a right answer, Sun in the frame minus Sun outside, belongs to the glare.
Its interval comes of drawing the pairs of twins again (bootstrap).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.systems.b.pair.applicability import LIMIT_DEG
from horizonval.systems.b.pair.frames import ALTITUDE_KM, FIELD_DEG, glare_optics, pair, scene, views
from horizonval.systems.task_cache import TaskCache

ZENITH_DEG = (60.0, 80.0, 98.0, 106.0, 110.0)
"""From the upper part of the forward frame down to just above the limb."""
LIMB_ZENITH_DEG = 180.0 - math.degrees(math.asin(MEAN_RADIUS_M / (MEAN_RADIUS_M + ALTITUDE_KM * 1e3)))
"""Of the hard horizon, to a tenth of a degree for the ellipsoid."""
HEADING_DEG = 90.0
AZIMUTHS_DEG = {"inside": 80.0, "outside": 225.0}
"""The forward camera looks to 90 deg, the left one to 0; each sees 50 deg to either side. Outside is the
middle of the rest."""
ATTITUDES_DEG = ((0.0, 0.0), (3.0, -2.0), (-2.0, 3.0), (2.0, 4.0))
"""Pitch and roll of the views of one height."""
WIDTH_PX = 512
CLEAN, GOOD, ORDINARY = LENSES = "lens without glare", "good lens", "ordinary lens"
"""The first is a second control: the same Sun and the same ground, and nothing scattered, mirrored or let in."""
FIXED, AUTOMATIC = "fixed exposure", "automatic exposure"
ORDINARY_SHARES = {"scattered": 0.05, "ghost": 1e-3, "stray": 10.0}
"""Written down before any frame was seen: scatter of 5 % (the good one has 0.3 %), ghosts of 1e-3 (1e-4), ten times the
stray light."""
AUTO = {"min_s": 2e-6, "max_s": 5e-3}
DRAWS = 10_000
PERCENT = (2.5, 97.5)
IN_FRAME_DEG = 90.0 - 0.5 * FIELD_DEG
"""Zenith angle at the upper edge of the forward camera, whose boresight is level."""


@dataclass(frozen=True)
class GlareOutcome:
    """Of one lens and exposure: whether the answer was right, shape (views,), Sun inside and outside, and the views.

    ``views`` are those of the published method, by place of the Sun, height and attitude.
    """

    inside: FloatArray
    outside: FloatArray
    views: dict[tuple[str, float, int], JsonObject]

    @property
    def difference(self) -> float:
        """Share of views without a right answer, Sun inside minus Sun outside."""
        return float(np.mean(self.outside) - np.mean(self.inside))

    def interval(self, rng: np.random.Generator) -> tuple[float, float]:
        """Return the 95 % interval of the difference, twins drawn again together."""
        draw = rng.integers(0, len(self.inside), (DRAWS, len(self.inside)))
        apart = (self.outside - self.inside)[draw].mean(axis=1)
        low, high = np.percentile(apart, PERCENT)
        return float(low), float(high)


def sun_in_frame(cache: TaskCache) -> dict[tuple[str, str], GlareOutcome]:
    """Do the experiment: outcomes by lens and exposure."""
    cameras = {f"{lens}, {exposure}": _camera(lens, exposure) for lens, exposure in product(LENSES, (FIXED, AUTOMATIC))}
    items = {}
    for (place, azimuth), zenith, (number, (pitch, roll)) in product(
        AZIMUTHS_DEG.items(), ZENITH_DEG, enumerate(ATTITUDES_DEG)
    ):
        tables = {
            "platform": {"altitude_km": ALTITUDE_KM, "heading_deg": HEADING_DEG},
            "sun": {"zenith_deg": zenith, "azimuth_deg": azimuth},
            "attitude": {"pitch_deg": pitch, "roll_deg": roll},
        }
        items[f"{place}, Sun at {zenith:g} deg, attitude {number}"] = {
            "cameras": cameras,
            "scene": scene(f"sun-{place}-{zenith:g}-{number}", air=True, **tables),
            "seed": cache.seed,
            "picture": number == 0 and place == "inside",
        }
    found = cache.each("B: Sun inside and outside the frame", views, items)
    keys = list(product(AZIMUTHS_DEG, ZENITH_DEG, range(len(ATTITUDES_DEG))))
    outcomes = {}
    for lens, exposure in product(LENSES, (FIXED, AUTOMATIC)):
        seen = {key: one[f"{lens}, {exposure}"] for key, one in zip(keys, found.values(), strict=True)}
        right = {
            place: np.array([float(is_right(one)) for (where, _, _), one in seen.items() if where == place])
            for place in AZIMUTHS_DEG
        }
        outcomes[lens, exposure] = GlareOutcome(right["inside"], right["outside"], seen)
    return outcomes


def is_right(one: JsonObject) -> bool:
    """Whether a view was answered within the limit."""
    return float(one["error_deg"].get("SIGHT", math.inf)) <= LIMIT_DEG


def _camera(lens: str, exposure: str) -> JsonObject:
    optics = glare_optics(**(ORDINARY_SHARES if lens == ORDINARY else {}))
    camera = pair(WIDTH_PX, tables=None if lens == CLEAN else {"optics": optics})
    if exposure == AUTOMATIC:
        camera["detector"] = {**camera["detector"], "auto_exposure": AUTO}
    return camera
