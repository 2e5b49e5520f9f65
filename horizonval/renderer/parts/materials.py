"""Surfaces of spacecraft by name: how they reflect sunlight, and how they emit.

Reflectance at a few wavelengths, linear between them and constant beyond. Each is read off typical published curves of
its kind (Henninger, Solar absorptance and thermal emittance of some common spacecraft thermal-control coatings, NASA RP
1121, 1984) and right to 0.05 or so: coatings differ from maker to maker, and age. Roughness is chosen here.

In thermal bands every surface is a grey Lambert one: what it does not emit it reflects, evenly into all directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from horizonval.core.errors import UserError
from horizonval.renderer.types import PluginDict
from horizonval.spec.scene import Material, SpacecraftPart

_UM = (0.4, 0.5, 0.6, 0.7, 0.9, 1.6)


@dataclass(frozen=True)
class _Surface:
    """``reflectance`` at ``_UM``; ``kind``: lambert, metal (rough mirror), glass (clear, smooth, over a Lambert base).

    ``roughness``: root mean square slope of a metal's or glass's facets.
    """

    kind: str
    reflectance: Sequence[float]
    emissivity: float
    roughness: float = 0.0


SURFACES: dict[Material, _Surface] = {
    "white_paint": _Surface("lambert", (0.70, 0.84, 0.85, 0.85, 0.84, 0.75), 0.90),
    "black_paint": _Surface("lambert", (0.04, 0.04, 0.04, 0.04, 0.04, 0.05), 0.90),
    "solar_cell": _Surface("glass", (0.02, 0.02, 0.02, 0.02, 0.03, 0.20), 0.85, 0.02),
    "kapton_foil": _Surface("metal", (0.10, 0.30, 0.62, 0.72, 0.80, 0.85), 0.70, 0.25),
    "gold": _Surface("metal", (0.39, 0.50, 0.92, 0.96, 0.98, 0.98), 0.03, 0.15),
    "aluminium": _Surface("metal", (0.91, 0.91, 0.90, 0.89, 0.88, 0.95), 0.05, 0.20),
}
GLASS_INDEX = 1.45


def emissivity_of(part: SpacecraftPart) -> float:
    """Return the emissivity of a part in thermal bands."""
    return SURFACES[part.material].emissivity if part.emissivity is None else part.emissivity


def solar_bsdf(part: SpacecraftPart, wavelength_um: Sequence[float], weight: Sequence[float], where: str) -> mi.BSDF:
    """Return how a part reflects sunlight of some wavelengths, weighted.

    Raises
    ------
    UserError
        For a BSDF that Mitsuba does not know, or that is none.
    """
    if part.bsdf is not None:
        return _loaded(part.bsdf, f"{where}.bsdf")
    surface = SURFACES[part.material]
    share = np.asarray(weight) / np.sum(weight)
    reflectance = float(np.interp(wavelength_um, _UM, surface.reflectance) @ share)
    if surface.kind == "lambert":
        plugin: PluginDict = {"type": "diffuse", "reflectance": reflectance}
    elif surface.kind == "metal":
        # a mirror of facets, none of whose light is lost but what the reflectance takes
        plugin = {"type": "roughconductor", "material": "none", "specular_reflectance": reflectance}
        plugin |= {"alpha": surface.roughness, "distribution": "ggx"}
    else:
        plugin = {"type": "roughplastic", "diffuse_reflectance": reflectance, "int_ior": GLASS_INDEX}
        plugin |= {"alpha": surface.roughness, "distribution": "ggx"}
    return _loaded(plugin, where)


def thermal_bsdf(part: SpacecraftPart) -> mi.BSDF:
    """Return how a part reflects in thermal bands."""
    return _loaded({"type": "diffuse", "reflectance": 1.0 - emissivity_of(part)}, "")


def _loaded(plugin: PluginDict, where: str) -> mi.BSDF:
    expected = 'a BSDF of Mitsuba, such as { type = "diffuse", reflectance = 0.5 }'
    try:
        inner = mi.load_dict(_numbers(plugin))
    except Exception as error:
        reason = " ".join(str(error).split())
        raise UserError(f"Mitsuba refuses it: {reason[:160]}", where=where, expected=expected) from None
    if not isinstance(inner, mi.BSDF):
        raise UserError(f"{plugin['type']!r} is not a BSDF", where=where, expected=expected)
    try:
        return mi.load_dict({"type": "twosided", "inner": inner})
    except Exception:
        # what lets light through has two sides by itself
        return inner


def _numbers(value: PluginDict) -> PluginDict:
    """Return a dictionary of TOML as Mitsuba wants it: an integer may be meant as a number."""
    return {
        key: _numbers(item) if isinstance(item, dict) else float(item) if type(item) is int else item
        for key, item in value.items()
    }
