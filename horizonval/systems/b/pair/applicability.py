"""The applicability region: which attitudes the pair can answer, and how well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods.video_vertical import END_PIXELS, PIXEL_SIGMA_PX, ChordEnds
from horizonval.geometry.camera import camera_from_spec
from horizonval.spec.camera import CameraSpec
from horizonval.systems.b.pair.frames import FIELD_DEG, answered, attitude, pair, scene, view
from horizonval.systems.published import page_text, published
from horizonval.systems.result import ComparisonRow, Table
from horizonval.systems.task_cache import TaskCache

PUBLISHED = published("B")
REGION_DEG = 20.0
"""Half the side of the region that is looked at. Ours: the source shows a map and says "a wide range of angles"."""
LIMIT_DEG = 1.0
"""Largest error of an answer that is right. Ours as well."""
STEP_DEG = 10.0
LARGEST_DEG = 40.0
OVERHEAD = {"zenith_deg": 0.0, "azimuth_deg": 0.0}
HIGH_SUN = {"zenith_deg": 30.0, "azimuth_deg": 120.0}
ALTITUDES_KM = (300.0, 500.0, 800.0)


@dataclass(frozen=True)
class Map:
    """Errors ``found`` by :func:`.frames.view` over ``pitch_deg`` and ``yaw_deg``, shape (n,)."""

    pitch_deg: FloatArray
    yaw_deg: FloatArray
    found: list[JsonObject]

    def error_deg(self, reading: str = "SIGHT") -> FloatArray:
        """Return the nadir error of each attitude; NaN where there is no answer."""
        return np.array([one["error_deg"].get(reading, np.nan) for one in self.found])

    def values(self, key: str) -> FloatArray:
        """Return one figure of each attitude; NaN where there is none."""
        return np.array([np.nan if (value := one.get(key)) is None else value for one in self.found])

    def within(self, half_deg: float) -> NDArray[np.bool_]:
        """Return which attitudes lie in the square of this half side."""
        return (np.abs(self.pitch_deg) <= half_deg) & (np.abs(self.yaw_deg) <= half_deg)

    def half_side_deg(self, limit_deg: float = LIMIT_DEG) -> float:
        """Return the half side of the largest square about zero that is answered throughout, within the limit."""
        wrong = ~(self.error_deg() < limit_deg)
        reach = np.maximum(np.abs(self.pitch_deg), np.abs(self.yaw_deg))
        good = reach[~wrong & (reach < reach[wrong].min())] if wrong.any() else reach
        return float(good.max()) if len(good) else 0.0

    def horizon_missed(self) -> NDArray[np.bool_]:
        """Return where the true horizon touches neither a quarter of the image's width in one camera or the other."""
        return np.array([min(one["in_view_px"].values()) < 1.0 for one in self.found])


def rms(values: FloatArray) -> float:
    """Return the root mean square of what is finite."""
    kept = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(kept**2))) if len(kept) else float("nan")


def grid(step_deg: float, largest_deg: float = LARGEST_DEG, *, finer_within_deg: float | None = None) -> FloatArray:
    """Return pitch and yaw, shape (n, 2): a square grid, with the middles of its cells too inside a smaller square."""
    axis = np.arange(-largest_deg, largest_deg + 0.5 * step_deg, step_deg)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    if finer_within_deg is None:
        return points
    middles = np.arange(-finer_within_deg + 0.5 * step_deg, finer_within_deg, step_deg)
    return np.concatenate([points, np.stack(np.meshgrid(middles, middles, indexing="ij"), axis=-1).reshape(-1, 2)])


def measured_map(
    cache: TaskCache, title: str, camera: JsonObject, attitudes: FloatArray, scenery: JsonObject | None = None
) -> Map:
    """Return the map of one camera pair over one kind of Earth."""
    changes = {"air": False, "sun": OVERHEAD, **(scenery or {})}
    items = {}
    for pitch, yaw in attitudes:
        name = f"pitch{pitch:g}-yaw{yaw:g}"
        items[name] = {
            "camera": camera,
            "scene": scene(name, attitude=attitude(float(pitch), float(yaw)), **changes),
            "seed": cache.seed,
        }
    results = cache.each(title, view, items)
    return Map(attitudes[:, 0], attitudes[:, 1], list(results.values()))


@dataclass(frozen=True)
class Applicability:
    """All maps: as published, the shipped field, and the way to the real Earth at half the resolution."""

    model: Map
    shipped: Map
    coarse: Mapping[str, Map]
    by_altitude: Mapping[float, Map]


def applicability(cache: TaskCache) -> Applicability:
    """Do the experiment: the published model, then what each departure from it does."""
    model = measured_map(cache, "B: map, sphere", pair(), grid(STEP_DEG, finer_within_deg=REGION_DEG))
    shipped = measured_map(cache, "B: map, 60 deg", pair(field_deg=60.0), grid(STEP_DEG, REGION_DEG))
    bare = {"earth": {"shape": "wgs84"}, "platform": {"altitude_km": 500.0, "latitude_deg": 45.0}}
    sceneries: dict[str, JsonObject] = {
        "sphere, no air": {},
        "WGS84, no air": bare,
        "WGS84, air": {"air": True, "sun": HIGH_SUN},
    }
    coarse = {
        name: measured_map(cache, f"B: map, {name}", pair(512), grid(2 * STEP_DEG), scenery)
        for name, scenery in sceneries.items()
    }
    by_altitude = {
        altitude: measured_map(
            cache,
            f"B: {altitude:g} km",
            pair(),
            grid(STEP_DEG, STEP_DEG),
            {"platform": {"altitude_km": altitude}},
        )
        for altitude in ALTITUDES_KM
    }
    return Applicability(model, shipped, coarse, by_altitude)


def share_answered(one: Map) -> float:
    """Return the share of a map's attitudes that got an answer."""
    return float(np.mean([answered(found) for found in one.found]))


TEXT = page_text("B")
MODEL_RMS_DEG = PUBLISHED.number("model_rms")
SMALLEST_SQUARE_DEG = 10.0


def region_summary(region: Applicability) -> dict[str, float]:
    """Return the rms errors [deg] inside the published region by what the vectors join, for the page's summary."""
    inside = region.model.within(REGION_DEG)
    errors = {
        ends: rms(region.model.error_deg(ends.name)[inside])
        for ends in (ChordEnds.PIXEL, ChordEnds.CIRCLE, ChordEnds.PLANE)
    }
    return {
        "half_side": REGION_DEG,
        "end_pixels": END_PIXELS,
        "mean": rms(region.model.error_deg()[inside]),
        "pixel": errors[ChordEnds.PIXEL],
        "circle": errors[ChordEnds.CIRCLE],
        "plane": errors[ChordEnds.PLANE],
    }


def region_rows(region: Applicability) -> list[ComparisonRow]:
    """Return the rows of the map over a sphere."""
    model = region.model
    inside = model.within(REGION_DEG)
    error = model.error_deg()
    finite = error[inside][np.isfinite(error[inside])]
    camera = camera_from_spec(CameraSpec.model_validate(pair()).camera)
    unanswered = np.isnan(error)
    return [
        TEXT.row(
            "model",
            rms(error[inside]),
            MODEL_RMS_DEG,
            limit=MODEL_RMS_DEG,
            end_pixels=END_PIXELS,
            cone=rms(model.error_deg("CONE")[inside]),
        ),
        TEXT.row(
            "model_single",
            rms(model.error_deg(ChordEnds.PIXEL.name)[inside]),
            MODEL_RMS_DEG,
            limit=MODEL_RMS_DEG,
            pixel_deg=float(np.degrees(PIXEL_SIGMA_PX / camera.fx)),
        ),
        TEXT.row("model_tilt", rms(model.values("tilt_error_deg")[inside])),
        TEXT.row(
            "region",
            model.half_side_deg(),
            missed=int(np.sum(unanswered & model.horizon_missed())),
            unanswered=int(unanswered.sum()),
        ),
        TEXT.row(
            "region_error",
            float(finite.max()) if len(finite) else 180.0,
            attitudes=len(finite),
        ),
        TEXT.row("region_shipped", region.shipped.half_side_deg()),
        TEXT.row("covariance", float(np.nanmean(model.values("nees")[inside]))),
    ]


def ends_table(model: Map) -> Table:
    """Return the table of what the end points are taken to be."""
    inside = model.within(REGION_DEG)
    names = {ends.name: ends.value for ends in ChordEnds} | {"CONE": TEXT.phrase("cone")}
    errors = {description: model.error_deg(key)[inside] for key, description in names.items()}
    lines = [(description, rms(error), float(np.nanmax(error))) for description, error in errors.items()]
    return TEXT.table("ends", lines, half_side=REGION_DEG, circle_px=rms(model.values("circle_px")[inside]))


def earth_table(region: Applicability) -> Table:
    """Return the table of altitudes, fields and Earths."""
    maps: dict[str, Map] = {
        f"{FIELD_DEG:g} deg, 1024 px, sphere": region.model,
        "60 deg, 1024 px, sphere": region.shipped,
        **{f"{FIELD_DEG:g} deg, 512 px, {name}": one for name, one in region.coarse.items()},
        **{f"{FIELD_DEG:g} deg, 1024 px, sphere, {km:g} km": one for km, one in region.by_altitude.items()},
    }

    def line(name: str, one: Map) -> tuple[Any, ...]:
        half_side = max(min(REGION_DEG, float(np.abs(one.pitch_deg).max())), SMALLEST_SQUARE_DEG)
        inside = one.within(half_side)
        errors = (rms(one.error_deg()[inside]), rms(one.error_deg("CONE")[inside]))
        return name, f"+-{half_side:g}", share_answered(one), *errors, float(np.nanmean(one.values("nees")[inside]))

    return TEXT.table("earth", [line(name, one) for name, one in maps.items()])
