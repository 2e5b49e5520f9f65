"""Sums and products of kernel vectors."""

from __future__ import annotations

import mitsuba as mi

from horizonval.renderer.types import Vec


def cross(p: Vec, q: Vec) -> Vec:
    """Return the vector product."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


def scaled(p: Vec, factor: mi.Float64 | float) -> Vec:
    """Return the product of a vector and a number."""
    return p[0] * factor, p[1] * factor, p[2] * factor


def added(p: Vec, q: Vec) -> Vec:
    """Return the sum."""
    return p[0] + q[0], p[1] + q[1], p[2] + q[2]
