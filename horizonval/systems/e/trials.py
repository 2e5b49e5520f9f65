"""Passes with rounding and noise through the whole pipeline, some at a time in a worker process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.systems.e.case import METHODS, NOISE_ARCSEC, ROUNDING_DEG, ExactPass, exact_pass, rounded
from horizonval.systems.e.localisation.celestial import ARCSEC, celestial_errors, normalised_squares, rms
from horizonval.systems.e.localisation.pipeline import PUBLISHED_ALPHA, PassPositions, locate, locate_as_published
from horizonval.systems.e.noise import NoiseReading, noisy
from horizonval.systems.task_cache import rng_of

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
    """Return, for every draw, each method's three errors, the normalised squared errors in the pass's middle, and chi2.

    ``published`` are the errors of the published order with its own factor, smoothed and filtered; ``alphas`` those of
    ours with other factors, filtered and after the way back, where the item asks for them. An item says ``kind``:
    ``exact`` (no noise), ``rounded`` (``quantum_deg``), ``shifted`` (the same with the grid of rounding at random),
    ``noisy`` (``shape``, ``order``, ``amount``) or ``white`` (``WHITE_ARCSEC``), and may give the ``angles`` that all
    of this is done to, and the ``instants`` of the pass at which there are any.
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
