"""Thermal absorption by correlated k: 16 g points in 7 bands of 500 to 1390 cm-1, their sources and their accuracy.

**Classes.** Inside a band the spectrum is sorted by absorption into 16 classes ("g points"), each with one profile
k_g(z) and a share w_g of the band; radiance is solved per class as if monochromatic and summed. The absorption follows
from the air (:mod:`horizonval.earth.gases.rrtmg`). The classes' Planck sources follow a sensor's response R through a
map F[i, g]: the share of class g in the 10 cm-1 bin i::

    S[b, g](T) = w_g * width_b * sum over bins i of b of F[i, g] / 10 cm-1 * integral over bin i of R(nu) B_nu(T) dnu

so that L = sum over b, g of the integral of S dTransmission, W m-2 sr-1. The integral is done by Gauss's rule between
the knots of the response. Every row of the published map is scaled so that the classes fill their bin exactly (``sum
over g of w_g width_b F[i, g] = 10 cm-1``): the sources of all classes add up to the band's Planck radiance. The sum of
a class over its band is then right to 5e-3 in one band and 1e-7 elsewhere.

The map was fitted to LOWTRAN7's spectra of the six AFGL climates at 330 ppm of carbon dioxide and does not depend on
the air. Features of the response narrower than 20 cm-1 are not resolved. Neglected: scattering, non-LTE (above 75 km).

**Accuracy** of the radiance of a band from 7.2 to 20 um for a given profile. Four intervals have been compared with
LOWTRAN7 (six climates) and, where it applies, REPTRAN (:data:`NAMED`). The accuracy of any other response is composed.
Let s_b be the share of RRTMG band b in the radiance of the US standard limb, e_b the error of the band, and c the error
of dividing a band that the response covers in part::

    relative error = square root of the sum over b of (s_b (e_b + c_b))^2,    c_b = 0 for whole bands

(the bands' errors are independent, since lines and gases differ). e_b is the largest difference from LOWTRAN7 over the
climates, or from REPTRAN where that is larger; it is 1 where it is unknown: LOWTRAN7 lacks strength at low pressure and
cannot judge the weak bands above 33 to 42 km, nor any band above 55 km. c is 6 % for rays that meet the ground or pass
below 7 km, 20 % up to 33 km and 35 % above, after the parts of 14.0 to 16.3 um and 10.5 to 12.5 um. A sum of half or
more becomes None.

The uncertainty of the height of half the plateau is the shift of that level on the US standard limb under the combined
errors of plateau and half. The plateau is the largest radiance from 10 to 24 km, or, where that is below 0.6 of it,
that of the ray 10 km below the hard horizon. For nadir the composed error is that of the bands' brightness
temperatures, and 1 K for each divided band, added in the same way.

The shares come from straight rays through the US standard atmosphere over a round Earth, in shells between the levels
of its absorption, good to a few per cent. A shell has the mean absorption of its faces and the source of its mean
temperature.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cache, lru_cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.digests import content_digest
from horizonval.core.errors import UserError
from horizonval.earth.gases import afgl
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.spectral import bands, sunlight
from horizonval.earth.spectral.planck import radiance_per_wavenumber
from horizonval.earth.spectral.quadrature import composite_gauss
from horizonval.earth.tables import npz
from horizonval.spec.camera import Band

_TABLE = "gpoint_map.npz"
MIN_PER_CM, MAX_PER_CM = 500.0, 1390.0
MIN_UM, MAX_UM = 1e4 / MAX_PER_CM, 1e4 / MIN_PER_CM
_POINTS = 4
"""Order of Gauss's rule between two edges at most 10 cm-1 apart: 1e-12 of the integral of R B."""


def g_weights() -> FloatArray:
    """Return the share of a band of each of its classes, from the weakest to the strongest; shape (16,)."""
    return np.asarray(npz(_TABLE)["g_weight"], dtype=np.float64)


@dataclass(frozen=True)
class GPoints:
    """The classes of absorption of a sensor band: 16 for every RRTMG band it touches.

    ``name``: length g, ``"rrtmg4g07"`` for band number and g point, both counted from 1; ``wavelength_um``: shape (g,),
    centroid of the response inside the RRTMG band; ``table_band``, ``table_g``: shape (g,), indices into
    :data:`horizonval.earth.gases.rrtmg.BANDS` and the 16 classes; ``wavenumber_per_cm`` (q,), ``weight_per_cm`` (g, q):
    ``S_g(T) = sum_q weight[g, q] B_nu(wavenumber[q], T)``.
    """

    name: tuple[str, ...]
    wavelength_um: FloatArray
    table_band: np.ndarray
    table_g: np.ndarray
    wavenumber_per_cm: FloatArray
    weight_per_cm: FloatArray

    def ln_absorption(self, state: GasState) -> FloatArray:
        """Return the logarithm of the absorption [1/m] of air, shape (g, ...) followed by the shape of its columns."""
        return _ln_absorption(_Lookup(content_digest(self.table_band, self.table_g, *state.contents()), self, state))

    def sun_radiance(self) -> FloatArray:
        """Return the mean radiance of the Sun's disc in every class [W m-2 sr-1], shape (g,), at 1 au."""
        nu = self.wavenumber_per_cm
        per_cm = sunlight.irradiance(1e4 / nu) * 1e4 / nu**2
        return self.weight_per_cm @ per_cm / sunlight.disc_projected_solid_angle()


@dataclass(frozen=True)
class _Lookup:
    """Classes and air, compared by their digest: the key of a cache."""

    digest: str
    points: GPoints = field(compare=False)
    state: GasState = field(compare=False)


@lru_cache(maxsize=4)
def _ln_absorption(lookup: _Lookup) -> FloatArray:
    """Return :meth:`GPoints.ln_absorption`, cached because frames of one place have the same air."""
    bands, g = lookup.points.table_band, lookup.points.table_g
    touched, place = np.unique(bands, return_inverse=True)
    found = np.log(lookup.state.absorption_per_m([int(band) for band in touched])[place, g])
    found.flags.writeable = False
    return found


@cache
def _share() -> FloatArray:
    """Return the map F with every row scaled to fill its bin, shape (bins, 16)."""
    table = npz(_TABLE)
    share = np.asarray(table["gpoint_spectral_fraction"], dtype=np.float64)
    bins = np.asarray(table["bin_edges_per_cm"], dtype=np.float64)
    widths = np.diff(np.asarray(table["band_edges_per_cm"], dtype=np.float64), axis=1)[table["bin_band_index"], 0]
    filled = share @ g_weights() * widths / np.diff(bins, axis=1)[:, 0]
    return share / filled[:, None]


def _sampled(band: Band) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Return wavenumbers [cm-1], quadrature weights including the response [cm-1], and the bin of each."""
    bins = np.asarray(npz(_TABLE)["bin_edges_per_cm"], dtype=np.float64)
    knots = 1e4 / bands.knots_um(band)
    edges = np.unique(np.concatenate([bins[:, 0], bins[-1:, 1], knots]))
    edges = edges[(edges >= max(knots.min(), MIN_PER_CM)) & (edges <= min(knots.max(), MAX_PER_CM))]
    nu, weight = composite_gauss(edges, _POINTS)
    nu, weight = nu.ravel(), weight.ravel()
    return nu, weight * bands.response(band, 1e4 / nu), np.searchsorted(bins[:, 0], nu, side="right") - 1


def g_points(band: Band, *, where: str = "") -> GPoints:
    """Return the classes of a sensor band, whose response is per unit power.

    ``where``: file and key, for the error message. Raises ``UserError``: response reaching outside 7.194 to 20 um.
    """
    lo, hi = bands.limits_um(band)
    tolerance = 1e-9
    if lo < MIN_UM - tolerance or hi > MAX_UM + tolerance:
        raise UserError(
            f"thermal band {band.name!r} spans {lo:g} to {hi:g} um",
            where=where,
            expected=f"a response within {np.ceil(MIN_UM * 1e3) / 1e3:g} to {MAX_UM:g} um "
            f"({MIN_PER_CM:g} to {MAX_PER_CM:g} cm-1), where there is an absorption table",
        )
    table = npz(_TABLE)
    g_weight = g_weights()
    bins = np.asarray(table["bin_edges_per_cm"], dtype=np.float64)
    edges = np.asarray(table["band_edges_per_cm"], dtype=np.float64)
    nu, weight, bin_of = _sampled(band)
    band_of = np.asarray(table["bin_band_index"])[bin_of]
    touched = [b for b in range(len(edges)) if weight[band_of == b].sum() > 0]
    rows = []
    for b in touched:
        # Share of class g per cm-1, times its width.
        density = _share()[bin_of] / np.diff(bins, axis=1)[bin_of] * (edges[b, 1] - edges[b, 0])
        rows.append((density * g_weight * (weight * (band_of == b))[:, None]).T)
    centroid = [1e4 * weight[band_of == b].sum() / (weight @ (nu * (band_of == b))) for b in touched]
    g = np.arange(len(g_weight))
    return GPoints(
        name=tuple(f"rrtmg{table['band_number'][b]}g{i + 1:02d}" for b in touched for i in g),
        wavelength_um=np.repeat(centroid, len(g)),
        table_band=np.repeat(touched, len(g)),
        table_g=np.tile(g, len(touched)),
        wavenumber_per_cm=nu,
        weight_per_cm=np.concatenate(rows),
    )


_RADIUS_M = 6.371e6
_CLIMATE = "us_standard"


def limb_radiances(points: GPoints, height_m: FloatArray, air: GasState | None = None) -> FloatArray:
    """Return the radiance of every g point [W m-2 sr-1] along rays, shape (n, g).

    ``height_m``: shape (n,), tangent heights below 100 km; for rays to a black ground, negative: impact parameter minus
    radius, down to minus the Earth's radius at nadir; ``air``: one column; default the US standard atmosphere with
    today's halocarbons.
    """
    if air is None:
        air = afgl.state(_CLIMATE, afgl.levels_m()).with_halocarbons()
    levels, temperature, ln_k = air.altitude_m, air.temperature_k, points.ln_absorption(air)
    rows = [_ray(points, float(h), levels, temperature, ln_k) for h in np.asarray(height_m, dtype=np.float64)]
    return np.stack(rows)


def _ray(points: GPoints, height_m: float, levels: FloatArray, temperature: FloatArray, ln_k: FloatArray) -> FloatArray:
    z = np.concatenate([[max(height_m, 0.0)], levels[levels > max(height_m, 0.0)]])
    k = np.exp(np.stack([np.interp(z, levels, row) for row in ln_k]))
    t = np.interp(z, levels, temperature)
    path = np.sqrt(np.maximum((_RADIUS_M + z) ** 2 - (_RADIUS_M + height_m) ** 2, 0.0))
    depth = 0.5 * (k[:, 1:] + k[:, :-1]) * np.diff(path)
    source = _source(points, 0.5 * (t[1:] + t[:-1]))
    near = depth[:, ::-1]
    order = near if height_m < 0 else np.concatenate([near, depth], axis=1)
    shells = source[:, ::-1] if height_m < 0 else np.concatenate([source[:, ::-1], source], axis=1)
    passed = np.exp(-np.concatenate([np.zeros((len(k), 1)), np.cumsum(order, axis=1)], axis=1))
    total = np.sum(shells * (passed[:, :-1] - passed[:, 1:]), axis=1)
    return total + (_source(points, t[:1])[:, 0] * passed[:, -1] if height_m < 0 else 0.0)


def _source(points: GPoints, kelvin: FloatArray) -> FloatArray:
    """Return S of every g point, shape (g, n)."""
    return points.weight_per_cm @ radiance_per_wavenumber(points.wavenumber_per_cm[:, None], kelvin)


RANGES_KM = (
    (-math.inf, 0.0), (0.0, 7.0), (7.0, 26.0), (26.0, 33.0), (33.0, 42.0), (42.0, 52.0), (52.0, 60.0),
    (60.0, math.inf),
)  # fmt: skip
"""Ranges of tangent heights of the stated accuracy; the first are rays that meet the ground."""
_MIDDLES_KM = (-10.0, 3.0, 18.0, 30.0, 38.0, 47.0, 56.0, 70.0)
_SPLIT = (0.06, 0.06, 0.20, 0.20, 0.35, 0.35, 0.35, 0.35)
_SPLIT_K = 1.0
_NO_STATEMENT = 0.5
_CUT = 0.02
"""Largest variation of the response between the classes of a whole band; a flat response gives 0.5 %."""
_OPAQUE = 0.6
_FARTHEST_KM = 5.0
_EDGE_UM = 0.01

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

    ``interval``: compared interval, such as ``"14.0-16.3 um"``, "" for composed values; ``ranges_km``: tangent heights
    (:data:`RANGES_KM`); ``relative``: relative accuracy of the radiance in each range, None if unknown;
    ``half_height_km``: uncertainty of the height of half the plateau, None if unknown; ``nadir_k``: of the brightness
    temperature straight down; ``sentences``: explanations for the reader.
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
"""The four compared intervals. 0.5 from 52 to 60 km represents a factor 1.5."""

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
    """Return the stated accuracy of a thermal band; ``UserError`` if the response leaves 7.2 to 20 um."""
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
    points = g_points(band)
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
    """An RRTMG band as part of a sensor band: number, g points, and whether the response varies within it."""

    number: str
    points: slice
    cut: bool


def _pieces(points: GPoints) -> list[_Piece]:
    weights = g_weights()
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
    """Return the largest height at which the radiance reaches a level, 0 where it never does."""
    above = np.flatnonzero(radiance >= level)
    if not above.size:
        return 0.0
    i = int(min(above[-1], len(height) - 2))
    fraction = math.log(radiance[i] / level) / math.log(radiance[i] / radiance[i + 1])
    return float(height[i] + (height[i + 1] - height[i]) * fraction)
