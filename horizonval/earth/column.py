"""What the renderer needs to know of the planet: columns of optical properties, one per spectral node.

The physics rooms end and the renderer begins here. A node is monochromatic (scattered sunlight) or a point of a
k-distribution (thermal emission); the renderer solves each node alone and adds them up::

    L_band = sum over the band's nodes of weight * L_node

Every property is linear in altitude between the nodes of the common grid and zero above its top.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class SpectralNode:
    """One monochromatic (or g-point) column of optical properties on the common altitude grid.

    Attributes
    ----------
    name : str
    band : str
        Band this node adds to.
    weight : float
        Band radiance = sum over nodes of ``weight`` * node radiance. [um] where the node radiance is per um, 1 where
        the node's source is integrated over the band already.
    wavelength_um : float
        Nominal wavelength.
    extinction_per_m : ndarray, shape (n,)
    molecular_per_m : ndarray, shape (n,)
        Scattering coefficient of molecules; zero for thermal nodes. Their phase function is
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
        of the ``radiance`` command (the answer is then 1/sr), 0 for none.
    source : ndarray, shape (n,)
        Thermal source function (Planck function weighted as the node asks), W m-2 sr-1 or W m-2 sr-1 um-1; emission
        per metre is extinction times source. Zero for solar nodes.
    surface_source : float
        Source of a black ground (before emissivity), unit of ``source``.
    sun_radiance : float
        Mean radiance of the Sun's disc outside the atmosphere, unit of the node radiance.
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
    source: FloatArray
    surface_source: float
    sun_radiance: float

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
    emissivity : float
        Of the ground, for thermal emission.
    refractivity : ndarray, shape (n,), or None
        n - 1 of the air, one for all nodes. None: light goes straight.
    """

    altitude_m: FloatArray
    top_m: float
    nodes: tuple[SpectralNode, ...]
    albedo: float
    emissivity: float
    refractivity: FloatArray | None = None
