r"""Layers of thin cloud as the air's columns have them.

A layer is a shell of constant extinction between its base and its top. On the columns' grid, between whose nodes
extinction is linear, node i has the mean of the shell's extinction weighted with the node's own hat function; with
even steps D::

    k_i = k [ F(z_i + D) - 2 F(z_i) + F(z_i - D) ] / D^2,        F'' = 1 between base and top, 0 elsewhere

which keeps the optical depth exactly, wherever base and top lie, and softens the edges over 2 D (200 m).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.clouds import layer_gaps, layer_kinds, layer_optics
from horizonval.earth.clouds.layer_gaps import LayerGaps
from horizonval.spec.scene import SceneSpec

THINNEST_M = 200.0


@dataclass(frozen=True)
class ThinLayer:
    """A layer of thin cloud.

    Attributes
    ----------
    base_m, top_m : float
    extinction_550_per_m : float
        At 550 nm, with gaps and cloud spread out evenly.
    particle : str
        Kind of its particles, see :mod:`horizonval.earth.clouds.layer_optics`.
    gaps : LayerGaps or None
        Where it is cloudy; None for an even layer.
    """

    base_m: float
    top_m: float
    extinction_550_per_m: float
    particle: str
    gaps: LayerGaps | None = None

    def column(self, altitude_m: FloatArray, raised_m: float = 0.0) -> FloatArray:
        """Return the extinction at 550 nm [1/m] on a grid, shape (n,); see the module text."""
        z = np.asarray(altitude_m, dtype=np.float64) - raised_m
        z = np.concatenate([2.0 * z[:1] - z[1:2], z, 2.0 * z[-1:] - z[-2:-1]])
        step = np.diff(z)

        def twice_integrated(height: FloatArray) -> FloatArray:
            above = np.maximum(height - self.base_m, 0.0) ** 2 - np.maximum(height - self.top_m, 0.0) ** 2
            return np.asarray(0.5 * above)

        slope = np.diff(twice_integrated(z)) / step
        # Beyond the layer the second difference is rounding, and whoever asks where the layer is would find it there.
        met = (z[2:] > self.base_m) & (z[:-2] < self.top_m)
        changes = np.where(met, np.maximum(np.diff(slope), 0.0), 0.0)
        return changes * self.extinction_550_per_m / (0.5 * (step[1:] + step[:-1]))

    def infrared_per_m(self, altitude_m: FloatArray, wavelength_um: FloatArray, raised_m: float = 0.0) -> FloatArray:
        """Return the absorption [1/m] at infrared wavelengths (g,) on a grid, shape (g, n)."""
        absorbed = layer_optics.infrared_absorption(self.particle, wavelength_um)
        return np.asarray(absorbed[:, None] * self.column(altitude_m, raised_m))


def layers_of(scene: SceneSpec) -> tuple[ThinLayer, ...]:
    """Return the layers of a scene.

    Raises
    ------
    UserError
        A base that is given without a top, or a top without a base, and that leaves no layer.
    """
    found = []
    for i, layer in enumerate(scene.layer):
        kind = layer_kinds.KINDS[layer.kind]
        latitude = scene.platform.latitude_deg
        base, top = layer_kinds.heights_m(layer, latitude)
        if top - base < THINNEST_M - 1e-6:
            raise UserError(
                f"the layer would reach from {base / 1e3:g} to {top / 1e3:g} km",
                where=f"{scene.scene.name}: layer[{i}]",
                expected=f"a top at least {THINNEST_M / 1e3:g} km above the base; give both",
            )
        cover = layer.cover
        if layer.occurrence == "climate":
            cover = layer_kinds.occurrence(layer.kind, latitude, float(scene.platform.epoch_utc.month))
        depth = kind.optical_depth if layer.optical_depth is None else layer.optical_depth
        if depth * cover <= 0.0:
            continue
        phase = layer.phase or kind.phase
        radius = layer.effective_radius_um
        if radius is None:
            radius = kind.effective_radius_um if phase == kind.phase else _USUAL_UM[phase]
        gaps = None
        if layer.scale_km is not None and cover < 1.0:
            seed = layer_gaps.seed_of(scene, i) if layer.seed is None else layer.seed
            gaps = LayerGaps(cover, layer.scale_km * 1e3, seed)
        found.append(ThinLayer(base, top, depth * cover / (top - base), layer_optics.particle(phase, radius), gaps))
    return tuple(found)


_USUAL_UM = {"ice": 30.0, "water": 8.0}
"""Where a layer's phase is not that of its kind."""


def merged_bands(layers: Sequence[tuple[float, float]], margin_m: float) -> list[tuple[float, float]]:
    """Return the heights that layers (base, top) take up, wider by a margin on both sides, without overlaps, rising."""
    merged: list[tuple[float, float]] = []
    for base, top in sorted((max(base - margin_m, 0.0), top + margin_m) for base, top in layers):
        if merged and base <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], top))
        else:
            merged.append((base, top))
    return merged
