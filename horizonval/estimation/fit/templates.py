"""Rendered profiles of the limb as a table.

Along a straight line whose lowest point lies at the height ``h`` over the ellipsoid the radiance is ::

    L(h) = mean(h) + sum_k a_k mode_k(h) + rest(h),      a_k ~ N(0, 1),   rest ~ N(0, left_sigma(h)^2)

The mean is that of an ensemble of air, cloud and ground: of thermal bands by latitude and month, of sunlit ones by the
Sun's zenith angle at the lowest point and its azimuth from the line of sight. The modes are empirical orthogonal
functions of the ensemble. A coefficient is correlated along the limb over the mode's ``correlation_rad``
(:func:`horizonval.estimation.fit.air.correlations`).

``h`` is negative where the line meets the ground: the depth of its middle below the ellipsoid. Lines are straight
continuations of what the camera sees; refraction is in the profile. A table does not depend on the position of the
camera above the air.

Thermal tables are interpolated multilinearly. In sunlit tables cubic splines go through the modes and through the root
of the mean, whose range is smaller and which stays positive: their error is 1.8 % of a profile, that of straight lines
up to 16 %. Standard deviations are multilinear. Tables that reach into twilight end in darkness.

Files hold whole numbers: of the mean 16 bits of the largest value of a profile, of modes and rest 8 bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from horizonval.core import atomic, files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, misfit

FORMAT = 2
FOLDER = Path(__file__).parent / "data"
"""Folder of the shipped tables."""
LEAST_OVERLAP = 0.6
"""Smallest common share of the wavelengths of two bands for one table: 10.5 to 12.5 um has 0.33 of 8 to 14 um, whose
limb is 10 km higher; the visible bands of the shipped cameras share 0.97."""
MONTHS = 12.0
"""Period of the second axis of thermal tables."""
CLOUDED = 0.75
"""Share of scenes with clouds in the ensembles of the shipped tables."""
_AXES = {"solar": ("sun_zenith_rad", "sun_azimuth_rad"), "thermal": ("latitude_rad", "month")}
_NUMBERS: dict[str, type[np.int8] | type[np.int16]] = {"mean": np.int16, "modes": np.int8, "left_sigma": np.int8}
"""Whole numbers of the profiles in a file."""


@dataclass(frozen=True, eq=False)
class LimbTemplates:
    """Profiles of the limb in one band over their two axes, A and B places along each.

    Attributes
    ----------
    band_kind : {"solar", "thermal"}
    band_um : tuple of two floats
        Wavelengths between which the band's response is above zero.
    height_m : ndarray, shape (H,)
        Rising, of the lines' lowest points.
    axes : tuple of two ndarray, shapes (A,) and (B,)
        Rising. Solar: the Sun's zenith angle and its azimuth from the line of sight, 0 (ahead) to pi [rad]. Thermal:
        latitude [rad] and month, 1.0 in the middle of January, which is a circle of 12.
    mean : ndarray, shape (A, B, H)
        W m-2 sr-1 um-1, the mean over the band by its response.
    modes : ndarray, shape (A, B, K, H)
        What one standard deviation of each adds.
    mode_kinds : tuple of str, length K
        What makes each differ: air, haze, scene (clouds), ground.
    correlation_rad : ndarray, shape (A, K, 2)
        At the first axis's places, along the meridian and along the parallel, angles at the Earth's centre.
    left_sigma : ndarray, shape (A, B, H)
        Standard deviation of what the modes leave.
    made_by : str
        How the table was made: command, version, ensemble.
    """

    band_kind: Literal["solar", "thermal"]
    band_um: tuple[float, float]
    height_m: FloatArray
    axes: tuple[FloatArray, FloatArray]
    mean: FloatArray
    modes: FloatArray
    mode_kinds: tuple[str, ...]
    correlation_rad: FloatArray
    left_sigma: FloatArray
    made_by: str = ""

    def __post_init__(self) -> None:
        problem = self._problem()
        if problem:
            raise UserError(problem, where="limb templates")

    def at(self, first: ArrayLike, second: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return mean (n, H), modes (n, K, H) and ``left_sigma`` (n, H) at positions along the limb.

        ``first``, ``second``: shape (n,), along the axes: solar (Sun's zenith angle, azimuth) [rad], thermal (latitude
        [rad], month). Beyond an axis's ends the last values hold, except in twilight, which ends; months are cyclic.
        """
        modes = np.tensordot(self._weights(first, second), self.modes, 2)
        return self.mean_at(first, second), modes, np.tensordot(self.linear(first, second), self.left_sigma, 2)

    def mean_at(self, first: ArrayLike, second: ArrayLike) -> FloatArray:
        """Return the mean profiles alone, shape (n, H); parameters as for :meth:`at`."""
        weights = self._weights(first, second)
        if self.band_kind == "thermal":
            return np.tensordot(weights, self.mean, 2)
        return np.asarray(np.maximum(np.tensordot(weights, self._root, 2), 0.0) ** 2)

    def lengths_at(self, first: ArrayLike) -> FloatArray:
        """Return the modes' lengths at places along the first axis, shape (n, K, 2)."""
        return np.tensordot(_straight(self.axes[0], np.atleast_1d(first)), self.correlation_rad, 1)

    @property
    def prior_sigmas(self) -> FloatArray:
        """Standard deviations of the modes in a normal prior, in units of the ensemble's, shape (K, 1).

        Clouds are in a scene or not: with the share ``q`` of cloudy scenes the unit variable of this mode is
        ``-(q / (1 - q))^1/2`` without. One standard deviation of the prior reaches there.
        """
        scene = np.array(self.mode_kinds) == "scene"
        return np.where(scene, np.sqrt(CLOUDED / (1.0 - CLOUDED)), 1.0)[:, None]

    @cached_property
    def _root(self) -> FloatArray:
        return np.sqrt(np.maximum(self.mean, 0.0))

    @cached_property
    def splines(self) -> tuple[CubicSpline, CubicSpline]:
        """The splines along zenith angle and azimuth through one value of 1, for every value; azimuth is symmetric."""
        zenith, azimuth = self.axes
        # A table that reaches beyond 98 deg is dark at 106 deg, where the limb has 1e-5 of its radiance at noon. On the
        # way there from 99 deg, the last angle of the shipped tables, radiance is right to 0.1 % of that at noon.
        twilight, dark = np.radians([98.0, 106.0])
        if twilight <= zenith[-1] < dark:
            zenith = np.append(zenith, dark)
        # Angles of 32 bits are rounded by less than 1e-6.
        in_plane = (azimuth[0] < 1e-6, azimuth[-1] > np.pi - 1e-6)
        return _spline(zenith, (False, True)), _spline(azimuth, in_plane)

    def _weights(self, first: ArrayLike, second: ArrayLike) -> FloatArray:
        """Return the weights of a table's profiles at positions, shape (n, A, B), by splines in a sunlit band."""
        if self.band_kind == "thermal":
            return self.linear(first, second)
        places = np.atleast_1d(first), _folded(np.atleast_1d(second))
        rows, columns = (
            spline(np.clip(x, spline.x[0], spline.x[-1])) for spline, x in zip(self.splines, places, strict=True)
        )
        return np.asarray(rows[:, : len(self.axes[0]), None] * columns[:, None, :])

    def linear(self, first: ArrayLike, second: ArrayLike) -> FloatArray:
        """Return the weights of a table's profiles at positions, shape (n, A, B), of straight lines."""
        first, second = np.atleast_1d(first), np.atleast_1d(second)
        if self.band_kind == "thermal":
            columns = _straight(self.axes[1], second, MONTHS)
        else:
            columns = _straight(self.axes[1], _folded(second))
        return np.asarray(_straight(self.axes[0], first)[:, :, None] * columns[:, None, :])

    def save(self, path: Path) -> None:
        """Write the table atomically and reproducibly; raises ``UserError`` if the file cannot be written."""
        arrays: dict[str, NDArray[Any]] = {
            "format": np.array(FORMAT),
            "band_kind": np.array(self.band_kind),
            "band_um": np.array(self.band_um),
            "height_m": self.height_m,
            "first": self.axes[0],
            "second": self.axes[1],
            "mode_kinds": np.array(self.mode_kinds),
            "correlation_rad": self.correlation_rad,
            "made_by": np.array(self.made_by),
        }
        for name, kind in _NUMBERS.items():
            scale, whole = quantised(getattr(self, name), kind)
            arrays[f"{name}_scale"], arrays[f"{name}_whole"] = scale.astype(np.float32), whole
        with atomic.replacing(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # names are not keywords of its own

    def _problem(self) -> str:
        """Return what is wrong with the shapes and numbers; empty for nothing."""
        if self.band_kind not in _AXES:
            return f"band_kind is {self.band_kind!r}, not solar or thermal"
        if len(self.axes) != 2 or len(self.band_um) != 2 or not 0.0 < self.band_um[0] < self.band_um[1]:
            return "a band has two wavelengths, rising, and a table two axes"
        for name, axis in zip(("height_m", *_AXES[self.band_kind]), (self.height_m, *self.axes), strict=True):
            if axis.ndim != 1 or len(axis) < 1 or not np.isfinite(axis).all() or (np.diff(axis) <= 0.0).any():
                return f"{name} does not rise"
        (a, b), k, h = map(len, self.axes), len(self.mode_kinds), len(self.height_m)
        wanted = {"mean": (a, b, h), "modes": (a, b, k, h), "correlation_rad": (a, k, 2), "left_sigma": (a, b, h)}
        for name, shape in wanted.items():
            values = getattr(self, name)
            if values.shape != shape:
                return f"{name} has the shape {values.shape}, not {shape}"
            if not np.isfinite(values).all():
                return f"{name} has values that are not finite"
        if (self.correlation_rad <= 0.0).any() or (self.left_sigma < 0.0).any():
            return "correlation_rad is not above 0, or left_sigma negative"
        return ""


def quantised(values: FloatArray, kind: type[np.int8] | type[np.int16]) -> tuple[FloatArray, NDArray[Any]]:
    """Return profiles (..., H) as scales (...) times integers (..., H), rounded to half a step."""
    scale = np.abs(values).max(axis=-1) / np.iinfo(kind).max
    scale = scale.astype(np.float32).astype(np.float64)
    whole = np.rint(values / np.where(scale > 0.0, scale, 1.0)[..., None])
    return scale, np.clip(whole, -np.iinfo(kind).max, np.iinfo(kind).max).astype(kind)


def load_templates(path: Path) -> LimbTemplates:
    """Read a table. Raises ``UserError``: no such file, not a table of profiles, damaged, or of a later format."""
    expected = "a table of `horizonval templates SUITE -o table.npz`"
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {key: np.asarray(data[key]) for key in data.files}
    except files.UNREADABLE_ARRAYS as e:
        problem = (e.strerror if isinstance(e, OSError) else None) or "not a table, or damaged"
        raise UserError(problem, where=str(path), expected=expected) from e
    try:
        if int(arrays["format"]) != FORMAT:
            raise UserError(
                f"format {int(arrays['format'])}", where=str(path), expected=f"format {FORMAT}", fix="make it again"
            )
        low, high = arrays["band_um"]
        for name in _NUMBERS:
            arrays[name] = arrays[f"{name}_whole"] * arrays[f"{name}_scale"].astype(np.float64)[..., None]
        numbers = {name: arrays[name].astype(np.float64) for name in ("height_m", "correlation_rad", *_NUMBERS)}
        return LimbTemplates(
            band_kind=str(arrays["band_kind"]),  # type: ignore[arg-type]  # checked when made
            band_um=(float(low), float(high)),
            axes=(arrays["first"].astype(np.float64), arrays["second"].astype(np.float64)),
            mode_kinds=tuple(str(name) for name in arrays["mode_kinds"]),
            made_by=str(arrays["made_by"]),
            **numbers,
        )
    except UserError as e:
        raise UserError(str(e), where=str(path), expected=expected) from e
    except (KeyError, ValueError, TypeError) as e:
        raise UserError(f"not a table of profiles: {misfit(e)}", where=str(path), expected=expected) from e


def templates_of(path: Path) -> LimbTemplates:
    """Return the table of a file, cached while the file is unchanged; errors as for :func:`load_templates`."""
    try:
        found = path.stat()
    except (OSError, ValueError):  # the latter of a name that no file can have
        return load_templates(path)
    return _of_version(path, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=8)
def _of_version(path: Path, changed_ns: int, size: int) -> LimbTemplates:
    return load_templates(path)


def is_of_band(table: LimbTemplates, band_kind: str | None, band_um: tuple[float, float]) -> bool:
    """Return whether a table's limb is that of a band."""
    return table.band_kind == band_kind and overlap(table.band_um, band_um) >= LEAST_OVERLAP


def shipped_templates(band_kind: Literal["solar", "thermal"], band_um: tuple[float, float]) -> LimbTemplates | None:
    """Return the shipped table whose band, between two wavelengths, overlaps most, or None if none does enough."""
    fit = [table for table in _shipped() if is_of_band(table, band_kind, band_um)]
    return max(fit, key=lambda table: overlap(table.band_um, band_um), default=None)


def overlap(a_um: Sequence[float], b_um: Sequence[float]) -> float:
    """Return the share of the wavelengths of either of two bands that both have."""
    both = max(min(a_um[1], b_um[1]) - max(a_um[0], b_um[0]), 0.0)
    return both / (a_um[1] - a_um[0] + b_um[1] - b_um[0] - both)


@cache
def _shipped() -> tuple[LimbTemplates, ...]:
    return tuple(load_templates(path) for path in sorted(FOLDER.glob("limb-*.npz")))


def _folded(azimuth: FloatArray) -> FloatArray:
    """Return angles from the line of sight of either sign as ones from 0 to pi."""
    return np.abs((azimuth + np.pi) % (2.0 * np.pi) - np.pi)


def _straight(axis: FloatArray, x: FloatArray, period: float | None = None) -> FloatArray:
    """Return the weights (n, A) of values on an axis in linear interpolation at x (n,); ends hold."""
    return np.stack([np.interp(x, axis, one, period=period) for one in np.eye(len(axis))], axis=-1)


def _spline(axis: FloatArray, level: tuple[bool, bool]) -> CubicSpline:
    """Return the splines through a value of 1 at each position of an axis.

    At either end the slope is 0 where ``level``, else that of the parabola through three positions.
    """
    n = len(axis)
    if n == 1:
        return CubicSpline(np.append(axis, axis + 1.0), np.ones((2, 1)))
    order: Literal[1, 2] = 1 if n == 2 else 2
    slopes = np.asarray(np.gradient(np.eye(n), axis, axis=0, edge_order=order))
    ends = tuple((1, 0.0 * slope if flat else slope) for flat, slope in zip(level, slopes[[0, -1]], strict=True))
    return CubicSpline(axis, np.eye(n), bc_type=ends)
