"""From a scene and a camera to the optical properties the renderer marches through."""

from __future__ import annotations

from horizonval.earth.column import FloatArray, OpticalModel, SpectralNode

__all__ = ["FloatArray", "OpticalModel", "SpectralNode"]
