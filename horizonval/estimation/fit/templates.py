"""Rendered profiles of the limb as a table that a fit reads, and the spline that interpolates it.

**Spline.** With the values ``f`` and slopes ``s`` at two positions ``h`` apart, and ``t`` from 0 to 1 between them::

    p = (1 + 2 t) (1 - t)^2 f_i + t^2 (3 - 2 t) f_i+1 + h t (1 - t)^2 s_i - h t^2 (1 - t) s_i+1

Slopes make the second derivative continuous, a set of linear equations, so that ``s = S f`` and ``p = w . f``. At an
end of the axis the slope is 0 where requested, else that of the parabola through three positions.

**Table.** Along a straight line whose lowest point lies at the height ``h`` over the ellipsoid the radiance is ::

    L(h) = mean(h) + sum_k a_k mode_k(h) + rest(h),      a_k ~ N(0, 1),   rest ~ N(0, left_sigma(h)^2)

The mean is that of an ensemble of air, cloud and ground: of thermal bands by latitude and month, of sunlit ones by the
Sun's zenith angle at the lowest point and its azimuth from the line of sight. The modes are empirical orthogonal
functions of the ensemble. A coefficient is correlated along the limb over the mode's ``correlation_rad``, which for the
air depends on latitude and direction (:mod:`.height`).

``h`` is negative where the line meets the ground: the depth of its middle below the ellipsoid. Lines are straight
continuations of what the camera sees; refraction is in the profile. A table does not depend on the position of the
camera above the air. Angles are those at the lowest point of each line.

Thermal tables are interpolated multilinearly. In sunlit tables splines (as above) go through the modes and through the
root of the mean, whose range is smaller and which stays positive: their error is 1.8 % of a profile, that of straight
lines up to 16 %. Standard deviations stay multilinear. Tables that reach into twilight end in darkness.

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

from horizonval.core import atomic, files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, misfit


def slopes(axis: FloatArray, level: tuple[bool, bool]) -> FloatArray:
    """Return the matrix (n, n) from values to slopes on a rising axis; ``level``: zero slope at either end."""
    n = len(axis)
    if n == 1:
        return np.zeros((1, 1))
    step = np.diff(axis)
    chord = (np.eye(n)[1:] - np.eye(n)[:-1]) / step[:, None]
    left, right = np.eye(n), np.zeros((n, n))
    for i in range(1, n - 1):
        left[i, i - 1 : i + 2] = step[i], 2.0 * (step[i - 1] + step[i]), step[i - 1]
        right[i] = 3.0 * (step[i] * chord[i - 1] + step[i - 1] * chord[i])
    for end, first, second in ((0, 0, 1), (-1, -1, -2)):
        if level[end]:
            continue
        bend = 0.0 if n == 2 else step[first] / (step[first] + step[second]) * (chord[first] - chord[second])
        right[end] = chord[first] + bend
    return np.asarray(np.linalg.solve(left, right))


def spline_weights(axis: FloatArray, slope: FloatArray, x: FloatArray) -> FloatArray:
    """Return the weights (m, n) of values on an axis at x (m,), clamped; ``slope``: :func:`slopes` of the axis."""
    if len(axis) == 1:
        return np.ones((len(x), 1))
    i = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
    h = axis[i + 1] - axis[i]
    t = np.clip((x - axis[i]) / h, 0.0, 1.0)
    weights = (h * t * (1.0 - t) ** 2)[:, None] * slope[i] - (h * t**2 * (1.0 - t))[:, None] * slope[i + 1]
    place = np.arange(len(x))
    weights[place, i] += (1.0 + 2.0 * t) * (1.0 - t) ** 2
    weights[place, i + 1] += t**2 * (3.0 - 2.0 * t)
    return np.asarray(weights)


FORMAT = 2
FOLDER = Path(__file__).parent / "data"
"""Folder of the shipped tables."""
LEAST_OVERLAP = 0.6
"""Smallest common share of the wavelengths of two bands for one table: 10.5 to 12.5 um has 0.33 of 8 to 14 um, whose
limb is 10 km higher; the visible bands of the shipped cameras share 0.97."""
MONTHS = 12.0
"""Months of a year: the period of the second axis of thermal tables."""
_AXES = {"solar": ("sun_zenith_rad", "sun_azimuth_rad"), "thermal": ("latitude_rad", "month")}


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
        What makes each differ: air, haze, cloud, ground.
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
        a, b = _pairs(first, second)
        if self.band_kind == "thermal":
            mean, modes, left = self._straight(a, b, self.mean, self.modes, self.left_sigma)
            return mean, modes, left
        root, modes = self._curved(a, b, self._root, self.modes)
        return np.maximum(root, 0.0) ** 2, modes, self._straight(a, b, self.left_sigma)[0]

    def lengths_at(self, first: ArrayLike) -> FloatArray:
        """Return the modes' lengths at places along the first axis, shape (n, K, 2)."""
        i, u = _between(self.axes[0], np.atleast_1d(np.asarray(first, dtype=np.float64)))
        share = u[:, None, None]
        after = np.minimum(i + 1, len(self.axes[0]) - 1)
        return np.asarray((1.0 - share) * self.correlation_rad[i] + share * self.correlation_rad[after])

    def mean_at(self, first: ArrayLike, second: ArrayLike) -> FloatArray:
        """Return the mean profiles alone, shape (n, H); parameters as for :meth:`at`."""
        a, b = _pairs(first, second)
        if self.band_kind == "thermal":
            return self._straight(a, b, self.mean)[0]
        return np.asarray(np.maximum(self._curved(a, b, self._root)[0], 0.0) ** 2)

    @cached_property
    def _root(self) -> FloatArray:
        return np.sqrt(np.maximum(self.mean, 0.0))

    @cached_property
    def splines(self) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        """Return positions on both axes and their slope matrices; azimuth is symmetric."""
        zenith, azimuth = self.axes
        # A table that reaches beyond 98 deg is dark at 106 deg, where the limb has 1e-5 of its radiance at noon. On the
        # way there from 99 deg, the last angle of the shipped tables, radiance is right to 0.1 % of that at noon.
        twilight, dark = np.radians([98.0, 106.0])
        if twilight <= zenith[-1] < dark:
            zenith = np.append(zenith, dark)
        # Angles of 32 bits are rounded by less than 1e-6.
        in_plane = (bool(azimuth[0] < 1e-6), bool(azimuth[-1] > np.pi - 1e-6))
        return (zenith, slopes(zenith, (False, True))), (azimuth, slopes(azimuth, in_plane))

    def _curved(self, a: FloatArray, b: FloatArray, *tables: FloatArray) -> list[FloatArray]:
        """Return values at places of a sunlit table by splines."""
        zenith, azimuth = self.splines
        rows = spline_weights(*zenith, a)[:, : len(self.axes[0])]
        columns = spline_weights(*azimuth, _folded(b))
        weights = (rows[:, :, None] * columns[:, None, :]).reshape(len(a), -1)
        return [
            (weights @ values.reshape(weights.shape[1], -1)).reshape(len(a), *values.shape[2:]) for values in tables
        ]

    def _straight(self, a: FloatArray, b: FloatArray, *tables: FloatArray) -> list[FloatArray]:
        """Return values at places of a table by straight lines."""
        i, u = _between(self.axes[0], a)
        if self.band_kind == "thermal":
            j, v = _round_the_year(self.axes[1], b)
        else:
            j, v = _between(self.axes[1], _folded(b))
        out = []
        for values in tables:
            flat = values.reshape(len(self.axes[0]), len(self.axes[1]), -1)
            total = np.zeros((len(a), flat.shape[-1]))
            for row, share in ((i, 1.0 - u), (np.minimum(i + 1, len(self.axes[0]) - 1), u)):
                for column, part in ((j, 1.0 - v), ((j + 1) % len(self.axes[1]), v)):
                    total += (share * part)[:, None] * flat[row, column]
            out.append(total.reshape(len(a), *values.shape[2:]))
        return out

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
        for name, values, kind in (
            ("mean", self.mean, np.int16),
            ("modes", self.modes, np.int8),
            ("left_sigma", self.left_sigma, np.int8),
        ):
            scale, whole = quantised(values, kind)
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
        grid, k = (len(self.axes[0]), len(self.axes[1])), len(self.mode_kinds)
        wanted = {
            "mean": (*grid, len(self.height_m)),
            "modes": (*grid, k, len(self.height_m)),
            "correlation_rad": (grid[0], k, 2),
            "left_sigma": (*grid, len(self.height_m)),
        }
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
        kind = str(arrays["band_kind"])
        low, high = (float(v) for v in arrays["band_um"])
        mean, modes, left = (
            arrays[f"{name}_whole"] * arrays[f"{name}_scale"].astype(np.float64)[..., None]
            for name in ("mean", "modes", "left_sigma")
        )
        numbers = [arrays[name].astype(np.float64) for name in ("height_m", "first", "second", "correlation_rad")]
        return LimbTemplates(
            band_kind=kind,  # type: ignore[arg-type]  # checked when made
            band_um=(low, high),
            height_m=numbers[0],
            axes=(numbers[1], numbers[2]),
            mean=mean,
            modes=modes,
            mode_kinds=tuple(str(name) for name in arrays["mode_kinds"]),
            correlation_rad=numbers[3],
            left_sigma=left,
            made_by=str(arrays["made_by"]),
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
    return _as_it_was(path, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=8)
def _as_it_was(path: Path, changed_ns: int, size: int) -> LimbTemplates:
    return load_templates(path)


def is_of_band(table: LimbTemplates, band_kind: str | None, band_um: tuple[float, float]) -> bool:
    """Return whether a table's limb is that of a band."""
    return table.band_kind == band_kind and overlap(table.band_um, band_um) >= LEAST_OVERLAP


def shipped_templates(band_kind: Literal["solar", "thermal"], band_um: tuple[float, float]) -> LimbTemplates | None:
    """Return the shipped table whose band, between two wavelengths, overlaps most, or None if none does enough."""
    likeness = [(overlap(band_um, t.band_um), i) for i, t in enumerate(_shipped()) if t.band_kind == band_kind]
    best, i = max(likeness, default=(0.0, 0))
    return _shipped()[i] if best >= LEAST_OVERLAP else None


def overlap(a_um: Sequence[float], b_um: Sequence[float]) -> float:
    """Return the share of the wavelengths of either of two bands that both have."""
    both = min(a_um[1], b_um[1]) - max(a_um[0], b_um[0])
    return max(both, 0.0) / (a_um[1] - a_um[0] + b_um[1] - b_um[0] - max(both, 0.0))


@cache
def _shipped() -> tuple[LimbTemplates, ...]:
    return tuple(load_templates(path) for path in sorted(FOLDER.glob("limb-*.npz")))


def _pairs(first: ArrayLike, second: ArrayLike) -> tuple[FloatArray, FloatArray]:
    a, b = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, dtype=np.float64)) for v in (first, second)))
    return a, b


def _folded(azimuth: FloatArray) -> FloatArray:
    """Return angles from the line of sight of either sign as ones from 0 to pi."""
    return np.abs((azimuth + np.pi) % (2.0 * np.pi) - np.pi)


def _between(axis: FloatArray, x: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the place before x and the share of the next; ends hold."""
    if len(axis) == 1:
        return np.zeros(x.shape, dtype=np.intp), np.zeros(x.shape)
    i = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
    return i, np.clip((x - axis[i]) / (axis[i + 1] - axis[i]), 0.0, 1.0)


def _round_the_year(axis: FloatArray, month: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the place before a month and the share of the next, round the year."""
    x = axis[0] + (month - axis[0]) % MONTHS
    i = np.searchsorted(axis, x, side="right") - 1
    after = np.append(axis, axis[0] + MONTHS)
    return i, (x - axis[i]) / (after[i + 1] - axis[i])
