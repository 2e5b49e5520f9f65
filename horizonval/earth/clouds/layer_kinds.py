"""Thin cloud by kind: its heights, optical depth and particles where a scene does not say, and how often it is seen.

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

**Occurrence** follows the published maps and zonal means in shape; figures are rounded to what separate instruments
agree on, about a fifth of the largest value of a kind:

- cirrus (Sassen, Wang and Liu 2008, CloudSat and CALIPSO): 35 % at the equator, 10 % in the subtropics, 18 % around
  45 deg, less towards the poles; 17 % over the globe;
- subvisible cirrus (Wang et al. 1996): 45 % at the equator, falling to a tenth of that beyond 40 deg;
- both move by 8 deg of latitude with the season, north in August;
- polar stratospheric clouds (Pitts et al. 2018): poleward of 60 deg, 50 % at 80 deg in the south from June to September
  and 10 % in the north from December to February, half as much in the months beside;
- noctilucent clouds (Thomas 1991; Russell et al. 2009): poleward of 55 deg, 80 % at 80 deg in the months of the summer
  solstice and the one after, a fourth of that in the months beside; the south has two thirds of the north.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.earth.clouds.relief import tropopause_m
from horizonval.spec.earth import CloudLayer

SHIFT_DEG, NORTHMOST_MONTH = 8.0, 8.0
_CIRRUS_DEG = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0)
_CIRRUS = (0.35, 0.30, 0.14, 0.10, 0.18, 0.15, 0.09, 0.05)
SUBVISIBLE, SUBVISIBLE_DEG, SUBVISIBLE_ELSEWHERE = 0.45, 18.0, 0.03


@dataclass(frozen=True)
class LayerKind:
    """What a kind of layer is where a scene does not say; heights in metres, from the tropopause if ``below``."""

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
    """Return how often a kind of cloud is seen at a latitude in a month (1 to 12), 0 to 1; the module text has sources.

    Raises
    ------
    KeyError
        The kind has no climate.
    """
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
    """Return 1 within ``half`` months of the middle of a season, ``beside`` one month from there, 0 beyond."""
    away = abs((month - middle + 6.0) % 12.0 - 6.0)
    return 1.0 if away <= half + 1e-9 else beside if away <= half + 1.0 + 1e-9 else 0.0


def _poleward(latitude_deg: float, first_deg: float, all_deg: float) -> float:
    return float(np.clip((latitude_deg - first_deg) / (all_deg - first_deg), 0.0, 1.0))
