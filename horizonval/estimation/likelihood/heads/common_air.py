"""One air for all heads: what limbs in several images have of it in common.

Heads of a housing look at one planet. A coefficient of a mode is one random function on it, so that the nodes of all
heads together have one covariance, as those of one image have (:mod:`..profile.air`): its roots are waves that reach
from limb to limb, and their unit unknowns are the heads' common unknowns. Where limbs are far apart each wave is in one
image, where they cross it is in both. Images of other wavelengths see other modes, with unknowns of their own; and so
does the gain of the optics, which is each head's.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.height.alike import correlations
from horizonval.estimation.likelihood.profile.air import GAIN_SIGMA, POLE_ITRS, NodeAir, waves_of

Name = tuple[Hashable, tuple[str, int]]


@dataclass(frozen=True)
class CommonAir:
    """The air of all heads.

    Attributes
    ----------
    heads : list of NodeAir
        With waves that are those of all heads, at a head's nodes.
    columns : list of ndarray of int
        Which of the common unknowns are each head's.
    waves : dict of ndarray
        By function, at the nodes of all heads that have it, one head after the other: (nodes, unknowns).
    owners : dict of list of int
        Those heads.
    count : int
        Of all unknowns.
    """

    heads: list[NodeAir]
    columns: list[NDArray[np.intp]]
    waves: dict[Name, FloatArray]
    owners: dict[Name, list[int]]
    count: int

    def taken_over(self, before: CommonAir, unknowns: FloatArray) -> FloatArray:
        """Return the unknowns that say what those of other nodes, little elsewhere, said."""
        parts = [air.coefficients(unknowns[at]) for air, at in zip(before.heads, before.columns, strict=True)]
        return self.saying(
            [dict(zip(a.names, c[:, 1:].T, strict=True)) for a, c in zip(before.heads, parts, strict=True)]
        )

    def saying(self, known: Sequence[dict[tuple[str, int], FloatArray]]) -> FloatArray:
        """Return the unknowns whose coefficients along the limbs are nearest to known ones, by head and function."""
        found = []
        for name, wave in self.waves.items():
            said = []
            for head in self.owners[name]:
                nodes = len(self.heads[head].up_itrs)
                values = known[head].get(name[1], np.zeros(2))
                said.append(np.interp(np.linspace(0.0, 1.0, nodes), np.linspace(0.0, 1.0, len(values)), values))
            found.append(wave.T @ np.concatenate(said) / np.maximum((wave**2).sum(axis=0), 1e-300))
        return np.concatenate(found)


def common_air(airs: Sequence[NodeAir], tables: Sequence[Hashable]) -> CommonAir:
    """Return the air of all heads as one.

    Parameters
    ----------
    airs : sequence of NodeAir
        Of each head, alone.
    tables : sequence
        What each was read from; of the same table are the same functions.
    """
    owners: dict[Name, list[int]] = {}
    for head, (air, table) in enumerate(zip(airs, tables, strict=True)):
        for name in air.names:
            key = (head, name) if name[0] == "gain" else (table, name)
            owners.setdefault(key, []).append(head)
    waves: dict[Name, FloatArray] = {}
    by_head: list[dict[tuple[str, int], tuple[FloatArray, int]]] = [{} for _ in airs]
    roots: dict[tuple[tuple[int, ...], bytes], FloatArray] = {}
    count = 0
    for key, heads in owners.items():
        numbers = [airs[head].names.index(key[1]) for head in heads]
        lengths = np.concatenate([airs[h].lengths_rad[:, i] for h, i in zip(heads, numbers, strict=True)])
        same = (tuple(heads), lengths.tobytes())
        if same not in roots:
            up = np.concatenate([airs[head].up_itrs for head in heads])
            roots[same] = waves_of(correlations(lengths[:, None], up, POLE_ITRS))[0]
        wave = GAIN_SIGMA * roots[same] if key[1][0] == "gain" else roots[same]
        waves[key] = wave
        first = 0
        for head in heads:
            last = first + len(airs[head].up_itrs)
            by_head[head][key[1]] = (wave[first:last], count)
            first = last
        count += wave.shape[1]
    own, columns = [], []
    for air, parts in zip(airs, by_head, strict=True):
        own.append(replace(air, waves=tuple(parts[name][0] for name in air.names)))
        columns.append(np.concatenate([parts[name][1] + np.arange(parts[name][0].shape[1]) for name in air.names]))
    return CommonAir(own, columns, waves, owners, count)
