"""Layers of thin cloud: their columns, kinds, occurrence, optical properties and gaps.

A layer is a shell of constant extinction between its base and its top. On the columns' grid, between whose nodes
extinction is linear, node i has the mean of the shell's extinction weighted with the node's hat function; with even
steps D::

    k_i = k [ F(z_i + D) - 2 F(z_i) + F(z_i - D) ] / D^2,        F'' = 1 between base and top, 0 elsewhere

This preserves the optical depth exactly for any base and top, and softens the edges over 2 D (200 m).

**Kinds**, with the values that apply where a scene gives none:

===================== ============== ====== ========== =====================================================
kind                  heights, km    depth  radius, um from
===================== ============== ====== ========== =====================================================
cirrus                2 km thick, to 0.2    30, ice    Sassen and Comstock 2001; Sassen, Wang and Liu 2008
                      1.5 km below
                      the tropopause
subvisible_cirrus     1 km thick, to 0.01   10, ice    Sassen and Cho 1992 (below 0.03); Wang et al. 1996
                      0.5 km below                     (SAGE II; 0.003 to 0.03 at 15 to 17 km in the tropics)
                      the tropopause
polar_stratospheric   18 to 22       0.01   10, ice    Poole and McCormick 1988; Pitts et al. 2018
noctilucent           82 to 84       1e-4   0.05, ice  Hervig et al. 2009 (AIM); Thomas 1991
thin_water            1.0 to 1.4     0.5    8, water   Leahy et al. 2012 (half of low marine cloud is below 3)
===================== ============== ====== ========== =====================================================

The tropopause is that of opaque clouds: 17 km in the tropics, 13 at 40 deg, 9 at the poles.

**Occurrence** follows the published maps and zonal means, rounded to what separate instruments agree on (a fifth of the
largest value of a kind):

- cirrus (Sassen, Wang and Liu 2008, CloudSat and CALIPSO): 35 % at the equator, 10 % in the subtropics, 18 % around 45
  deg, less towards the poles; 17 % over the globe;
- subvisible cirrus (Wang et al. 1996): 45 % at the equator, falling to a tenth of that beyond 40 deg;
- both move by 8 deg of latitude with the season, north in August;
- polar stratospheric clouds (Pitts et al. 2018): poleward of 60 deg, 50 % at 80 deg in the south from June to September
  and 10 % in the north from December to February, half as much in the adjacent months;
- noctilucent clouds (Thomas 1991; Russell et al. 2009): poleward of 55 deg, 80 % at 80 deg in the months of the summer
  solstice and the one after, a fourth of that in the adjacent months; the south has two thirds of the north.

**Optical properties**, relative to the extinction at 550 nm, come from three tables by effective radius
(``cloud_optics.json``; sources in its README): water droplets (4 to 30 um) and ice crystals (10 to 60 um, severely
rough habits) at six wavelengths from 0.45 to 0.9 um, and in the infrared their absorption in the bands of RRTMG, 500 to
1390 cm-1; ice spheres of 0.02 to 0.2 um (noctilucent clouds), 0.2 to 1.05 um. Interpolation is linear in the logarithms
of radius and wavelength. Droplets and crystals below 0.45 um are as at 0.45 um, and from 0.9 to 1.05 um as at 0.9 um. A
kind of particle is named by phase and effective radius [um]: ``ice 30``, ``water 8``.

The phase function is that of Henyey and Greenstein with the tables' asymmetry. It has no halo, rainbow or glory (two to
four times the surroundings, within 5 deg of the antisolar direction), and within 2 deg of the Sun single scattering is
too dark by an order of magnitude. Between 20 and 150 deg it is within some 30 per cent of the phase function of rough
crystals.

In the infrared scattering is neglected: a layer absorbs, emits, and transmits the rest. That takes some 5 % off the
opacity of ice in windows. Ice of 0.2 um and less has no infrared absorption: at the mesopause an optical depth of 1e-4
would add 1e-4 of the radiance of the ground.

**Gaps** come from gradient noise of two octaves, cells of the given scale and of half of it. u is its rank among its
values over the globe, uniform from 0 to 1. With cover c the cloud's share of its full optical depth is::

    f = min(1, max(0, (u - (1 - c)) / w + 1/2)),        w = min(0.3, c, 1 - c)

whose mean over the globe is exactly c; within one horizon the covered share differs by chance. From 0 to 1 it takes
about a sixth of the scale. The layer's column at a place is its mean column times ``f / c``; base and top are the same
everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.clouds.earth_pattern import (
    EARTH_RADIUS_M,
    FALLOFF,
    even_points,
    lattice_noise,
    numpy_split,
    ranked,
)
from horizonval.earth.clouds.relief import seed_of, tropopause_m
from horizonval.earth.tables import json_object
from horizonval.spec.earth import FINE_ICE_UM, CloudLayer
from horizonval.spec.scene import SceneSpec

SHIFT_DEG, NORTHMOST_MONTH = 8.0, 8.0
_CIRRUS_DEG = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0)
_CIRRUS = (0.35, 0.30, 0.14, 0.10, 0.18, 0.15, 0.09, 0.05)
SUBVISIBLE, SUBVISIBLE_DEG, SUBVISIBLE_ELSEWHERE = 0.45, 18.0, 0.03


@dataclass(frozen=True)
class LayerKind:
    """Default properties of a kind of layer; heights in metres, from the tropopause if ``below_tropopause``."""

    base_m: float
    top_m: float
    below_tropopause: bool
    optical_depth: float
    phase: str
    effective_radius_um: float


KINDS = {
    "cirrus": LayerKind(-3500.0, -1500.0, True, 0.2, "ice", 30.0),
    "subvisible_cirrus": LayerKind(-1500.0, -500.0, True, 0.01, "ice", 10.0),
    "polar_stratospheric": LayerKind(18_000.0, 22_000.0, False, 0.01, "ice", 10.0),
    "noctilucent": LayerKind(82_000.0, 84_000.0, False, 1e-4, "ice", 0.05),
    "thin_water": LayerKind(1000.0, 1400.0, False, 0.5, "water", 8.0),
}


def heights_m(layer: CloudLayer, latitude_deg: float) -> tuple[float, float]:
    """Return base and top of a layer; where only one is given the other keeps the kind's thickness."""
    kind = KINDS[layer.kind]
    level = float(tropopause_m(latitude_deg)) if kind.below_tropopause else 0.0
    base, top = level + kind.base_m, level + kind.top_m
    if layer.base_km is not None:
        top = layer.base_km * 1e3 + (top - base)
        base = layer.base_km * 1e3
    if layer.top_km is not None:
        thickness = top - base
        top = layer.top_km * 1e3
        base = layer.base_km * 1e3 if layer.base_km is not None else max(top - thickness, 200.0)
    return base, top


def occurrence(kind: str, latitude_deg: float, month: float) -> float:
    """Return how often a kind of cloud occurs, 0 to 1, at a latitude in a month; ``KeyError`` if unknown."""
    north = SHIFT_DEG * np.cos((month - NORTHMOST_MONTH) * np.pi / 6.0)
    latitude, south = abs(latitude_deg), latitude_deg < 0.0
    if kind == "cirrus":
        return float(np.interp(abs(latitude_deg - north), _CIRRUS_DEG, _CIRRUS))
    if kind == "subvisible_cirrus":
        near = np.exp(-(((latitude_deg - north) / SUBVISIBLE_DEG) ** 2))
        return float(SUBVISIBLE_ELSEWHERE + (SUBVISIBLE - SUBVISIBLE_ELSEWHERE) * near)
    if kind == "polar_stratospheric":
        middle, half, most = (7.5, 1.5, 0.5) if south else (1.0, 1.0, 0.1)
        return most * _season(month, middle, half, 0.5) * _poleward(latitude, 60.0, 80.0)
    if kind == "noctilucent":
        middle, most = (0.5, 0.8 * 2.0 / 3.0) if south else (6.5, 0.8)
        return most * _season(month, middle, 0.5, 0.25) * _poleward(latitude, 55.0, 80.0)
    raise KeyError(kind)


def _season(month: float, middle: float, half: float, beside: float) -> float:
    """Return 1 within ``half`` months of the middle of a season, ``beside`` in the adjacent months, 0 beyond."""
    away = abs((month - middle + 6.0) % 12.0 - 6.0)
    return 1.0 if away <= half + 1e-9 else beside if away <= half + 1.0 + 1e-9 else 0.0


def _poleward(latitude_deg: float, first_deg: float, all_deg: float) -> float:
    return float(np.clip((latitude_deg - first_deg) / (all_deg - first_deg), 0.0, 1.0))


_TABLE = "cloud_optics.json"
LONGEST_UM = 1.05
SHORTEST_UM = 0.2
REFERENCE_UM = 0.55


def particle(phase: str, effective_radius_um: float) -> str:
    """Return the name of a kind of particle."""
    return f"{phase} {effective_radius_um:g}"


def is_particle(kind: str) -> bool:
    """Return whether a kind of particle is one of thin cloud."""
    return kind.split(" ")[0] in ("ice", "water")


def sunlit(kind: str, wavelength_um: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return extinction and scattering per extinction at 550 nm, and asymmetry, one entry per wavelength.

    Raises ``UserError``: wavelength outside 0.2 to 1.05 um.
    """
    wavelength = np.asarray(wavelength_um, dtype=np.float64)
    if wavelength.size and not (wavelength.min() >= SHORTEST_UM and wavelength.max() <= LONGEST_UM):
        raise UserError(
            f"no optical properties of thin cloud at {wavelength.min():g} to {wavelength.max():g} um",
            expected=f"wavelengths within {SHORTEST_UM:g} to {LONGEST_UM:g} um",
            fix="or leave out [[layer]]",
        )
    name, radius = _table(kind)
    table = json_object(_TABLE)[name]
    known = np.log(np.array(table["wavelength_um"]))

    def at(values: FloatArray, ln_wavelength: FloatArray) -> FloatArray:
        return np.asarray(np.interp(ln_wavelength, known, values))

    if name == "fine_ice":
        relative = np.exp(_by_radius(table, np.log(np.array(table["extinction_rel_550"])), radius))
        extinction = np.exp(at(np.log(relative), np.log(wavelength)))
        albedo = np.ones_like(extinction)
    else:
        mass = _by_radius(table, np.array(table["mass_extinction_m2_kg"]), radius)
        extinction = at(mass, np.log(wavelength)) / at(mass, np.log(np.array(REFERENCE_UM)))
        albedo = 1.0 - at(_by_radius(table, np.array(table["one_minus_ssa"]), radius), np.log(wavelength))
    asymmetry = at(_by_radius(table, np.array(table["asymmetry"]), radius), np.log(wavelength))
    return extinction, extinction * albedo, asymmetry


def infrared_absorption(kind: str, wavelength_um: ArrayLike) -> FloatArray:
    """Return the absorption in the infrared per extinction at 550 nm, one entry per wavelength, by RRTMG's bands."""
    wavenumber = 1e4 / np.asarray(wavelength_um, dtype=np.float64)
    name, radius = _table(kind)
    if name == "fine_ice":
        return np.zeros_like(wavenumber)
    everything = json_object(_TABLE)
    table, edges = everything[name], np.array(everything["rrtmg_edges_per_cm"], dtype=np.float64)
    mass = _by_radius(table, np.array(table["mass_extinction_m2_kg"]), radius)
    reference = np.interp(np.log(REFERENCE_UM), np.log(np.array(table["wavelength_um"])), mass)
    absorbed = _by_radius(table, np.array(table["infrared_absorption_m2_kg"]), radius)
    band = np.clip(np.searchsorted(edges, wavenumber, side="right") - 1, 0, len(edges) - 2)
    return np.asarray(absorbed[band] / reference)


def _table(kind: str) -> tuple[str, float]:
    """Return the name of a kind's table, and its effective radius [um]."""
    phase, radius = kind.split(" ")
    value = float(radius)
    return ("fine_ice" if phase == "ice" and value <= FINE_ICE_UM else phase), value


def _by_radius(table: dict[str, Any], values: FloatArray, radius_um: float) -> FloatArray:
    """Return rows of a table at an effective radius."""
    radii = np.log(np.array(table["effective_radius_um"], dtype=np.float64))
    x = np.clip(np.interp(np.log(radius_um), radii, np.arange(len(radii))), 0.0, len(radii) - 1.0)
    i = min(int(x), len(radii) - 2)
    return np.asarray(values[i] + (values[i + 1] - values[i]) * (x - i))


OCTAVES = 2
SOFT = 0.3
"""Largest w of the module text."""
RANK_POINTS, RANK_STEPS = 100_000, 512


@dataclass(frozen=True)
class LayerGaps:
    """The pattern of a layer: covered share between 0 and 1, size of the noise's largest cells, and seed."""

    cover: float
    scale_m: float
    seed: int

    @property
    def softness(self) -> float:
        """Range of ranks over which cloud thins out."""
        return min(SOFT, self.cover, 1.0 - self.cover)


def gap_noise(
    gaps: LayerGaps,
    position: tuple[Any, Any, Any],
    seed: Any,
    split: Callable[[Any], tuple[Any, Any]],
    real: Callable[[Any], Any],
) -> Any:
    """Return the noise at unit vectors, in arbitrary units; ``split`` and ``real`` as in :func:`lattice_noise`.

    ``seed``: that of the gaps, in a type that can be added to hashes.
    """
    total: Any = 0.0
    for octave in range(OCTAVES):
        per_cell = EARTH_RADIUS_M / gaps.scale_m * 2.0**octave
        x, y, z = (v * per_cell for v in position)
        total = total + FALLOFF**octave * lattice_noise((x, y, z), octave, seed, split, real)
    return total


@lru_cache(maxsize=8)
def rank_table(gaps: LayerGaps) -> tuple[float, float, FloatArray]:
    """Return ``(lowest, highest, rank)``: rank of the noise at RANK_STEPS + 1 even steps from lowest to highest."""
    points = even_points(RANK_POINTS)
    place = points[:, 0], points[:, 1], points[:, 2]
    return ranked(gap_noise(gaps, place, gaps.seed, numpy_split, lambda h: h.astype(np.float64)), RANK_STEPS)


THINNEST_M = 200.0


@dataclass(frozen=True)
class ThinLayer:
    """A layer of thin cloud.

    ``extinction_550_per_m``: at 550 nm, averaged over gaps and cloud; ``particle``: kind of its particles, see the
    module text; ``gaps``: cloudy part, None for an even layer.
    """

    base_m: float
    top_m: float
    extinction_550_per_m: float
    particle: str
    gaps: LayerGaps | None = None

    def column(self, altitude_m: FloatArray, raised_m: float = 0.0) -> FloatArray:
        """Return the extinction at 550 nm [1/m] on a grid, shape (n,); see the module text."""
        z = np.asarray(altitude_m, dtype=np.float64) - raised_m
        z = np.concatenate([2.0 * z[:1] - z[1:2], z, 2.0 * z[-1:] - z[-2:-1]])
        step = np.diff(z)

        def twice_integrated(height: FloatArray) -> FloatArray:
            above = np.maximum(height - self.base_m, 0.0) ** 2 - np.maximum(height - self.top_m, 0.0) ** 2
            return np.asarray(0.5 * above)

        slope = np.diff(twice_integrated(z)) / step
        # Beyond the layer the second difference is rounding error, which must not look like cloud.
        met = (z[2:] > self.base_m) & (z[:-2] < self.top_m)
        changes = np.where(met, np.maximum(np.diff(slope), 0.0), 0.0)
        return changes * self.extinction_550_per_m / (0.5 * (step[1:] + step[:-1]))

    def infrared_per_m(self, altitude_m: FloatArray, wavelength_um: FloatArray, raised_m: float = 0.0) -> FloatArray:
        """Return the absorption [1/m] at infrared wavelengths (g,) on a grid, shape (g, n)."""
        absorbed = infrared_absorption(self.particle, wavelength_um)
        return np.asarray(absorbed[:, None] * self.column(altitude_m, raised_m))


def layers_of(scene: SceneSpec) -> tuple[ThinLayer, ...]:
    """Return the layers of a scene; raises ``UserError`` if base and top leave no layer."""
    found = []
    for i, layer in enumerate(scene.layer):
        kind = KINDS[layer.kind]
        latitude = scene.platform.latitude_deg
        base, top = heights_m(layer, latitude)
        if top - base < THINNEST_M - 1e-6:
            raise UserError(
                f"the layer would reach from {base / 1e3:g} to {top / 1e3:g} km",
                where=f"{scene.scene.name}: layer[{i}]",
                expected=f"a top at least {THINNEST_M / 1e3:g} km above the base; give both",
            )
        cover = layer.cover
        if layer.occurrence == "climate":
            cover = occurrence(layer.kind, latitude, float(scene.platform.epoch_utc.month))
        depth = kind.optical_depth if layer.optical_depth is None else layer.optical_depth
        if depth * cover <= 0.0:
            continue
        phase = layer.phase or kind.phase
        radius = layer.effective_radius_um
        if radius is None:
            radius = kind.effective_radius_um if phase == kind.phase else _USUAL_UM[phase]
        gaps = None
        if layer.scale_km is not None and cover < 1.0:
            seed = seed_of(scene, "layer", i) if layer.seed is None else layer.seed
            gaps = LayerGaps(cover, layer.scale_km * 1e3, seed)
        found.append(ThinLayer(base, top, depth * cover / (top - base), particle(phase, radius), gaps))
    return tuple(found)


_USUAL_UM = {"ice": 30.0, "water": 8.0}
"""Effective radius where a layer's phase differs from that of its kind."""


def merged_bands(layers: Sequence[tuple[float, float]], margin_m: float) -> list[tuple[float, float]]:
    """Return the heights that layers (base, top) occupy with a margin on both sides, merged and rising."""
    merged: list[tuple[float, float]] = []
    for base, top in sorted((max(base - margin_m, 0.0), top + margin_m) for base, top in layers):
        if merged and base <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], top))
        else:
            merged.append((base, top))
    return merged
