"""A table cut down to what one mission's limbs need, and its C99 header for a flight computer.

A table of the whole Earth is reduced to the mission: along its two axes to the nodes on either side of the mission's
limbs, in height to those from the lowest needed upwards. Then heights are dropped one after the other, each time the
one that a straight line between its neighbours replaces best, as long as the largest difference from the whole table of
the mean and of any mode, at any remaining node, as a share of the largest mean at that node, stays below a given error.
Modes that are smaller than that error everywhere are dropped, and their variance is added to the residual variance.

The header holds constants, whole numbers and their scales.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.estimation.fit.templates import LimbTemplates, quantised

FEWEST_HEIGHTS = 8
FAINT = 1e-3
"""Of the brightest light of a table: where a limb has less it is dark, and no share of it counts."""
BESIDE = 2
"""Extra nodes of a sunlit table on either side of the mission's limbs.

A spline's end effect falls fourfold per node.
"""


@dataclass(frozen=True)
class LimbPlaces:
    """Limbs of a mission: ``first``, ``second`` (n,) on the axes of a table; ``lowest_m``: lowest height needed."""

    first: FloatArray
    second: FloatArray
    lowest_m: float


@dataclass(frozen=True)
class CutTable:
    """A reduced table; ``error`` and ``rms`` against the whole one at the places, share of the largest mean.

    ``bytes`` in memory: whole numbers of profiles, and axes and scales of 4 bytes.
    """

    table: LimbTemplates
    error: float
    rms: float
    bytes: int


def cut_down(whole: LimbTemplates, places: LimbPlaces, error: float) -> CutTable:
    """Return the table that the places need; ``UserError`` for no places, or an error that no table can meet."""
    if not len(places.first):
        raise UserError("no limb is in view in any frame", expected="a camera that looks at the limb")
    if not 1e-4 <= error <= 0.1:
        raise UserError(f"found {error:g}", where="--error", expected="a share from 0.0001 to 0.1")
    beside = 0 if whole.band_kind == "thermal" else BESIDE
    rows = _around(whole.axes[0], places.first, beside)
    if whole.band_kind == "thermal":
        columns = months_around(whole.axes[1], places.second)
    else:
        columns = _around(whole.axes[1], np.abs((places.second + np.pi) % (2.0 * np.pi) - np.pi), beside)
    low = max(int(np.searchsorted(whole.height_m, places.lowest_m, side="right")) - 1, 0)
    grid = np.ix_(rows, columns)
    near = replace(
        whole,
        height_m=whole.height_m[low:],
        axes=(whole.axes[0][rows], whole.axes[1][columns]),
        correlation_rad=whole.correlation_rad[rows],
        mean=whole.mean[grid][..., low:],
        modes=whole.modes[grid][..., low:],
        left_sigma=whole.left_sigma[grid][..., low:],
    )
    near = _without_small_modes(near, error)
    kept = _heights(near, error)
    table = _rounded(
        replace(
            near,
            height_m=near.height_m[kept],
            mean=near.mean[..., kept],
            modes=near.modes[..., kept],
            left_sigma=near.left_sigma[..., kept],
        )
    )
    off = _differences(near, table, places)
    a, b, k, h = table.modes.shape
    size = a * b * (2 * h + k * h + h) + 4 * (a * b * (2 + k) + a + b + 2 * a * k + h)
    return CutTable(table, float(np.abs(off).max()), float(np.sqrt(np.mean(off**2))), size)


def _around(axis: FloatArray, x: FloatArray, beside: int = 0) -> np.ndarray:
    """Return the nodes of an axis that the interpolation at some places reads, and so many on either side."""
    i = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, max(len(axis) - 2, 0))
    return np.arange(max(int(i.min()) - beside, 0), min(int(i.max()) + 1 + beside, len(axis) - 1) + 1)


def months_around(axis: FloatArray, month: FloatArray) -> np.ndarray:
    """Return the months, numbers on a rising axis round the year, that the interpolation at some reads."""
    i = np.searchsorted(axis, axis[0] + (month - axis[0]) % 12.0, side="right") - 1
    return np.unique(np.concatenate([i, (i + 1) % len(axis)]))


def _scale(table: LimbTemplates) -> FloatArray:
    """Return the largest mean at every node, shape (A, B, 1)."""
    return np.maximum(table.mean.max(axis=-1, keepdims=True), 1e-30)


def _without_small_modes(table: LimbTemplates, error: float) -> LimbTemplates:
    large = (np.abs(table.modes) / _scale(table)[:, :, None]).max(axis=(0, 1, 3)) > error
    small = np.sum(table.modes[:, :, ~large] ** 2, axis=2)
    return replace(
        table,
        modes=table.modes[:, :, large],
        mode_kinds=tuple(kind for kind, kept in zip(table.mode_kinds, large, strict=True) if kept),
        correlation_rad=table.correlation_rad[:, large],
        left_sigma=np.sqrt(table.left_sigma**2 + small),
    )


def _heights(table: LimbTemplates, error: float) -> np.ndarray:
    """Return which heights stay."""
    scale = _scale(table)
    rows = np.concatenate([(table.mean / scale)[:, :, None], table.modes / scale[:, :, None]], axis=2).reshape(
        -1, len(table.height_m)
    )
    kept = list(range(len(table.height_m)))

    def cost(place: int) -> float:
        before, after = kept[place - 1], kept[place + 1]
        z = table.height_m[before : after + 1]
        w = (z - z[0]) / (z[-1] - z[0])
        line = rows[:, [before]] * (1.0 - w) + rows[:, [after]] * w
        return float(np.abs(rows[:, before : after + 1] - line).max())

    costs = [np.inf, *[cost(i) for i in range(1, len(kept) - 1)], np.inf]
    while len(kept) > FEWEST_HEIGHTS:
        i = int(np.argmin(costs))
        if costs[i] > error:
            break
        del kept[i], costs[i]
        for j in (i - 1, i):
            if 0 < j < len(kept) - 1:
                costs[j] = cost(j)
    return np.array(kept)


def _rounded(table: LimbTemplates) -> LimbTemplates:
    """Return the table as its file will say it."""

    def back(values: FloatArray, kind: type[np.int8] | type[np.int16]) -> FloatArray:
        scale, whole = quantised(values, kind)
        return np.asarray(scale[..., None] * whole)

    return replace(
        table,
        mean=back(table.mean, np.int16),
        modes=back(table.modes, np.int8),
        left_sigma=back(table.left_sigma, np.int8),
    )


def _differences(whole: LimbTemplates, cut: LimbTemplates, places: LimbPlaces) -> FloatArray:
    """Return by how much mean and modes at the places differ, shares of the largest mean."""
    mean, modes, _ = whole.at(places.first, places.second)
    scale = np.maximum(mean.max(axis=1), FAINT * max(float(whole.mean.max()), 1e-30))
    mean_cut, modes_cut, _ = cut.at(places.first, places.second)
    before = np.concatenate([mean[:, None], modes], axis=1)
    after = np.concatenate([mean_cut[:, None], modes_cut], axis=1)
    i = np.clip(np.searchsorted(cut.height_m, whole.height_m, side="right") - 1, 0, len(cut.height_m) - 2)
    w = (whole.height_m - cut.height_m[i]) / (cut.height_m[i + 1] - cut.height_m[i])
    between = after[..., i] * (1.0 - w) + after[..., i + 1] * w
    return np.asarray((between - before) / scale[:, None, None])


BETWEEN = {
    "thermal": "Linear between nodes and heights",
    "solar": "Between nodes splines of the mean's root and of modes, linear between heights",
}
"""Nodes and heights, as :mod:`horizonval.estimation.fit.templates` has it."""


def header_text(table: LimbTemplates, comment: str) -> str:
    """Return the text of a header.

    ``value = scale[a][b] * whole[a][b][h]``; ``LIMB_FIRST`` is the Sun's zenith angle [rad] or the latitude [rad],
    ``LIMB_SECOND`` the Sun's azimuth from the line of sight [rad] or the month; ``limb_end`` are the modes of the air.
    Slopes are matrices from the values on an axis to the slopes of the spline through them.
    """
    a, b, k, h = table.modes.shape
    zenith, zenith_slopes, second_slopes = _slopes(table)
    air = np.flatnonzero(np.array(table.mode_kinds) == "air")
    lines = [
        "/* Profiles of the limb, made by `horizonval templates SUITE -o table.h`.",
        *textwrap.wrap(comment, 100, initial_indent="   ", subsequent_indent="   "),
        f"   {BETWEEN[table.band_kind]}; value = scale * whole number. W m-2 sr-1 um-1, metres, radians. */",
        "#ifndef LIMB_TABLE_H",
        "#define LIMB_TABLE_H",
        "#include <stdint.h>",
        f"#define LIMB_THERMAL {int(table.band_kind == 'thermal')}",
        f"#define LIMB_A {a}",
        f"#define LIMB_B {b}",
        f"#define LIMB_K {k}",
        f"#define LIMB_H {h}",
        f"#define LIMB_ENDS {len(air)}",
        _whole("limb_end", "LIMB_ENDS + 1", np.append(air, 0).astype(np.int8), "int8_t"),
        _floats("limb_band_um", "2", np.array(table.band_um)),
        _floats("limb_first", "LIMB_A", table.axes[0]),
        _floats("limb_second", "LIMB_B", table.axes[1]),
        _floats("limb_height_m", "LIMB_H", table.height_m),
        f"#define LIMB_Z {len(zenith)}",
        _floats("limb_zenith", "LIMB_Z", zenith),
        _floats("limb_zenith_slopes", "LIMB_Z * LIMB_Z", zenith_slopes.ravel()),
        _floats("limb_second_slopes", "LIMB_B * LIMB_B", second_slopes.ravel()),
        # a table may have no modes, an array of C not
        _floats(
            "limb_correlation_rad",
            "LIMB_A * (LIMB_K + 1) * 2",
            np.concatenate([table.correlation_rad, np.ones((a, 1, 2))], axis=1).ravel(),
        ),
    ]
    none = np.zeros((a, b, 1, h))
    for name, values, shape, kind in (
        ("mean", table.mean, "LIMB_A * LIMB_B * LIMB_H", np.int16),
        (
            "modes",
            np.concatenate([table.modes * table.prior_sigmas, none], axis=2),
            "LIMB_A * LIMB_B * (LIMB_K + 1) * LIMB_H",
            np.int8,
        ),
        ("left", table.left_sigma, "LIMB_A * LIMB_B * LIMB_H", np.int8),
    ):
        scale, whole = quantised(values, kind)
        lines += [
            _floats(f"limb_{name}_scale", shape.removesuffix(" * LIMB_H"), scale.ravel()),
            _whole(f"limb_{name}", shape, whole.ravel(), "int16_t" if kind is np.int16 else "int8_t"),
        ]
    return "\n".join([*lines, "#endif", ""])


def _slopes(table: LimbTemplates) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the first axis and the slopes of its and the second axis's splines; a thermal table's are linear: 0."""
    if table.band_kind == "thermal":
        first, second = table.axes
        return first, np.zeros((len(first), len(first))), np.zeros((len(second), len(second)))
    zenith, azimuth = table.splines
    return zenith.x, zenith(zenith.x, 1), azimuth(azimuth.x, 1)


def _floats(name: str, shape: str, values: FloatArray) -> str:
    return _array("float", name, shape, [f"{float(np.float32(v)):.9e}f" for v in values])


def _whole(name: str, shape: str, values: NDArray[np.int8] | NDArray[np.int16], kind: str) -> str:
    return _array(kind, name, shape, [str(int(v)) for v in values])


def _array(kind: str, name: str, shape: str, words: list[str]) -> str:
    body = textwrap.fill(", ".join(words), 110, initial_indent="    ", subsequent_indent="    ")
    return f"static const {kind} {name}[{shape}] = {{\n{body}\n}};"
