"""What is known before the image is looked at: values, each with the standard deviation of its error.

A value ``m`` of a quantity ``x`` that is known to ``sigma`` is one more row of a fit's normal equations, beside those
of the pixels: ``(x - m) / sigma``, of unit variance. Nothing here is the truth: an estimator may lean on a value as far
as its sigma lets it.

The error of an attitude is a turn about the body's own axes, x (roll), y (pitch), z (yaw): with the true quaternion
``q``, ``q_body_from_itrs = exp(error) q``, so that a fit's row is ``log(q_prior q_fit^-1) / sigma`` by components. A
rough direction of the nadir is an attitude whose turn about the nadir is unknown.

Assumptions about air, lens and detector are fields with defaults: a method reads them here and has none of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.ellipsoid import WGS84

MEAN_RADIUS_M = 6371008.8
"""(2 a + b) / 3 of WGS84, the radius of the sphere that a method assumes which is given no other."""


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
    ("nadir_cam", "nadir_cam", 1.0),
    ("limb_scale_height_km", "limb_scale_height_m", 1e3),
    ("limb_scale_height_sigma_km", "limb_scale_height_sigma_m", 1e3),
    ("limb_relief_km", "limb_relief_m", 1e3),
    ("air_height_sigma_km", "air_height_sigma_m", 1e3),
    ("lens_blur_px", "lens_blur_px", 1.0),
    ("gain_sigma_percent", "gain_sigma", 1e-2),
    ("accept_deg", "accept_rad", math.pi / 180.0),
)
"""Key of a table ``[prior]``, its name here, and what turns a number of the key into SI; None for what is no number."""

_PAIRS = {
    "altitude_m": "altitude_sigma_m",
    "r_itrs": "position_sigma_m",
    "q_cam_from_itrs": "attitude_sigma_rad",
    "limb_height_m": "limb_height_sigma_m",
}
"""A value, and the standard deviation that it cannot be without. A rough nadir may take the attitude's place."""

_FROM_0 = ("limb_scale_height_m", "limb_scale_height_sigma_m", "limb_relief_m")
"""Numbers that may be 0. Those of the file's other keys are above 0, but the limb's height: of a sphere in place of the
ellipsoid the limb may lie below."""
_VECTORS = {"r_itrs": 3, "q_cam_from_itrs": 4, "attitude_sigma_rad": 3, "nadir_cam": 3}

GAIN_SIGMA = {"thermal": 0.02, "solar": 0.05}
"""Relative standard deviation of a calibrated detector's gain and lens transmission, where ``gain_sigma`` is None:
thermal detectors are calibrated by a black body before the lens, visible ones by integrating spheres."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What a flight computer knows beside the image and the camera. All of it can be missing.

    Raises ``UserError``: a value without its sigma or the other way round, a sigma that is not above 0, a vector of
    another shape, a position inside the planet, a quaternion that is not of length 1, a rough nadir in addition to an
    attitude, a radius for anything but a sphere.

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
    nadir_cam : ndarray, shape (3,), or None
        Rough direction of the nadir in camera axes, of any length, in place of ``q_cam_from_itrs``: right to
        ``attitude_sigma_rad`` across it.
    limb_scale_height_m, limb_scale_height_sigma_m : float
        Scale height with which the limb's radiance falls outwards. By default that of the air's density from the ground
        to 60 km (6 to 8.5 km), with a sigma that covers a bare planet as well as haze and ozone. Both 0: a hard limb.
    limb_relief_m : float or None
        Standard deviation of the limb's height along itself. None for that of the band in any weather. 0: a sphere
        without relief.
    air_height_sigma_m : float
        Of the common height of the air whose profiles a method knows: 10 hPa of sea-level pressure is 80 m, the geoid
        30 m.
    lens_blur_px : float
        Standard deviation of the lens's blur that fits start from.
    gain_sigma : float or None
        Relative standard deviation of the calibration from digital numbers to radiance. None for :data:`GAIN_SIGMA`.
    accept_rad : float
        Standard deviation of the nadir up to which an answer is of use. Guarded methods refuse a less certain one.

    Examples
    --------
    >>> import horizonval as hv
    >>> prior = hv.Prior(shape="wgs84", altitude_m=550e3, altitude_sigma_m=1e3)
    >>> prior
    <Prior shape, altitude_m>
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
    nadir_cam: FloatArray | None = None
    limb_scale_height_m: float = 7e3
    limb_scale_height_sigma_m: float = 4e3
    limb_relief_m: float | None = None
    air_height_sigma_m: float = 300.0
    lens_blur_px: float = 0.7
    gain_sigma: float | None = None
    accept_rad: float = math.radians(0.2)

    def __post_init__(self) -> None:
        if self.nadir_cam is not None and self.q_cam_from_itrs is not None:
            raise UserError("nadir_cam beside q_cam_from_itrs", where="Prior", expected="one of the two")
        for value, sigma in _PAIRS.items():
            if value == "q_cam_from_itrs" and self.nadir_cam is not None:
                value = "nadir_cam"
            if (getattr(self, value) is None) != (getattr(self, sigma) is None):
                given, other = (value, sigma) if getattr(self, sigma) is None else (sigma, value)
                raise UserError(f"{given} without {other}", where="Prior", expected="both or neither")
        if self.shape not in (None, "wgs84", "sphere"):
            raise _found(repr(self.shape), "shape", "'wgs84' or 'sphere'")
        if self.radius_m is not None and self.shape != "sphere":
            raise _found(repr(self.radius_m), "radius_m", "shape = 'sphere' beside it")
        for _, name, unit in FILE_KEYS:
            if name in _VECTORS:
                self._vector(name, _VECTORS[name])
            elif unit is not None:
                self._number(name)
        for name in ("nadir_cam", "q_cam_from_itrs"):
            self._scale_to_unit_length(name)
        if self.r_itrs is not None:
            distance, least = float(np.linalg.norm(self.r_itrs)), self._least_radius_m
            if distance <= least:
                found = f"a place {distance / 1e3:.6g} km from the Earth's centre"
                raise _found(found, "r_itrs", f"one outside of the planet, beyond {least / 1e3:.6g} km")
        if self.attitude_sigma_rad is not None and not (self.attitude_sigma_rad > 0).all():
            raise _found("one of 0 or less", "attitude_sigma_rad", "angles above 0")
        if self.climate == BY_LATITUDE_MONTH and (self.r_itrs is None or self.epoch_utc is None):
            raise _found(repr(self.climate), "climate", "r_itrs and epoch_utc beside it")
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
    def rough_nadir(self) -> tuple[FloatArray, float] | None:
        """Direction of the nadir in camera axes, shape (3,), and its largest standard deviation [rad]; None without.

        From ``nadir_cam``, or from attitude and position together.
        """
        if self.attitude_sigma_rad is None:
            return None
        sigma = float(self.attitude_sigma_rad.max())
        if self.nadir_cam is not None:
            return self.nadir_cam, sigma
        if self.q_cam_from_itrs is None or self.r_itrs is None or self.position_sigma_m is None:
            return None
        distance = float(np.linalg.norm(self.r_itrs))
        x, y, z, w = self.q_cam_from_itrs
        axis, down = np.array([x, y, z]), -self.r_itrs / distance
        across = 2.0 * np.cross(axis, down)
        return down + w * across + np.cross(axis, across), math.hypot(sigma, self.position_sigma_m / distance)

    @property
    def in_words(self) -> str:
        """What is known, as one line: the planet's shape, and the keys of a prior file with their values."""
        radius_km = self.sphere_radius_m / 1e3
        parts = [
            {
                "wgs84": f"WGS84, by spherical methods a sphere of {radius_km:.4f} km",
                "sphere": f"a sphere of {radius_km:.4f} km",
                None: f"the Earth as a sphere of {radius_km:.4f} km, its flattening as an error",
            }[self.shape]
        ]
        for key, name, unit in FILE_KEYS[2:]:
            value = getattr(self, name)
            if name in self._stated:
                parts.append(f"{key} {value if unit is None else _rounded(np.atleast_1d(value) / unit)}")
        return "; ".join(parts)

    def __repr__(self) -> str:
        return f"<Prior {', '.join(self.known) or 'of nothing'}>"

    @property
    def known(self) -> tuple[str, ...]:
        """Names of what is known, without the standard deviations."""
        return tuple(name for name in self._stated if name not in _PAIRS.values())

    @property
    def _stated(self) -> tuple[str, ...]:
        """Names of the fields that differ from their defaults."""
        values = {name: getattr(self, name) for name in DEFAULTS}
        return tuple(name for name, value in values.items() if value is not None and np.any(value != DEFAULTS[name]))

    def _number(self, name: str) -> None:
        value = getattr(self, name)
        if value is None and DEFAULTS[name] is None:
            return
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise _found(repr(value), name, "a finite number")
        if name in _FROM_0 and value < 0.0:
            raise _found(repr(value), name, "a number of 0 or more")
        if name not in (*_FROM_0, "limb_height_m") and value <= 0.0:
            raise _found(repr(value), name, "a number above 0")
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
            raise _found(repr(value), name, f"{length} finite numbers")
        self._keep(name, array)

    def _scale_to_unit_length(self, name: str) -> None:
        value: FloatArray | None = getattr(self, name)
        if value is None:
            return
        norm = float(np.linalg.norm(value))
        # Components of four digits are a unit quaternion; a rough nadir has any length.
        if name == "q_cam_from_itrs" and abs(norm - 1.0) > 1e-3:
            raise _found(f"a length of {norm:.6g}", name, "a unit quaternion")
        if norm == 0.0:
            raise _found("no direction", name, "a vector other than 0")
        # Rounding is left, so that a prior that is rebuilt from its values keeps their bits.
        if abs(norm - 1.0) > 1e-12:
            self._keep(name, value / norm)

    def _keep(self, name: str, array: FloatArray) -> None:
        array.flags.writeable = False
        object.__setattr__(self, name, array)


def _rounded(values: FloatArray) -> str:
    return " ".join(f"{value:.7g}" for value in values)


def _found(found: str, field: str, expected: str) -> UserError:
    return UserError(f"found {found}", where=f"Prior: {field}", expected=expected)


DEFAULTS = {field.name: field.default for field in fields(Prior)}
"""Default of every field: None for what is not known, a number for an assumption."""
