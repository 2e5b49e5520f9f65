r"""Forward peaks of thin cloud: what no cut series of moments can hold goes straight on and counts as not scattered.

A phase function of asymmetry g has the moments ``g^l``; the diffuse field keeps those up to a degree N, and ice with
g = 0.8 has more. Wiscombe's delta-M method (J. Atmos. Sci. 34, 1408 (1977)) takes the share ``f = g^(N + 1)`` as a
peak straight ahead::

    k' = k - f k_s,        source of light scattered before: k_s (g^l - f) for l <= N

Light scattered once keeps its phase function, with the smaller extinction towards the Sun and the camera (TMS; Nakajima
and Tanaka, J. Quant. Spectrosc. Radiat. Transf. 40, 51 (1988)). For layers of thin cloud alone, so that air without
them stays as it is. Seen through such a layer the Sun's disc is brighter by ``exp(f tau)``: it holds light that a real
one has within a few degrees around it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from horizonval.earth.column import OpticalModel, SpectralNode


def without_peaks(model: OpticalModel, degree: int) -> OpticalModel:
    """Return a model whose layers scatter straight on what moments of a degree do not hold."""
    if not model.layers:
        return model
    return replace(model, nodes=tuple(_without_peak(node, degree) for node in model.nodes))


def _without_peak(node: SpectralNode, degree: int) -> SpectralNode:
    if not len(node.layer_per_m):
        return node
    share = [w * g ** (degree + 1) for w, g in zip(node.layer_albedo, node.layer_asymmetry, strict=True)]
    forward = np.array(share)[:, None] * node.layer_per_m
    total = forward.sum(axis=0)
    # what scatters stays as much, of less extinction
    albedo = tuple(w / (1.0 - f) for w, f in zip(node.layer_albedo, share, strict=True))
    return replace(
        node,
        extinction_per_m=node.extinction_per_m - total,
        layer_per_m=node.layer_per_m - forward,
        layer_albedo=albedo,
        forward_per_m=total,
    )
