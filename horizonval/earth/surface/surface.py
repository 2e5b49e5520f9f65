r"""How the Earth's surface reflects sunlight: land, seasonal snow, a wind-roughened ocean, and white cloud tops.

**Land, snow, clouds and foam** are Lambert reflectors, each with a spectrum. **Water** has a Lambert part (light that
has been scattered below the surface) and the Sun's glint off its facets::

    f_glint = F(omega) p(theta_n) S / (4 mu_sun mu_view cos^4 theta_n),   p = exp(-tan^2 theta_n / s2) / (pi s2)

with Fresnel's reflectance F of unpolarised light at the angle of incidence omega on a facet, theta_n the facet's tilt,
and s2 = 0.003 + 0.00512 W the mean square slope under a wind of W m/s (C. Cox and W. Munk, J. Opt. Soc. Am. 44, 838
(1954): the same for all wind directions, Gaussian). Facets hide and shade each other near the horizon; S is Smith's
factor in the form for a joint view and light path, ``1 / (1 + L(mu_sun) + L(mu_view))`` (L. Tsang, J. A. Kong, R. T.
Shin, *Theory of Microwave Remote Sensing*, Wiley 1985), which keeps f finite at the horizon and the reflected share of
a beam below one. Light reflected twice is lost. The index of sea water is taken as 1.34 at all wavelengths.

Of skylight water reflects what a flat surface reflects of a uniform sky (6.7 %; roughness lowers it by about a sixth).

**Season.** Land north of a line is under snow; the line moves with the month so that the area beyond it is the mean
snow cover of the northern hemisphere (Rutgers Global Snow Lab, monthly means: 47 million km2 in January, 2.9 in
August). South of 60 S all land is snow. Mountains, glaciers off that line and sea ice are left out.

The spectra are round numbers that follow published measurements, not the measurement of one place; land is one mixture
everywhere, 60 % green vegetation and 40 % dry soil (shapes after the ASTER spectral library, A. M. Baldridge et al.,
Remote Sens. Environ. 113, 711 (2009)), 0.05 in the blue and 0.32 in the near infrared. Snow: S. G. Warren, Rev.
Geophys. 20, 67 (1982), grains of a tenth of a millimetre, a tenth taken off for age and dirt. Water: clear oceanic
water with 0.1 mg of chlorophyll per m3 (A. Morel and S. Maritorena, J. Geophys. Res. 106, 7163 (2001)). Foam: cover of
E. C. Monahan and I. O'Muircheartaigh (J. Phys. Oceanogr. 10, 2094 (1980)), albedo of P. Koepke (Appl. Opt. 23, 1816
(1984)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erfc

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds.relief import CloudField, cloud_field
from horizonval.spec.scene import SceneSpec

WATER_INDEX = 1.34
WIND_SPEED_M_S = 7.0
FOAM_ALBEDO = 0.22
SNOW_EDGE_DEG = 2.0
"""Half width in latitude of the belt in which snow sets in."""
SOUTHERN_SNOW_DEG = -60.0
SNOW_LINE_DEG = (40.6, 41.2, 44.7, 50.7, 58.3, 65.2, 70.1, 71.6, 68.7, 59.0, 48.6, 42.8)
"""Northern snow line in the middle of each month, January first."""

_SPECTRA = {
    "vegetation": (
        (0.30, 0.40, 0.45, 0.50, 0.55, 0.60, 0.65, 0.68, 0.70, 0.72, 0.75, 0.80, 0.90, 1.10, 1.30, 1.45, 1.65, 1.95,
         2.20, 2.50),
        (0.03, 0.035, 0.04, 0.05, 0.09, 0.07, 0.05, 0.045, 0.09, 0.18, 0.32, 0.37, 0.39, 0.39, 0.34, 0.14, 0.24, 0.06,
         0.13, 0.05),
    ),
    "soil": (
        (0.30, 0.40, 0.50, 0.60, 0.70, 0.80, 0.90, 1.10, 1.30, 1.65, 1.95, 2.20, 2.50),
        (0.04, 0.07, 0.11, 0.16, 0.20, 0.23, 0.25, 0.28, 0.31, 0.33, 0.28, 0.31, 0.25),
    ),
    "snow": (
        (0.30, 0.50, 0.60, 0.70, 0.80, 0.90, 1.00, 1.05, 1.10, 1.20, 1.30, 1.40, 1.50, 1.65, 1.80, 1.95, 2.20, 2.50),
        (0.88, 0.89, 0.885, 0.87, 0.85, 0.81, 0.73, 0.71, 0.72, 0.57, 0.55, 0.30, 0.05, 0.10, 0.18, 0.03, 0.12, 0.03),
    ),
    "water": (
        (0.30, 0.40, 0.44, 0.49, 0.51, 0.55, 0.58, 0.60, 0.65, 0.70, 2.50),
        (0.015, 0.022, 0.020, 0.012, 0.008, 0.004, 0.002, 0.001, 0.0005, 0.0, 0.0),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class GroundModel:
    """What lies at the end of a ray, as plain data that survives JSON bit by bit.

    Attributes
    ----------
    kind : "uniform" or "earth"
    albedo : float
        Of a uniform ground.
    wind_speed_m_s : float
        Over the ocean of an "earth".
    snow_line_deg : float
        Northern latitude beyond which its land is under snow.
    clouds : CloudField or None
    """

    kind: str
    albedo: float
    wind_speed_m_s: float
    snow_line_deg: float
    clouds: CloudField | None

    @property
    def plain(self) -> bool:
        """Whether this is nothing but a Lambert ground."""
        return self.kind == "uniform" and self.clouds is None


@dataclass(frozen=True)
class Albedos:
    """Lambert albedo of every kind of ground at one wavelength.

    ``sky``: what water reflects of skylight. ``cloud``: of the highest tops.
    """

    land: float
    snow: float
    water: float
    foam: float
    sky: float
    cloud: float


def ground_model(scene: SceneSpec) -> GroundModel:
    """Return what a scene says of ground and clouds."""
    surface = scene.surface
    wind = WIND_SPEED_M_S if surface.wind_speed_m_s is None else surface.wind_speed_m_s
    line = snow_line_deg(scene.platform.epoch_utc)
    return GroundModel(surface.kind, surface.albedo, wind, line, cloud_field(scene))


def snow_line_deg(epoch: datetime) -> float:
    """Return the latitude north of which land is under snow, linear between the middles of the months."""
    day = epoch.timetuple().tm_yday - 1 + epoch.hour / 24.0
    return float(np.interp(day / 365.25 * 12.0 - 0.5, np.arange(12), SNOW_LINE_DEG, period=12.0))


def snow_share(latitude_deg: ArrayLike, line_deg: float) -> FloatArray:
    """Return how much of the land at a latitude is under snow."""
    latitude = np.asarray(latitude_deg, dtype=np.float64)
    north = (latitude - line_deg) / (2.0 * SNOW_EDGE_DEG) + 0.5
    return np.maximum(np.clip(north, 0.0, 1.0), latitude < SOUTHERN_SNOW_DEG)


def spectrum(name: str, wavelength_um: ArrayLike) -> FloatArray:
    """Return the albedo of "vegetation", "soil", "snow" or (light from below its surface) "water"."""
    return np.interp(np.asarray(wavelength_um, dtype=np.float64), *_SPECTRA[name])


def foam_share(wind_speed_m_s: float) -> float:
    """Return the share of the ocean under whitecaps."""
    return min(2.95e-6 * wind_speed_m_s**3.52, 1.0)


def albedos(ground: GroundModel, wavelength_um: float) -> Albedos:
    """Return all albedos at one wavelength; on a uniform ground "land" is the ground."""
    cloud = ground.clouds.albedo if ground.clouds else 0.0
    if ground.kind == "uniform":
        return Albedos(ground.albedo, 0.0, 0.0, 0.0, 0.0, cloud)
    land = 0.6 * spectrum("vegetation", wavelength_um) + 0.4 * spectrum("soil", wavelength_um)
    snow, water = spectrum("snow", wavelength_um), spectrum("water", wavelength_um)
    return Albedos(float(land), float(snow), float(water), FOAM_ALBEDO, water_sky_albedo(), cloud)


def slope_variance(wind_speed_m_s: float) -> float:
    """Return the mean square slope of the sea, both directions together."""
    return 0.003 + 0.00512 * wind_speed_m_s


def slope_density(tan2: ArrayLike, variance: float) -> FloatArray:
    """Return the density of facets per unit of slope squared, at the squared tangent of their tilt."""
    return np.exp(-np.asarray(tan2, dtype=np.float64) / variance) / (math.pi * variance)


def fresnel(cosine: ArrayLike, index: float = WATER_INDEX) -> FloatArray:
    """Return the reflectance of unpolarised light that comes from air at an angle of incidence."""
    c = np.asarray(cosine, dtype=np.float64)
    g = np.sqrt(index * index - 1.0 + c * c)
    across = (g - c) / (g + c)
    along = (c * (g + c) - 1.0) / (c * (g - c) + 1.0)
    return 0.5 * across**2 * (1.0 + along**2)


@cache
def water_sky_albedo() -> float:
    """Return what a flat sea reflects of a uniform sky: 2 int F mu dmu."""
    x, w = np.polynomial.legendre.leggauss(64)
    mu = 0.5 * (x + 1.0)
    return float(np.sum(w * mu * fresnel(mu)))


def hidden(mu: ArrayLike, variance: float) -> FloatArray:
    """Return Smith's function L of the cosine to the vertical: 0 overhead, growing without limit to the horizon."""
    mu = np.clip(np.asarray(mu, dtype=np.float64), 1e-6, 1.0)
    v = np.minimum(mu / np.sqrt(np.maximum(1.0 - mu * mu, 1e-12) * variance), 25.0)
    return np.maximum(0.5 * (np.exp(-v * v) / (v * math.sqrt(math.pi)) - erfc(v)), 0.0)


def glint_brdf(mu_sun: ArrayLike, mu_view: ArrayLike, cosine: ArrayLike, variance: float) -> FloatArray:
    """Return the sea's facet reflectance [1/sr].

    Parameters
    ----------
    mu_sun, mu_view : array_like
        Cosines of the angles between the vertical and Sun and observer; 0 where either is below the horizon.
    cosine : array_like
        Cosine of the angle between the directions to Sun and observer.
    variance : float
        See :func:`slope_variance`.
    """
    sun, view = np.asarray(mu_sun, dtype=np.float64), np.asarray(mu_view, dtype=np.float64)
    up = (sun > 0.0) & (view > 0.0)
    sun, view = np.clip(sun, 1e-6, 1.0), np.clip(view, 1e-6, 1.0)
    incidence = np.sqrt(np.maximum(0.5 * (1.0 + np.asarray(cosine, dtype=np.float64)), 1e-12))
    tilt2 = np.minimum(((sun + view) / (2.0 * incidence)) ** 2, 1.0)
    seen = 1.0 / (1.0 + hidden(sun, variance) + hidden(view, variance))
    density = slope_density(1.0 / tilt2 - 1.0, variance)
    return np.where(up, fresnel(incidence) * density * seen / (4.0 * sun * view * tilt2**2), 0.0)
