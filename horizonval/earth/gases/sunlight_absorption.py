"""Oxygen and water vapour in sunlight: a band's energy divided into an unabsorbed part and a few absorbing parts.

SPCTRAL2 (Bird and Riordan 1986, J. Climate Appl. Meteor. 25, 87) gives the transmission of sunlight through the air
after Leckner (1978), with coefficients every few nanometres: for a relative air mass M and precipitable water W [cm]

    T_mixed = exp(-1.41 a_u M / (1 + 118.3 a_u M)^0.45),    T_water = exp(-0.2385 a_w W M / (1 + 20.07 a_w W M)^0.45)

Each is one function of ``x = a M``, which is fitted by a sum of exponentials of x (non-negative least squares): every
wavelength is a mixture of classes with coefficients proportional to a. The classes of all wavelengths of a band are
combined into at most four: oxygen's and water's, each of depths below and above 1 along :data:`REFERENCE`, or fewer
where that leaves less than 0.6 % of the band's energy. They become separate nodes with the coefficient that preserves
their transmission along that path; the rest, of depths below 0.05, stays with the band's other nodes. A band that loses
less than 3 % along that path keeps its nodes without gases (445 to 755 nm: 2 %).

Along slant paths and at the limb lines are broader where the pressure is higher (Curtis and Godson in the limit of
strong lines): columns are weighted with p / p0, for water with p / (0.79 p0), its mean. A vertical path is SPCTRAL2's.
From air mass 1 to 5 the parts reproduce SPCTRAL2's transmission of 700 to 800 and 750 to 950 nm to 1.3 %, and SPCTRAL2
that of the direct spectrum of ASTM G173 to 0.5 %. Single features are uncertain by a third of the loss. The limb has
not been compared: above 30 km the true absorption is larger.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import nnls

from horizonval.core.arrays import FloatArray
from horizonval.earth.tables import csv

MIN_UM, MAX_UM = 0.57, 1.65
REFERENCE = (2.0, 3.0)
"""Air mass and precipitable water [cm] of the path on which every part's transmission is exact: down and up."""
_MIXED, _WATER = (1.41, 118.3), (0.2385, 20.07)
_POWER = 0.45
_WEAK, _STRONG = 0.05, 1.0
_LEAST_SHARE = 0.004
_PATHS, _ERROR = ((1.0, 1.5), (2.0, 3.0), (4.0, 6.0), (10.0, 1.0)), 0.006
"""Paths along which a band's transmission must be right, and how well, for fewer parts than four to suffice."""
_LEAST_LOSS = 0.03
"""Loss of a band's energy along the reference path that is neglected. Cameras of 445 to 755 nm (2.3 %) thus keep four
nodes, as many as one launch of the renderer's kernel takes."""
_STANDARD_PA, _GRAVITY, _AVOGADRO = 101_325.0, 9.80665, 6.02214076e23
_AIR_KG, _WATER_KG = 28.9644e-3 / _AVOGADRO, 18.0153e-3 / _AVOGADRO
_WATER_PRESSURE = 0.79


@dataclass(frozen=True)
class AbsorbingPart:
    """A part of a band's energy whose absorption is exponential.

    ``energy`` (m,): of the band's samples; the parts of a band add up to all of it. ``mixed``: coefficient per air
    mass. ``water``: per cm of precipitable water.
    """

    energy: FloatArray
    mixed: float
    water: float


def parts(wavelength_um: FloatArray, energy: FloatArray) -> tuple[AbsorbingPart, ...]:
    """Return the parts of a band's measure, the unabsorbed first; none where the band hardly absorbs."""
    table_um, water, mixed = csv("gases_in_sunlight.csv")
    inside = (wavelength_um >= MIN_UM) & (wavelength_um <= MAX_UM)
    a_water, a_mixed = (np.interp(wavelength_um, table_um, a) * inside for a in (water, mixed))
    if not (energy * (a_water + a_mixed)).any():
        return ()
    (u_share, u_each), (w_share, w_each) = _exponentials(*_MIXED), _exponentials(*_WATER)
    # Axes: sample, class of the mixed gases, class of water.
    weight = energy[:, None, None] * u_share[:, None] * w_share
    k_mixed = np.broadcast_to((a_mixed[:, None] * u_each)[:, :, None], weight.shape)
    k_water = np.broadcast_to((a_water[:, None] * w_each)[:, None, :], weight.shape)
    of_mixed, of_water = k_mixed * REFERENCE[0], k_water * REFERENCE[1]
    depth, total = of_mixed + of_water, energy.sum()
    if 1.0 - (weight * np.exp(-depth)).sum() / total < _LEAST_LOSS:
        return ()
    mine, strong = of_mixed > of_water, depth >= _STRONG
    for groups in (
        (np.ones_like(mine),),
        (strong, ~strong),
        (mine, ~mine),
        (mine & strong, mine & ~strong, ~mine & strong, ~mine & ~strong),
    ):
        left = weight.copy()
        found = []
        for group in groups:
            absorbing = np.where(group & (depth >= _WEAK), weight, 0.0)
            if absorbing.sum() >= _LEAST_SHARE * total:
                found.append(_part(absorbing, k_mixed, k_water))
                left -= absorbing
        split = (_part(left, k_mixed, k_water), *found)
        error = [
            (weight * np.exp(-k_mixed * m - k_water * w)).sum()
            - sum(part.energy.sum() * np.exp(-part.mixed * m - part.water * w) for part in split)
            for m, w in _PATHS
        ]
        if np.abs(error).max() < _ERROR * total:
            break
    return split


def _part(weight: FloatArray, k_mixed: FloatArray, k_water: FloatArray) -> AbsorbingPart:
    coefficients = []
    for k, path in zip((k_mixed, k_water), REFERENCE, strict=True):
        coefficients.append(-np.log((weight * np.exp(-k * path)).sum() / weight.sum()) / path)
    return AbsorbingPart(weight.sum(axis=(1, 2)), float(coefficients[0]), float(coefficients[1]))


@cache
def _exponentials(linear: float, saturation: float) -> tuple[FloatArray, FloatArray]:
    """Return weights (sum 1) and coefficients of ``exp(-c x / (1 + d x)^0.45)`` for x from 1e-4 to 1e4 / c."""
    x = np.geomspace(1e-4, 1e4, 161) / linear
    each = linear * np.geomspace(1e-4, 1e3, 15)
    value = np.exp(-linear * x / (1.0 + saturation * x) ** _POWER)
    rows = np.exp(-np.outer(x, each))
    weight, _ = nnls(np.vstack([rows, 10.0 * np.ones(len(each))]), np.append(value, 10.0), maxiter=1000)
    used = weight > 0
    return weight[used] / weight.sum(), each[used]


def air_mass_per_m(pressure_pa: FloatArray, number_density_air: FloatArray) -> FloatArray:
    """Return the relative air mass in a metre, weighted with the pressure: 1 for a column of 1013.25 hPa."""
    return np.asarray(2.0 * _AIR_KG * _GRAVITY * number_density_air * pressure_pa / _STANDARD_PA**2)


def water_cm_per_m(pressure_pa: FloatArray, number_density_h2o: FloatArray) -> FloatArray:
    """Return precipitable water [cm] in a metre, weighted with the pressure relative to its mean for water."""
    return np.asarray(0.1 * _WATER_KG * number_density_h2o * pressure_pa / (_WATER_PRESSURE * _STANDARD_PA))
