"""Rows and tables of the applicability region: the model's error, what its vectors join, and the real Earth."""

from __future__ import annotations

from typing import Any

import numpy as np

from horizonval.estimation.methods.video_vertical import END_PIXELS, PIXEL_SIGMA_PX, ChordEnds
from horizonval.geometry.camera import camera_from_spec
from horizonval.spec.camera import CameraSpec
from horizonval.systems.b.pair.applicability import (
    PUBLISHED,
    REGION_DEG,
    Applicability,
    Map,
    rms,
    share_answered,
)
from horizonval.systems.b.pair.frames import FIELD_DEG, pair
from horizonval.systems.result import ComparisonRow, Table
from horizonval.systems.text import page_text

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
