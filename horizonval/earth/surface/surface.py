"""Reflection of sunlight by the Earth's surface: land, snow, a wind-roughened ocean, and white cloud tops.

**Land, clouds and foam** are Lambert reflectors, each material with a spectrum. **Snow** is anisotropic in the Sun's
beam. **Water** has a Lambert part (scattering below the surface) and the Sun's glint off its facets::

    f_glint = F(omega) p(theta_n) S / (4 mu_sun mu_view cos^4 theta_n),   p = exp(-tan^2 theta_n / s2) / (pi s2)

with Fresnel's reflectance F of unpolarised light at the angle of incidence omega on a facet, theta_n the facet's tilt,
and s2 = 0.003 + 0.00512 W the mean square slope under a wind of W m/s (C. Cox and W. Munk, J. Opt. Soc. Am. 44, 838
(1954): isotropic, Gaussian). Facets hide and shade each other near the horizon; S is Smith's factor in the form for a
joint view and sunlight path, ``1 / (1 + L(mu_sun) + L(mu_view))`` (L. Tsang, J. A. Kong, R. T. Shin, *Theory of
Microwave Remote Sensing*, Wiley 1985), which keeps f finite at the horizon and the reflected share of a beam below one.
Double reflection is neglected. The index of sea water is 1.34 at all wavelengths. Water reflects skylight like a flat
surface under a uniform sky (6.7 %; roughness lowers it by about a sixth).

Materials, their spectra, snow cover and sea ice: :mod:`horizonval.earth.surface.ground_map`. Foam: cover of E. C.
Monahan and I. O'Muircheartaigh (J. Phys. Oceanogr. 10, 2094 (1980)).

**Snow** reflects the Sun's beam anisotropically. For weakly absorbing snow, with cosines mu_sun and mu_view to the
vertical and the scattering angle theta in degrees,

    R_0 = (A + B (mu_sun + mu_view) + C mu_sun mu_view + p(theta)) / (4 (mu_sun + mu_view)),
    p = 11.1 exp(-0.087 theta) + 1.1 exp(-0.014 theta),    A = 1.247, B = 1.186, C = 5.157

(A. A. Kokhanovsky and E. P. Zege, Appl. Opt. 43, 1589 (2004); A. A. Kokhanovsky, J. Geophys. Res. 118, 9325 (2013)).
The factor relative to a Lambert surface is ``R_0 / N(mu_sun)`` with N the mean of R_0 over the upper hemisphere,
weighted by mu_view, so that snow reflects the share of the beam given by its albedo at any Sun. N is 0.99 to 1.02 for
the Sun more than 9 deg high; the factor violates reciprocity by as much.

Neglected: in the near infrared absorbing snow is more anisotropic than white snow and reflects more of a low Sun;
sastrugi reduce the forward peak under a low Sun (S. G. Warren, R. E. Brandt, P. O'Rawe Hinton, J. Geophys. Res. 103,
25789 (1998)). The form is valid to zenith angles of 75 deg or so; cosines are at least :data:`LEAST_SNOW_COSINE`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.special import erf

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere import climate
from horizonval.earth.clouds.relief import CloudField, cloud_field
from horizonval.earth.surface.ground_map import DRY, FOAM_ALBEDO, spectrum
from horizonval.spec.scene import SceneSpec

WATER_INDEX = 1.34
WIND_SPEED_M_S = 7.0


@dataclass(frozen=True)
class GroundModel:
    """Everything that a ray can end on, as plain data that JSON preserves exactly.

    ``kind``: ``"uniform"``, ``"earth"`` or ``"chequered"``; ``albedo``: of a uniform ground, or of every other square;
    ``wind_speed_m_s``: over the ocean of an "earth"; ``month``: 0.5 to 12.5, 7.0 the middle of July, for snow and sea
    ice; ``albedo_other``, ``square_km``: of the other squares, and the side of all, on a "chequered" ground.
    """

    kind: str
    albedo: float
    wind_speed_m_s: float
    month: float
    city_lights: bool
    clouds: CloudField | None
    albedo_other: float = 0.0
    square_km: float = 0.0

    @property
    def plain(self) -> bool:
        """Whether this is only a Lambert ground."""
        return self.kind == "uniform" and self.clouds is None


@dataclass(frozen=True)
class Albedos:
    """Albedo of everything at one wavelength.

    ``ground``, ``other``: of a uniform ground, or of the squares of a chequered one. ``sky``: reflectance of water for
    skylight. ``cloud``: of the highest tops.
    """

    ground: float
    vegetation: float
    soil: float
    sand: float
    snow: float
    firn: float
    water: float
    foam: float
    sky: float
    cloud: float
    other: float = 0.0


def ground_model(scene: SceneSpec) -> GroundModel:
    """Return the ground and clouds of a scene."""
    surface = scene.surface
    wind = WIND_SPEED_M_S if surface.wind_speed_m_s is None else surface.wind_speed_m_s
    squares = surface.albedo_other or 0.0, surface.square_km or 0.0
    return GroundModel(
        surface.kind,
        surface.albedo,
        wind,
        climate.month_of_rows(scene),
        surface.city_lights,
        cloud_field(scene),
        *squares,
    )


def foam_share(wind_speed_m_s: float) -> float:
    """Return the share of the ocean under whitecaps."""
    return min(2.95e-6 * wind_speed_m_s**3.52, 1.0)


def albedos(ground: GroundModel, wavelength_um: float) -> Albedos:
    """Return all albedos at one wavelength."""
    cloud = ground.clouds.albedo if ground.clouds else 0.0
    if ground.kind != "earth":
        return Albedos(ground.albedo, *(0.0,) * 8, cloud, ground.albedo_other)
    materials = {name: float(spectrum(name, wavelength_um)) for name in (*DRY, "water")}
    return Albedos(0.0, **materials, foam=FOAM_ALBEDO, sky=water_sky_albedo(), cloud=cloud)


def slope_variance(wind_speed_m_s: float) -> float:
    """Return the mean square slope of the sea, both directions together."""
    return 0.003 + 0.00512 * wind_speed_m_s


def fresnel(cosine: Any, index: float = WATER_INDEX, of: Any = np) -> Any:
    """Return the reflectance for unpolarised light from air at cosines of the angle of incidence.

    ``of``, here and below: the module of the functions of arrays, NumPy or Dr.Jit.
    """
    g = of.sqrt(index * index - 1.0 + cosine * cosine)
    across = (g - cosine) / (g + cosine)
    along = (cosine * (g + cosine) - 1.0) / (cosine * (g - cosine) + 1.0)
    return 0.5 * across * across * (1.0 + along * along)


@cache
def water_sky_albedo() -> float:
    """Return the reflectance of a flat sea for a uniform sky: 2 int F mu dmu."""
    x, w = np.polynomial.legendre.leggauss(64)
    mu = 0.5 * (x + 1.0)
    return float(np.sum(w * mu * fresnel(mu)))


def _hidden(mu: Any, variance: Any, of: Any) -> Any:
    """Return Smith's function L of the cosine to the vertical: 0 overhead, growing without limit to the horizon."""
    v = of.minimum(mu / of.sqrt(of.maximum(1.0 - mu * mu, 1e-12) * variance), 25.0)
    beyond = 1.0 - (erf if of is np else of.erf)(v)
    return of.maximum(0.5 * (of.exp(-v * v) / (v * math.sqrt(math.pi)) - beyond), 0.0)


def glint_brdf(mu_sun: Any, mu_view: Any, cosine: Any, variance: Any, of: Any = np) -> Any:
    """Return the reflectance of the sea's facets [1/sr]; 0 where Sun or observer is below the horizon.

    ``mu_sun``, ``mu_view``: cosines of the angles between the vertical and Sun and observer. ``cosine``: that of the
    angle between the directions to Sun and observer. ``variance``: see :func:`slope_variance`.
    """
    up = (mu_sun > 0.0) & (mu_view > 0.0)
    sun, view = of.clip(mu_sun, 1e-6, 1.0), of.clip(mu_view, 1e-6, 1.0)
    incidence = of.sqrt(of.maximum(0.5 * (1.0 + cosine), 1e-12))
    tilt = (sun + view) / (2.0 * incidence)
    tilt2 = of.minimum(tilt * tilt, 1.0)
    seen = 1.0 / (1.0 + _hidden(sun, variance, of) + _hidden(view, variance, of))
    density = of.exp((1.0 - 1.0 / tilt2) / variance) / (math.pi * variance)
    found = fresnel(incidence, of=of) * density * seen / (4.0 * sun * view * tilt2 * tilt2)
    return np.where(up, found, 0.0) if of is np else of.select(up, found, 0.0)


SNOW_A, SNOW_B, SNOW_C = 1.247, 1.186, 5.157
LEAST_SNOW_COSINE = 0.15
SNOW_NODES = 65
"""Size of the table of N, even in the cosine of the Sun's zenith angle."""


def snow_reflection(mu_sun: Any, mu_view: Any, cosine: Any, of: Any = np) -> Any:
    """Return R_0 from the cosines of Sun and observer zenith angles and of the angle between their directions."""
    sun, view = (of.maximum(mu, LEAST_SNOW_COSINE) for mu in (mu_sun, mu_view))
    theta = of.rad2deg((np.arccos if of is np else of.acos)(of.clip(-cosine, -1.0, 1.0)))
    p = 11.1 * of.exp(-0.087 * theta) + 1.1 * of.exp(-0.014 * theta)
    return (SNOW_A + SNOW_B * (sun + view) + SNOW_C * sun * view + p) / (4.0 * (sun + view))


@cache
def mean_snow_reflection() -> FloatArray:
    """Return N at :data:`SNOW_NODES` cosines of the Sun's zenith angle."""
    x, w = np.polynomial.legendre.leggauss(48)
    mu = 0.5 * (x + 1.0)
    azimuth = (np.arange(128) + 0.5) * np.pi / 128
    sun = np.linspace(0.0, 1.0, SNOW_NODES)[:, None, None]
    view = mu[None, :, None]
    sines = np.sqrt((1.0 - sun**2) * (1.0 - view**2))
    found = snow_reflection(sun, view, sun * view + sines * np.cos(azimuth))
    mean = np.asarray(np.sum(w * mu * found.mean(axis=-1), axis=-1))
    mean.setflags(write=False)
    return mean
