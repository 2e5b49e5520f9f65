r"""Square patches of bicubic splines: values at the nodes of an even grid made into coefficients, and read by a kernel.

A patch has :data:`INTERVALS` intervals a side. In each direction the spline is

    s(t) = sum_k c_k B(t - k),      B the cubic B-spline on whole numbers,      k = -1 .. INTERVALS + 1

with ``s(i)`` the value at node i and, as it has two coefficients more than there are nodes, no jump of the third
derivative at the first and last inner nodes ("not a knot"). It is of fourth order up to its edges: it needs no
neighbours. On an edge it depends on that edge's nodes alone, so that patches of one size join without a step.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.types import Number

INTERVALS = 8
NODES = INTERVALS + 1
COEFFICIENTS = INTERVALS + 3
VALUES_AT_ONCE = 60_000
"""Half a megabyte of them, as a processor keeps near."""


def spline_matrix(intervals: int) -> FloatArray:
    """Return the matrix from values at nodes to coefficients, shape (intervals + 3, intervals + 1)."""
    size = intervals + 3
    rows = np.zeros((size, size))
    for i in range(intervals + 1):
        rows[i, i : i + 3] = np.array([1.0, 4.0, 1.0]) / 6.0
    # the third derivative is c(k+3) - 3 c(k+2) + 3 c(k+1) - c(k) on an interval; it does not jump
    jump = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    rows[intervals + 1, :5] = jump
    rows[intervals + 2, size - 5 :] = jump
    right = np.zeros((size, intervals + 1))
    right[: intervals + 1] = np.eye(intervals + 1)
    return np.asarray(np.linalg.solve(rows, right))


@cache
def to_coefficients() -> FloatArray:
    """Return :func:`spline_matrix` of a patch."""
    return spline_matrix(INTERVALS)


@cache
def prediction() -> FloatArray:
    """Return the matrix that makes values at every second node of a patch, from its second on, from the others."""
    half = spline_matrix(INTERVALS // 2)
    out = np.zeros((INTERVALS // 2, len(half)))
    for place in range(INTERVALS // 2):
        out[place, place : place + 4] = spline_weights(0.5)
    return out @ half


def _along(matrix: FloatArray, values: FloatArray, axis: int) -> FloatArray:
    """Return a matrix times values along an axis of (..., NODES, NODES, q).

    Term by term: a product of matrices would round by how many patches there are. A few patches at a time, which stay
    in a processor's cache.
    """
    shape = list(values.shape)
    shape[axis - 3] = len(matrix)
    patches, product = values.reshape(-1, *values.shape[-3:]), np.empty((math.prod(shape[:-3]), *shape[-3:]))
    few = max(VALUES_AT_ONCE // math.prod(shape[-3:]), 1)
    for first in range(0, len(patches), few):
        nodes, totals = (np.moveaxis(part[first : first + few], axis - 3, 0) for part in (patches, product))
        term = np.empty(nodes.shape[1:])
        for weights, total in zip(matrix, totals, strict=True):
            np.multiply(nodes[0], weights[0], out=total)
            for node, weight in zip(nodes[1:], weights[1:], strict=True):
                np.multiply(node, weight, out=term)
                total += term
    return product.reshape(shape)


def coefficients_of(values: FloatArray) -> FloatArray:
    """Return coefficients (..., COEFFICIENTS, COEFFICIENTS, q) of patches with values (..., NODES, NODES, q)."""
    return _along(to_coefficients(), _along(to_coefficients(), values, 0), 1)


def predicted(values: FloatArray, axis: int) -> FloatArray:
    """Return values as the splines through every second node along an axis (0, 1) have them, at the nodes between."""
    return _along(prediction(), between(values, axis, 0), axis)


def between(values: FloatArray, axis: int, first: int = 1) -> FloatArray:
    """Return the values of every second node along an axis (0, 1) of (..., NODES, NODES, q)."""
    return values[(..., *[slice(first, None, 2) if k == axis else slice(None) for k in range(2)], slice(None))]


def spline_weights(w: Number) -> list[Number]:
    """Return the weights of four neighbouring coefficients at ``w`` from 0 to 1 in an interval."""
    w2 = w * w
    w3 = w2 * w
    u = 1.0 - w
    return [
        u * u * u * (1.0 / 6.0),
        (3.0 * w3 - 6.0 * w2 + 4.0) * (1.0 / 6.0),
        (-3.0 * w3 + 3.0 * w2 + 3.0 * w + 1.0) * (1.0 / 6.0),
        w3 * (1.0 / 6.0),
    ]
