"""System E: passive localisation of a satellite from two stations' angles (Hadinejad & Amiri 2020)."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.geometry.rotation import itrs_from_gcrs, turn
from horizonval.systems.e import case as noise
from horizonval.systems.e import figures as pictures
from horizonval.systems.e.case import (
    ENVISAT,
    EPOCH_UTC,
    METHODS,
    NOISE_ARCSEC,
    NOISE_ROUNDING_DEG,
    PUBLISHED_NOISE,
    PUBLISHED_ROUNDING,
    QUANTITIES,
    ROUNDING_DEG,
    STATIONS,
    WHITE_ARCSEC,
    Figures,
    NoiseReading,
    exact_pass,
    gathered,
    items_of,
    rounded,
    rounding_items,
    streak_items,
    work,
)
from horizonval.systems.e.figures import (
    TEXT,
    Rows,
    as_published,
    cases,
    factor_table,
    mean,
    meaning_table,
    noise_table,
    rounding_table,
    streak_table,
)
from horizonval.systems.e.from_frames import frames_part_of, located_from
from horizonval.systems.e.localisation.batch import triangulate
from horizonval.systems.e.localisation.pipeline import ALPHA, PUBLISHED_ALPHA, PUBLISHED_WIDTH_S, locate
from horizonval.systems.e.localisation.smoothing import smooth_clamped
from horizonval.systems.e.localisation.stations import celestial_errors
from horizonval.systems.e.passes.rows import frame_part
from horizonval.systems.result import Claim, ComparisonRow, Figure, Reproduction, Status
from horizonval.systems.task_cache import TaskCache

NEAR = 0.15
"""Share by which a plain figure may be off: another element set of the same satellite."""
FACTOR = 2.0
"""Factor by which the published order may miss its figures with the width chosen for it."""


def claims(rows: Rows, nearest: NoiseReading, draws: int) -> list[Claim]:
    """Return every printed error, judged: three at a time. Settings of the experiment are no results."""
    out = []
    for key, case, printed in cases():
        table = "rounding" if key.startswith("rounded") else "noise"
        plain = mean(rows, key, "plain")
        fields = {"case": case, "reading": nearest.description, "draws": str(draws), "measured": _three(plain)}
        off = float(np.abs(plain / np.array(printed["plain"]) - 1.0).max())
        near = Status.REPRODUCED if table == "rounding" else Status.BOUNDED
        status = near if off <= NEAR else Status.CONTRADICTED
        out.append(TEXT.claim(f"plain_{table}", _three(printed["plain"]), status, figure=table, **fields))
        smoothed, filtered = (as_published(rows, key, stage) for stage in (0, 1))
        ratio = smoothed / np.array(printed["proposed"])
        status = Status.BOUNDED if ratio.max() <= FACTOR and ratio.min() >= 1.0 / FACTOR else Status.CONTRADICTED
        fields |= {"smoothed": _three(smoothed), "filtered": _three(filtered)}
        fields |= {"best": _three(mean(rows, key, "proposed")), "batch": _three(mean(rows, key, "batch"))}
        out.append(TEXT.claim("proposed", _three(printed["proposed"]), status, figure=table, **fields))
    out.append(
        TEXT.claim("unit", "200, 300, 400 arcsec", Status.NOT_DETERMINABLE, figure="noise", reading=nearest.description)
    )
    return out


def _three(figures: FloatArray | Figures) -> str:
    """Return right ascension, declination and distance."""
    a, b, c = figures
    return f"{a:.3g}, {b:.3g} arcsec, {c:.2g} km"


DRAWS = 200
"""Independent passes for every figure of the noise table, and random rounding grids for the rounding table."""
FEWER_DRAWS = 40
"""Draws for the reading with the most noise, and for noise on top of measured streaks."""

_CLAMPED_S = 5.0


def reproduce(cache: TaskCache) -> Reproduction:
    """Do the experiment: rounding, noise, honesty of the covariances; then from rendered frames."""
    columns = {
        meaning: noise.plain_column(meaning, cache.rng("localisation", "meaning", meaning.description), DRAWS)
        for meaning in noise.MEANINGS
    }
    nearest = min(columns, key=lambda meaning: noise.distance(columns[meaning]))
    seed = cache.seed
    items = rounding_items(seed, DRAWS) | items_of("white", DRAWS, seed, kind="white")
    for name, meaning, draws in (("noisy", nearest, DRAWS), ("noisiest", noise.LARGEST, FEWER_DRAWS)):
        for amount in NOISE_ARCSEC:
            items |= items_of(
                f"{name} {amount:g}",
                draws,
                seed,
                kind="noisy",
                shape=meaning.shape,
                order=meaning.order,
                amount=amount,
                alphas=name == "noisy",
            )
    items |= items_of("exact", 1, seed, kind="exact")
    rows = dict(gathered(cache.each("localisation from angles", work, items)))
    frames = frame_part(cache, ENVISAT, STATIONS, EPOCH_UTC, exact_pass().times_s)
    from_frames = frames_part_of(frames.passes)
    _, measured, both = located_from(frames.passes)
    streaks = streak_items(seed, FEWER_DRAWS, nearest, measured.angles_rad, np.flatnonzero(both))
    rows |= dict(gathered(cache.each("localisation from streaks", work, streaks)))
    six = cases()

    def share(method: str) -> FloatArray:
        return np.array([mean(rows, key, method) / np.array(printed["proposed"]) for key, _, printed in six])

    return TEXT.reproduction(
        rows=(
            *_plain_rows(rows, nearest),
            *_proposed_rows(rows),
            *_published_rows(rows),
            *_check_rows(rows, nearest, columns),
            *from_frames.rows,
            *frames.rows,
        ),
        tables=(
            rounding_table(rows),
            noise_table(rows, nearest, DRAWS),
            factor_table(rows),
            streak_table(rows, FEWER_DRAWS),
            meaning_table(columns),
            from_frames.table,
            *frames.tables,
        ),
        figures=(*_figures(rows), from_frames.figure, *frames.figures),
        settings={
            "element_set": [ENVISAT.line1, ENVISAT.line2],
            "epoch_utc": EPOCH_UTC.isoformat(),
            "draws": DRAWS,
            "seed": seed,
            "forgetting_factor": ALPHA,
            "noise_meaning": nearest.description,
        },
        claims=claims(rows, nearest, DRAWS),
        published=np.array([as_published(rows, k, 0) / np.array(p["proposed"]) for k, _, p in six]),
        published_filtered=np.array([as_published(rows, k, 1) / np.array(p["proposed"]) for k, _, p in six]),
        kernels={q: rows[f"rounded {q:g}"]["kernel"][0][1] for q in ROUNDING_DEG},
        proposed=share("proposed"),
        batch=share("batch"),
        readings=len(columns),
        nearest=nearest.description,
        distance=noise.distance(columns[nearest]),
        frames=from_frames.summary,
    )


def rounding_rows(cache: TaskCache) -> list[ComparisonRow]:
    """Return the rows of the rounding table, in which nothing is drawn."""
    own = {name: item for name, item in rounding_items(cache.seed, 1).items() if item["kind"] == "rounded"}
    items = {name: {**item, "alphas": False} for name, item in own.items()}
    rows = dict(gathered(cache.each("E: rounding", work, items)))
    return [*_plain_rows(rows, noise.LARGEST), *_proposed_rows(rows), *_published_rows(rows)]


def _known_cases(rows: Rows) -> list[tuple[str, str, dict[str, Figures]]]:
    """Return the published rows that were computed."""
    return [one for one in cases() if one[0] in rows]


def _plain_rows(rows: Rows, nearest: noise.NoiseReading) -> list[ComparisonRow]:
    out = []
    for key, case, printed in _known_cases(rows):
        rounded_only = key.startswith("rounded")
        for (quantity, unit), theirs, ours in zip(QUANTITIES, printed["plain"], mean(rows, key, "plain"), strict=True):
            out.append(
                TEXT.row(
                    "plain_rounded" if rounded_only else "plain_noisy",
                    float(ours),
                    theirs,
                    limit=0.15 * theirs if rounded_only else None,
                    against=theirs,
                    case=case,
                    quantity=quantity,
                    unit=unit,
                    apart=ours / theirs - 1.0,
                    reading=nearest.description,
                    passes=len(rows[key]["rms"]),
                )
            )
    return out


def _proposed_rows(rows: Rows) -> list[ComparisonRow]:
    out = []
    for key, case, printed in _known_cases(rows):
        columns = {method: mean(rows, key, method) for method in METHODS}
        for i, ((quantity, unit), theirs) in enumerate(zip(QUANTITIES, printed["proposed"], strict=True)):
            ours: dict[str, Any] = {method: float(column[i]) for method, column in columns.items()}
            names: dict[str, Any] = {"case": case, "quantity": quantity, "unit": unit}
            out.append(TEXT.row("proposed", ours["proposed"], theirs, limit=theirs, **names, **ours))
    return out


def _published_rows(rows: Rows) -> list[ComparisonRow]:
    """Return the published order with the published factor, beside what is printed for it."""
    out = []
    for key, case, printed in _known_cases(rows):
        smoothed, filtered = (as_published(rows, key, stage) for stage in (0, 1))
        for i, ((quantity, unit), theirs) in enumerate(zip(QUANTITIES, printed["proposed"], strict=True)):
            names: dict[str, Any] = {"case": case, "quantity": quantity, "unit": unit, "passes": len(rows[key]["rms"])}
            ratio = float(smoothed[i] / theirs)
            fields: dict[str, Any] = {"alpha": PUBLISHED_ALPHA, "width_s": PUBLISHED_WIDTH_S, "ratio": ratio}
            out.append(
                TEXT.row("as_published", float(smoothed[i]), theirs, filtered=float(filtered[i]), **names, **fields)
            )
    return out


def _check_rows(
    rows: Rows, nearest: noise.NoiseReading, columns: dict[noise.NoiseReading, FloatArray]
) -> list[ComparisonRow]:
    def beaten(row: str, method: str, printed: Figures) -> int:
        return int(np.sum(mean(rows, row, method) <= np.array(printed)))

    six = cases()
    wins: dict[str, Any] = {m: sum(beaten(key, m, printed["proposed"]) for key, _, printed in six) for m in METHODS}
    noisiest, shifted = (
        sum(beaten(f"{row} {setting:g}", "proposed", printed[i]) for i, setting in enumerate(settings))
        for row, settings, printed in (
            ("noisiest", NOISE_ARCSEC, PUBLISHED_NOISE["proposed"]),
            ("shifted", ROUNDING_DEG, PUBLISHED_ROUNDING["proposed"]),
        )
    )
    streaks: dict[str, Any] = {
        m: sum(beaten(f"streaks {key}", m, printed["proposed"]) for key, _, printed in six) for m in METHODS
    }
    largest = columns[noise.LARGEST]
    clamped = float(pictures.clamped_bias(_CLAMPED_S)[[0, -1]].max())
    out = [
        TEXT.row("beaten_proposed", wins["proposed"], 18, limit=18, at_least=True, **wins),
        TEXT.row("beaten_batch", wins["batch"], limit=18, at_least=True),
        TEXT.row("beaten_streaks", streaks["proposed"], 18, limit=18, at_least=True, **streaks),
        TEXT.row(
            "beaten_largest_noise",
            noisiest,
            reading=noise.LARGEST.description,
            factor=np.exp(np.mean(np.log(largest / np.array(PUBLISHED_NOISE["plain"])))),
        ),
        TEXT.row("beaten_shifted", shifted, places=len(rows["shifted 1"]["rms"])),
        TEXT.row(
            "reading",
            100.0 * noise.distance(columns[nearest]),
            reading=nearest.description,
            readings=len(columns),
        ),
        TEXT.row("clamped", clamped, width_s=_CLAMPED_S, station=STATIONS[0].name),
        TEXT.row("exact", float(mean(rows, "exact", "proposed")[1])),
    ]
    squares = rows["white"]["squares"]
    low, high = (float(stats.chi2.ppf(p, 3 * len(squares)) / len(squares)) for p in (0.005, 0.995))
    for method, column in zip(METHODS[2:], squares.T, strict=True):
        out.append(
            TEXT.row(
                "covariance",
                float(column.mean()),
                limit=(high - low) / 2.0,
                against=(high + low) / 2.0,
                method=method,
                noise_arcsec=WHITE_ARCSEC,
                passes=len(column),
                low=low,
                high=high,
            )
        )
    return out


def _figures(rows: Rows) -> tuple[Figure, ...]:
    truth = exact_pass()
    measured = truth.measured(rounded(truth.angles_rad, NOISE_ROUNDING_DEG))
    located = locate(measured)
    clamped = [smooth_clamped(truth.times_s, u, _CLAMPED_S) for u in measured.directions_itrs]
    back = np.swapaxes(itrs_from_gcrs(EPOCH_UTC, truth.times_s), -1, -2)
    positions = {
        "plain": located.plain,
        "clamped": turn(back, triangulate(STATIONS[0].r_itrs, STATIONS[1].r_itrs, *clamped)[0]),
        "proposed": located.proposed,
        "batch": located.batch,
    }
    errors = {name: celestial_errors(r, truth.r_gcrs) for name, r in positions.items()}
    six = cases()
    ours = {m: np.array([mean(rows, key, m) for key, _, _ in six]) for m in METHODS}
    published = np.array([p["proposed"] for _, _, p in six])
    title = f"angles rounded to {NOISE_ROUNDING_DEG:g} deg"
    return (
        TEXT.figure("pass", pictures.geometry),
        TEXT.figure(
            "errors",
            partial(pictures.errors_against_time, errors, title),
            rounding_deg=NOISE_ROUNDING_DEG,
            clamped_s=_CLAMPED_S,
        ),
        TEXT.figure("smoothing-bias", partial(pictures.end_bias, located.kernel.kernel)),
        TEXT.figure("ratios", partial(pictures.ratios, [case for _, case, _ in six], published, ours)),
    )
