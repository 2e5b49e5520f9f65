"""Additions to the Sun's irradiance in a scene's sky: its limb darkening, the Moon, and the night.

**Magnitude of the Moon** (C. W. Allen, *Astrophysical Quantities*, 3rd ed. 1976, section 66; the same law in Krisciunas
and Schaefer, PASP 103, 1033 (1991), eq. 9), for a phase angle a in degrees and distances in au::

    V = +0.21 + 5 lg(r Delta) + 0.026 |a| + 4e-9 a^4

-12.74 for the full Moon at its mean distance, against -26.75 for the Sun at 1 au. Neglected: the opposition surge below
a = 5 deg (up to 0.3 mag brighter), waxing and waning (0.1 mag), libration (a few per cent), polarisation. The law is
fitted to phase angles up to about 150 deg; closer to new Moon the irradiance is negligible.

**Colour of the Moon.** B - V is 0.92 (Allen) and 0.65 for the Sun, so the albedo is proportional to the wavelength to
the power 1.1 in the blue; towards 1 um to the power 0.8 (ratio 1.6 of 1.0 to 0.55 um, as in the ROLO model: Kieffer and
Stone, AJ 129, 2887 (2005)). Constant beyond 1.1 um. Good to some 10 % at 0.4 and 1 um.

**Disc of the Moon.** Radiance follows Lommel and Seeliger, ``mu0 / (mu0 + mu)`` between terminator and limb: a full
Moon as bright at the edge as in the middle. Its mean over the disc has a closed form (Hapke, *Theory of reflectance*,
2012, section 11.3), which scales the disc to the magnitude. Maria, earthshine and the Moon's thermal emission are
neglected.

**Limb darkening** of the Sun: Neckel's analytical functions (Sol. Phys. 229, 13 (2005), table 1). They are fitted to
the measured continuum of Neckel and Labs (Sol. Phys. 153, 91 (1994)), 300 to 1100 nm::

    I(mu) / I(1) = A_0 + A_1 mu + ... + A_5 mu^5,      A_k = a_k0 + a_k1 / lambda + a_k5 / lambda^5

with ``mu^2 = 1 - (r / R)^2`` on the disc and the wavelength in um. At mu = 1 every set sums to one. The darkening jumps
across the Balmer limit: between 373 and 385 nm, where Neckel gives no fit, it is linear in wavelength. Beyond 1.1 um it
is constant, although the disc is flatter there (at 2 um its edge is brighter by some 10 % of the centre). Spots,
faculae and the chromosphere are neglected.

**Airglow.** Layers of a Gaussian profile, zenith column in rayleigh (1 R = 1e10 / (4 pi) photons m-2 s-1 sr-1 along the
line of sight; Hunten, Roach and Chamberlain, J. Atmos. Terr. Phys. 8, 345 (1956)), typical of middle latitudes in a
year of average solar activity:

==============  =================  ===========  ======  =========================================================
emission        wavelength         column       height  width (half maximum)
==============  =================  ===========  ======  =========================================================
OI              557.7 nm           250 R        97 km   8 km
Na D            589.3 nm           60 R         91 km   9 km
O2 A (0-0)      762 nm             6 kR         94 km   9 km; as seen from above: air below 60 km absorbs it
OH Meinel       0.6 to 1.1 um      R / nm       88 km   9 km; bands of the table below, smeared over wavelength
NO2 continuum   0.4 to 0.7 um      R / nm       95 km   14 km
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
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel, SpectralNode
from horizonval.earth.spectral import bands
from horizonval.spec.camera import Band

V_SUN = -26.75
V_MOON_UNIT = 0.21
"""V of the full Moon at 1 au from Sun and observer."""
V_UM = 0.55
BLUE_SLOPE, RED_SLOPE = 1.1, 0.8
RED_END_UM = 1.1


def moon_magnitude(phase_rad: float, sun_distance_au: float, distance_au: float) -> float:
    """Return the Moon's V; ``sun_distance_au``: from Sun to Moon, ``distance_au``: from Moon to observer."""
    a = abs(math.degrees(phase_rad))
    return V_MOON_UNIT + 5.0 * math.log10(sun_distance_au * distance_au) + 0.026 * a + 4e-9 * a**4


def moon_colour(wavelength_um: ArrayLike) -> FloatArray:
    """Return the albedo relative to that at 0.55 um."""
    wavelength = np.minimum(np.asarray(wavelength_um, float), RED_END_UM) / V_UM
    return wavelength ** np.where(wavelength < 1.0, BLUE_SLOPE, RED_SLOPE)


def irradiance_ratio(
    wavelength_um: ArrayLike, phase_rad: float, sun_moon_au: float, moon_au: float, sun_au: float
) -> FloatArray:
    """Return the Moon's spectral irradiance over the Sun's, across the rays, outside the atmosphere.

    ``phase_rad``: angle at the Moon between Sun and observer. Distances from the Sun to the Moon, from the Moon to the
    observer, and from the Sun to the point of reference.
    """
    return (
        10.0 ** (0.4 * (V_SUN - moon_magnitude(phase_rad, sun_moon_au, moon_au)))
        * sun_au**2
        * moon_colour(wavelength_um)
    )


_RANGES = (
    (
        (0.30, 0.37298),
        ((0.35601, -0.085217, 0.0), (1.11529, 0.085217, -0.001871), (-0.67237, 0.0, 0.003589)),
        ((0.18696, 0.0, -0.002415), (0.00038, 0.0, 0.000897), (0.01373, 0.0, -0.000200)),
    ),
    (
        (0.385, 0.42257),
        ((0.09900, 0.010643, 0.0), (1.96884, -0.010643, -0.009166), (-2.80511, 0.0, 0.024873)),
        ((3.32780, 0.0, -0.029317), (-2.17878, 0.0, 0.018273), (0.58825, 0.0, -0.004663)),
    ),
    (
        (0.42257, 1.10),
        ((0.75267, -0.265577, 0.0), (0.93874, 0.265577, -0.004095), (-1.89287, 0.0, 0.012582)),
        ((2.42234, 0.0, -0.017117), (-1.71150, 0.0, 0.011977), (0.49062, 0.0, -0.003347)),
    ),
)


def limb_darkening_of(wavelength_um: float) -> tuple[float, ...]:
    """Return ``A_0 ... A_5`` of ``I(mu) / I(1) = sum A_k mu^k``; constant outside 0.30 to 1.10 um."""
    wavelength = min(max(wavelength_um, _RANGES[0][0][0]), _RANGES[-1][0][1])
    for (low, high), *_ in _RANGES:
        if low <= wavelength <= high:
            return tuple(_fit(wavelength, low))
    left, right = _RANGES[0][0][1], _RANGES[1][0][0]
    share = (wavelength - left) / (right - left)
    return tuple((1.0 - share) * _fit(left, _RANGES[0][0][0]) + share * _fit(right, _RANGES[1][0][0]))


def _fit(wavelength_um: float, low_um: float) -> FloatArray:
    rows = next(first + second for (low, _), first, second in _RANGES if low == low_um)
    return np.array(rows) @ np.array([1.0, 1.0 / wavelength_um, wavelength_um**-5])


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


def airglow_radiance(rayleigh: FloatArray | float, wavelength_um: FloatArray | float) -> FloatArray:
    """Return W m-2 sr-1 of a column in rayleigh (or W m-2 sr-1 um-1 of rayleigh per um)."""
    return np.asarray(rayleigh) * RAYLEIGH * PLANCK_TIMES_C / (np.asarray(wavelength_um) * 1e-6)


def band_energy(band: Band, layer: Layer) -> tuple[FloatArray, FloatArray]:
    """Return wavelengths and contributions to the band's zenith radiance of the layer [W m-2 sr-1], with response."""
    if len(layer.wavelength_um) == 1:
        wavelength, weight = np.array(layer.wavelength_um), np.ones(1)
        column = np.array(layer.column)
        weight = weight * bands.response(band, wavelength)
    else:
        wavelength, weight = bands.sampled(band, layer.wavelength_um)
        column = np.interp(wavelength, layer.wavelength_um, layer.column, left=0.0, right=0.0)
    photons = wavelength / bands.reference_wavelength_um(band)
    return wavelength, weight * photons * airglow_radiance(column, wavelength)


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


NIGHT_ZENITH_RAD = math.radians(99.0)
"""Solar zenith angle beyond which night sources count.

With the Sun 9 deg below the horizon twilight illuminates the ground with some 0.1 lx (between 3.4 lx at 6 deg and 0.008
lx at 12 deg: Kaufmann, *IES Lighting Handbook*; Seidelmann, *Explanatory Supplement*, 1992, section 9.3), half of a
full Moon; with a higher Sun, night sources add less than twilight's variation from day to day."""


@dataclass(frozen=True)
class Moonlight:
    """The Moon as seen from the Earth's centre: phase angle [rad] and distances [au]; ``sun_au``: Sun to Earth."""

    phase_rad: float
    sun_moon_au: float
    moon_au: float
    sun_au: float


def night_in_view(sun_zenith_rad: float, horizon_rad: float) -> bool:
    """Return whether somewhere in view the Sun is lower than :data:`NIGHT_ZENITH_RAD`.

    ``sun_zenith_rad``: of the Sun at the sub-satellite point. ``horizon_rad``: angle at the Earth's centre from that
    point to the horizon.
    """
    return sun_zenith_rad + horizon_rad > NIGHT_ZENITH_RAD


def with_sky(
    model: OpticalModel,
    camera_bands: list[Band],
    *,
    sun_distance_au: float,
    moon: Moonlight | None,
    airglow: bool,
    background: bool,
) -> OpticalModel:
    """Return the model with limb darkening and moonlight in its solar nodes, and optionally the night.

    Thermal bands have a uniform Sun (the disc's edge is within 10 % of its centre at 10 um, and the Sun saturates any
    horizon sensor), and no Moon.
    """
    nodes = []
    for node in model.nodes:
        if node.solar_irradiance > 0.0:
            ratio = 0.0
            if moon is not None:
                ratio = float(
                    irradiance_ratio(node.wavelength_um, moon.phase_rad, moon.sun_moon_au, moon.moon_au, moon.sun_au)
                )
            node = replace(
                node,
                limb_darkening=limb_darkening_of(node.wavelength_um),
                moon_irradiance=node.solar_irradiance * ratio,
            )
        nodes.append(node)
    model = replace(model, nodes=tuple(nodes))
    if not (airglow or background):
        return model
    return with_night(model, camera_bands, sun_distance_au, airglow=airglow, sky=background)
