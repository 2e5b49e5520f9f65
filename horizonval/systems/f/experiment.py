"""System F: a conical scanner of the seventies, in the carbon dioxide band and in a window, under clear sky and clouds.

The publication names cold clouds as the principal cause of its two scanners' noise. Here the same scan is made with and
without clouds, so that what they add is a difference and no guess.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure as MplFigure

from horizonval.core.json_types import JsonObject
from horizonval.systems.f.errors import (
    THRESHOLDS,
    BandErrors,
    band_errors,
    plateau_deficits,
    signal_of,
    worst_error_deg,
)
from horizonval.systems.f.scan_cone import (
    ALTITUDE_KM,
    BANDS,
    CO2,
    ELECTRONICS,
    FRACTION,
    INCLINATION_DEG,
    PLACES,
    WINDOW,
    scan,
)
from horizonval.systems.published import page_text, published
from horizonval.systems.result import Claim, ComparisonRow, Reproduction, Status, Table
from horizonval.systems.task_cache import TaskCache
from horizonval.systems.weather_viewpoints import weather_places

COLOURS = {CO2: "#0072b2", WINDOW: "#d55e00"}


def draw_scans(scans: Mapping[str, Mapping[str, JsonObject]]) -> MplFigure:
    """The signal of the cloudiest scan in both bands, clear and under clouds."""
    figure = MplFigure(figsize=(9.0, 5.0), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    cloudiest = max(scans[WINDOW], key=lambda name: float(scans[WINDOW][name]["covered"]))
    for panel, band in zip(axes, (CO2, WINDOW), strict=True):
        one = scans[band][cloudiest]
        phase = np.array(one["phase_rad"])
        for sky, style in (("clear", "--"), ("clouds", "-")):
            signal = signal_of(phase, np.array(one[sky]))
            panel.plot(np.degrees(signal.phase_rad), signal.value, style, color=COLOURS[band], lw=1.2, label=sky)
        top = float(np.max(one["clear"]))
        panel.axhline(FRACTION * top, color="#000000", lw=0.7, ls=":")
        panel.set(title=band, ylabel="W m⁻² sr⁻¹", ylim=(0.0, None))
        panel.legend(frameon=False, fontsize=8, loc="lower center")
    axes[-1].set_xlabel("phase of the scan from the nadir's [deg]")
    axes[-1].set_xlim(*(math.degrees(p) for p in (phase[0] - 0.1, phase[-1] + 0.2)))
    return figure


def draw_errors(errors: Mapping[str, Mapping[str, BandErrors]]) -> MplFigure:
    """Errors of all scans, clear and under clouds, pitch against roll."""
    figure = MplFigure(figsize=(9.0, 7.2), layout="constrained")
    axes = figure.subplots(2, 2)
    for row, band in zip(axes, errors, strict=True):
        for panel, kind in zip(row, THRESHOLDS, strict=True):
            one = errors[band][kind]
            for sky, mark in (("clear", "o"), ("clouds", "x")):
                panel.plot(one.pitch[sky], one.roll[sky], mark, ms=4, mfc="none", color=COLOURS[band], label=sky)
            panel.axhline(0.0, color="#000000", lw=0.5)
            panel.axvline(0.0, color="#000000", lw=0.5)
            panel.set(title=f"{band}: {kind}", xlabel="pitch error [deg]", ylabel="roll error [deg]")
            panel.legend(frameon=False, fontsize=8)
    return figure


TEXT = page_text("F")
PRINTED = published("F")
HARD_LIMIT_DEG = 1e-3
LEAST_RATIO = 5.0
LEAST_CORRELATION = 0.7
"""The bars were set before any scan was made."""

Errors = Mapping[str, Mapping[str, BandErrors]]


def reproduce(cache: TaskCache) -> Reproduction:
    """Make the scans and return rows, claims, table and figures."""
    places = weather_places(PLACES, INCLINATION_DEG, cache.seed)
    made = cache.each("F: scans", scan, scan_items(places))
    scans = _by_band(made, places)
    errors, deficits = _measured(scans, places)
    rows = tuple(_rows(errors, deficits))
    return TEXT.reproduction(
        rows=rows,
        tables=[_table(errors)],
        figures=[
            TEXT.figure("scans", partial(draw_scans, scans)),
            TEXT.figure("errors", partial(draw_errors, errors)),
        ],
        settings={"altitude_km": ALTITUDE_KM, "inclination_deg": INCLINATION_DEG, **asdict(ELECTRONICS)},
        claims=_claims(errors, deficits),
        places=PLACES,
        window={kind: added_deg(errors[WINDOW][kind]) for kind in THRESHOLDS},
        co2={kind: added_deg(errors[CO2][kind]) for kind in THRESHOLDS},
        clear={kind: clear_deg(errors[CO2][kind]) for kind in THRESHOLDS},
        window_clear={kind: clear_deg(errors[WINDOW][kind]) for kind in THRESHOLDS},
        largest=max(
            float(np.nanmax(np.abs(errors[WINDOW][k].added(errors[WINDOW][k].worst_axis)))) for k in THRESHOLDS
        ),
    )


def scan_items(places: Mapping[str, JsonObject]) -> dict[str, JsonObject]:
    """Return the items of all scans by name."""
    return {
        f"{name}, {band}": {**place, "altitude_km": ALTITUDE_KM, "band_um": list(limits)}
        for band, limits in BANDS.items()
        for name, place in places.items()
    }


def rows_of_scans(made: Mapping[str, JsonObject], places: Mapping[str, JsonObject]) -> list[ComparisonRow]:
    """Return all rows of the scans of some places, by the names of :func:`scan_items`."""
    return list(_rows(*_measured(_by_band(made, places), places)))


def _by_band(made: Mapping[str, JsonObject], places: Mapping[str, JsonObject]) -> dict[str, dict[str, JsonObject]]:
    return {band: {name: made[f"{name}, {band}"] for name in places} for band in BANDS}


def _measured(
    scans: Mapping[str, Mapping[str, JsonObject]], places: Mapping[str, JsonObject]
) -> tuple[Errors, dict[str, np.ndarray]]:
    errors = {band: {kind: band_errors(scans[band], places, kind) for kind in THRESHOLDS} for band in BANDS}
    return errors, {band: plateau_deficits(scans[band]) for band in BANDS}


def added_deg(errors: BandErrors) -> float:
    """Return one standard deviation of what clouds add, in the worse axis."""
    return float(np.nanstd(errors.added(errors.worst_axis)))


def clear_deg(errors: BandErrors) -> float:
    """Return one standard deviation of the clear scans' errors, in the axis that clouds disturb more."""
    found = errors.pitch if errors.worst_axis == "pitch" else errors.roll
    return float(np.std(found["clear"]))


def correlation(errors: BandErrors, deficits: np.ndarray) -> float:
    """Return the correlation of the pitch that clouds add with the difference of both plateaus' deficits."""
    added = errors.added("pitch")
    known = np.isfinite(added)
    return float(np.corrcoef(added[known], (deficits[:, 0] - deficits[:, 1])[known])[0, 1])


def _rows(errors: Errors, deficits: Mapping[str, np.ndarray]) -> Iterator[ComparisonRow]:
    yield TEXT.row("hard_edge", worst_error_deg(), limit=HARD_LIMIT_DEG)
    for kind in THRESHOLDS:
        window, co2 = errors[WINDOW][kind], errors[CO2][kind]
        phrase = TEXT.phrase(kind)
        for band, one in ((WINDOW, window), (CO2, co2)):
            where: dict[str, Any] = {"band": band, "threshold": phrase, "axis": one.worst_axis, "places": PLACES}
            largest = float(np.nanmax(np.abs(one.added(one.worst_axis))))
            mean = float(np.nanmean(one.added(one.worst_axis)))
            yield TEXT.row("added", added_deg(one), largest=largest, mean=mean, **where)
            yield TEXT.row("clear", clear_deg(one), height=one.height_km, sigma=float(np.max(one.sigma)), **where)
        ratio = added_deg(window) / max(added_deg(co2), 1e-9)
        yield TEXT.row("ratio", ratio, limit=LEAST_RATIO, at_least=True, threshold=phrase)
        share = added_deg(window) / clear_deg(window)
        yield TEXT.row("principal", share, limit=1.0, at_least=True, threshold=phrase)
    yield TEXT.row(
        "correlation", abs(correlation(errors[WINDOW]["fraction"], deficits[WINDOW])), limit=LEAST_CORRELATION,
        at_least=True,
    )  # fmt: skip
    for band in BANDS:
        one = errors[band]["fixed"]
        yield TEXT.row("spare", float(one.spare), band=band, places=PLACES, refused=one.refused)


def _claims(errors: Errors, deficits: Mapping[str, np.ndarray]) -> Iterator[Claim]:
    def print_of(key: str) -> str:
        return str(PRINTED.figures[key].value)

    principal = all(added_deg(errors[WINDOW][k]) > clear_deg(errors[WINDOW][k]) for k in THRESHOLDS)
    yield TEXT.claim(
        "principal",
        print_of("principal"),
        Status.BOUNDED if principal else Status.CONTRADICTED,
        fixed=added_deg(errors[WINDOW]["fixed"]),
        fraction=added_deg(errors[WINDOW]["fraction"]),
        clear_fixed=clear_deg(errors[WINDOW]["fixed"]),
        clear_fraction=clear_deg(errors[WINDOW]["fraction"]),
        co2_fixed=added_deg(errors[CO2]["fixed"]),
        co2_fraction=added_deg(errors[CO2]["fraction"]),
        co2_clear=clear_deg(errors[CO2]["fraction"]),
    )
    for kind in THRESHOLDS:
        one = errors[WINDOW][kind]
        seen = added_deg(one) > float(np.max(one.sigma))
        yield TEXT.claim(
            kind,
            print_of(kind),
            Status.REPRODUCED if seen else Status.CONTRADICTED,
            added=added_deg(one),
            co2=added_deg(errors[CO2][kind]),
            sigma=float(np.max(one.sigma)),
            mean=float(np.nanmean(one.added(one.worst_axis))),
            axis=one.worst_axis,
        )
    found = abs(correlation(errors[WINDOW]["fraction"], deficits[WINDOW]))
    yield TEXT.claim("one_to_one", print_of("one_to_one"), Status.NOT_DETERMINABLE, found=found)
    yield TEXT.claim("size", print_of("size"), Status.NOT_DETERMINABLE, added=added_deg(errors[WINDOW]["fraction"]))


def _table(errors: Errors) -> Table:
    def lines() -> Iterator[list[str | float]]:
        for band, by_kind in errors.items():
            for kind, one in by_kind.items():
                for axis, found in (("pitch", one.pitch), ("roll", one.roll)):
                    added = one.added(axis)
                    yield [
                        band,
                        TEXT.phrase(kind),
                        axis,
                        float(np.mean(found["clear"])),
                        float(np.std(found["clear"])),
                        float(np.nanmean(added)),
                        float(np.nanstd(added)),
                        float(np.nanmax(np.abs(added))),
                    ]

    return TEXT.table("errors", lines(), places=PLACES)
