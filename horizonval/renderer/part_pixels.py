"""Which pixels of parts have rays of their own, and what the others take from them.

On a smooth face of a matt part light changes slowly from pixel to pixel: rays are spent where faces, shadows and
outlines have edges, and on every :data:`STRIDE` th pixel each way inside. Between those the light is a mean with linear
weights over nodes on the same face, up to two strides away; where a pixel has too few of them, it has its own rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray

STRIDE = 4
FEWEST = 0.3
"""Least sum of the weights of a pixel's nodes, as a share of that far from all edges."""
TURN_COSINE, OFF_PLANE = np.cos(np.radians(2.5)), 0.06
"""One face: normals within 2.5 deg, and points as near to each other's planes as this share of their distance."""

Pixels = NDArray[np.int64]


@dataclass(frozen=True)
class Faces:
    """What the centres of an image's pixels meet, arrays in row order.

    ``key``, shape (n,): equal on one part under one light, negative where rays of their own are needed; ``normal``,
    ``place``, shape (n, 3).
    """

    key: Pixels
    normal: FloatArray
    place: FloatArray

    def alike(self, one: Pixels, other: Pixels) -> NDArray[np.bool_]:
        """Return whether pixels are on the same smooth face; numbers of the same shape."""
        same = np.asarray((self.key[one] == self.key[other]) & (self.key[one] >= 0))
        one, other = one[same], other[same]
        way, normal = self.place[other] - self.place[one], self.normal[one]
        off = np.abs(np.einsum("ni,ni->n", way, normal))
        turned = np.einsum("ni,ni->n", normal, self.normal[other])
        same[same] = (turned > TURN_COSINE) & (off <= OFF_PLANE * np.linalg.norm(way, axis=1))
        return same


@dataclass(frozen=True)
class PixelPlan:
    """Pixels by their numbers in row order.

    ``sampled``: those with rays of their own; ``between``: others, shape (m,), with their nodes and weights (m, 16).
    """

    sampled: Pixels
    between: Pixels
    nodes: Pixels
    weights: FloatArray

    @classmethod
    def of(cls, faces: Faces, covered: NDArray[np.bool_]) -> PixelPlan:
        """Plan an image of which pixels are ``covered``, shape (H, W)."""
        height, width = covered.shape
        row, column = np.nonzero(covered & (faces.key.reshape(covered.shape) >= 0))
        for down, across in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            near = np.clip(row + down, 0, height - 1) * width + np.clip(column + across, 0, width - 1)
            kept = faces.alike(row * width + column, near)
            row, column = row[kept], column[kept]
        node = np.zeros(covered.shape, dtype=bool)
        node[row, column] = (row % STRIDE == 0) & (column % STRIDE == 0)
        others = ~node[row, column]
        row, column = row[others], column[others]
        away = np.arange(-1, 3) * STRIDE
        rows, columns = (k[:, None] // STRIDE * STRIDE + away for k in (row, column))
        down, across = (
            np.maximum(1.0 - np.abs(near - k[:, None]) / (2.0 * STRIDE), 0.0)
            for near, k in ((rows, row), (columns, column))
        )
        known = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None, :]
        nodes = np.clip(rows, 0, height - 1)[:, :, None] * width + np.clip(columns, 0, width - 1)[:, None, :]
        known &= node.ravel()[nodes]
        own = np.broadcast_to((row * width + column)[:, None, None], nodes.shape)
        known[known] = faces.alike(own[known], nodes[known])
        weights = (down[:, :, None] * across[:, None, :] * known).reshape(len(row), 16)
        total = weights.sum(axis=1)
        enough = total > 4.0 * FEWEST
        between = (row * width + column)[enough]
        sampled = covered.copy()
        sampled.ravel()[between] = False
        weights = weights[enough] / total[enough][:, None]
        return cls(np.flatnonzero(sampled), between, nodes.reshape(len(row), 16)[enough], weights)

    def mean(self, image: FloatArray) -> FloatArray:
        """Return the light of the pixels between, shape (m,)."""
        return np.asarray((image[self.nodes] * self.weights).sum(axis=1))
