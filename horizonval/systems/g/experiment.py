"""System G: a static quadrant sensor as a rain-measuring satellite had one, designed for 350 km and flown at 402.5 km.

Requirement and altitudes are the mission's; layout, gains and sizes are ours, by a rule that sees 350 km only.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure as MplFigure

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.systems.g.design import (
    BAND_UM,
    DESIGN_KM,
    ETA_RAD,
    HALF_AZIMUTH_RAD,
    TILT_RAD,
    Processing,
    QuadrantDesign,
    design,
    limb_profiles,
    sectors,
    width_rad,
    working_range_rad,
)
from horizonval.systems.g.errors import LEVEL, TILTS_DEG, AltitudeErrors, by_altitude, fly
from horizonval.systems.published import page_text, published
from horizonval.systems.result import Cell, Claim, ComparisonRow, Reproduction, Status, Table
from horizonval.systems.task_cache import TaskCache
from horizonval.systems.weather_viewpoints import WeatherPlace, weather_places

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000")


def draw_fields(design: QuadrantDesign, sectors: Mapping[float, FloatArray], raised_km: float) -> MplFigure:
    """The mean limb in the body at both altitudes, over the fields."""
    figure = MplFigure(figsize=(9.0, 3.4), layout="constrained")
    axes = figure.subplots()
    for name, (low, high) in design.layout.fields().items():
        axes.axvspan(*np.degrees([low, high]), color="#bbbbbb", alpha=0.6 if name == "A" else 0.3, lw=0.0)
        axes.annotate(name, (np.degrees(0.5 * (low + high)), 0.35), ha="center", fontsize=11)
    for (altitude, seen), colour in zip(sectors.items(), COLOURS, strict=False):
        low, mean, high = np.percentile(seen, [5, 50, 95], axis=(0, 1))
        style = "-" if altitude in (DESIGN_KM, raised_km) else ":"
        axes.plot(np.degrees(ETA_RAD), mean, style, color=colour, label=f"{altitude:g} km")
        axes.fill_between(np.degrees(ETA_RAD), low, high, color=colour, alpha=0.2, lw=0.0)
    axes.set(xlabel="nadir angle in the body [deg]", ylabel="W m⁻² sr⁻¹", ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=8)
    return figure


def draw_altitudes(
    flown: Mapping[str, Sequence[AltitudeErrors]], requirement_deg: float, raised_km: float
) -> MplFigure:
    """Error, lift and scale against altitude."""
    figure = MplFigure(figsize=(9.0, 6.4), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
    for (name, found), colour in zip(flown.items(), COLOURS, strict=False):
        km = [one.altitude_km for one in found]
        axes[0].plot(km, [one.level_deg for one in found], "-o", ms=3, color=colour, label=f"{name}, level")
        axes[0].plot(km, [one.tilted_deg for one in found], "--s", ms=3, color=colour, label=f"{name}, up to 0.5 deg")
        axes[0].plot(km, [one.unchecked_deg for one in found], ":^", ms=3, color=colour)
        axes[1].plot(km, [100.0 * one.out_of_range for one in found], "-o", ms=3, color=colour)
        axes[1].plot(km, [100.0 * one.refused for one in found], "--s", ms=3, color=colour)
        axes[2].plot(km, [one.scale for one in found], "-o", ms=3, color=colour)
    axes[0].axhline(requirement_deg, color="#000000", lw=0.9, ls="-.")
    for panel in axes:
        for at in (DESIGN_KM, raised_km):
            panel.axvline(at, color="#000000", lw=0.6, ls=":")
    axes[0].set(ylabel="3 sigma [deg]", ylim=(0.0, None))
    axes[1].set_ylabel("out of range,\nrefused [%]")
    axes[2].set(ylabel="reading / tilt", xlabel="altitude [km]")
    axes[0].legend(frameon=False, fontsize=8)
    return figure


def draw_widths(widths_deg: FloatArray, errors: Mapping[str, FloatArray], requirement_deg: float) -> MplFigure:
    """Error against the width of the field across the limb."""
    figure = MplFigure(figsize=(9.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for k, (name, found) in enumerate(errors.items()):
        axes.plot(widths_deg, found, ("-", "--")[k % 2] + "o", ms=3, color=COLOURS[k // 2], label=name)
    axes.axhline(requirement_deg, color="#000000", lw=0.9, ls="-.")
    axes.set(xlabel="width of the field across the limb [deg]", ylabel="3 sigma [deg]", ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=8)
    return figure


def draw_months(flown: Mapping[str, AltitudeErrors], requirement_deg: float) -> MplFigure:
    """Error of level bodies by month."""
    figure = MplFigure(figsize=(9.0, 3.0), layout="constrained")
    axes = figure.subplots()
    for (name, one), colour in zip(flown.items(), COLOURS, strict=False):
        axes.plot(range(1, 13), one.month_deg, "-o", ms=3, color=colour, label=name)
    axes.axhline(requirement_deg, color="#000000", lw=0.9, ls="-.")
    axes.set(xlabel="month", ylabel="3 sigma, level [deg]", xticks=range(1, 13), ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=8)
    return figure


TEXT = page_text("G")
PRINTED = published("G")
INCLINATION_DEG = PRINTED.number("inclination")
REQUIREMENT_DEG = PRINTED.number("requirement")
RAISED_KM = PRINTED.number("raised")
ALTITUDES_KM = (340.0, DESIGN_KM, 360.0, 370.0, 380.0, 390.0, RAISED_KM, 410.0)
PLACES = 96
WIDTHS_DEG = (2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0, 8.0)
PROCESSINGS: tuple[Processing, ...] = ("normalised", "plain")
REFUSALS = 0.01
"""Share of readings without an answer from which a sensor has failed, whatever the others say."""

Flown = Mapping[Processing, Sequence[AltitudeErrors]]


def reproduce(cache: TaskCache) -> Reproduction:
    """Design at 350 km, fly everywhere, and return rows, claims, tables and figures."""
    items = weather_places(PLACES, INCLINATION_DEG, cache.seed)
    made = cache.each("G: limbs", limb_profiles, limb_items(items))
    places = [WeatherPlace.of(item) for item in items.values()]
    profiles = np.array([one["radiance"] for one in made.values()])
    seen = {km: _seen(places, km, profiles[:, i]) for i, km in enumerate(ALTITUDES_KM)}
    at_design, level = profiles[:, ALTITUDES_KM.index(DESIGN_KM)], seen[DESIGN_KM][:, LEVEL]
    designs = {p: design(places, at_design, level, p) for p in PROCESSINGS}
    flown = {p: by_altitude(d, places, seen) for p, d in designs.items()}
    widths: dict[str, list[AltitudeErrors]] = {}
    for p in PROCESSINGS:
        for km in (DESIGN_KM, RAISED_KM):
            name = TEXT.phrase("at", processing=TEXT.phrase(p), km=km)
            widths[name] = [
                fly(design(places, at_design, level, p, math.radians(w)), places, km, seen[km]) for w in WIDTHS_DEG
            ]
    ours = designs["normalised"]
    rows = tuple(_rows(designs, flown))
    found = {p: {one.altitude_km: one for one in found} for p, found in flown.items()}
    return TEXT.reproduction(
        rows=rows,
        tables=[_altitude_table(flown), _width_table(widths)],
        figures=[
            TEXT.figure("fields", partial(draw_fields, ours, _levels(seen), RAISED_KM)),
            TEXT.figure(
                "altitudes",
                partial(
                    draw_altitudes,
                    {TEXT.phrase(p): one for p, one in flown.items()},
                    REQUIREMENT_DEG,
                    RAISED_KM,
                ),
            ),
            TEXT.figure(
                "widths",
                partial(
                    draw_widths,
                    np.array(WIDTHS_DEG),
                    {name: np.array([one.tilted_deg for one in each]) for name, each in widths.items()},
                    REQUIREMENT_DEG,
                ),
            ),
            TEXT.figure(
                "months",
                partial(
                    draw_months,
                    {
                        TEXT.phrase("at", processing=TEXT.phrase(p), km=km): found[p][km]
                        for p in PROCESSINGS
                        for km in (DESIGN_KM, RAISED_KM)
                    },
                    REQUIREMENT_DEG,
                ),
            ),
        ],
        settings={
            "band_um": BAND_UM,
            "inclination_deg": INCLINATION_DEG,
            "altitudes_km": ALTITUDES_KM,
            "places": PLACES,
            "tilts_deg": TILTS_DEG,
            "fields_deg": {name: np.degrees(ends).tolist() for name, ends in ours.layout.fields().items()},
            "half_azimuth_deg": math.degrees(HALF_AZIMUTH_RAD),
            "range_deg": math.degrees(ours.range_rad),
        },
        claims=_claims(flown, widths),
        places=PLACES,
        width=math.degrees(ours.layout.width_rad),
        limb=math.degrees(ours.layout.limb_rad),
        height=ours.limb.height_m / 1e3,
        low=found["normalised"][DESIGN_KM],
        high=found["normalised"][RAISED_KM],
        plain_low=found["plain"][DESIGN_KM],
        plain_high=found["plain"][RAISED_KM],
        failed=failed(found["normalised"][RAISED_KM]),
        plain_failed=failed(found["plain"][RAISED_KM]),
        requirement=REQUIREMENT_DEG,
        compared=_compared(widths),
    )


def failed(errors: AltitudeErrors) -> bool:
    """Whether a sensor misses the requirement, level or tilted by half a degree, or often has no answer."""
    met = errors.tilted_deg <= REQUIREMENT_DEG and errors.level_deg <= REQUIREMENT_DEG
    return not met or errors.refused > REFUSALS


def _seen(places: Sequence[WeatherPlace], altitude_km: float, profiles: FloatArray) -> FloatArray:
    """Return sectors, shape (places, tilts, 4, n)."""
    tilts = [(math.radians(pitch), math.radians(roll)) for pitch, roll in TILTS_DEG]
    return np.array(
        [
            [sectors(place, altitude_km, radiance, pitch, roll) for pitch, roll in tilts]
            for place, radiance in zip(places, profiles, strict=True)
        ]
    )


def _levels(seen: Mapping[float, FloatArray]) -> dict[float, FloatArray]:
    return {km: seen[km][:, LEVEL] for km in (DESIGN_KM, RAISED_KM)}


def _compared(widths: Mapping[str, Sequence[AltitudeErrors]]) -> str:
    """Return, as text, which widths (normalised) do at the one altitude and at the other."""

    def good(km: float) -> str:
        name = TEXT.phrase("at", processing=TEXT.phrase("normalised"), km=km)
        found = [f"{w:g}" for w, one in zip(WIDTHS_DEG, widths[name], strict=True) if not failed(one)]
        return ", ".join(found) or TEXT.phrase("none")

    return TEXT.phrase("compared", low=good(DESIGN_KM), high=good(RAISED_KM))


def limb_items(places: Mapping[str, JsonObject], altitudes_km: Sequence[float] = ALTITUDES_KM) -> dict[str, JsonObject]:
    """Return the items of all limbs by name."""
    return {name: {**place, "altitudes_km": altitudes_km} for name, place in places.items()}


def rows_of_limbs(
    profiles: FloatArray, altitudes_km: Sequence[float], items: Mapping[str, JsonObject]
) -> list[ComparisonRow]:
    """Return all rows of the limbs of some places; ``altitudes_km`` include the mission's two.

    ``profiles``: shape (places, altitudes, 4, rays), of :func:`horizonval.systems.g.design.limb_profiles`.
    """
    places = [WeatherPlace.of(item) for item in items.values()]
    seen = {km: _seen(places, km, profiles[:, i]) for i, km in enumerate(altitudes_km)}
    at_design, level = profiles[:, list(altitudes_km).index(DESIGN_KM)], seen[DESIGN_KM][:, LEVEL]
    designs = {p: design(places, at_design, level, p) for p in PROCESSINGS}
    return list(_rows(designs, {p: by_altitude(d, places, seen) for p, d in designs.items()}))


def _rows(designs: Mapping[Processing, QuadrantDesign], flown: Flown) -> Iterator[ComparisonRow]:
    ours = designs["normalised"]
    yield TEXT.row(
        "width",
        math.degrees(width_rad(ours.limb)),
        tilt=math.degrees(TILT_RAD),
        range=math.degrees(working_range_rad()),
        half=math.degrees(ours.limb.half_rad),
        limb=math.degrees(ours.layout.limb_rad),
    )
    for p in PROCESSINGS:
        by_km = {one.altitude_km: one for one in flown[p]}
        sigma = math.degrees(designs[p].sigma_rad)
        low, high = by_km[DESIGN_KM], by_km[RAISED_KM]
        for key, limit in (("low", REQUIREMENT_DEG if p == "normalised" else None), ("high", None)):
            one = low if key == "low" else high
            yield TEXT.row(
                key,
                one.tilted_deg,
                REQUIREMENT_DEG,
                limit=limit,
                processing=TEXT.phrase(p),
                level=one.level_deg,
                worst=one.worst_deg,
                refused=one.refused,
                level_refused=one.refused_level,
                unchecked=one.unchecked_deg,
                low=one.low_deg,
                high=one.high_deg,
                out=one.out_of_range,
                lift=one.lift_deg,
                scale=one.scale,
                sigma=sigma,
                places=PLACES,
                km=one.altitude_km,
            )


def _claims(flown: Flown, widths: Mapping[str, Sequence[AltitudeErrors]]) -> Iterator[Claim]:
    by_km = {one.altitude_km: one for one in flown["normalised"]}
    low, high = by_km[DESIGN_KM], by_km[RAISED_KM]
    met = Status.BOUNDED if low.tilted_deg <= REQUIREMENT_DEG else Status.CONTRADICTED
    yield TEXT.claim(
        "requirement",
        REQUIREMENT_DEG,
        met,
        tilted=low.tilted_deg,
        level=low.level_deg,
        low=low.low_deg,
        high=low.high_deg,
    )
    predicted = Status.BOUNDED if failed(high) else Status.CONTRADICTED
    yield TEXT.claim(
        "raised",
        str(PRINTED.figures["fate"].value),
        predicted,
        figure="fate",
        tilted=high.tilted_deg,
        level=high.level_deg,
        out=high.out_of_range,
        refused=high.refused,
        level_refused=high.refused_level,
        unchecked=high.unchecked_deg,
        compared=_compared(widths),
    )
    yield TEXT.claim("interference", str(PRINTED.figures["interference"].value), Status.NOT_DETERMINABLE)


def _altitude_table(flown: Flown) -> Table:
    def lines() -> Iterator[list[Cell]]:
        for processing, found in flown.items():
            for one in found:
                yield [TEXT.phrase(processing), one.altitude_km, *_cells(one), _known(one.lift_deg), _known(one.scale)]

    return TEXT.table("altitudes", lines(), places=PLACES)


def _width_table(widths: Mapping[str, Sequence[AltitudeErrors]]) -> Table:
    def lines() -> Iterator[list[Cell]]:
        for name, found in widths.items():
            for width, one in zip(WIDTHS_DEG, found, strict=True):
                yield [name, width, *_cells(one), _known(one.scale)]

    return TEXT.table("widths", lines())


def _cells(one: AltitudeErrors) -> list[Cell]:
    errors = [_known(value) for value in (one.level_deg, one.tilted_deg, one.unchecked_deg)]
    return [*errors, 100.0 * one.out_of_range, 100.0 * one.refused, 100.0 * one.refused_level]


def _known(value: float) -> float | None:
    """Return a number for a table, None where there is none."""
    return value if math.isfinite(value) else None
