"""How far the radiance of a thermal band can be trusted, given the profile: figures for any band from 7.2 to 20 um.

Four intervals have been compared as they are with LOWTRAN7 (six climates) and, where it applies, REPTRAN; for them the
stated figures are :data:`NAMED`. Any other response is composed. Let s_b be the share of RRTMG band b in what the
sensor sees of the US standard limb (:mod:`horizonval.earth.spectral.limb_shares`), e_b the band's own error, and c the
error of splitting a band that the response covers in part::

    relative error = square root of the sum over b of (s_b (e_b + c_b))^2,    c_b = 0 for whole bands

(the bands have other lines and other gases: their errors are independent and differ in sign). e_b is the largest
difference from LOWTRAN7 over the climates, or from REPTRAN where that is larger. It is taken as 1 where nobody can
tell: LOWTRAN7 lacks strength at low pressure and says nothing about the weak bands above 33 to 42 km, and nothing at
all above 55 km. c is 6 % for rays that meet the ground or pass below 7 km, 20 % up to 33 km and 35 % above, as the cut
parts of 14.0 to 16.3 um differ from REPTRAN's and those of 10.5 to 12.5 um from LOWTRAN7's. A sum of half or more is no
statement and becomes None.

The height of half the plateau moves by as much as the errors of plateau and half, taken together, move the level on the
US standard limb; the plateau is the largest radiance from 10 to 24 km, or, where that is below 0.6 of it, that of the
ray 10 km below the hard horizon. Straight down the composed error is that of the bands' brightness temperatures, and
1 K for each cut band, added in the same way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import thermal_absorption
from horizonval.earth.spectral.limb_shares import limb_radiances
from horizonval.earth.spectral.thermal_absorption import GPoints
from horizonval.spec.camera import Band

RANGES_KM = (
    (-math.inf, 0.0), (0.0, 7.0), (7.0, 26.0), (26.0, 33.0), (33.0, 42.0), (42.0, 52.0), (52.0, 60.0),
    (60.0, math.inf),
)  # fmt: skip
"""Tangent heights that figures are given for; the first are rays that meet the ground."""
_MIDDLES_KM = (-10.0, 3.0, 18.0, 30.0, 38.0, 47.0, 56.0, 70.0)
_SPLIT = (0.06, 0.06, 0.20, 0.20, 0.35, 0.35, 0.35, 0.35)
_SPLIT_K = 1.0
_NO_STATEMENT = 0.5
_CUT = 0.02
"""By how much the classes of a band may differ in what the response leaves of them; one whole band has 0.5 %."""
_OPAQUE = 0.6
_FARTHEST_KM = 5.0
_EDGE_UM = 0.01
_RADIUS_M = 6.371e6
_BANDS: dict[str, tuple[float, ...]] = {
    "3": (0.01, 0.02, 0.17, 0.16, 0.19, 1, 1, 1),
    "4": (0.01, 0.02, 0.02, 0.10, 0.19, 0.20, 0.5, 1),
    "5": (0.10, 0.11, 0.17, 0.17, 0.30, 0.35, 1, 1),
    "6": (0.02, 0.07, 0.21, 0.20, 1, 1, 1, 1),
    "7": (0.11, 0.12, 0.05, 0.10, 0.18, 1, 1, 1),
    "8": (0.02, 0.08, 0.26, 0.31, 1, 1, 1, 1),
    "9": (0.02, 0.02, 0.41, 1, 1, 1, 1, 1),
}  # fmt: skip
_BANDS_NADIR_K = {"3": 1.3, "4": 1.1, "5": 3.4, "6": 0.5, "7": 0.6, "8": 0.6, "9": 0.7}

_LEFT_OUT = (
    "Emission is that of local thermodynamic equilibrium, which fails above about 75 km.",
    "Left out: scattering, and all structure of a response finer than 20 cm-1. Halocarbons are those of today; the "
    "comparisons had none.",
    "The figures are those of the spectroscopy for a given profile; weather, season and stratospheric warmings move "
    "the horizon by more.",
)


@dataclass(frozen=True)
class ThermalAccuracy:
    """Stated accuracy of a band's radiance in clear air.

    Attributes
    ----------
    interval : str
        The compared interval that the figures belong to, for example ``"14.0-16.3 um"``; "" for composed figures.
    ranges_km : tuple of (float, float)
        Tangent heights, the first for rays that meet the ground; see :data:`RANGES_KM`.
    relative : tuple of (float or None)
        Relative accuracy of the radiance in each range; None where there is no statement.
    half_height_km : float or None
        Uncertainty of the height at which the radiance falls to half its plateau; None where there is no statement.
    nadir_k : float
        Of the brightness temperature straight down.
    sentences : tuple of str
        What a reader must know, one statement each.
    """

    interval: str
    ranges_km: tuple[tuple[float, float], ...]
    relative: tuple[float | None, ...]
    half_height_km: float | None
    nadir_k: float
    sentences: tuple[str, ...]


@dataclass(frozen=True)
class _Named:
    lo_um: float
    hi_um: float
    relative: tuple[float | None, ...]
    half_height_km: float
    nadir_k: float


NAMED = {
    "14.0-16.3 um": _Named(14.0, 16.3, (0.05, 0.04, 0.04, 0.07, 0.12, 0.15, 0.5, None), 2.0, 2.2),
    "14.16-16.25 um": _Named(14.16, 16.25, (0.03, 0.03, 0.04, 0.07, 0.12, 0.15, 0.5, None), 2.0, 1.2),
    "8-14 um": _Named(8.0, 14.0, (0.04, 0.06, 0.11, 0.13, 0.13, None, None, None), 0.2, 0.6),
    "10.5-12.5 um": _Named(10.5, 12.5, (0.02, 0.06, 0.35, 0.30, None, None, None, None), 0.2, 0.6),
}
"""The four compared intervals. 0.5 from 52 to 60 km stands for a factor 1.5."""

_SPECTROSCOPY_KM = (
    "The height of half the plateau is uncertain by 1.5 to 2 km from the spectroscopy alone: it lies 1.5 to 2.0 km "
    "below LOWTRAN7's and 0.7 to 1.9 km above REPTRAN's. The error is nearly the same in all climates (0.3 km), so "
    "that differences between latitudes, seasons and frames are far better known."
)
_NAMED_SENTENCES = {
    "14.0-16.3 um": (
        _SPECTROSCOPY_KM,
        "From 33 to 42 km the radiance is 10 to 15 % below LOWTRAN7's and 7 to 13 % above REPTRAN's; from 60 to 75 km "
        "it was compared with a crude line-by-line sum only (40 %).",
    ),
    "14.16-16.25 um": (_SPECTROSCOPY_KM,),
    "8-14 um": ("Above 42 km, where the limb has a tenth of its brightness or less, the radiance is unverified.",),
    "10.5-12.5 um": (
        "Above 7 km the limb is dim (0.5 W m-2 sr-1 or less from 10 km on) and its radiance is known to a third only.",
    ),
}


def thermal_accuracy(band: Band) -> ThermalAccuracy:
    """Return the stated accuracy of a thermal band.

    Parameters
    ----------
    band : Band
        A response within 7.2 to 20 um.

    Raises
    ------
    UserError
        Response outside the tables.
    """
    for name, named in NAMED.items():
        if band.lo_um is None or band.hi_um is None:
            continue
        if abs(band.lo_um - named.lo_um) <= _EDGE_UM and abs(band.hi_um - named.hi_um) <= _EDGE_UM:
            comparison = (
                f"Figures of {name} as compared with LOWTRAN7 in six climates and with REPTRAN where it applies."
            )
            return ThermalAccuracy(
                name,
                RANGES_KM,
                named.relative,
                named.half_height_km,
                named.nadir_k,
                (comparison, *_NAMED_SENTENCES[name], *_LEFT_OUT),
            )
    return _composed(band)


def _composed(band: Band) -> ThermalAccuracy:
    points = thermal_absorption.g_points(band)
    pieces = _pieces(points)
    limb = _shares(pieces, limb_radiances(points, 1e3 * np.array(_MIDDLES_KM)))
    relative: list[float | None] = []
    for i, split in enumerate(_SPLIT):
        errors = [_BANDS[piece.number][i] + (split if piece.cut else 0.0) for piece in pieces]
        total = float(np.linalg.norm(limb[i] * errors))
        relative.append(round(total, 2) if total < _NO_STATEMENT else None)
    down = _shares(pieces, limb_radiances(points, np.array([-_RADIUS_M])))[0]
    nadir = [_BANDS_NADIR_K[piece.number] + (_SPLIT_K if piece.cut else 0.0) for piece in pieces]
    comparison = (
        "Figures composed from those of the RRTMG bands that the response touches, by their shares in the radiance"
        + ("; it cuts at least one of them, which adds 6 to 35 % of that band." if any(p.cut for p in pieces) else ".")
    )
    half = _half_height_km(points, tuple(relative))
    unknown = () if half is not None else ("There is no statement about the height of half the plateau.",)
    return ThermalAccuracy(
        "",
        RANGES_KM,
        tuple(relative),
        half,
        round(float(np.linalg.norm(down * nadir)), 1),
        (comparison, *unknown, *_LEFT_OUT),
    )


@dataclass(frozen=True)
class _Piece:
    """One RRTMG band as a sensor sees it: its number, its g points, and whether the response varies within it."""

    number: str
    points: slice
    cut: bool


def _pieces(points: GPoints) -> list[_Piece]:
    weights = thermal_absorption.g_weights()
    pieces = []
    for first in range(0, len(points.name), len(weights)):
        here = slice(first, first + len(weights))
        # A response that is flat over the band gives every class its weight.
        share = points.weight_per_cm[here].sum(axis=1) / weights
        number = points.name[first].removeprefix("rrtmg").partition("g")[0]
        pieces.append(_Piece(number, here, float(np.ptp(share)) > _CUT * float(share.mean())))
    return pieces


def _shares(pieces: list[_Piece], radiance: FloatArray) -> FloatArray:
    """Return the share of every piece in radiances of shape (n, g), shape (n, pieces)."""
    parts = np.stack([radiance[:, piece.points].sum(axis=1) for piece in pieces], axis=1)
    return parts / parts.sum(axis=1, keepdims=True)


def _half_height_km(points: GPoints, relative: tuple[float | None, ...]) -> float | None:
    height = np.arange(0.0, 80.5, 0.5)
    radiance = limb_radiances(points, 1e3 * height).sum(axis=1)
    ground = float(limb_radiances(points, np.array([-10e3])).sum())
    plateau, of_plateau = float(radiance[(height >= 10) & (height <= 24)].max()), relative[_range(17.0)]
    if plateau < _OPAQUE * ground:
        plateau, of_plateau = ground, relative[0]
    middle = _outermost(height, radiance, plateau / 2)
    of_half = relative[_range(middle)]
    if of_half is None or of_plateau is None:
        return None
    error = math.hypot(of_half, of_plateau)
    moved = max(abs(_outermost(height, radiance, plateau / 2 * (1 + sign * error)) - middle) for sign in (-1, 1))
    return round(moved, 1) if moved <= _FARTHEST_KM else None


def _range(height_km: float) -> int:
    return next(i for i, (_, high) in enumerate(RANGES_KM) if height_km < high)


def _outermost(height: FloatArray, radiance: FloatArray, level: float) -> float:
    """Return the largest height at which the radiance is a level, 0 where it is nowhere as bright."""
    above = np.flatnonzero(radiance >= level)
    if not above.size:
        return 0.0
    i = int(min(above[-1], len(height) - 2))
    fraction = math.log(radiance[i] / level) / math.log(radiance[i] / radiance[i + 1])
    return float(height[i] + (height[i + 1] - height[i]) * fraction)
