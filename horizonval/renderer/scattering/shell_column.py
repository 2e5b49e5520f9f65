"""One column of air for one spectral node, with the heights and Sun angles at which its diffuse field is solved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from horizonval.core.arrays import FloatArray
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
    def heights(self) -> FloatArray:
        """Heights of the field, shape (n_height,)."""
        return self.top_m * np.linspace(0.0, 1.0, self.quality.n_height) ** 2

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
            self.altitude_m, self.node.extinction_per_m, self.planet_m, self.heights, n_up, n_down, n_nodes
        )
