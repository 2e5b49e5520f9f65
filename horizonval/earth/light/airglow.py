"""Sources at night: airglow below 120 km, and the sky behind it.

**Airglow.** Layers of a Gaussian profile, zenith column in rayleigh (1 R = 1e10 / (4 pi) photons m-2 s-1 sr-1 along the
line of sight; Hunten, Roach and Chamberlain, J. Atmos. Terr. Phys. 8, 345 (1956)), typical of middle latitudes in a
year of average solar activity:

==============  =================  ===========  ======  =========================================================
emission        wavelength         column       height  width (half maximum)
==============  =================  ===========  ======  =========================================================
OI              557.7 nm           250 R        97 km   8 km Na D            589.3 nm           60 R         91 km   9
km O2 A (0-0)      762 nm             6 kR         94 km   9 km; as seen from above: air below 60 km absorbs it OH
Meinel       0.6 to 1.1 um      R / nm       88 km   9 km; bands of the table below, smeared over wavelength NO2
continuum   0.4 to 0.7 um      R / nm       95 km   14 km
==============  =================  ===========  ======  =========================================================

Lines and heights: Roach and Gordon, *The Light of the Night Sky* (1973); Leinert et al., A&AS 127, 1 (1998), section 6;
heights also from rockets (Greer and Best 1967; Watanabe et al. 1981) and the Shuttle (Mende et al., JGR 98, 19117
(1993)). Each varies by a factor of two from night to night. Neglected: OI 630.0 nm (100 R at 250 km, above the top),
777 nm, the ultraviolet Herzberg bands, aurora, and any structure in latitude and time.

**Sky.** Zodiacal light and stars are one uniform radiance of the Sun's colour: 22.0 mag arcsec-2 in V, 210 S10, the
mean over the sky of some 110 S10 of zodiacal light and 100 S10 of stars (Roach and Gordon 1973; Leinert et al. 1998,
tables 16 and 36). The true sky ranges from 23 at the galactic poles to 21 in the Milky Way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.earth.light.moonlight import V_SUN
from horizonval.earth.spectral import bands
from horizonval.spec.camera import Band

TOP_M = 120_000.0
STEP_M = 100.0
REACH = 1.5
"""Half-maximum widths at which a layer is cut off on either side (4e-4 of it, restored by scaling)."""
SKY_V = 22.0
ARCSEC2_SR = math.radians(1.0 / 3600.0) ** 2
RAYLEIGH = 1e10 / (4.0 * math.pi)
"""Photons m-2 s-1 sr-1."""
PLANCK_TIMES_C = 1.98644586e-25
"""J m."""


@dataclass(frozen=True)
class Layer:
    """One emission: a line (one wavelength, column in rayleigh) or a continuum (rayleigh per um, linear between)."""

    height_m: float
    width_m: float
    wavelength_um: tuple[float, ...]
    column: tuple[float, ...]

    def profile_per_m(self, altitude_m: FloatArray) -> FloatArray:
        """Return the share of the column per metre; its integral, linear between the altitudes, is 1."""
        x = (altitude_m - self.height_m) / self.width_m
        shape = np.where(np.abs(x) <= REACH, np.exp(-4.0 * math.log(2.0) * x**2), 0.0)
        return shape / np.trapezoid(shape, altitude_m)


LAYERS = (
    Layer(97e3, 8e3, (0.5577,), (250.0,)),
    Layer(91e3, 9e3, (0.5893,), (60.0,)),
    Layer(94e3, 9e3, (0.7620,), (6000.0,)),
    Layer(
        88e3,
        9e3,
        (0.52, 0.60, 0.65, 0.70, 0.75, 0.80, 0.90, 1.00, 1.10),
        (0.0, 1.0e3, 3.0e3, 6.0e3, 1.3e4, 1.8e4, 4.0e4, 8.0e4, 1.0e5),
    ),
    Layer(95e3, 14e3, (0.38, 0.45, 0.55, 0.60, 0.75), (0.0, 2.0e3, 4.0e3, 4.0e3, 0.0)),
)


def radiance(rayleigh: FloatArray | float, wavelength_um: FloatArray | float) -> FloatArray:
    """Return W m-2 sr-1 of a column in rayleigh (or W m-2 sr-1 um-1 of rayleigh per um)."""
    return np.asarray(rayleigh) * RAYLEIGH * PLANCK_TIMES_C / (np.asarray(wavelength_um) * 1e-6)


def band_energy(band: Band, layer: Layer) -> tuple[FloatArray, FloatArray]:
    """Return wavelengths and their contributions to the band's radiance of the layer in the zenith [W m-2 sr-1].

    They include response and photon weighting of :mod:`horizonval.earth.spectral.bands`.
    """
    if len(layer.wavelength_um) == 1:
        wavelength, weight = np.array(layer.wavelength_um), np.ones(1)
        column = np.array(layer.column)
        weight = weight * bands.response(band, wavelength)
    else:
        wavelength, weight = bands.sampled(band, layer.wavelength_um)
        column = np.interp(wavelength, layer.wavelength_um, layer.column, left=0.0, right=0.0)
    photons = wavelength / bands.reference_wavelength_um(band)
    return wavelength, weight * photons * radiance(column, wavelength)


def with_night(
    model: OpticalModel, camera_bands: list[Band], sun_distance_au: float, *, airglow: bool, sky: bool
) -> OpticalModel:
    """Return the model with airglow up to 120 km in its solar nodes, and the sky behind them.

    A wavelength's share of a band's energy is divided linearly between the two neighbouring nodes: the band's energy is
    exact, and the air in front attenuates it as it does those nodes.
    """
    z: FloatArray = np.arange(round(TOP_M / STEP_M) + 1, dtype=np.float64) * STEP_M
    nodes = list(model.nodes)
    for band in camera_bands:
        mine = sorted((i for i, n in enumerate(nodes) if n.band == band.name), key=lambda i: nodes[i].wavelength_um)
        if band.kind != "solar" or not mine:
            continue
        if airglow:
            glow = _glow(band, [nodes[i] for i in mine], z)
            for i, column in zip(mine, glow, strict=True):
                nodes[i] = replace(nodes[i], glow_per_m=column)
        if sky:
            share = 10.0 ** (0.4 * (V_SUN - SKY_V)) / ARCSEC2_SR * sun_distance_au**2
            for i in mine:
                nodes[i] = replace(nodes[i], sky_radiance=nodes[i].solar_irradiance * share)
    aglow = any(len(n.glow_per_m) for n in nodes)
    return replace(model, nodes=tuple(nodes), glow_altitude_m=z if aglow else model.glow_altitude_m)


def _glow(band: Band, nodes: list[SpectralNode], altitude_m: FloatArray) -> FloatArray:
    """Return W m-3 sr-1 um-1 of every node, shape (n_nodes, n_altitude)."""
    at = np.array([n.wavelength_um for n in nodes])
    glow = np.zeros((len(nodes), len(altitude_m)))
    for layer in LAYERS:
        wavelength, energy = band_energy(band, layer)
        position = np.interp(wavelength, at, np.arange(len(at)))
        for k, node in enumerate(nodes):
            share = np.maximum(1.0 - np.abs(position - k), 0.0)
            glow[k] += float(np.sum(energy * share)) / node.weight * layer.profile_per_m(altitude_m)
    return glow
