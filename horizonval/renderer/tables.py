r"""Altitude profiles and the Sun's optical depth as tables that a kernel reads.

Profiles are linear in altitude between the nodes of one common grid and zero above the top. The nodes of a batch lie
side by side in memory, so that one packet gather serves the batch.

The optical depth towards the Sun from height ``h`` under solar zenith cosine ``mu`` is tabulated on::

    h  = top x_r^2,          mu = mu_h + (1 - mu_h) x_mu^2,      mu_h = -sqrt(h (2 R + h)) / (R + h)

``mu_h`` is the cosine of the geometric horizon seen from ``h``, so the table never straddles the shadow edge, and the
squares put nodes where the optical depth bends most: near the ground and near the horizon. Stored is
``ln(tau + tau_0)``, ``tau_0 = 1e-12``: nearly linear along both axes, so bilinear interpolation serves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.renderer.types import Real, Values, Vec

TAU_FLOOR = 1e-12

_ALIGNMENT = 128


def gather_row(table: Real, index: mi.UInt32, width: int) -> list[Real]:
    """Return the ``width`` neighbouring entries of a flat table at row ``index``."""
    if width % 4 == 0:
        scalar: Any = type(table)
        packet = packet_type(scalar)
        packets = [dr.gather(packet, table, index * (width // 4) + k) for k in range(width // 4)]
        return [values[k] for values in packets for k in range(4)]
    return [dr.gather(type(table), table, index * width + k) for k in range(width)]


def table_of(scalar: type[Real], values: NDArray[np.floating]) -> Real:
    """Return values as a flat array of the type ``scalar`` (Float32 or Float64), fit for :func:`gather_row`.

    Dr.Jit reads NumPy's memory in place, and gathers packets and loads vectors with one instruction only where they are
    aligned. NumPy's alignment varies, and every combination would be another kernel to compile.
    """
    return table_of_parts(scalar, [values])


def table_of_parts(scalar: type[Real], parts: Sequence[NDArray[np.floating]]) -> Real:
    """Return the values of arrays, one behind the other, as :func:`table_of`: large ones are copied once."""
    dtype = np.dtype(np.float32 if dr.type_v(scalar) == dr.VarType.Float32 else np.float64)
    size = sum(part.size for part in parts)
    room = np.empty(size * dtype.itemsize + _ALIGNMENT, dtype=np.uint8)
    first = -room.ctypes.data % _ALIGNMENT
    aligned = room[first : first + size * dtype.itemsize].view(dtype)
    filled = 0
    for part in parts:
        aligned[filled : filled + part.size] = part.ravel()
        filled += part.size
    return scalar(aligned)


def vectors(v: FloatArray) -> Vec:
    """Return rows (n, 3) as three kernel arrays."""
    x, y, z = (table_of(mi.Float64, v[:, k]) for k in range(3))
    return x, y, z


@cache
def packet_type(scalar: type[Real]) -> Any:
    """Return the type of four neighbouring Float32 or Float64 values."""
    module = dr.cuda if dr.backend_v(scalar) == dr.JitBackend.CUDA else dr.llvm
    return module.ad.Array4f if dr.type_v(scalar) == dr.VarType.Float32 else module.ad.Array4f64


def _at(nodes: mi.Float64, i: mi.UInt32) -> Any:
    return dr.gather(mi.Float64, nodes, i)


@dataclass(frozen=True)
class AltitudeGrid:
    """Where on the common altitude grid a height lies. Uniform grids need no search."""

    altitude_m: mi.Float64
    count: int
    step_m: float | None

    @classmethod
    def of(cls, altitude_m: NDArray[np.float64]) -> AltitudeGrid:
        """Build from rising altitudes [m]."""
        steps = np.diff(altitude_m)
        uniform = bool(np.all(np.abs(steps - steps[0]) <= 1e-9 * altitude_m[-1]))
        return cls(
            table_of(mi.Float64, altitude_m), len(altitude_m), float(altitude_m[-1]) / len(steps) if uniform else None
        )

    def locate(self, height_m: Real) -> tuple[mi.UInt32, Real, mi.Bool]:
        """Return ``(i, w, inside)``: lower node, weight of the upper one, and whether the height is at most the top.

        Heights below 0 (rounding at the ground) count as 0. On even grids they may be single.
        """
        if self.step_m is not None:
            x = dr.maximum(height_m, 0.0) * (1.0 / self.step_m)
            i = dr.minimum(mi.UInt32(dr.minimum(x, self.count)), self.count - 2)
            w = x - type(x)(i)
        else:
            i = dr.binary_search(1, self.count - 1, lambda k: _at(self.altitude_m, k) <= height_m)
            i = mi.UInt32(i) - 1
            low, high = _at(self.altitude_m, i), _at(self.altitude_m, i + 1)
            w = dr.maximum(height_m - low, 0.0) / (high - low)
        return i, dr.minimum(w, 1.0), w <= 1.0 + 1e-9


def interpolate(table: Real, i: mi.UInt32, w: Real, width: int, stride: int = 1) -> list[Real]:
    """Return a row's values linear between rows ``i`` and ``i + stride``."""
    low, high = gather_row(table, i, width), gather_row(table, i + stride, width)
    return [dr.fma(b - a, w, a) for a, b in zip(low, high, strict=True)]


@dataclass(frozen=True)
class SunShell:
    """A layer of thin cloud in the way of sunlight.

    Extinction [1/m] per node between two heights, path lengths exact.
    """

    base_m: mi.Float64
    top_m: mi.Float64
    per_m: Values

    def depth(self, height_m: mi.Float64, mu: mi.Float64, radius_m: float) -> Values:
        """Return the optical depth per node from points outwards, towards a zenith cosine, over a sphere."""
        r = radius_m + height_m
        forth = r * mu
        miss2 = dr.fma(-forth, forth, r * r)

        def inside(edge_m: mi.Float64) -> mi.Float64:
            x = radius_m + edge_m
            half = dr.sqrt(dr.maximum(dr.fma(x, x, -miss2), 0.0))
            return dr.maximum(half - dr.maximum(forth, -half), 0.0)

        length = inside(self.top_m) - inside(self.base_m)
        return [k * length for k in self.per_m]


@dataclass(frozen=True)
class SunTable:
    """``ln(tau + tau_0)`` of a node batch, shape (n_height, n_mu, width) flattened.

    Without ``shells``, layers of thin cloud.

    Values in Float32 are interpolated in Float32, which costs half as much and 1e-6 of the optical depth.
    """

    values: mi.Float64 | mi.Float32
    n_height: int
    n_mu: int
    radius_m: float
    top_m: float
    shells: tuple[SunShell, ...] = ()

    @staticmethod
    def nodes(n_height: int, n_mu: int, radius_m: float, top_m: float) -> tuple[FloatArray, FloatArray]:
        """Return heights (n_height,) [m] and solar zenith cosines (n_height, n_mu) of the table's nodes."""
        h = top_m * np.linspace(0.0, 1.0, n_height) ** 2
        mu_h = -np.sqrt(h * (2 * radius_m + h)) / (radius_m + h)
        mu = mu_h[:, None] + (1.0 - mu_h[:, None]) * np.linspace(0.0, 1.0, n_mu)[None, :] ** 2
        return h, mu

    def transmittance(
        self,
        height_m: mi.Float64,
        mu: mi.Float64,
        width: int,
        factor: Callable[[mi.Float64], Values] | None = None,
    ) -> Values:
        """Return ``exp(-tau)`` towards the Sun. Directions below the geometric horizon count as on it.

        ``factor``: of tau at the places, by the Sun's cosine; layers left out.
        """
        h = dr.clip(height_m, 0.0, self.top_m)
        mu_h = -dr.sqrt(h * (2.0 * self.radius_m + h)) / (self.radius_m + h)
        x = dr.sqrt(h * (1.0 / self.top_m)) * (self.n_height - 1)
        y = dr.sqrt(dr.clip((mu - mu_h) / (1.0 - mu_h), 0.0, 1.0)) * (self.n_mu - 1)
        i = dr.minimum(mi.UInt32(x), self.n_height - 2)
        j = dr.minimum(mi.UInt32(y), self.n_mu - 2)
        values: Any = self.values
        real = type(values)
        wx, wy = real(x - mi.Float64(i)), real(y - mi.Float64(j))
        row = i * self.n_mu + j
        near = interpolate(values, row, wy, width)
        far = interpolate(values, row + self.n_mu, wy, width)
        less: list[Any] = [TAU_FLOOR - dr.exp(dr.fma(b - a, wx, a)) for a, b in zip(near, far, strict=True)]
        if factor is not None:
            less = [mi.Float64(v) * f for v, f in zip(less, factor(dr.maximum(mu, mu_h)), strict=True)]
        found = [mi.Float64(dr.exp(v)) for v in less]
        return through_shells(found, self.shells, h, dr.maximum(mu, mu_h), self.radius_m)


def through_shells(
    transmittance: Values, shells: tuple[SunShell, ...], height_m: mi.Float64, mu: mi.Float64, radius_m: float
) -> Values:
    """Return transmittances towards the Sun with those of layers; arguments as of :meth:`SunShell.depth`."""
    for shell in shells:
        depth = shell.depth(height_m, mu, radius_m)
        transmittance = [t * dr.exp(-v) for t, v in zip(transmittance, depth, strict=True)]
    return transmittance
