"""Number of spectral nodes that a solar band needs for a stated error.

The rule of n nodes is exact for polynomials in wavelength; the remaining error is found by trial. For a few rays the
radiance of the atmosphere, scattered once, is computed at every sampled wavelength of the band and at the nodes of the
rule. The smallest n whose band radiance is within the error on every ray is taken.

The rays have tangent heights of 0 to 60 km or meet the ground straight below and at 70 deg from the vertical, each with
the Sun at 30, 70 and 88 deg from the zenith and at right angles to the line of sight. The atmosphere is made of shells
2 to 10 km thick with constant coefficients: a crude radiance (a few per cent), but the same on both sides of the
comparison. Gases, ozone, aerosol and albedo are the scene's.

Other rays can be slightly worse than the worst of these (tests allow 1.5 times the error). Multiple scattering, which
depends on wavelength more gently at the limb, is not included.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.atmosphere import aerosol
from horizonval.earth.atmosphere.air import Air
from horizonval.earth.atmosphere.solar_rule import Measure, RuleFamily, SolarRule
from horizonval.earth.gases import ozone, rayleigh

MAX_NODES = 64
_RADIUS_M = 6_371_000.0
_EDGES_M = 1e3 * np.concatenate([np.arange(0, 20, 2), np.arange(20, 60, 4), np.arange(60, 101, 10)])
_TANGENT_M = 1e3 * np.array([0.0, 4.0, 8.0, 14.0, 20.0, 32.0, 44.0, 60.0])
_SUN_ZENITH_DEG = (30.0, 70.0, 88.0)
_VIEW_ZENITH_DEG = (0.0, 70.0)


def choose_rule(measure: Measure, air: Air, albedo: float, error: float, where: str) -> SolarRule:
    """Return the smallest rule whose band radiance is within a relative error on every ray of the module text.

    Raises ``UserError``: no rule of up to 64 nodes is good enough; names ``where``, file and key of the band.
    """
    fine, energy = _thinned(measure)
    spectra = _Spectra.of(fine, *_ozone(fine, air), air)
    rays = [(ray, float(ray.radiance(spectra) @ energy)) for ray in _rays(_shell_means(air), albedo)]
    rules = RuleFamily(measure, MAX_NODES, with_ozone=air.with_ozone)
    for n in range(1, MAX_NODES + 1):
        rule = rules.rule(n)
        spectra = _Spectra.of(rule.wavelength_um, rule.ozone_cold_m2, rule.ozone_warm_m2, air)
        energy = rule.weight_um * rule.mean_irradiance
        for i, (ray, expected) in enumerate(rays):
            approximate = float(ray.radiance(spectra) @ energy)
            if abs(approximate - expected) > error * expected:
                # The ray that fails this rule will probably fail the next one as well.
                rays.insert(0, rays.pop(i))
                break
        else:
            return rule
    raise UserError(
        f"{MAX_NODES} spectral nodes leave an error of more than {error:g}",
        where=where,
        expected="a larger render.band_error, a narrower band, or a number of nodes in the band",
    )


def _thinned(measure: Measure) -> tuple[FloatArray, FloatArray]:
    """Return the measure with the four samples of each interval of the Sun's table combined."""
    energy = measure.energy.reshape(-1, 4)
    total = energy.sum(axis=1)
    used = total > 0
    centre = np.einsum("ij,ij->i", energy, measure.wavelength_um.reshape(-1, 4))
    return centre[used] / total[used], total[used]


def _ozone(wavelength_um: FloatArray, air: Air) -> tuple[FloatArray, FloatArray]:
    zero = np.zeros_like(wavelength_um)
    if not air.with_ozone:
        return zero, zero
    return Measure(wavelength_um, zero, 0.0, 0.0).ozone()


@dataclass(frozen=True)
class _Spectra:
    """Effect of a unit of each constituent: air, ozone at 220 K, ozone at 280 K, kinds of particles.

    ``extinction`` and ``particles`` have shape (constituents, wavelengths); ``particles`` is scattering, ``asymmetry``
    its g. ``air`` is the scattering cross section of a molecule, ``cos2`` its phase function.
    """

    extinction: FloatArray
    air: FloatArray
    cos2: FloatArray
    particles: FloatArray
    asymmetry: FloatArray

    @classmethod
    def of(cls, wavelength_um: FloatArray, cold: FloatArray, warm: FloatArray, air: Air) -> _Spectra:
        molecule = rayleigh.cross_section_m2(wavelength_um)
        kinds = [aerosol.optics(kind, wavelength_um) for kind in air.aerosol.kinds]
        shape = (len(kinds), len(wavelength_um))
        return cls(
            np.array([molecule, cold, warm, *(k.extinction for k in kinds)]),
            molecule,
            rayleigh.cos2(wavelength_um),
            np.array([k.scattering for k in kinds]).reshape(shape),
            np.array([k.asymmetry for k in kinds]).reshape(shape),
        )

    def scattering(self, amounts: FloatArray, cosine: float) -> FloatArray:
        """Return scattering towards the observer [1/m/sr]; amounts of shape (segments, constituents)."""
        molecules = rayleigh.phase_function_per_sr(cosine, self.cos2) * self.air
        g = self.asymmetry
        particles = self.particles * (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * cosine) ** 1.5)
        return amounts[:, :1] * molecules + amounts[:, 3:] @ particles


def _shell_means(air: Air) -> FloatArray:
    """Return mean amounts of the constituents per metre in every shell, shape (shells, constituents)."""
    share = ozone.warm_share(air.state.temperature_k)
    o3 = air.state.number_density_o3
    columns = np.array([air.state.number_density_air, o3 * (1 - share), o3 * share, *air.aerosol.extinction_550_per_m])
    z = air.altitude_m
    below = np.concatenate(
        [np.zeros((len(columns), 1)), np.cumsum((columns[:, 1:] + columns[:, :-1]) / 2 * np.diff(z), axis=1)], axis=1
    )
    at_edges = np.array([np.interp(_EDGES_M, z, column) for column in below])
    return (np.diff(at_edges, axis=1) / np.diff(_EDGES_M)).T


@dataclass(frozen=True)
class _Ray:
    """A ray divided into segments of one shell each, ordered from the observer.

    ``amounts``: shape (segments, constituents), per metre; ``length_m``: shape (segments,); ``to_sun``: shape
    (segments, constituents), columns from the middle of each segment towards the Sun; ``cosine``: of the scattering
    angle; ``ground``, ``ground_to_sun``: albedo / pi times the cosine of the Sun's zenith angle (0 at the limb), and
    the columns from there.
    """

    amounts: FloatArray
    length_m: FloatArray
    to_sun: FloatArray
    cosine: float
    ground: float
    ground_to_sun: FloatArray

    def radiance(self, spectra: _Spectra) -> FloatArray:
        """Return the radiance per unit of sunlight at every wavelength [1/sr]."""
        extinction = self.amounts @ spectra.extinction
        depth = extinction * self.length_m[:, None]
        before = np.cumsum(depth, axis=0) - depth
        toward = np.exp(-before - self.to_sun @ spectra.extinction)
        source = spectra.scattering(self.amounts, self.cosine) / extinction
        total = np.einsum("sw,sw,sw->w", source, toward, -np.expm1(-depth))
        if self.ground:
            total = total + self.ground * np.exp(-depth.sum(axis=0) - self.ground_to_sun @ spectra.extinction)
        return np.asarray(total)


def _rays(shells: FloatArray, albedo: float) -> Iterator[_Ray]:
    radii = _RADIUS_M + _EDGES_M
    ground_radius = radii[:1]
    for sun_deg in _SUN_ZENITH_DEG:
        mu = np.cos(np.radians(sun_deg))
        nothing = np.zeros(shells.shape[1])
        for tangent in _RADIUS_M + _TANGENT_M:
            reach = np.sqrt(np.maximum(radii**2 - tangent**2, 0.0))[radii >= tangent]
            middle = (reach[1:] + reach[:-1]) / 2
            r = np.hypot(tangent, middle)
            used = shells[len(shells) - len(middle) :]
            to_sun = _columns_to_sun(shells, r, mu * tangent / r)
            # The far half is the mirror image of the near one: the Sun is at right angles.
            yield _Ray(
                np.concatenate([used[::-1], used]),
                np.concatenate([np.diff(reach)[::-1], np.diff(reach)]),
                np.concatenate([to_sun[::-1], to_sun]),
                0.0,
                0.0,
                nothing,
            )
        for view_deg in _VIEW_ZENITH_DEG:
            view = np.cos(np.radians(view_deg))
            reach = -_RADIUS_M * view + np.sqrt(radii**2 - _RADIUS_M**2 * (1 - view**2))
            middle = (reach[1:] + reach[:-1]) / 2
            r = np.sqrt(_RADIUS_M**2 + middle**2 + 2 * _RADIUS_M * view * middle)
            to_sun = _columns_to_sun(shells, r, mu * (_RADIUS_M + middle * view) / r)
            at_ground = _columns_to_sun(shells, ground_radius, np.array([mu]))[0]
            yield _Ray(shells[::-1], np.diff(reach)[::-1], to_sun[::-1], -view * mu, albedo / np.pi * mu, at_ground)


def _columns_to_sun(shells: FloatArray, r: FloatArray, mu: FloatArray) -> FloatArray:
    """Return the columns from points at radius r along rays of zenith cosine mu >= 0, shape (points, constituents)."""
    radii = np.maximum(_RADIUS_M + _EDGES_M, r[:, None])
    impact2 = (r**2 * (1 - mu**2))[:, None]
    return np.diff(np.sqrt(np.maximum(radii**2 - impact2, 0.0)), axis=1) @ shells
