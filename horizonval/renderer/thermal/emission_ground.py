"""What the ends of rays emit: kinds of ground, their temperatures, and the sky that they reflect.

Ground of temperature T and emissivity e sends ``sum over g of through_g [e_g S_g(T) + (1 - e_g) sky_g]`` along a ray.
Water mirrors: its sky is the air along the reflected ray. For all else sky_g is the mean radiance of the air above
(downwelling irradiance over pi), that of the row of columns at its latitude::

    sky_g = int S_g 2 E_2(tau) dtau,        layer by layer  S (2 E_3(tau_low) - 2 E_3(tau_high))

in plane layers: what a grazing ray sees of the curvature of the Earth changes a sky by less than 1 %, of which a ground
of emissivity 0.95 reflects a twentieth. Reflected sunlight is left out.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.special import expn

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.surface import land, surface
from horizonval.earth.surface.emissivity import emissivity, water_emissivity
from horizonval.earth.surface.ground_emission import LAG_RAD, GroundEmission
from horizonval.earth.surface.surface import GroundModel
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.types import Vec

KINDS = ("land", "snow", "water")
SKY_LAYERS = 160
ALL = slice(None)


def kinds_of(emission: GroundEmission) -> tuple[str, ...]:
    """Return the kinds of ground there are; a uniform one is all land."""
    return KINDS if emission.kind == "earth" else KINDS[:1]


def shares(emission: GroundEmission, ground: GroundModel | None, normal: FloatArray) -> dict[str, FloatArray]:
    """Return the share of every kind of ground below unit normals (n, 3), shapes (n,). Foam counts as water.

    Without a ``ground`` model land has no seasonal snow.
    """
    count = len(normal)
    if emission.kind != "earth":
        return {"land": np.ones(count)}
    latitude = np.degrees(np.arcsin(np.clip(normal[:, 2], -1.0, 1.0)))
    dry = land.is_land(latitude, np.degrees(np.arctan2(normal[:, 1], normal[:, 0]))).astype(float)
    line = 91.0 + surface.SNOW_EDGE_DEG if ground is None else ground.snow_line_deg
    snow = surface.snow_share(latitude, line)
    return {"land": dry * (1.0 - snow), "snow": dry * snow, "water": 1.0 - dry}


def temperatures_k(emission: GroundEmission, normal: FloatArray, sun_itrs: FloatArray) -> dict[str, FloatArray]:
    """Return the temperature of every kind of ground below unit normals (n, 3), shapes (n,)."""

    def at(values: tuple[float, ...]) -> FloatArray:
        return np.interp(normal[:, 2], emission.sin_latitude, values)

    land_k = at(emission.land_k)
    if any(emission.diurnal_k):
        land_k = land_k + at(emission.diurnal_k) * _diurnal_cosine(normal, sun_itrs)
    return {"land": land_k, "snow": at(emission.snow_k), "water": at(emission.water_k)}


def _diurnal_cosine(normal: FloatArray, sun: FloatArray) -> FloatArray:
    """Return ``cos(H - lag)``."""
    east = np.arctan2(normal[:, 1], normal[:, 0]) - np.arctan2(sun[1], sun[0])
    return np.cos(east - LAG_RAD)


def temperature_range_k(emission: GroundEmission, kind: str) -> tuple[float, float]:
    """Return the coldest and the warmest that a kind of ground can be."""
    values = np.array({"land": emission.land_k, "snow": emission.snow_k, "water": emission.water_k}[kind])
    swing = np.abs(emission.diurnal_k) if kind == "land" else np.zeros_like(values)
    return float((values - swing).min()), float((values + swing).max())


def emissivities(emission: GroundEmission, kind: str, wavelength_um: FloatArray, cosine: FloatArray) -> FloatArray:
    """Return the emissivity of a kind of ground, shape (g, n), at view cosines (n,)."""
    shape = len(wavelength_um), len(cosine)
    if emission.kind != "earth":
        return np.full(shape, emission.emissivity)
    if kind == "water":
        return water_emissivity(wavelength_um[:, None], cosine)
    return np.broadcast_to(emissivity(kind, wavelength_um)[:, None], shape)


def sky_radiance(extinction: FloatArray, source: FloatArray, altitude_m: FloatArray) -> FloatArray:
    """Return sky_g of the module text [W m-2 sr-1]; columns of shape (..., n) from the ground up."""
    layer = 0.5 * (extinction[..., 1:] + extinction[..., :-1]) * np.diff(altitude_m)
    tau = np.concatenate([np.zeros((*layer.shape[:-1], 1)), np.cumsum(layer, axis=-1)], axis=-1)
    escaped = 2.0 * expn(3, np.minimum(tau, 700.0))
    # a source linear in tau: of a thick layer the lower end counts for most; the light comes steeply, mu about 2/3
    steep = np.maximum(1.5 * layer, 1e-3)
    high = 1.0 / steep - 1.0 / np.expm1(np.minimum(steep, 700.0))
    low = 1.0 - high
    mean = source[..., :-1] * low + source[..., 1:] * high
    return np.asarray(np.sum(mean * (escaped[..., :-1] - escaped[..., 1:]), axis=-1))


def mirrored(planet: Planet, o: Vec, d: Vec) -> tuple[Vec, Vec, Vec]:
    """Return where rays meet the ground, its normals there, and the reflected directions; kernel arrays."""
    mid, half, _ = planet.chord(o, d)
    p = along(o, d, mid - half)
    _, normal = planet.height_and_normal(p)
    return p, normal, along(d, normal, -2.0 * dot(d, normal))


class GroundSource:
    """What the ground of a band emits and reflects.

    ``sky``: shape (g, m), of everything but water; computed when first asked for, black ground needs none.
    """

    def __init__(self, band: EmittingBand, emission: GroundEmission) -> None:
        self.band, self.emission = band, emission
        self.spline = band.source_spline()

    @cached_property
    def sky(self) -> FloatArray:
        """Return the mean radiance of the air above, on a grid that is fine at the ground."""
        band = self.band
        z = band.altitude_m[-1] * np.linspace(0.0, 1.0, SKY_LAYERS + 1) ** 2
        if len(band.layers):
            z = np.union1d(z, band.altitude_m[band.layer_per_m.any(axis=0)])
        return sky_radiance(band.extinction_at(z), np.moveaxis(self.spline(band.air_k(z)), 2, 0), z)

    @property
    def mirrors(self) -> bool:
        """Whether there is water."""
        return self.emission.kind == "earth"

    def black(self, temperature_k: FloatArray, part: slice = ALL) -> FloatArray:
        """Return S_g(T) of some g points at temperatures (n,), shape (g, n)."""
        return self.spline.of(part)(temperature_k).T

    def emissivities(self, kind: str, cosine: FloatArray, part: slice = ALL) -> FloatArray:
        """Return the emissivity of some g points at view cosines (n,), shape (g, n)."""
        wavelengths, owner = np.unique(self.band.wavelength_um[part], return_inverse=True)
        return emissivities(self.emission, kind, wavelengths, cosine)[owner]

    def sky_at(self, sin_latitude: FloatArray, part: slice = ALL) -> FloatArray:
        """Return the sky's mean radiance at places (n,) for some g points, shape (g, n)."""
        if self.emission.kind != "earth" and self.emission.emissivity == 1.0:
            return np.zeros((len(self.band.wavelength_um[part]), len(sin_latitude)))
        return np.stack([np.interp(sin_latitude, self.band.sin_latitude, row) for row in self.sky[part]])
