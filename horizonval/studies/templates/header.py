"""A table of profiles as a header of C99: constants, whole numbers and their scales."""

from __future__ import annotations

import textwrap

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.templates import LimbTemplates, quantised

BETWEEN = {
    "thermal": "Linear between nodes and heights",
    "solar": "Between nodes splines of the mean's root and of modes, linear between heights",
}
"""Nodes and heights, as :mod:`horizonval.estimation.likelihood.templates` has it."""


def header_text(table: LimbTemplates, comment: str) -> str:
    """Return the text of a header.

    ``value = scale[a][b] * whole[a][b][h]``; ``LIMB_FIRST`` is the Sun's zenith angle [rad] or the latitude [rad],
    ``LIMB_SECOND`` the Sun's azimuth from the line of sight [rad] or the month.
    """
    a, b, k, h = table.modes.shape
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
        _floats("limb_band_um", "2", np.array(table.band_um)),
        _floats("limb_first", "LIMB_A", table.axes[0]),
        _floats("limb_second", "LIMB_B", table.axes[1]),
        _floats("limb_height_m", "LIMB_H", table.height_m),
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
        ("modes", np.concatenate([table.modes, none], axis=2), "LIMB_A * LIMB_B * (LIMB_K + 1) * LIMB_H", np.int8),
        ("left", table.left_sigma, "LIMB_A * LIMB_B * LIMB_H", np.int8),
    ):
        scale, whole = quantised(values, kind)
        lines += [
            _floats(f"limb_{name}_scale", shape.removesuffix(" * LIMB_H"), scale.ravel()),
            _whole(f"limb_{name}", shape, whole.ravel(), "int16_t" if kind is np.int16 else "int8_t"),
        ]
    return "\n".join([*lines, "#endif", ""])


def _floats(name: str, shape: str, values: FloatArray) -> str:
    return _array("float", name, shape, [f"{float(np.float32(v)):.9e}f" for v in values])


def _whole(name: str, shape: str, values: NDArray[np.int8] | NDArray[np.int16], kind: str) -> str:
    return _array(kind, name, shape, [str(int(v)) for v in values])


def _array(kind: str, name: str, shape: str, words: list[str]) -> str:
    body = textwrap.fill(", ".join(words), 110, initial_indent="    ", subsequent_indent="    ")
    return f"static const {kind} {name}[{shape}] = {{\n{body}\n}};"
