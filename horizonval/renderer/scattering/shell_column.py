"""One column of air for one spectral node, with the heights and Sun angles at which its diffuse field is solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds.layers import merged_bands
from horizonval.earth.column import SpectralNode
from horizonval.renderer.scattering.harmonics import pairs
from horizonval.renderer.scattering.quality import Quality, degree_of
from horizonval.renderer.scattering.shell_rays import ShellRays, shell_rays
from horizonval.renderer.scattering.sun_angles import sun_angle_cosines

SOLVED_TOGETHER = 4
"""Columns per launch: they share the geometry of all rays. Always as many, so that one compiled kernel serves all."""


@dataclass(frozen=True)
class ShellColumn:
    """A column over a spherical ground.

    Attributes
    ----------
    node : SpectralNode
    altitude_m : ndarray, shape (n,)
        Of the node's columns.
    planet_m : float
        Radius of the ground.
    quality : Quality
    """

    node: SpectralNode
    altitude_m: FloatArray
    planet_m: float
    quality: Quality

    @property
    def top_m(self) -> float:
        """Vacuum above."""
        return float(self.altitude_m[-1])

    @property
    def degree(self) -> int:
        """Degree of the moments."""
        return degree_of(self.node, self.quality)

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """``(l, m)`` of the moments."""
        return pairs(self.degree)

    @cached_property
    def bands(self) -> list[tuple[float, float]]:
        """Heights of layers of thin cloud with their softened edges, rising, without overlaps."""
        return layer_bands(self.node, self.altitude_m)

    @cached_property
    def heights(self) -> FloatArray:
        """Heights of the field, shape (n_height,)."""
        return field_heights(self.top_m, self.quality.n_height, self.bands)

    @cached_property
    def sun_cosines(self) -> FloatArray:
        """Cosines of the Sun's zenith angle of the field, shape (n_sun,)."""
        return sun_angle_cosines(self.quality.n_sun)

    def at(self, values: FloatArray, radius_m: FloatArray) -> FloatArray:
        """Return a column's values at radii."""
        return np.interp(radius_m - self.planet_m, self.altitude_m, values)

    def rays(self, n_up: int, n_down: int, n_nodes: int) -> ShellRays:
        """Return rays from every height in every polar direction."""
        return shell_rays(
            self.altitude_m, self.node.extinction_per_m, self.planet_m, self.heights, n_up, n_down, n_nodes, self.bands
        )


HEIGHTS_IN_LAYER = 13
"""Dense towards a layer's edges: what is seen of a dense one from the side is its outermost hundred metres, where light
scattered towards the Sun grows from next to nothing."""


def layer_bands(node: SpectralNode, altitude_m: FloatArray) -> list[tuple[float, float]]:
    """Return the heights between which a node's layers are, rising, without overlaps."""
    bands = []
    for column in node.layer_per_m:
        inside = np.nonzero(column > 0.0)[0]
        if len(inside):
            last = len(altitude_m) - 1
            bands.append((float(altitude_m[max(inside[0] - 1, 0)]), float(altitude_m[min(inside[-1] + 1, last)])))
    return merged_bands(bands, 0.0)


def field_heights(top_m: float, n_height: int, bands: Sequence[tuple[float, float]] = ()) -> FloatArray:
    """Return the heights of a field: even in their roots, and :data:`HEIGHTS_IN_LAYER` in each sharp layer."""
    heights = top_m * np.linspace(0.0, 1.0, n_height) ** 2
    for base, top in bands:
        near = 0.1 * (top - base)
        outside = (heights < base - near) | (heights > top + near) | (heights == 0.0) | (heights == top_m)
        share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, HEIGHTS_IN_LAYER))
        heights = np.union1d(heights[outside], base + (top - base) * share)
    return heights
