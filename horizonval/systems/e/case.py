"""The pass of Hadinejad & Amiri 2020: ENVISAT over two stations, with the element set that this project gives it.

*Noise.* "Gaussian noise of variance n arcsec on top of 0.1 degree rounding" is ambiguous. The paper gives no unit of a
variance (arcsec squared) and no order of noise and rounding. Every reading here is run through the plain two-ray least
squares and compared with the paper's own plain column: nine figures, the distance being the root mean square of the
logarithm of their ratios.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry.orbit import ElementSet, gcrs_states, itrs_states
from horizonval.geometry.rotation import itrs_from_gcrs, turn
from horizonval.systems.e.localisation.batch import triangulate
from horizonval.systems.e.localisation.pipeline import (
    PUBLISHED_ALPHA,
    PassPositions,
    TwoStationPass,
    locate,
    locate_as_published,
)
from horizonval.systems.e.localisation.stations import ARCSEC, Station, celestial_errors, normalised_squares, rms
from horizonval.systems.published import published
from horizonval.systems.task_cache import rng_of

Figures = tuple[float, ...]

ENVISAT = ElementSet(
    "1 27386U 02009A   20001.54192287  .00000005  00000-0  15038-4 0  9994",
    "2 27386  98.1404  17.3951 0001257  86.5901  84.8559 14.37967408934480",
)
"""Assumed elements, since the paper gives none: above 48 degrees at both stations for the whole window."""

PUBLISHED = published("E")


def _station(name: str, longitude_deg: float, latitude_deg: float, height_m: float) -> Station:
    return Station(name, float(np.radians(longitude_deg)), float(np.radians(latitude_deg)), height_m)


_FIRST, _SECOND = (place for place, _ in PUBLISHED.tables["stations"].columns())
STATIONS = (_station("S1", **_FIRST), _station("S2", **_SECOND))

EPOCH_UTC = datetime.fromisoformat(str(PUBLISHED.figures["start"].value))
STEP_S = PUBLISHED.number("step")
LENGTH_S = PUBLISHED.number("length")

METHODS = ("plain", "smoothed", "filtered", "proposed", "batch")
QUANTITIES = (("right ascension", "arcsec"), ("declination", "arcsec"), ("distance", "km"))


def _printed(table: str, setting: str) -> tuple[tuple[float, ...], dict[str, tuple[Figures, ...]]]:
    """Return a table's settings, and the printed errors of both methods at each of them."""
    columns = list(PUBLISHED.tables[table].columns())
    errors = {
        method: tuple(tuple(read[f"{method} {quantity}"] or 0.0 for quantity, _ in QUANTITIES) for _, read in columns)
        for method in ("proposed", "plain")
    }
    return tuple(settings[setting] for settings, _ in columns), errors


ROUNDING_DEG, PUBLISHED_ROUNDING = _printed("rounding", "rounding_deg")
"""Root mean square errors at each rounding: right ascension, declination [arcsec], distance [km]."""
NOISE_ARCSEC, PUBLISHED_NOISE = _printed("noise", "noise_arcsec")
NOISE_ROUNDING_DEG = PUBLISHED.number("noise_rounding")


@dataclass(frozen=True)
class ExactPass:
    """The truth: times [s], angles as in :class:`TwoStationPass` [rad], positions [m]."""

    times_s: FloatArray
    angles_rad: FloatArray
    r_itrs: FloatArray
    r_gcrs: FloatArray

    def at(self, instants: Sequence[int]) -> ExactPass:
        """Return the truth at some of the instants."""
        i = np.asarray(instants, int)
        return ExactPass(self.times_s[i], self.angles_rad[i], self.r_itrs[i], self.r_gcrs[i])

    def measured(self, angles_rad: FloatArray) -> TwoStationPass:
        """Return a pass in which these angles were measured."""
        return TwoStationPass(STATIONS, EPOCH_UTC, self.times_s, angles_rad)


@lru_cache(maxsize=1)
def exact_pass() -> ExactPass:
    """Return the truth, every half second of the window."""
    times = np.arange(0.0, LENGTH_S + 0.5 * STEP_S, STEP_S)
    r_itrs, _ = itrs_states(ENVISAT, EPOCH_UTC, times)
    r_gcrs, _ = gcrs_states(ENVISAT, EPOCH_UTC, times)
    angles = np.concatenate([np.stack(s.azimuth_elevation(r_itrs), axis=1) for s in STATIONS], axis=1)
    return ExactPass(times, angles, r_itrs, r_gcrs)


def rounded(angles_rad: FloatArray, quantum_deg: float, offset: ArrayLike = 0.0) -> FloatArray:
    """Return angles rounded to whole multiples of a quantum; ``offset`` shifts the grid by a share of it."""
    quantum = np.radians(quantum_deg)
    return (np.round(angles_rad / quantum - np.asarray(offset, float)) + offset) * quantum


@dataclass(frozen=True)
class NoiseReading:
    """One reading: the distribution's shape, and whether noise comes before the rounding, after it, or alone."""

    shape: str
    order: str

    @property
    def description(self) -> str:
        """For people."""
        return f"{SHAPES[self.shape][0]}, {ORDERS[self.order]}"


Draw = Callable[[np.random.Generator, tuple[int, ...]], FloatArray]

SHAPES: dict[str, tuple[str, Draw]] = {
    "sigma": ("standard deviation n", lambda rng, shape: rng.standard_normal(shape)),
    "two-sigma": ("n is two standard deviations", lambda rng, shape: 0.5 * rng.standard_normal(shape)),
    "three-sigma": ("n is three standard deviations", lambda rng, shape: rng.standard_normal(shape) / 3.0),
    "fwhm": ("n is the full width at half maximum", lambda rng, shape: rng.standard_normal(shape) / 2.3548),
    "uniform": ("uniform within +-n", lambda rng, shape: rng.uniform(-1.0, 1.0, shape)),
    "variance": ("variance n arcsec^2", lambda rng, shape: rng.standard_normal(shape)),
}
ORDERS = {
    "before": "before rounding",
    "after": "after rounding",
    "alone": "without rounding",
}
MEANINGS = tuple(NoiseReading(shape, order) for shape in SHAPES for order in ORDERS)
LARGEST = NoiseReading("sigma", "before")
"""The reading with the most noise."""


def noisy(
    meaning: NoiseReading,
    amount: float,
    rng: np.random.Generator,
    draws: int | None = None,
    angles_rad: FloatArray | None = None,
) -> FloatArray:
    """Return angles with noise and rounding, shape (n, 4), or (draws, n, 4); the pass's exact ones, or those given."""
    exact = exact_pass().angles_rad if angles_rad is None else angles_rad
    scale = np.sqrt(amount) if meaning.shape == "variance" else amount
    shape = exact.shape if draws is None else (draws, *exact.shape)
    noise = scale * ARCSEC * SHAPES[meaning.shape][1](rng, shape)
    if meaning.order == "before":
        return rounded(exact + noise, NOISE_ROUNDING_DEG)
    if meaning.order == "after":
        return rounded(exact, NOISE_ROUNDING_DEG) + noise
    return exact + noise


def plain_rms(angles_rad: FloatArray) -> FloatArray:
    """Return the errors, shape (..., 3), of the plain way from angles of shape (..., n, 4)."""
    truth = exact_pass()
    first, second = STATIONS
    u1 = first.directions_itrs(angles_rad[..., 0], angles_rad[..., 1])
    u2 = second.directions_itrs(angles_rad[..., 2], angles_rad[..., 3])
    r_itrs = triangulate(first.r_itrs, second.r_itrs, u1, u2)[0]
    back = np.swapaxes(itrs_from_gcrs(EPOCH_UTC, truth.times_s), -1, -2)
    return rms(celestial_errors(turn(back, r_itrs), truth.r_gcrs))


def plain_column(meaning: NoiseReading, rng: np.random.Generator, draws: int) -> FloatArray:
    """Return the plain column's nine figures, shape (3, 3), averages over independent draws."""
    return np.array([plain_rms(noisy(meaning, n, rng, draws)).mean(axis=0) for n in NOISE_ARCSEC])


def distance(column: FloatArray) -> float:
    """Return how far a plain column is from the published one: 0.1 is about 10 %."""
    return float(np.sqrt(np.mean(np.log(column / np.array(PUBLISHED_NOISE["plain"])) ** 2)))


_AT_ONCE = 20
ALPHAS = (PUBLISHED_ALPHA, 1.0)
"""Forgetting factors tried beside ours: the published one, and no adaptation at all."""
WHITE_ARCSEC = 200.0
"""Independent noise without rounding: where a covariance can be checked."""


def items_of(row: str, draws: int, seed: int, **what: Any) -> dict[str, JsonObject]:
    """Return the items of a row's draws, some draws each."""
    starts = range(0, draws, _AT_ONCE)
    return {
        f"{row} {start}": {"row": row, "seed": seed, "first": start, "draws": min(_AT_ONCE, draws - start), **what}
        for start in starts
    }


def work(item: JsonObject) -> JsonObject:
    """Return each method's three errors for every draw, the normalised squared errors in the pass's middle, and chi2.

    ``published``: errors of the published order with its factor, smoothed and filtered; ``alphas``: ours with other
    factors, filtered and after the backward pass, if requested. ``kind``: ``exact`` (no noise), ``rounded``
    (``quantum_deg``), ``shifted`` (random grid of rounding), ``noisy`` (``shape``, ``order``, ``amount``) or ``white``
    (``WHITE_ARCSEC``). Optional: ``angles`` to use, and ``instants`` with measurements.
    """
    truth = exact_pass().at(item["instants"]) if "instants" in item else exact_pass()
    exact = np.array(item["angles"]) if "angles" in item else truth.angles_rad
    out: JsonObject = {"rms": [], "squares": [], "chi2": [], "kernel": [], "published": [], "alphas": []}
    for draw in range(item["first"], item["first"] + item["draws"]):
        rng = rng_of(item["seed"], "localisation", item["row"], str(draw))
        measured = truth.measured(_angles(item, exact, rng))
        located = locate(measured)
        out["rms"].append([rms(errors_of(located, method, truth)).tolist() for method in METHODS])
        middle = len(truth.times_s) // 2
        out["squares"].append([float(squares_of(located, m, truth)[middle]) for m in METHODS[2:]])
        out["chi2"].append(located.orbit.chi2_per_dof)
        out["kernel"].append([located.kernel.kernel.degree, located.kernel.kernel.width_s])
        published = locate_as_published(measured)
        out["published"].append([rms(celestial_errors(r, truth.r_gcrs)).tolist() for r in published])
        others = [locate(measured, alpha=alpha) for alpha in ALPHAS] if item.get("alphas") else []
        out["alphas"].append([[rms(errors_of(o, m, truth)).tolist() for m in ("filtered", "proposed")] for o in others])
    return out


def errors_of(located: PassPositions, method: str, truth: ExactPass) -> FloatArray:
    """Return a method's errors, shape (n, 3): right ascension and declination [arcsec], distance [km]."""
    return celestial_errors(getattr(located, method), truth.r_gcrs)


def squares_of(located: PassPositions, method: str, truth: ExactPass) -> FloatArray:
    """Return a method's normalised squared errors of position, shape (n,): 3 on average where it is honest."""
    return normalised_squares(getattr(located, method), getattr(located, f"{method}_covariances"), truth.r_gcrs)


def _angles(item: JsonObject, exact: FloatArray, rng: np.random.Generator) -> FloatArray:
    if item["kind"] == "rounded":
        return rounded(exact, item["quantum_deg"])
    if item["kind"] == "shifted":
        return rounded(exact, item["quantum_deg"], rng.uniform(-0.5, 0.5, 4))
    if item["kind"] == "noisy":
        return noisy(NoiseReading(item["shape"], item["order"]), item["amount"], rng, angles_rad=exact)
    if item["kind"] == "white":
        return exact + WHITE_ARCSEC * ARCSEC * rng.standard_normal(exact.shape)
    return exact


def rounding_items(seed: int, shifted: int) -> dict[str, JsonObject]:
    """Return the items of the rounding table: as it is, and with the grid of rounding at random places."""
    items: dict[str, JsonObject] = {}
    for quantum in ROUNDING_DEG:
        items |= items_of(f"rounded {quantum:g}", 1, seed, kind="rounded", quantum_deg=quantum, alphas=True)
        items |= items_of(f"shifted {quantum:g}", shifted, seed, kind="shifted", quantum_deg=quantum)
    return items


def streak_items(
    seed: int, draws: int, meaning: NoiseReading, angles_rad: FloatArray, instants: NDArray[np.int_]
) -> dict[str, JsonObject]:
    """Return the items of both tables from the angles that were measured in rendered frames."""
    given: dict[str, Any] = {"angles": angles_rad.tolist(), "instants": [int(i) for i in instants]}
    items: dict[str, JsonObject] = {}
    for quantum in ROUNDING_DEG:
        items |= items_of(f"streaks rounded {quantum:g}", 1, seed, kind="rounded", quantum_deg=quantum, **given)
    for amount in NOISE_ARCSEC:
        noise = {"kind": "noisy", "shape": meaning.shape, "order": meaning.order, "amount": amount}
        items |= items_of(f"streaks noisy {amount:g}", draws, seed, **noise, **given)
    return items


def gathered(results: Mapping[str, JsonObject]) -> Iterator[tuple[str, dict[str, FloatArray]]]:
    """Yield every row's name with its draws along axis 0: ``rms`` (draws, methods, 3), and the others."""
    rows: dict[str, list[JsonObject]] = {}
    for name, result in results.items():
        rows.setdefault(name.rpartition(" ")[0], []).append(result)
    for row, parts in rows.items():
        yield row, {key: np.concatenate([np.array(part[key]) for part in parts]) for key in parts[0]}
