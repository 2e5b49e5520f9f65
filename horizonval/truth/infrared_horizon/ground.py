"""What the ground sends up a ray that meets it, band by band.

A ground of emissivity e and temperature T sends ``e S(T)``, and throws back ``1 - e`` of the sky's mean radiance. Rays
10 km below the hard horizon come up at 3 deg from the level, through ten to twenty times the air of a vertical one: of
the reflected light next to nothing gets out, so the sky is worked out for some latitudes and heights only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.surface.ground_emission import (
    EmittingPlaces,
    GroundEmission,
    emitting_places,
    ground_emissivity,
    ground_k,
)
from horizonval.earth.weather.column_map import ColumnMap
from horizonval.geometry.ellipsoid import Ellipsoid, geodetic_from_itrs, surface_normal

_SKY_ROWS, _SKY_STRIDE = 12, 5


@dataclass(frozen=True)
class GroundPlaces:
    """Where rays meet the ground.

    ``normal``: the ellipsoid's, shape (n, 3). ``cosine``: of the view to the vertical, shape (n,). ``places``: what
    emits there.
    """

    normal: FloatArray
    cosine: FloatArray
    places: EmittingPlaces


def ground_places(
    r_itrs: FloatArray, place_itrs: FloatArray, ellipsoid: Ellipsoid, sun_itrs: FloatArray, emission: GroundEmission
) -> GroundPlaces:
    """Return what is at places of shape (n, 3) seen from a camera, with the Sun in a direction."""
    latitude, longitude, _ = geodetic_from_itrs(place_itrs, ellipsoid)
    line = r_itrs - place_itrs
    line = line / np.linalg.norm(line, axis=-1, keepdims=True)
    normal = surface_normal(place_itrs, ellipsoid)
    cosine = np.einsum("ij,ij->i", normal, line)
    sun_longitude = float(np.arctan2(sun_itrs[1], sun_itrs[0]))
    return GroundPlaces(normal, cosine, emitting_places(emission, latitude, longitude, sun_longitude))


def ground_radiance(band: EmittingBand, emission: GroundEmission, at: GroundPlaces) -> FloatArray:
    """Return the radiance [W m-2 sr-1], shape (n, g), of the ground towards the camera."""
    places = at.places
    sky = _sky(band, at) if emission.kind != "uniform" or emission.emissivity < 1.0 else 0.0
    total = np.zeros((len(at.cosine), band.count))
    for kind, share in places.shares.items():
        e = ground_emissivity(emission, kind, band.wavelength_um, at.cosine[:, None])
        source = band.source(ground_k(emission, kind, places))
        total += share[:, None] * (e * source + (1.0 - e) * sky)
    return total


def _thinned(columns: FloatArray) -> FloatArray:
    """Return every so many heights of columns, and the highest; thin cloud is then right to the share that it is of a
    few steps, in the little that a ground reflects."""
    return np.concatenate([columns[..., :-1:_SKY_STRIDE], columns[..., -1:]], axis=-1)


def _sky(band: EmittingBand, at: GroundPlaces) -> FloatArray:
    """Return the mean radiance of the sky, shape (n, g)."""
    if band.column_map is not None:
        return _sky_of_map(band, band.column_map, at.normal)
    count = len(band.sin_latitude)
    rows = np.unique(np.linspace(0, count - 1, min(count, _SKY_ROWS)).round().astype(int))
    some = replace(
        band.of_columns(rows),
        altitude_m=_thinned(band.altitude_m),
        layer_per_m=_thinned(band.layer_per_m),
        sin_latitude=band.sin_latitude[rows],
    )
    return np.stack([np.interp(at.places.sin_latitude, some.sin_latitude, g) for g in some.sky_irradiance()], axis=-1)


def _sky_of_map(band: EmittingBand, lattice: ColumnMap, normal: FloatArray) -> FloatArray:
    """Return the same where columns stand on a map: that of the column next to each place."""
    nearest = np.argmax(normal @ lattice.normals().T, axis=1)
    columns, owner = np.unique(nearest, return_inverse=True)
    some = replace(
        band.of_columns(columns),
        altitude_m=_thinned(band.altitude_m),
        layer_per_m=_thinned(band.layer_per_m),
        sin_latitude=np.arange(len(columns), dtype=np.float64),
        column_map=None,
    )
    return some.sky_irradiance()[:, owner].T
