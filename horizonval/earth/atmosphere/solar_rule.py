"""Gauss's rule of a solar band: its wavelengths and weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.gases import ozone, sunlight_absorption
from horizonval.earth.spectral import bands, sunlight
from horizonval.earth.spectral.quadrature import Orthonormal
from horizonval.spec.camera import Band


@dataclass(frozen=True)
class Measure:
    """The measure ``R(lambda) (lambda / lambda_ref) E_sun(lambda)`` of a band, sampled finely.

    ``wavelength_um``, ``energy``: shape (m,), W m-2 at 1 au, whose sum is the band's irradiance; ``width_um``:
    effective width, the integral of the response; ``reference_um``: ``lambda_ref``.
    """

    wavelength_um: FloatArray
    energy: FloatArray
    width_um: float
    reference_um: float

    def ozone(self) -> tuple[FloatArray, FloatArray]:
        """Return ozone's cross sections at 220 and 280 K [m2], shape (m,) each; 0 beyond their range to the red."""
        known = self.wavelength_um <= ozone.MAX_UM
        samples = np.zeros((2, len(self.wavelength_um)))
        samples[:, known] = ozone.cold_and_warm_m2(self.wavelength_um[known])
        return samples[0], samples[1]


@dataclass(frozen=True)
class SolarRule:
    """Gauss's rule of a measure.

    Attributes
    ----------
    wavelength_um, weight_um : ndarray, shape (n,)
        Nodes, and their weights, which add up to the band's effective width.
    mean_irradiance : float
        Irradiance of every node at 1 au, W m-2 um-1.
    energy_ratio : ndarray, shape (n,)
        Smoothed ``lambda_ref / lambda`` at the nodes. It turns the weights into those of the plain integral over
        wavelength, exact for reflectances that are polynomials of degree n - 1 in wavelength.
    ozone_cold_m2, ozone_warm_m2 : ndarray, shape (n,)
        Smoothed cross sections of ozone at 220 and 280 K; 0 without ozone.
    mixed_gases, water_vapour : ndarray, shape (n,)
        Absorption per air mass and per cm of precipitable water; 0 without gases in sunlight.
    """

    wavelength_um: FloatArray
    weight_um: FloatArray
    mean_irradiance: float
    energy_ratio: FloatArray
    ozone_cold_m2: FloatArray
    ozone_warm_m2: FloatArray
    mixed_gases: FloatArray
    water_vapour: FloatArray


class RuleFamily:
    """Gauss's rules of 1 to ``n_max`` nodes for one measure.

    ``n_max`` must be well below the number of samples. Without ``with_ozone`` the nodes' cross sections of ozone are 0,
    and the measure may reach below 280 nm.
    """

    def __init__(self, measure: Measure, n_max: int, *, with_ozone: bool = False) -> None:
        self._measure = measure
        self._polynomials = Orthonormal.of(measure.wavelength_um, measure.energy, n_max)
        self._ratio = self._polynomials.moments(measure.reference_um / measure.wavelength_um)
        self._ozone = [self._polynomials.moments(samples) for samples in measure.ozone()] if with_ozone else None

    def rule(self, n: int) -> SolarRule:
        """Return the rule of n nodes."""
        nodes, energy = self._polynomials.rule(n)
        mean = float(energy.sum() / self._measure.width_um)
        cold = warm = np.zeros(n)
        if self._ozone is not None:
            cold, warm = (self._polynomials.smoothed(moments, nodes) for moments in self._ozone)
        ratio = self._polynomials.smoothed(self._ratio, nodes)
        return SolarRule(nodes, energy / mean, mean, ratio, cold, warm, np.zeros(n), np.zeros(n))


def check_sunlight(band: Band, where: str) -> None:
    """Raise ``UserError`` for a band that reaches beyond the Sun's known spectrum."""
    lo, hi = bands.limits_um(band)
    if lo < sunlight.MIN_UM or hi > sunlight.MAX_UM:
        raise UserError(
            f"band {band.name!r} spans {lo:g} to {hi:g} um",
            where=where,
            expected=f"a response within {sunlight.MIN_UM:g} to {sunlight.MAX_UM:g} um, the Sun's known spectrum",
        )


def solar_measure(band: Band, where: str) -> Measure:
    """Return a band's measure, with the Sun at 1 au; raises ``UserError`` beyond the Sun's known spectrum.

    The Sun's distance must not change any node, not even by rounding: tables of the air are cached by content.
    """
    check_sunlight(band, where)
    wavelength, weight = bands.sampled(band, sunlight.table_um(), order=4)
    reference = bands.reference_wavelength_um(band)
    weight = weight * wavelength / reference
    energy = weight * sunlight.irradiance(wavelength)
    return Measure(wavelength, energy, float(weight.sum()), reference)


def gauss(measure: Measure, n: int, *, with_ozone: bool = False) -> SolarRule:
    """Return Gauss's rule of n nodes for a measure."""
    return RuleFamily(measure, n, with_ozone=with_ozone).rule(n)


def rule_with_gases(
    measure: Measure, clear_rule: Callable[[Measure], SolarRule], *, with_ozone: bool = False
) -> SolarRule:
    """Return the rule of a band in which oxygen and water vapour absorb, or the plain one where they hardly do.

    ``clear_rule`` finds the rule of a measure. The part of the band without absorption has a rule for its own measure;
    every absorbing part of :func:`horizonval.earth.gases.sunlight_absorption.parts` is one node at its mean wavelength.
    All nodes have the band's mean irradiance.
    """
    parts = sunlight_absorption.parts(measure.wavelength_um, measure.energy)
    if not parts:
        return clear_rule(measure)
    clear = parts[0]
    rule = clear_rule(replace(measure, energy=clear.energy))
    mean = float(measure.energy.sum() / measure.width_um)
    cold, warm = measure.ozone() if with_ozone else (np.zeros_like(measure.energy),) * 2
    absorbing = [part.energy / part.energy.sum() for part in parts[1:]]
    share = np.array([part.energy.sum() / measure.energy.sum() for part in parts[1:]])

    def joined(of_rule: FloatArray, samples: FloatArray) -> FloatArray:
        return np.concatenate([of_rule, [float(each @ samples) for each in absorbing]])

    count = len(rule.wavelength_um)
    return SolarRule(
        wavelength_um=joined(rule.wavelength_um, measure.wavelength_um),
        weight_um=np.concatenate([rule.weight_um * (rule.mean_irradiance / mean), share * measure.width_um]),
        mean_irradiance=mean,
        energy_ratio=joined(rule.energy_ratio, measure.reference_um / measure.wavelength_um),
        ozone_cold_m2=joined(rule.ozone_cold_m2, cold),
        ozone_warm_m2=joined(rule.ozone_warm_m2, warm),
        mixed_gases=np.array([clear.mixed] * count + [part.mixed for part in parts[1:]]),
        water_vapour=np.array([clear.water] * count + [part.water for part in parts[1:]]),
    )
