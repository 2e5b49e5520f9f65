"""What the ends of rays emit: kinds of ground, their temperatures, and the sky that they reflect.

Ground of temperature T and emissivity e sends ``sum over g of through_g [e_g S_g(T) + (1 - e_g) sky_g]`` along a ray.
Water mirrors: its sky is the air along the reflected ray. For all else sky_g is the mean radiance of the air above
(downwelling irradiance over pi), that of the row of columns at its latitude::

    sky_g = int S_g 2 E_2(tau) dtau,        layer by layer  S (2 E_3(tau_low) - 2 E_3(tau_high))

in plane layers: what a grazing ray sees of the curvature of the Earth changes a sky by less than 1 %, of which a ground
of emissivity 0.95 reflects a twentieth. Reflected sunlight is left out.
"""

from __future__ import annotations

import math
from functools import cached_property
from itertools import product

import numpy as np
from scipy.special import expn

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.surface import ground_map
from horizonval.earth.surface.emissivity import emissivity, water_emissivity
from horizonval.earth.surface.ground_emission import (
    KINDS,
    LAG_RAD,
    EmittingPlaces,
    GroundEmission,
    emitting_places,
    ground_k,
)
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.types import Vec

SKY_LAYERS = 160
ALL = slice(None)


def kinds_of(emission: GroundEmission) -> tuple[str, ...]:
    """Return the kinds of ground there are; a uniform one is all land."""
    return KINDS if emission.kind == "earth" else KINDS[:1]


def places_below(emission: GroundEmission, normal: FloatArray, sun_itrs: FloatArray) -> EmittingPlaces:
    """Return what emits below unit normals (n, 3), the Sun in a direction."""
    latitude = np.arcsin(np.clip(normal[:, 2], -1.0, 1.0))
    longitude = np.arctan2(normal[:, 1], normal[:, 0])
    return emitting_places(emission, latitude, longitude, math.atan2(sun_itrs[1], sun_itrs[0]))


def temperature_range_k(emission: GroundEmission, kind: str) -> tuple[float, float]:
    """Return bounds of how cold and how warm a kind of ground can be, all heights and hours of a latitude together."""
    rows = np.arcsin(np.array(emission.sin_latitude))
    latitude = np.unique(np.concatenate([rows, np.radians(np.arange(-90.0, 90.01, 0.25))]))
    high = ground_map.highest_m(np.degrees(latitude)) if emission.kind == "earth" else np.zeros_like(latitude)
    found = []
    for hour, height, sheet, land in product((0.0, math.pi), (0.0 * high, high), (0.0, 1.0), (False, True)):
        same = np.ones_like(latitude)
        at = EmittingPlaces(np.sin(latitude), (hour + LAG_RAD) * same, {}, (land * same) > 0.0, height, sheet * same)
        found.append(ground_k(emission, kind, at))
    return float(np.min(found)), float(np.max(found))


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

    ``sky``: shape (g, m), of everything but water, at the columns of ``coarse``; computed when first asked for, black
    ground needs none.
    """

    def __init__(self, band: EmittingBand, emission: GroundEmission) -> None:
        self.band, self.emission = band, emission
        self.spline = band.source_spline()

    @cached_property
    def coarse(self) -> EmittingBand:
        """Return the band with as many columns as the sky needs: where there is a map, every fourth.

        The sky is a twentieth of what leaves the ground, and ten degrees of weather change it by a few per cent.
        """
        return self.band.coarser()

    @cached_property
    def sky(self) -> FloatArray:
        """Return the mean radiance of the air above, on a grid that is fine at the ground."""
        band = self.coarse
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

    def sky_at(self, normal: FloatArray, part: slice = ALL) -> FloatArray:
        """Return the sky's mean radiance over places of unit normals (n, 3) for some g points, shape (g, n)."""
        if self.emission.kind != "earth" and self.emission.emissivity == 1.0:
            return np.zeros((len(self.band.wavelength_um[part]), len(normal)))
        return self.coarse.between(self.sky[part], normal)
