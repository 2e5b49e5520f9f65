"""What is known before the image is looked at: values, each with the standard deviation of its error.

A value ``m`` of a quantity ``x`` that is known to ``sigma`` is one more row of a fit's normal equations, beside those
of the pixels: ``(x - m) / sigma``, of unit variance. Nothing here is the truth: an estimator may lean on a value as far
as its sigma lets it.

The error of an attitude is a turn about the body's own axes, x (roll), y (pitch), z (yaw): with the true quaternion
``q``, ``q_body_from_itrs = exp(error) q``, so that a fit's row is ``log(q_prior q_fit^-1) / sigma`` by components.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.ellipsoid import WGS84

MEAN_RADIUS_M = 6371008.8
"""(2 a + b) / 3 of WGS84, the radius of the sphere that a method assumes which is given no other."""

UNIT_TOLERANCE = 1e-3
"""Tolerance of a quaternion's length, for components of four digits; it is scaled to 1."""

ROUNDING = 1e-12
"""Departure from unit length that is not rescaled, so that a prior rebuilt from its values keeps their bits."""

BY_LATITUDE_MONTH = "by_latitude_month"

FILE_KEYS: tuple[tuple[str, str, float | None], ...] = (
    ("shape", "shape", None),
    ("radius_km", "radius_m", 1e3),
    ("altitude_km", "altitude_m", 1e3),
    ("altitude_sigma_km", "altitude_sigma_m", 1e3),
    ("position_itrs_km", "r_itrs", 1e3),
    ("position_sigma_km", "position_sigma_m", 1e3),
    ("q_cam_from_itrs", "q_cam_from_itrs", 1.0),
    ("attitude_sigma_deg", "attitude_sigma_rad", math.pi / 180.0),
    ("epoch_utc", "epoch_utc", None),
    ("limb_height_km", "limb_height_m", 1e3),
    ("limb_height_sigma_km", "limb_height_sigma_m", 1e3),
    ("climate", "climate", None),
    ("sun_sigma_deg", "sun_sigma_rad", math.pi / 180.0),
)
"""Key of a table ``[prior]``, its name here, and what turns a number of the key into SI; None for what is no number."""

_PAIRS = {
    "altitude_m": "altitude_sigma_m",
    "r_itrs": "position_sigma_m",
    "q_cam_from_itrs": "attitude_sigma_rad",
    "limb_height_m": "limb_height_sigma_m",
}
"""A value, and the standard deviation that it cannot be without."""

_NUMBERS = (
    "radius_m",
    "altitude_m",
    "altitude_sigma_m",
    "position_sigma_m",
    "limb_height_m",
    "limb_height_sigma_m",
    "sun_sigma_rad",
)
"""All above 0 but the limb's height, which may have either sign over a sphere in place of the ellipsoid."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What a flight computer knows beside the image and the camera. All of it can be missing.

    Raises ``UserError``: a value without its sigma or the other way round, a sigma that is not above 0, a vector of
    another shape, a position inside the planet, a quaternion that is not of length 1, a radius for anything but a
    sphere.

    Attributes
    ----------
    shape : {"wgs84", "sphere"} or None
        Of the planet; exact. None leaves it to the method: the published ones fit a sphere and count the Earth's
        flattening as an error of theirs.
    radius_m : float or None
        Radius of the sphere; the Earth's mean radius without it.
    altitude_m, altitude_sigma_m : float or None
        Height above the shape, of an ellipsoid the geodetic one.
    r_itrs : ndarray, shape (3,), or None
        Position of the camera in Earth-fixed axes [m], from the Earth's centre, whatever its shape.
    position_sigma_m : float or None
        Of every component.
    q_cam_from_itrs : ndarray, shape (4,), or None
        Attitude of the camera, scalar last.
    attitude_sigma_rad : ndarray, shape (3,), or None
        Of the error as a turn about the body's x (roll), y (pitch) and z (yaw).
    epoch_utc : datetime or None
        Of the image. Exact: what a clock is off by is far below what a position is.
    limb_height_m, limb_height_sigma_m : float or None
        Mean height along the limb of the visible limb above the horizon of the shape.
    climate : str or None
        What is known of the air: the name of an atmosphere (``horizonval list atmospheres``), the path of a profile
        file (.csv, .json) or of a table of ``horizonval templates`` (.npz), or ``"by_latitude_month"`` for the climate
        of the place and the month.
    sun_sigma_rad : float or None
        Of the observation's ``sun_cam``, in each of two directions across it. None where ``sun_cam`` is that of a
        coarse Sun sensor, right to a degree.

    Examples
    --------
    >>> import horizonval as hv
    >>> prior = hv.Prior(shape="wgs84", altitude_m=550e3, altitude_sigma_m=1e3)
    >>> prior
    <Prior shape, altitude>
    >>> hv.Prior(altitude_m=550e3)
    Traceback (most recent call last):
    horizonval.core.errors.UserError: Prior: altitude_m without altitude_sigma_m; expected both or neither
    """

    shape: Literal["wgs84", "sphere"] | None = None
    radius_m: float | None = None
    altitude_m: float | None = None
    altitude_sigma_m: float | None = None
    r_itrs: FloatArray | None = None
    position_sigma_m: float | None = None
    q_cam_from_itrs: FloatArray | None = None
    attitude_sigma_rad: FloatArray | None = None
    epoch_utc: datetime | None = None
    limb_height_m: float | None = None
    limb_height_sigma_m: float | None = None
    climate: str | None = None
    sun_sigma_rad: float | None = None

    def __post_init__(self) -> None:
        for value, sigma in _PAIRS.items():
            if (getattr(self, value) is None) != (getattr(self, sigma) is None):
                given, other = (value, sigma) if getattr(self, sigma) is None else (sigma, value)
                raise UserError(f"{given} without {other}", where="Prior", expected="both or neither")
        if self.shape not in (None, "wgs84", "sphere"):
            raise UserError(f"found {self.shape!r}", where="Prior: shape", expected="'wgs84' or 'sphere'")
        if self.radius_m is not None and self.shape != "sphere":
            raise UserError(f"found {self.radius_m!r}", where="Prior: radius_m", expected="shape = 'sphere' beside it")
        for name in _NUMBERS:
            self._number(name, above_0=name != "limb_height_m")
        for name, length in (("r_itrs", 3), ("q_cam_from_itrs", 4), ("attitude_sigma_rad", 3)):
            self._vector(name, length)
        if self.r_itrs is not None:
            distance, least = float(np.linalg.norm(self.r_itrs)), self._least_radius_m
            if distance <= least:
                raise UserError(
                    f"found a place {distance / 1e3:.6g} km from the Earth's centre",
                    where="Prior: r_itrs",
                    expected=f"one outside of the planet, beyond {least / 1e3:.6g} km",
                )
        if self.attitude_sigma_rad is not None and not (self.attitude_sigma_rad > 0).all():
            raise UserError("found one of 0 or less", where="Prior: attitude_sigma_rad", expected="angles above 0")
        if self.q_cam_from_itrs is not None:
            norm = float(np.linalg.norm(self.q_cam_from_itrs))
            if abs(norm - 1.0) > UNIT_TOLERANCE:
                raise UserError(
                    f"found a length of {norm:.6g}", where="Prior: q_cam_from_itrs", expected="a unit quaternion"
                )
            if abs(norm - 1.0) > ROUNDING:
                self._keep("q_cam_from_itrs", self.q_cam_from_itrs / norm)
        if self.climate == BY_LATITUDE_MONTH and (self.r_itrs is None or self.epoch_utc is None):
            raise UserError(
                f"found {self.climate!r}", where="Prior: climate", expected="r_itrs and epoch_utc beside it"
            )
        if self.epoch_utc is not None:
            naive = self.epoch_utc.tzinfo is None
            utc = self.epoch_utc.replace(tzinfo=UTC) if naive else self.epoch_utc.astimezone(UTC)
            object.__setattr__(self, "epoch_utc", utc)

    @property
    def sphere_radius_m(self) -> float:
        """Radius of the sphere that a spherical method assumes."""
        return MEAN_RADIUS_M if self.radius_m is None else self.radius_m

    @property
    def _least_radius_m(self) -> float:
        """Distance from the centre below which a place lies inside whatever the planet is taken for."""
        return self.sphere_radius_m if self.shape == "sphere" else WGS84.b_m

    @property
    def flattening(self) -> float:
        """What a spherical method leaves out: the Earth's flattening, 0 where the planet is known for a sphere."""
        return 0.0 if self.shape == "sphere" else WGS84.flattening

    @property
    def angular_radius(self) -> tuple[float, float] | None:
        """Angular radius of the sphere from the known altitude [rad], and its variance [rad^2]; None without one.

        ``rho = asin(R / (R + h))``, so that ``d rho / d h = -tan(rho) / (R + h)``.
        """
        if self.altitude_m is None or self.altitude_sigma_m is None:
            return None
        distance = self.sphere_radius_m + self.altitude_m
        rho = math.asin(self.sphere_radius_m / distance)
        return rho, (math.tan(rho) / distance * self.altitude_sigma_m) ** 2

    @property
    def known(self) -> tuple[str, ...]:
        """What is known, in words."""
        words = {
            "shape": "shape",
            "altitude_m": "altitude",
            "r_itrs": "position",
            "q_cam_from_itrs": "attitude",
            "epoch_utc": "time",
            "limb_height_m": "limb height",
            "climate": "climate",
            "sun_sigma_rad": "Sun",
        }
        return tuple(word for name, word in words.items() if getattr(self, name) is not None)

    @property
    def in_words(self) -> str:
        """What is known, with all numbers, as one line."""
        radius_km = self.sphere_radius_m / 1e3
        parts = [
            {
                "wgs84": f"WGS84, by spherical methods a sphere of {radius_km:.4f} km",
                "sphere": f"a sphere of {radius_km:.4f} km",
                None: f"the Earth as a sphere of {radius_km:.4f} km, its flattening as an error",
            }[self.shape]
        ]
        if self.altitude_m is not None and self.altitude_sigma_m is not None:
            parts.append(f"altitude {self.altitude_m / 1e3:.3f} km to {self.altitude_sigma_m / 1e3:g} km")
        if self.r_itrs is not None and self.position_sigma_m is not None:
            place = " ".join(f"{x:.3f}" for x in self.r_itrs / 1e3)
            parts.append(f"position {place} km to {self.position_sigma_m / 1e3:g} km")
        if self.q_cam_from_itrs is not None and self.attitude_sigma_rad is not None:
            sigmas = " ".join(f"{x:g}" for x in np.degrees(self.attitude_sigma_rad))
            parts.append(f"attitude to {sigmas} deg (roll, pitch, yaw)")
        if self.epoch_utc is not None:
            parts.append(f"time {self.epoch_utc:%Y-%m-%d %H:%M:%S} UTC")
        if self.limb_height_m is not None and self.limb_height_sigma_m is not None:
            parts.append(f"limb at {self.limb_height_m / 1e3:.3f} km to {self.limb_height_sigma_m / 1e3:g} km")
        if self.climate is not None:
            parts.append(f"air {self.climate}")
        if self.sun_sigma_rad is not None:
            parts.append(f"Sun to {math.degrees(self.sun_sigma_rad):g} deg")
        return "; ".join(parts)

    def __repr__(self) -> str:
        return f"<Prior {', '.join(self.known) or 'of nothing'}>"

    def _number(self, name: str, *, above_0: bool) -> None:
        value = getattr(self, name)
        if value is None:
            return
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise UserError(f"found {value!r}", where=f"Prior: {name}", expected="a finite number")
        if above_0 and value <= 0:
            raise UserError(f"found {value!r}", where=f"Prior: {name}", expected="a number above 0")
        object.__setattr__(self, name, float(value))

    def _vector(self, name: str, length: int) -> None:
        value: FloatArray | Sequence[float] | None = getattr(self, name)
        if value is None:
            return
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != (length,) or not np.isfinite(array).all():
            raise UserError(f"found {value!r}", where=f"Prior: {name}", expected=f"{length} finite numbers")
        self._keep(name, array)

    def _keep(self, name: str, array: FloatArray) -> None:
        array.flags.writeable = False
        object.__setattr__(self, name, array)
