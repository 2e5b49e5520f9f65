"""Reflectance of water and snow in the kernel: :mod:`horizonval.earth.surface.surface` and
:mod:`horizonval.earth.surface.snow_reflectance`, written again.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi

from horizonval.earth.surface import snow_reflectance, surface
from horizonval.renderer.types import inverse_root


def fresnel(c: mi.Float64) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.surface.fresnel` of water."""
    g = dr.sqrt(surface.WATER_INDEX**2 - 1.0 + c * c)
    across = (g - c) / (g + c)
    along_ = (c * (g + c) - 1.0) / (c * (g - c) + 1.0)
    return 0.5 * across * across * (1.0 + along_ * along_)


def _hidden(mu: mi.Float64, variance: mi.Float64) -> mi.Float64:
    v = dr.minimum(mu * inverse_root(dr.maximum(1.0 - mu * mu, 1e-12) * variance), 25.0)
    return dr.maximum(0.5 * (dr.exp(-v * v) / (v * math.sqrt(math.pi)) - (1.0 - dr.erf(v))), 0.0)


def glint_brdf(mu_sun: mi.Float64, mu_view: mi.Float64, cosine: mi.Float64, variance: mi.Float64) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.surface.glint_brdf`."""
    up = (mu_sun > 0.0) & (mu_view > 0.0)
    mu_sun, mu_view = dr.clip(mu_sun, 1e-6, 1.0), dr.clip(mu_view, 1e-6, 1.0)
    incidence = dr.sqrt(dr.maximum(0.5 * (1.0 + cosine), 1e-12))
    tilt = (mu_sun + mu_view) / (2.0 * incidence)
    tilt2 = dr.minimum(tilt * tilt, 1.0)
    seen = 1.0 / (1.0 + _hidden(mu_sun, variance) + _hidden(mu_view, variance))
    density = dr.exp((1.0 - 1.0 / tilt2) / variance) / (math.pi * variance)
    return dr.select(up, fresnel(incidence) * density * seen / (4.0 * mu_sun * mu_view * tilt2 * tilt2), 0.0)


def snow_factor(mean: mi.Float64, mu_sun: mi.Float64, mu_view: mi.Float64, cosine: mi.Float64) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.snow_reflectance.forward_factor`; ``mean``: its table of N."""
    x = dr.clip(mu_sun, 0.0, 1.0) * (snow_reflectance.NODES - 1.0)
    i = dr.minimum(mi.UInt32(x), snow_reflectance.NODES - 2)
    over = dr.lerp(dr.gather(mi.Float64, mean, i), dr.gather(mi.Float64, mean, i + 1), x - mi.Float64(i))
    sun, view = (dr.maximum(mu, snow_reflectance.LEAST_COSINE) for mu in (mu_sun, mu_view))
    theta = dr.rad2deg(dr.acos(dr.clip(-cosine, -1.0, 1.0)))
    p = 11.1 * dr.exp(-0.087 * theta) + 1.1 * dr.exp(-0.014 * theta)
    top = snow_reflectance.A + snow_reflectance.B * (sun + view) + snow_reflectance.C * sun * view + p
    return top / (4.0 * (sun + view) * over)
