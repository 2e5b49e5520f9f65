"""What the renderer needs to know of the planet: columns of optical properties, one per spectral node.

The physics rooms end and the renderer begins here. A node is monochromatic; the renderer solves each node alone and
adds them up::

    L_band = sum over the band's nodes of weight * L_node

Every property is linear in altitude between the nodes of the common grid and zero above its top. Scattered sunlight
comes in such nodes, thermal bands are :class:`horizonval.earth.atmosphere.emission.EmittingBand`.
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
    """Where columns of air stand that differ from the one below the camera.

    Attributes
    ----------
    altitude_m : ndarray, shape (k,)
        On which they are given: even, from 0 to the top of the model.
    sin_latitude : ndarray, shape (m,)
        Even and rising, at least two; of geodetic latitudes. Empty where there is a map.
    column_map : ColumnMap or None
        Where the m columns stand if the air varies with longitude too.
    """

    altitude_m: FloatArray
    sin_latitude: FloatArray
    column_map: ColumnMap | None = None


@dataclass(frozen=True)
class SpectralNode:
    """One monochromatic (or g-point) column of optical properties on the common altitude grid.

    Attributes
    ----------
    name : str
    band : str
        Band this node adds to.
    weight : float
        Band radiance = sum over nodes of ``weight`` * node radiance [um]; 1 for an atmosphere file's band.
    wavelength_um : float
        Nominal wavelength.
    extinction_per_m : ndarray, shape (n,)
    molecular_per_m : ndarray, shape (n,)
        Scattering coefficient of molecules. Their phase function is
        ``(1 - c/3 + c cos^2) / (4 pi)`` with c = ``molecular_cos2``.
    molecular_cos2 : float
        0.75 without depolarisation (Rayleigh), ``0.75 (1 - q) / (1 + 2 q)`` with ``q = rho / (2 - rho)`` for a
        depolarisation factor rho, 0 for isotropic scattering.
    particle_per_m : ndarray, shape (n,)
        Scattering coefficient of particles, phase function of Henyey and Greenstein.
    asymmetry : ndarray, shape (n,)
        Its asymmetry g at every altitude; where there are no particles, any number in (-1, 1).
    solar_irradiance : float
        W m-2 um-1 at the scene's distance of the Sun, outside the atmosphere, across the rays. 1 for atmosphere files
        of the ``radiance`` command: the answer is then 1/sr.
    sun_radiance : float
        Mean radiance of the Sun's disc outside the atmosphere, unit of the node radiance.
    limb_darkening : tuple of float
        Coefficients of ``I(mu) / I(1) = sum a_k mu^k`` on the Sun's disc; (1,) for a uniform one.
    moon_irradiance : float
        The Moon's irradiance at the Earth's centre, outside the atmosphere, unit of ``solar_irradiance``; 0 for none.
    sky_radiance : float
        Of the sky behind everything, unit of the node radiance.
    glow_per_m : ndarray, shape (m,)
        Emission of the air itself, whatever its temperature and the Sun's height (airglow), on the model's
        ``glow_altitude_m``: W m-3 sr-1 um-1, the node radiance per metre. Empty for none.
    layer_per_m : ndarray, shape (m, n)
        Extinction of each of the model's ``layers``, which ``extinction_per_m`` has in it.
    layer_albedo, layer_asymmetry : tuple of float
        Scattering per ``layer_per_m``, and asymmetry of each layer's particles.
    forward_per_m : ndarray, shape (n,)
        What of ``particle_per_m`` scatters straight on and is not in ``extinction_per_m``, see
        :mod:`horizonval.renderer.scattering.shells`; empty for nothing.
    more_extinction_per_m, more_molecular_per_m : ndarray, shape (m, k)
        What the model's ``columns`` have more of (less: negative) than the node's own column. Empty without columns.
    energy_ratio : float
        Of solar bands, whose weights count photons: a band's energy radiance is the sum over nodes of ``weight`` *
        ``energy_ratio`` * node radiance. Not a number where nobody asks for it.
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
    altitude_m : ndarray, shape (n,)
        Rising from 0 to ``top_m``.
    top_m : float
        Vacuum above.
    nodes : tuple of SpectralNode
    albedo : float
        Lambert albedo of the ground, for sunlight.
    ground_varies : bool
        Whether the ground is more than ``albedo`` says, or has clouds above it.
    glow_altitude_m : ndarray, shape (m,)
        Altitudes of ``glow_per_m``, from 0 on; may go on above ``top_m``, where the air glows without dimming. Empty
        where nothing glows.
    refractivity : ndarray, shape (n,), or None
        n - 1 of the air, one for all nodes. None: light goes straight.
    thermal : tuple of EmittingBand
        The thermal bands of a scene, each with its own air over height and latitude.
    emission : GroundEmission or None
        What ground and clouds emit in them; None where there are no thermal bands.
    layers : tuple of (float, float)
        Base and top of the layers of thin cloud: the air's columns bend sharply there.
    gaps : tuple of LayerGaps or None
        Of each of the layers where it is cloudy, None for an even one. The columns are those of the mean layer.
    columns : ColumnPlaces or None
        Of air that differs from place to place: where ``more_extinction_per_m`` of the nodes stands. None: the nodes'
        own columns serve everywhere.
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
        """Nothing shines above."""
        return max(self.top_m, float(self.glow_altitude_m[-1])) if len(self.glow_altitude_m) else self.top_m
