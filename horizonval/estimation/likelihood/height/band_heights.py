r"""How high the fitted edge of a band's limb stands, and how it may depart from that: made of the shipped profiles.

The heights are those of :mod:`.edge_height`, over the size of a pixel and the two axes of a table: the Sun's angles of
a sunlit band, latitude and month of a thermal one. Of a mode of the profiles the height changes by half of the
difference between one standard deviation above the mean and one below, and stays so along the limb as far as the mode
does.

Whether a scene has clouds at all is no normal number but one of two, and a height is to be right for either: it is the
middle of both, known to half of their distance, whatever share of the ensemble has clouds.

A profile that is no exponential leaves its height open by a multiple of what a fit of it leaves
(:data:`MISFIT_PX`): little by day, and much of the veil of a Sun that stands behind the limb.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.height.edge_height import edge_height
from horizonval.estimation.likelihood.height.sunlit_profiles import CLOUDED, FAINTEST, ZENITHS_RAD, seen_from
from horizonval.estimation.likelihood.knowledge import BLUR_PX
from horizonval.estimation.likelihood.templates import MONTHS, LimbTemplates, shipped_templates

PIXELS_M = np.geomspace(2e3, 256e3, 15)
"""Of height in a pixel: of a camera of 0.05 deg in low orbit, and of one of a degree at four times its distance."""
SEEN_FROM_M = 700e3
"""Where the observer stands above the ground, of sunlit profiles: from 300 to 2000 km heights of a high Sun differ by
0.1 km."""
MISFIT_PX = 5.0
"""Pixels by which a limb is misplaced for what the fit of it leaves, of its step. A residual that is all like the slope
of the edge, half of the step in a pixel and over three of the twenty that are fitted, moves it by so much."""


@dataclass(frozen=True)
class EdgeHeights:
    """At n places along a limb.

    Attributes
    ----------
    mean_m : ndarray, shape (n,)
    patterns_m : ndarray, shape (k, n)
        One standard deviation of what each mode changes, and of what is no exponential (last).
    correlation_rad : ndarray, shape (n, k, 2)
        Angle at the Earth's centre as far as which each stays alike, along the meridian and along the parallel.
    """

    mean_m: FloatArray
    patterns_m: FloatArray
    correlation_rad: FloatArray


class BandHeights:
    """Heights of a band's edge on a grid.

    Parameters
    ----------
    table : LimbTemplates
    scale_m : float
        Scale height of the edge that is fitted.
    """

    def __init__(self, table: LimbTemplates, scale_m: float) -> None:
        states = _states(table)
        axes = (ZENITHS_RAD, table.axes[1]) if table.band_kind == "solar" else table.axes
        self._thermal = table.band_kind == "thermal"
        if table.band_kind == "solar":
            states = np.exp(seen_from(table, np.log(np.maximum(states, 1e-300)), SEEN_FROM_M))
        else:
            # The year is a circle: its first month follows the last.
            states = np.concatenate([states, states[:, :, :1]], axis=2)
            axes = (table.axes[0], np.append(table.axes[1], table.axes[1][0] + MONTHS))
        flat = states.reshape(-1, len(table.height_m))
        found = [edge_height(table.height_m, flat, float(pixel), BLUR_PX, scale_m) for pixel in PIXELS_M]
        shape = (len(PIXELS_M), *states.shape[:3])
        heights = np.moveaxis(np.array([one[0] for one in found]).reshape(shape), 1, 0)
        misfit = np.array([one[1] for one in found]).reshape(shape)[:, 0]
        changes = 0.5 * (heights[1::2] - heights[2::2])
        middle = heights[0] + sum(
            0.5 * (more + less) - heights[0]
            for kind, more, less in zip(table.mode_kinds, heights[1::2], heights[2::2], strict=True)
            if kind == "scene"
        )
        open_m = MISFIT_PX * misfit * PIXELS_M[:, None, None]
        values = np.concatenate([middle[None], changes, open_m[None]])
        self._grid = RegularGridInterpolator((np.log(PIXELS_M), *axes), np.moveaxis(values, 0, -1))
        self._ends = [(float(axis[0]), float(axis[-1])) for axis in axes]
        # What is no exponential is so as the light is, which changes along the limb no faster than the air does.
        self._table, self._air = table, [kind == "air" for kind in table.mode_kinds]

    def at(self, pixel_m: FloatArray, first: FloatArray, second: FloatArray) -> EdgeHeights:
        """Return the heights at places along a limb.

        Parameters
        ----------
        pixel_m : ndarray, shape (n,)
            Of height in a pixel; wider and narrower ones than the grid's are taken for its last.
        first, second : ndarray, shape (n,)
            Along the table's axes: the Sun's zenith angle and azimuth from the line of sight [rad]; latitude [rad] and
            month. Beyond the ends their last values hold.
        """
        if self._thermal:
            second = self._ends[1][0] + (second - self._ends[1][0]) % MONTHS
        places = [np.log(np.clip(pixel_m, PIXELS_M[0], PIXELS_M[-1]))]
        places += [np.clip(x, *ends) for x, ends in zip((first, second), self._ends, strict=True)]
        points = np.column_stack(np.broadcast_arrays(*places))
        found = self._grid(points).T
        lengths = self._table.lengths_at(points[:, 1])
        lengths = np.concatenate([lengths, lengths[:, self._air].mean(axis=1, keepdims=True)], axis=1)
        return EdgeHeights(found[0], found[1:], lengths)


@cache
def band_heights(
    band_kind: Literal["solar", "thermal"], band_um: tuple[float, float], scale_m: float
) -> BandHeights | None:
    """Return the heights of the shipped table of a band, None where none is."""
    table = shipped_templates(band_kind, band_um)
    return None if table is None else _of_table(table, scale_m)


@cache
def _of_table(table: LimbTemplates, scale_m: float) -> BandHeights:
    return BandHeights(table, scale_m)


def _states(table: LimbTemplates) -> FloatArray:
    """Return the mean profiles, and those of each mode more and less, shape (1 + 2 k, A, B, h)."""
    changed = []
    for k, kind in enumerate(table.mode_kinds):
        mode = table.modes[:, :, k]
        more, less = 1.0, 1.0
        if kind == "scene":
            more, less = math.sqrt((1.0 - CLOUDED) / CLOUDED), math.sqrt(CLOUDED / (1.0 - CLOUDED))
        sign = _of_clouds(table, mode) if kind == "scene" else 1.0
        changed += [np.maximum(table.mean + by * mode, FAINTEST * table.mean) for by in (sign * more, -sign * less)]
    return np.stack([table.mean, *changed])


def _of_clouds(table: LimbTemplates, mode: FloatArray) -> float:
    """Return the sign with which a mode has clouds: bright under a high Sun, cold in the infrared."""
    below = mode[0] if table.band_kind == "solar" else -mode
    return 1.0 if below[..., table.height_m < 0.0].sum() > 0.0 else -1.0
