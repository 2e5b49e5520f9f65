"""The renderer's thermal radiance along given rays, as the physics tests ask for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from emission_reference import RADIUS_M, limits_um

from horizonval.earth.column import OpticalModel
from horizonval.earth.optical import optical_model
from horizonval.renderer.rays import NODES, thermal_radiance
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

OBSERVER_M = 500e3


def key(interval: str) -> str:
    """Return the name of a band: an interval's without the full stop."""
    return interval.replace(".", "-")


def model_of(bands: Mapping[str, tuple[float, float]] | Sequence[str], **tables: Any) -> OpticalModel:
    """Return the optical model of top hats [um] (or intervals by name) in a scene with these tables.

    The air holds no particles and bends no light unless a table says so: the codes it is compared with do neither.
    """
    limits = bands if isinstance(bands, Mapping) else {key(name): limits_um(name) for name in bands}
    camera = {
        "camera": {"width": 1, "height": 1, "fov_deg": 1},
        "band": [{"name": n, "kind": "thermal", "lo_um": lo, "hi_um": hi} for n, (lo, hi) in limits.items()],
    }
    scene = {"camera": {"file": "test"}, "platform": {"altitude_km": 500}} | tables
    clean = {"aerosol": "none", "halocarbons": False, "refraction": False}
    scene["atmosphere"] = clean | tables.get("atmosphere", {})
    return optical_model(SceneSpec.model_validate(scene), CameraSpec.model_validate(camera))


def limb_rays(heights_m: Sequence[float], radius_m: float = RADIUS_M) -> tuple[np.ndarray, np.ndarray]:
    """Return observers and directions of rays of these impact parameters above a sphere, seen from 500 km."""
    b, distance = radius_m + np.asarray(heights_m, dtype=np.float64), radius_m + OBSERVER_M
    zero = np.zeros_like(b)
    return np.stack([-np.sqrt(distance**2 - b**2), zero, b], axis=1), np.tile([1.0, 0.0, 0.0], (len(b), 1))


def radiances(
    model: OpticalModel, heights_m: Sequence[float], radius_m: float = RADIUS_M, nodes: int = NODES
) -> dict[str, np.ndarray]:
    """Return the renderer's radiance [W m-2 sr-1] of every band along such rays."""
    observer, direction = limb_rays(heights_m, radius_m)
    return thermal_radiance(model, radius_m, observer, direction, nodes=nodes)
