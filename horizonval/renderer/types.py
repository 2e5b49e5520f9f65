"""Types of kernel values, for signatures.

Mitsuba's array types belong to the variant that is selected at run time; its stubs give each one name for all variants.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import drjit as dr
import mitsuba as mi

from horizonval.core.arrays import FloatArray

Real = TypeVar("Real", "mi.Float32", "mi.Float64")
"""Single or double precision, the same throughout a signature."""

Number = TypeVar("Number", float, FloatArray, "mi.Float32", "mi.Float64")
"""For arithmetic that NumPy and kernels share."""

Vec3: TypeAlias = tuple[Real, Real, Real]
"""Three components, broadcast against each other."""

if TYPE_CHECKING:
    Vec: TypeAlias = Vec3[mi.Float64]
    """Three components in double precision."""

    Values: TypeAlias = list[mi.Float64]
    """One array per spectral node of a batch."""
else:
    # Mitsuba evaluates the annotations of dataclasses that a plugin holds, when its array types exist; imports do not.
    Vec, Values = tuple, list


PluginDict: TypeAlias = dict[str, Any]
"""A plugin, or a whole scene, as ``mi.load_dict`` takes it: what a value may be depends on its plugin."""


def indices_where(condition: mi.Bool) -> mi.UInt32:
    """Return where a condition holds, rising."""
    return mi.UInt32(dr.compress(condition))


Array = TypeVar("Array", "mi.UInt32", "mi.Float64")


def joined(arrays: Sequence[Array]) -> Array:
    """Return arrays one behind the other, evaluated: Dr.Jit's concatenation compiles a kernel for every length."""
    filled = [a for a in arrays if dr.width(a)]
    if len(filled) < 2:
        return filled[0] if filled else arrays[0]
    result = dr.empty(type(filled[0]), sum(dr.width(a) for a in filled))
    first = 0
    for a in filled:
        dr.scatter(result, a, numbers_from(first, dr.width(a)), mode=dr.ReduceMode.Permute)
        first += dr.width(a)
    return result


def numbers_from(first: int, count: int) -> mi.UInt32:
    """Return whole numbers from ``first`` on, which is data, as in :func:`constant`."""
    return dr.opaque(mi.UInt32, first, 1) + dr.arange(mi.UInt32, count) if count else mi.UInt32()


def in_single(v: Vec) -> Vec3[mi.Float32]:
    """Return a vector in single precision."""
    x, y, z = (mi.Float32(c) for c in v)
    return x, y, z


def constant_vector(values: Iterable[float]) -> Vec:
    """Return three components as :func:`constant`."""
    x, y, z = (constant(v) for v in values)
    return x, y, z


def constant(value: float) -> mi.Float64:
    """Return an array of size 1 whose value is data, not a constant of the compiled kernel: frames share kernels."""
    return dr.opaque(mi.Float64, float(value), 1)


def inverse_root(x: Real) -> Real:
    """Return ``1 / sqrt(x)``, in double precision with the same rounding everywhere.

    Dr.Jit's inverse root is an instruction that reads the upper half of a double on a GPU: right to 1e-6, which is six
    metres of the Earth's radius. The same holds for its reciprocal, tangent and hyperbolic functions; kernels use none
    of them.
    """
    return 1.0 / dr.sqrt(x)
