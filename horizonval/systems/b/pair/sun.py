"""The Sun in the frame: from high above the field of the forward camera down to the limb, and through it."""

from __future__ import annotations

import math

from horizonval.core.json_types import JsonObject
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.systems.b.pair.frames import ALTITUDE_KM, FIELD_DEG, glare_optics, pair, scene, view
from horizonval.systems.task_cache import TaskCache

ZENITH_DEG = (30.0, 60.0, 80.0, 90.0, 98.0, 104.0, 109.0, 112.0)
HIGHEST_IN_FRAME_DEG = 90.0 - 0.5 * FIELD_DEG
"""Zenith angle at the upper edge of the forward camera, whose boresight is level."""
LIMB_ZENITH_DEG = 180.0 - math.degrees(math.asin(MEAN_RADIUS_M / (MEAN_RADIUS_M + ALTITUDE_KM * 1e3)))
"""Of the hard horizon, to a tenth of a degree for the ellipsoid."""
AZIMUTH_DEG = 80.0
HEADING_DEG = 90.0
WIDTH_PX = 512
GOOD, HAZY = "good lens", "hazy lens"
HAZE = {"scattered": 0.05, "ghost": 1e-3}
"""A lens without coating or baffle, as small satellites fly them; the good one scatters 0.3 %, its ghost is 1e-4."""


def sun_in_frame(cache: TaskCache) -> dict[str, dict[float, JsonObject]]:
    """Do the experiment: what the method makes of each height of the Sun, by lens and by zenith angle [deg]."""
    found: dict[str, dict[float, JsonObject]] = {}
    for lens, shares in ((GOOD, {}), (HAZY, HAZE)):
        items = {}
        for zenith in ZENITH_DEG:
            tables = {
                "platform": {"altitude_km": ALTITUDE_KM, "heading_deg": HEADING_DEG},
                "sun": {"zenith_deg": zenith, "azimuth_deg": AZIMUTH_DEG},
            }
            items[f"{zenith:g}"] = {
                "camera": pair(WIDTH_PX, tables={"optics": glare_optics(**shares)}),
                "scene": scene(f"sun-{zenith:g}", air=True, **tables),
                "seed": cache.seed,
                "picture": True,
                "searched": True,
            }
        results = cache.each(f"B: Sun in the frame, {lens}", view, items)
        found[lens] = dict(zip(ZENITH_DEG, results.values(), strict=True))
    return found
