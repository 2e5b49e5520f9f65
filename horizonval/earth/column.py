"""Interface between the physics and the renderer: columns of optical properties, one per spectral node.

A node is monochromatic; the renderer solves each node separately::

    L_band = sum over the band's nodes of weight * L_node

Every property is linear in altitude between the nodes of the common grid and zero above its top. Thermal bands are
:class:`horizonval.earth.atmosphere.emission.EmittingBand`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.clouds.layers import LayerGaps
from horizonval.earth.surface.ground_emission import GroundEmission
from horizonval.earth.weather.field import ColumnMap


@dataclass(frozen=True)
class ColumnPlaces:
    """Positions of columns of air that differ from the one below the camera.

    ``altitude_m``: shape (k,), even levels from 0 to the top of the model; ``sin_latitude``: shape (m,), even and
    rising, of geodetic latitudes, at least two, empty with a map; ``column_map``: positions of the m columns if the air
    varies with longitude too.
    """

    altitude_m: FloatArray
    sin_latitude: FloatArray
    column_map: ColumnMap | None = None


@dataclass(frozen=True)
class SpectralNode:
    """One monochromatic column of optical properties on the common altitude grid.

    Attributes
    ----------
    band : str
        Band this node adds to.
    weight : float
        Band radiance = sum over nodes of ``weight`` * node radiance [um]; 1 for an atmosphere file's band.
    wavelength_um : float
        Nominal wavelength.
    extinction_per_m : ndarray, shape (n,)
    molecular_per_m, molecular_cos2 : ndarray, shape (n,); float
        Scattering coefficient of molecules. Their phase function is ``(1 - c/3 + c cos^2) / (4 pi)`` with c =
        ``molecular_cos2``: 0.75 without depolarisation (Rayleigh), ``0.75 (1 - q) / (1 + 2 q)`` with ``q = rho / (2 -
        rho)`` for a depolarisation factor rho, 0 for isotropic scattering.
    particle_per_m, asymmetry : ndarray, shape (n,)
        Scattering coefficient of particles, and asymmetry g of their Henyey-Greenstein phase function, in (-1, 1).
    solar_irradiance : float
        W m-2 um-1 outside the atmosphere, across the rays, at the scene's distance of the Sun. 1 for atmosphere files
        of the ``radiance`` command, whose radiances are in 1/sr.
    sun_radiance, sky_radiance : float
        Outside the atmosphere, in the unit of the node radiance: mean of the Sun's disc, and the sky behind everything.
    limb_darkening : tuple of float
        Coefficients of ``I(mu) / I(1) = sum a_k mu^k`` on the Sun's disc; (1,) for a uniform one.
    moon_irradiance : float
        The Moon's irradiance at the Earth's centre, outside the atmosphere, unit of ``solar_irradiance``.
    glow_per_m : ndarray, shape (m,)
        Airglow on the model's ``glow_altitude_m``: W m-3 sr-1 um-1, the node radiance per metre. Empty for none.
    layer_per_m : ndarray, shape (m, n)
        Extinction of each of the model's ``layers``, included in ``extinction_per_m``.
    layer_albedo, layer_asymmetry : tuple of float
        Scattering per ``layer_per_m``, and asymmetry of each layer's particles.
    forward_per_m : ndarray, shape (n,)
        Part of ``particle_per_m`` that scatters straight on and is not in ``extinction_per_m``, see
        :mod:`horizonval.renderer.scattering.shells`; may be empty.
    more_extinction_per_m, more_molecular_per_m : ndarray, shape (m, k)
        Difference of the model's ``columns`` from the node's own column. Empty without columns.
    energy_ratio : float
        Of solar bands, whose weights count photons: a band's energy radiance is the sum over nodes of ``weight`` *
        ``energy_ratio`` * node radiance. NaN where it is not needed.
    """

    name: str
    band: str
    weight: float
    wavelength_um: float
    extinction_per_m: FloatArray
    molecular_per_m: FloatArray
    molecular_cos2: float
    particle_per_m: FloatArray
    asymmetry: FloatArray
    solar_irradiance: float
    sun_radiance: float
    limb_darkening: tuple[float, ...] = (1.0,)
    moon_irradiance: float = 0.0
    sky_radiance: float = 0.0
    glow_per_m: FloatArray = field(default_factory=lambda: np.zeros(0))
    layer_per_m: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    layer_albedo: tuple[float, ...] = ()
    layer_asymmetry: tuple[float, ...] = ()
    forward_per_m: FloatArray = field(default_factory=lambda: np.zeros(0))
    more_extinction_per_m: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    more_molecular_per_m: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    energy_ratio: float = math.nan

    @property
    def scattering_per_m(self) -> FloatArray:
        """Scattering coefficient of everything, shape (n,)."""
        return self.molecular_per_m + self.particle_per_m


@dataclass(frozen=True)
class OpticalModel:
    """Optical properties of a whole scene or atmosphere file.

    Attributes
    ----------
    altitude_m, top_m : ndarray, shape (n,); float
        Rising from 0 to ``top_m``, with vacuum above.
    albedo : float
        Lambert albedo of the ground, for sunlight.
    ground_varies : bool
        Whether the ground differs from a Lambert ground of ``albedo``, or has clouds above it.
    glow_altitude_m : ndarray, shape (m,)
        Altitudes of ``glow_per_m``, from 0; may extend above ``top_m``, where the glow is not attenuated. May be empty.
    refractivity : ndarray, shape (n,), or None
        n - 1 of the air, one for all nodes. None: straight rays.
    emission : GroundEmission or None
        What ground and clouds emit in the thermal bands.
    layers : tuple of (float, float)
        Base and top of the layers of thin cloud, where the columns bend sharply.
    gaps : tuple of LayerGaps or None
        Cloudy part of each layer, None for an even one. The columns are those of the mean layer.
    columns : ColumnPlaces or None
        Positions of the columns of ``more_extinction_per_m``. None: the nodes' own columns apply everywhere.
    band_order : tuple of str
        Names of all bands in the camera's order; empty for that of ``nodes`` and then ``thermal``.
    """

    altitude_m: FloatArray
    top_m: float
    nodes: tuple[SpectralNode, ...]
    albedo: float
    ground_varies: bool = False
    glow_altitude_m: FloatArray = field(default_factory=lambda: np.zeros(0))
    refractivity: FloatArray | None = None
    thermal: tuple[EmittingBand, ...] = ()
    emission: GroundEmission | None = None
    layers: tuple[tuple[float, float], ...] = ()
    gaps: tuple[LayerGaps | None, ...] = ()
    columns: ColumnPlaces | None = None
    band_order: tuple[str, ...] = ()

    @property
    def bands(self) -> tuple[str, ...]:
        """Names of all bands, each once, solar and thermal, in the camera's order."""
        return self.band_order or tuple(
            dict.fromkeys([*(node.band for node in self.nodes), *(band.name for band in self.thermal)])
        )

    @property
    def has_gaps(self) -> bool:
        """Whether a layer of thin cloud has gaps."""
        return any(gaps is not None for gaps in self.gaps)

    @property
    def glow_top_m(self) -> float:
        """Top of everything that emits or scatters."""
        return max(self.top_m, float(self.glow_altitude_m[-1])) if len(self.glow_altitude_m) else self.top_m
