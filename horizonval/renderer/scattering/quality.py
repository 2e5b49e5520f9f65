"""Resolution of the tables of light scattered more than once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from horizonval.earth.column import OpticalModel, SpectralNode


@dataclass(frozen=True)
class Quality:
    """Resolution of the tables and of the quadratures behind them.

    ``n_*``: heights, Sun angles; directions above and below the horizon, azimuths in half a turn and nodes on a ray;
    ``first_*`` the same for the light scattered once, which has the shadow's edge and the aureole in it.
    ``particle_degree``: up to which moments are kept where there are particles, of the light scattered once or twice;
    ``later_degree`` that of light scattered more often or reflected at the ground, in which nothing narrow is left.
    """

    n_height: int
    n_sun: int
    n_up: int
    n_down: int
    n_azimuth: int
    n_nodes: int
    first_up: int
    first_azimuth: int
    first_nodes: int
    particle_degree: int
    later_degree: int


STANDARD = Quality(24, 128, 20, 4, 6, 24, 28, 10, 64, 8, 4)
"""For images. Molecules at 450 to 850 nm, against a table of far higher resolution: at most 0.06 % of the radiance with
the Sun up, 0.3 % until it is 8 deg below the horizon, 0.8 % (850 nm: 3 %) until 18 deg."""

FINE = Quality(32, 160, 24, 4, 8, 48, 32, 16, 96, 12, 6)
"""For single rays: 0.02 %, 0.3 % and 0.4 % (850 nm: 1.1 %)."""


LAYERED = replace(STANDARD, n_down=10, particle_degree=12, later_degree=6, first_azimuth=16)
"""For images with layers of thin cloud, whose particles scatter further forward than haze: with as few directions below
the horizon as haze has, sums over them would make high moments of smooth light."""

_DENSE_STRATOSPHERE = 0.015
"""Optical depth of particles above 12 km: half of it in a quiet stratosphere, twice and more after an eruption."""
_STRATOSPHERE_M = 12_000.0


def for_images(model: OpticalModel) -> Quality:
    """Return the resolution that images of a model need.

    A stratosphere full of particles needs the higher moments, too, with the Sun set: light that comes over the horizon
    from the Sun is scattered straight back, where moments up to the eighth leave 5 to 7 % too much at 850 nm.
    """
    if model.layers:
        return LAYERED
    above = model.altitude_m >= _STRATOSPHERE_M
    depth = max(
        (float(np.trapezoid(n.particle_per_m[above], model.altitude_m[above])) for n in model.nodes), default=0.0
    )
    return LAYERED if depth > _DENSE_STRATOSPHERE else STANDARD


MOLECULAR_DEGREE = 2
"""Of the moments that molecules scatter by."""


def degree_of(node: SpectralNode, quality: Quality) -> int:
    """Return the degree of the moments a node needs."""
    return quality.particle_degree if node.particle_per_m.any() else MOLECULAR_DEGREE
