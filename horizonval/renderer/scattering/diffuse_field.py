"""The diffuse field of a column of air: moments of the sky at every height and Sun angle."""

from __future__ import annotations

from dataclasses import dataclass

from horizonval.core.arrays import FloatArray

SMALLEST = 1e-30
"""Light below it counts as none: everything is interpolated as a logarithm."""


@dataclass(frozen=True)
class DiffuseField:
    """Moments of diffuse light on heights ``top x^2`` and the angles of ``sun_angles``, per unit solar irradiance.

    Attributes
    ----------
    top_m, planet_m : float
    degree : int
    moments : ndarray, shape (n_height, n_sun, n_harmonics)
        ``I_lm`` in the order of :func:`harmonics.pairs`.
    irradiance : ndarray, shape (n_sun,)
        Diffuse irradiance on the ground.
    heights : ndarray, shape (n_height,), or None
        Where they are not those.
    """

    top_m: float
    planet_m: float
    degree: int
    moments: FloatArray
    irradiance: FloatArray
    heights: FloatArray | None = None


@dataclass(frozen=True)
class MultipleScattering:
    """What :func:`solve` returns: the air alone, one reflection at a ground of albedo 1, and the air's albedo s."""

    air: DiffuseField
    bounce: DiffuseField
    spherical_albedo: float

    def over_ground(self, albedo: float) -> DiffuseField:
        """Return the field over a Lambert ground."""
        factor = albedo / (1.0 - albedo * self.spherical_albedo)
        return DiffuseField(
            self.air.top_m,
            self.air.planet_m,
            self.air.degree,
            self.air.moments + factor * self.bounce.moments,
            self.air.irradiance + factor * self.bounce.irradiance,
            self.air.heights,
        )
