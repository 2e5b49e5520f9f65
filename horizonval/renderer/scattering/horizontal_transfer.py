r"""How far light from the ground spreads sideways before the air scatters it: a transfer function over the ground.

Over a ground of reflected flux ``F(x)`` the mean radiance at height z is a convolution of F. For a wave of F with
horizontal wave number k (in a plane-parallel column, scattering isotropic) it obeys, as an amplitude,

    J_k(z) = D_k(z) + sum over z' of s(z') dz' G_k(z, z') J_k(z')
    D_k(z)     = int_0^1 exp(-tau(0, z) / mu) J0(k z sqrt(1 - mu^2) / mu) dmu           straight from the ground
    G_k(z, z') = 1/2 int_0^1 exp(-tau(z, z') / mu) J0(k |z - z'| sqrt(1 - mu^2) / mu) dmu / mu     scattered at z'

with J0 Bessel's function: without air, D is ``exp(-k z)``, the Fourier transform of the solid angle that an element of
ground fills, ``z / (2 pi (x^2 + z^2)^(3/2))``. What is wanted is the ratio to k = 0, ``H_k(z) = J_k(z) / J_0(z)``,
by which the waves of a map of the ground are weakened. The skylight that comes back to the ground is the sum of
``s dz J_k D_k / 2``; its ratio to k = 0 is the other function.

Nothing in here is tuned. Forward scattering of particles counts as none: ``s = molecules + (1 - g) particles``. Light
flatter than the Earth's horizon is left out of D.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import j0

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import SpectralNode

LEVELS_M = (700.0, 2000.0, 5000.0, 12_000.0, 30_000.0)
"""Heights at which the light is wanted; between them it is linear in the logarithm of the height."""
WAVE_NUMBERS_PER_M = np.concatenate([[0.0], np.geomspace(1e-6, 5e-4, 18)])
_EDGES_M = np.concatenate([[0.0], np.geomspace(400.0, 60e3, 22)])
_COSINES = 48
_FLATTEST = 0.004
_EARTH_M = 6.371e6


@dataclass(frozen=True)
class HorizontalTransfer:
    """Transfer functions at :data:`WAVE_NUMBERS_PER_M` of a column: ``air`` at the levels, shape (levels, k); ``sky``.

    Both are 1 at wave number 0.
    """

    air: FloatArray
    sky: FloatArray

    @classmethod
    def of(cls, node: SpectralNode, altitude_m: FloatArray) -> HorizontalTransfer:
        """Solve the equation of the module text for a column."""
        z, mu, weight = _heights(), *_cosines()
        width = np.diff(_EDGES_M)
        sideways = node.scattering_per_m - node.particle_per_m * np.clip(node.asymmetry, 0.0, 1.0)
        # a forward peak may be out of the extinction, but not of the scattering
        peak = node.forward_per_m if len(node.forward_per_m) else 0.0
        absorption = np.maximum(node.extinction_per_m - node.scattering_per_m + peak, 0.0)
        scattering = np.interp(z, altitude_m, sideways, right=0.0)
        fine = np.linspace(0.0, _EDGES_M[-1], 1201)
        k = np.interp(fine, altitude_m, absorption + sideways, right=0.0)
        depth = np.concatenate([[0.0], np.cumsum(0.5 * (k[1:] + k[:-1]) * np.diff(fine))])
        tau, tau_edge = np.interp(z, fine, depth), np.interp(_EDGES_M, fine, depth)
        levels = np.array(LEVELS_M)
        tau_level = np.interp(levels, fine, depth)

        def direct(height: FloatArray, depth: FloatArray) -> FloatArray:
            seen = mu > np.sqrt(height / (2.0 * _EARTH_M))[:, None]
            through = np.exp(-depth[:, None] / mu) * weight * mu * seen
            return np.einsum("im,imk->ik", through, _waves(height, np.zeros(1))[:, 0])

        def scattered(height: FloatArray, depth: FloatArray) -> FloatArray:
            through = 0.5 * np.exp(-np.abs(depth[:, None] - tau)[..., None] / mu) * weight
            return np.einsum("ijm,ijmk->ijk", through, _waves(height, z)) * (scattering * width)[:, None]

        ground = direct(z, tau)
        between = scattered(z, tau)
        # within a layer: the chance that isotropic light of it meets it again, shared as its scattering is
        own = np.diff(tau_edge)
        meets = 1.0 - (0.5 - _e3(own)) / np.maximum(own, 1e-12)
        meets = np.where(own > 1e-6, meets, 0.0) * scattering * width / np.maximum(own, 1e-12)
        same = np.arange(len(z))
        between[same, same] = meets[:, None]
        system = np.eye(len(z)) - between.transpose(2, 0, 1)
        inside = np.linalg.solve(system, ground.T[..., None])[..., 0].T
        at_levels = direct(levels, tau_level) + np.einsum("ijk,jk->ik", scattered(levels, tau_level), inside)
        sky = np.einsum("i,ik,ik->k", scattering * width, inside, ground)
        sky_scale = sky[0] if sky[0] > 0.0 else 1.0
        return cls(at_levels / at_levels[:, :1], sky / sky_scale)


def _heights() -> FloatArray:
    return np.asarray(0.5 * (_EDGES_M[1:] + _EDGES_M[:-1]))


@cache
def _cosines() -> tuple[FloatArray, FloatArray]:
    """Return cosines and their weights in ``d ln mu``."""
    x, w = np.polynomial.legendre.leggauss(_COSINES)
    reach = -np.log(_FLATTEST)
    return np.exp(-0.5 * reach * (1.0 - x)), 0.5 * reach * w


def _waves(height: FloatArray, other: FloatArray) -> FloatArray:
    """Return J0 of the module text, shape (heights, others, cosines, wave numbers)."""
    return _waves_between(tuple(height.tolist()), tuple(other.tolist()))


@cache
def _waves_between(height: tuple[float, ...], other: tuple[float, ...]) -> FloatArray:
    mu = _cosines()[0]
    slope = np.sqrt(1.0 - mu**2) / mu
    apart = np.abs(np.array(height)[:, None] - np.array(other))
    waves = j0(apart[..., None, None] * slope[:, None] * WAVE_NUMBERS_PER_M)
    waves.setflags(write=False)
    return waves


def _e3(x: FloatArray) -> FloatArray:
    """Return the exponential integral of third order."""
    mu, w = _cosines()
    return np.asarray(np.sum(w * mu**2 * np.exp(-x[..., None] / mu), axis=-1))
