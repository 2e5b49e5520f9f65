"""The tables of the two-station localisation: published beside ours, and what the published noise may mean."""

from __future__ import annotations

import numpy as np
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.systems.e import noise as noise
from horizonval.systems.e.case import (
    METHODS,
    NOISE_ARCSEC,
    NOISE_ROUNDING_DEG,
    PUBLISHED_NOISE,
    PUBLISHED_ROUNDING,
    QUANTITIES,
    ROUNDING_DEG,
    Figures,
)
from horizonval.systems.result import Cell, Table

Rows = dict[str, dict[str, FloatArray]]
"""Draws of every row, by the row's name: see ``localisation_trials.gathered``."""


_COLUMNS = (
    "measurement",
    "error of",
    "published plain",
    "published proposed",
    "plain",
    "smoothed",
    "+ adaptive filter",
    "+ way back (proposed)",
    "batch fit",
)


def mean(rows: Rows, row: str, method: str) -> FloatArray:
    """Return a row's three errors of a method, means over its draws, shape (3,)."""
    return rows[row]["rms"][:, METHODS.index(method)].mean(axis=0)


def half_width(rows: Rows, row: str, method: str) -> FloatArray:
    """Return half the 95 % confidence interval of :func:`mean`, shape (3,)."""
    draws = rows[row]["rms"][:, METHODS.index(method)]
    return stats.t.ppf(0.975, len(draws) - 1) * draws.std(axis=0, ddof=1) / np.sqrt(len(draws))


def cases(rows: Rows) -> list[tuple[str, str, dict[str, Figures]]]:
    """Return key, words and published columns of the six published rows."""
    rounding = [
        (f"rounded {q:g}", f"rounded to {q:g} deg", {k: v[i] for k, v in PUBLISHED_ROUNDING.items()})
        for i, q in enumerate(ROUNDING_DEG)
    ]
    return rounding + [
        (f"noisy {n:g}", f"noise {n:g} arcsec", {k: v[i] for k, v in PUBLISHED_NOISE.items()})
        for i, n in enumerate(NOISE_ARCSEC)
    ]


def rounding_table(rows: Rows) -> Table:
    """Return the rounding table, published and ours."""
    cells: list[tuple[Cell, ...]] = []
    for i, q in enumerate(ROUNDING_DEG):
        for j, (quantity, unit) in enumerate(QUANTITIES):
            shifted = mean(rows, f"shifted {q:g}", "proposed")[j]
            half = half_width(rows, f"shifted {q:g}", "proposed")[j]
            ours = [round(float(mean(rows, f"rounded {q:g}", m)[j]), 3) for m in METHODS]
            published = [PUBLISHED_ROUNDING[k][i][j] for k in ("plain", "proposed")]
            cells.append(
                (f"{q:g} deg", f"{quantity} [{unit}]", *published, *ours, f"{shifted:.3g} ± {half:.1g}"),
            )
    return Table(
        "Rounded angles: root mean square errors",
        (*_COLUMNS, "proposed, grid at random"),
        tuple(cells),
        "The last column is the mean over random places of the rounding grid, with its 95 % confidence interval.",
    )


def noise_table(rows: Rows, nearest: noise.NoiseReading, draws: int) -> Table:
    """Return the noise table, published and ours, under one reading of its noise."""
    cells: list[tuple[Cell, ...]] = []
    for i, n in enumerate(NOISE_ARCSEC):
        for j, (quantity, unit) in enumerate(QUANTITIES):
            ours = [
                f"{mean(rows, f'noisy {n:g}', m)[j]:.3g} ± {half_width(rows, f'noisy {n:g}', m)[j]:.1g}"
                for m in METHODS
            ]
            published = [PUBLISHED_NOISE[k][i][j] for k in ("plain", "proposed")]
            cells.append((f"{n:g} arcsec", f"{quantity} [{unit}]", *published, *ours))
    return Table(
        f"Gaussian noise and {NOISE_ROUNDING_DEG:g} deg rounding: root mean square errors",
        _COLUMNS,
        tuple(cells),
        f"Noise read as: {nearest.words}. Means of {draws} passes with their 95 % confidence intervals.",
    )


def meaning_table(columns: dict[noise.NoiseReading, FloatArray]) -> Table:
    """Return the plain column under every reading of the noise, the nearest first."""
    ordered = sorted(columns.items(), key=lambda pair: noise.distance(pair[1]))
    return Table(
        "What the published noise may mean: the plain column under each reading",
        ("reading", "distance [%]", *(f"{q} at {n:g} [{u}]" for n in NOISE_ARCSEC for q, u in QUANTITIES)),
        tuple(
            (meaning.words, round(100.0 * noise.distance(c), 1), *(round(float(v), 2) for v in c.ravel()))
            for meaning, c in ordered
        ),
        "Published: " + ", ".join(f"{v:g}" for row in PUBLISHED_NOISE["plain"] for v in row) + ".",
    )
