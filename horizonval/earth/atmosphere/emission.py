"""Thermal bands as the renderer and the truth see them: absorption and temperature over height and latitude.

A band is a set of g points (:mod:`horizonval.earth.spectral.thermal_absorption`), each solved as if monochromatic and
summed::

    L = sum over g of [ integral of S_g(T) exp(-tau_g) dtau_g  +  (ground, cloud or Sun behind) exp(-tau_g) ]

The air is given at levels of height for every row of latitude. Between levels the absorption is linear in its logarithm
and the temperature linear, as the tables' authors mean them; between rows the renderer takes both ``extinction`` and
``source`` of :meth:`EmittingBand.columns` as linear in the sine of latitude, beyond the last row as on it. Air that
varies with longitude too stands in columns on a map (:mod:`horizonval.earth.weather.column_map`), bilinear between.

Columns over high ground begin there: below it nothing absorbs or emits, though the ground itself lies on the ellipsoid.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.special import expn

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral.planck import radiance_per_wavenumber
from horizonval.earth.weather.column_map import ColumnMap

COLDEST_K, WARMEST_K, STEP_K = 80.0, 400.0, 1.0
"""Range and step of the spline through S(T); its error is below 1e-8 of S."""
_OPAQUE, _THIN = 300.0, 1e-3
GROUND_STEP_M = 250.0
"""Over which a column over high ground begins: the step of the grid of maps, so that its depth is right."""


@dataclass(frozen=True)
class SourceSpline:
    """S_g(T) by a spline between COLDEST_K and WARMEST_K; beyond them exactly, which takes longer.

    ``wavenumber_per_cm`` (q,) and ``weight_per_cm`` (g, q) are those of an :class:`EmittingBand`.
    """

    wavenumber_per_cm: FloatArray
    weight_per_cm: FloatArray
    spline: CubicSpline

    def __call__(self, temperature_k: ArrayLike) -> FloatArray:
        """Return S [W m-2 sr-1]; shape of the temperature and (g,) behind it."""
        temperature = np.asarray(temperature_k, dtype=np.float64)
        value = np.asarray(self.spline(np.clip(temperature, COLDEST_K, WARMEST_K)))
        outside = (temperature < COLDEST_K) | (temperature > WARMEST_K)
        if np.any(outside):
            planck = radiance_per_wavenumber(self.wavenumber_per_cm, temperature[outside][:, None])
            value[outside] = planck @ self.weight_per_cm.T
        return value

    def of(self, part: slice) -> SourceSpline:
        """Return that of some of the g points."""
        spline = CubicSpline.construct_fast(self.spline.c[:, :, part], self.spline.x)
        return SourceSpline(self.wavenumber_per_cm, self.weight_per_cm[part], spline)


@dataclass(frozen=True)
class EmittingBand:
    """One thermal band of a camera with the air it looks through.

    Attributes
    ----------
    name : str
        Of the band.
    wavelength_um : ndarray, shape (g,)
        Nominal, per g point.
    altitude_m : ndarray, shape (n,)
        The grid the renderer marches on: between its nodes extinction and source are linear. 0 to the top.
    sin_latitude : ndarray, shape (m,)
        Of geodetic latitude, rising in equal steps; one value alone means the same air everywhere. With a map: one
        value of no meaning, and m below is the number of the map's columns.
    level_m : ndarray, shape (k,)
    ln_extinction : ndarray, shape (g, m, k)
        Logarithm of the extinction [1/m] at the levels.
    temperature_k : ndarray, shape (m, k)
        At the levels.
    source_wavenumber_per_cm : ndarray, shape (q,)
    source_weight_per_cm : ndarray, shape (g, q)
        ``S_g(T) = sum_q weight[g, q] B_nu(wavenumber[q], T)``, W m-2 sr-1.
    sun_radiance : ndarray, shape (g,)
        Mean radiance of the Sun's disc outside the atmosphere [W m-2 sr-1].
    layer_per_m : ndarray, shape (g, n)
        What thin cloud adds to the extinction, on ``altitude_m``; of shape (0, 0) for none.
    layers : ndarray, shape (k, 2)
        Base and top of its layers [m].
    each_layer_per_m : ndarray, shape (k, g, n)
        ``layer_per_m`` layer by layer, where one has gaps; else of shape (0, 0, 0).
    column_map : ColumnMap or None
        Where the columns of air stand that varies with longitude.
    ground_m : ndarray, shape (m,)
        Height at which each column begins; of shape (0,) where all begin at 0.
    """

    name: str
    wavelength_um: FloatArray
    altitude_m: FloatArray
    sin_latitude: FloatArray
    level_m: FloatArray
    ln_extinction: FloatArray
    temperature_k: FloatArray
    source_wavenumber_per_cm: FloatArray
    source_weight_per_cm: FloatArray
    sun_radiance: FloatArray
    column_map: ColumnMap | None = None
    layer_per_m: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    layers: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    each_layer_per_m: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0)))
    ground_m: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def is_uniform(self) -> bool:
        """Whether the air is the same everywhere."""
        return self.column_map is None and len(self.sin_latitude) == 1

    def coarser(self) -> EmittingBand:
        """Return the band with fewer columns where it has a map: for what varies little, such as the sky's mean."""
        if self.column_map is None:
            return self
        place, kept = self.column_map.coarser()
        return replace(self.of_columns(kept), column_map=place)

    def of_columns(self, kept: NDArray[np.intp]) -> EmittingBand:
        """Return the band with some of its columns; where they stand is left as it is."""
        return replace(
            self,
            ln_extinction=self.ln_extinction[:, kept],
            temperature_k=self.temperature_k[kept],
            ground_m=self.ground_m[kept] if len(self.ground_m) else self.ground_m,
        )

    def between(self, values: FloatArray, normal: FloatArray) -> FloatArray:
        """Return what is given at the columns, shape (g, m), at places with unit normals (n, 3), shape (g, n)."""
        if self.column_map is None:
            return np.stack([np.interp(normal[:, 2], self.sin_latitude, row) for row in values])
        x, y = self.column_map.plane(normal)
        return np.asarray(sum(values[:, i] * w for i, w in self.column_map.corners(x, y)))

    @property
    def count(self) -> int:
        """Number of g points."""
        return len(self.wavelength_um)

    def source(self, temperature_k: ArrayLike) -> FloatArray:
        """Return S_g(T) [W m-2 sr-1]; shape of the temperature and (g,) behind it."""
        temperature = np.asarray(temperature_k, dtype=np.float64)[..., None]
        return radiance_per_wavenumber(self.source_wavenumber_per_cm, temperature) @ self.source_weight_per_cm.T

    def source_spline(self) -> SourceSpline:
        """Return a quick S_g(T) for many temperatures."""
        nodes = np.arange(COLDEST_K, WARMEST_K + STEP_K, STEP_K)
        spline = CubicSpline(nodes, self.source(nodes))
        return SourceSpline(self.source_wavenumber_per_cm, self.source_weight_per_cm, spline)

    def columns(self) -> tuple[FloatArray, FloatArray]:
        """Return extinction [1/m] and source function [W m-2 sr-1] on ``altitude_m``, shapes (g, m, n)."""
        return self.extinction_at(self.altitude_m), np.moveaxis(self.source_spline()(self.air_k(self.altitude_m)), 2, 0)

    def sky_irradiance(self) -> FloatArray:
        """Return the mean radiance of the sky over the ground [W m-2 sr-1], shape (g, m): irradiance over pi.

        A Lambert ground of emissivity e sends up ``e S`` and ``1 - e`` times this. The air is taken as plane layers
        whose source is linear in optical depth, for which this is exact (space behind is dark)::

            sky = integral of S 2 E_2(tau) dtau,    E_2 = -dE_3/dtau,    E_3 = -dE_4/dtau

        On a round Earth low rays meet less air: its sky is less by at most 0.13 % of the ground's own S in any g point,
        0.05 % in a band (which may be 0.6 % of the sky where that is nearly dark).
        """
        extinction, source = self.columns()
        layer = 0.5 * (extinction[..., 1:] + extinction[..., :-1]) * np.diff(self.altitude_m)
        tau = np.concatenate([np.zeros((*layer.shape[:-1], 1)), np.cumsum(layer, axis=-1)], axis=-1)
        tau = np.minimum(tau, _OPAQUE)
        third = expn(3, tau)
        fourth = (np.exp(-tau) - tau * third) / 3.0
        passed, step = 2.0 * (third[..., :-1] - third[..., 1:]), np.diff(tau, axis=-1)
        moment = 2.0 * (fourth[..., :-1] - fourth[..., 1:] - step * third[..., 1:])
        thick = step > _THIN
        # The mean place of what is seen of a layer; the middle of a thin one, where the moments cancel.
        upper = np.divide(moment, step * passed, out=np.full_like(step, 0.5), where=thick & (passed > 1e-30))
        mean = source[..., :-1] * (1.0 - upper) + source[..., 1:] * upper
        return np.asarray(np.sum(mean * passed, axis=-1))

    def extinction_at(self, altitude_m: ArrayLike) -> FloatArray:
        """Return the extinction [1/m] at heights (n,), shape (g, m, n)."""
        i, w = self._locate(altitude_m)
        z = np.asarray(altitude_m, dtype=np.float64)
        gas = np.empty((*self.ln_extinction.shape[:2], len(z)))
        # Hundreds of columns of one g point stay in a processor's cache, those of all do not.
        for of_point, ln_levels in zip(gas, self.ln_extinction, strict=True):
            np.exp(ln_levels[:, i] * (1.0 - w) + ln_levels[:, i + 1] * w, out=of_point)
        if self.ground_m.any():
            gas *= self._above_ground(z)
        if not len(self.layers):
            return gas
        return gas + np.stack([np.interp(z, self.altitude_m, row) for row in self.layer_per_m])[:, None, :]

    def _above_ground(self, z: FloatArray) -> FloatArray:
        """Return how much of the air around heights (n,) lies above the ground of each column, shape (m, n)."""
        low, high = np.maximum(z - 0.5 * GROUND_STEP_M, 0.0), z + 0.5 * GROUND_STEP_M
        return np.clip((high - self.ground_m[:, None]) / (high - low), 0.0, 1.0)

    def air_k(self, altitude_m: ArrayLike) -> FloatArray:
        """Return the temperature at heights (n,), shape (m, n)."""
        i, w = self._locate(altitude_m)
        return self.temperature_k[:, i] * (1.0 - w) + self.temperature_k[:, i + 1] * w

    def _locate(self, altitude_m: ArrayLike) -> tuple[np.ndarray, FloatArray]:
        z = np.clip(np.asarray(altitude_m, dtype=np.float64), self.level_m[0], self.level_m[-1])
        i = np.clip(np.searchsorted(self.level_m, z, side="right") - 1, 0, len(self.level_m) - 2)
        return i, (z - self.level_m[i]) / (self.level_m[i + 1] - self.level_m[i])
