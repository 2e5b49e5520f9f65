"""System E: passive localisation of a satellite from two stations' angles (Hadinejad & Amiri 2020).

The truth is an orbit of SGP4; :func:`horizonval.locate` gets its angles, rounded and with noise.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from functools import cache
from typing import Any

import numpy as np
from matplotlib.figure import Figure as MplFigure

import horizonval as hv
from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry.orbit import ElementSet, gcrs_states, itrs_states
from horizonval.geometry.sightings import Station, celestial
from horizonval.report.plots import COLOURS
from horizonval.systems.entries import Result, Values, system
from horizonval.systems.task_cache import TaskCache, rng_of

SYSTEM = system("E")
GIVEN = SYSTEM.given
STATIONS = [Station(*place) for place in GIVEN["stations"]]
SECONDS = np.arange(0.0, GIVEN["length_s"] + 0.5 * GIVEN["step_s"], GIVEN["step_s"])
START = datetime.fromisoformat(GIVEN["start"])
TIMES = [START + timedelta(seconds=float(t)) for t in SECONDS]
METHODS: dict[str, dict[str, float]] = {"plain": {}, "proposed": {"smooth_s": 1.0, "forgetting": 0.3}}
"""Keywords of :func:`horizonval.locate`: the reference method, and the proposed one."""
QUANTITIES = {"ra": "right ascension [arcsec]", "dec": "declination [arcsec]", "dist": "distance [km]"}
DRAWS = 40
"""Independent passes for every figure of the noise table."""


@cache
def exact() -> tuple[FloatArray, FloatArray]:
    """Return the true angles [deg], shape (n, 2, 2); right ascension, declination [deg] and distance [km], (n, 3)."""
    elements = ElementSet(*GIVEN["elements"])
    r_itrs, _ = itrs_states(elements, START, SECONDS)
    r_gcrs, _ = gcrs_states(elements, START, SECONDS)
    angles = np.stack([station.azimuth_elevation(r_itrs) for station in STATIONS], axis=1)
    return np.degrees(angles), celestial(r_gcrs) * [180.0 / np.pi, 180.0 / np.pi, 1e-3]


def errors(angles_deg: FloatArray, method: str) -> FloatArray:
    """Return a method's errors of right ascension, declination [arcsec] and distance [km], shape (n, 3)."""
    found = hv.locate(angles_deg, STATIONS, TIMES, **METHODS[method])
    off = np.stack([found.right_ascension_deg, found.declination_deg, found.distance_km], axis=-1) - exact()[1]
    off[:, 0] = np.remainder(off[:, 0] + 180.0, 360.0) - 180.0
    return off * [3600.0, 3600.0, 1.0]


def rounded(quantum_deg: float) -> FloatArray:
    """Return the true angles rounded to whole multiples."""
    return np.asarray(np.round(exact()[0] / quantum_deg) * quantum_deg)


def noisy(item: JsonObject) -> JsonObject:
    """Return errors of every pass, by method: an item's noise of two standard deviations, after rounding."""
    found: dict[str, list[FloatArray]] = {method: [] for method in METHODS}
    for draw in range(DRAWS):
        noise = rng_of(item["seed"], "localisation", f"{item['arcsec']:g}", str(draw)).standard_normal(
            (len(TIMES), 2, 2)
        )
        angles = rounded(GIVEN["noise_rounding_deg"]) + 0.5 * item["arcsec"] / 3600.0 * noise
        for method, each in found.items():
            each.append(rms(errors(angles, method)))
    return {method: np.array(each).tolist() for method, each in found.items()}


def rms(found: FloatArray) -> FloatArray:
    """Return the root mean square over the pass."""
    return np.asarray(np.sqrt(np.mean(found**2, axis=0)))


def _columns(table: str, found: dict[str, FloatArray]) -> dict[str, list[float]]:
    """Return the values of a table from errors of shape (settings, 3) by method."""
    return {f"{m}_{table}_{q}": found[m][:, k].tolist() for m in METHODS for k, q in enumerate(QUANTITIES)}


def _growth(found: dict[str, FloatArray], first: int, last: int) -> list[float]:
    """Return the proposed over the reference method's growth of errors between two settings, for each quantity."""
    proposed, plain = (found[method][last] - found[method][first] for method in ("proposed", "plain"))
    return [float(ratio) for ratio in proposed / plain]


def quick(cache: TaskCache) -> Values:
    """Return the values of the rounding table, in which nothing is random."""
    passes = {method: [errors(rounded(q), method) for q in GIVEN["rounding_deg"]] for method in METHODS}
    found = {method: np.array([rms(one) for one in each]) for method, each in passes.items()}
    return _columns("rounding", found) | {
        "figures": [float(np.abs(one[:, 2]).max()) for one in passes["proposed"]],
        "gap": _growth(found, 0, 1),
        "suffices": float(found["proposed"][1, 2]),
        "exact": float(rms(errors(exact()[0], "plain"))[2]),
    }


def reproduce(cache: TaskCache) -> Result:
    """Do the experiment."""
    items = {f"{n:g} arcsec": {"arcsec": n, "seed": cache.seed} for n in GIVEN["noise_arcsec"]}
    made = cache.each("E: noise", noisy, items)
    passes = {method: np.array([one[method] for one in made.values()]) for method in METHODS}
    found = {method: np.median(each, axis=1) for method, each in passes.items()}
    far = (passes["proposed"] > 3.0 * found["proposed"][:, None]).any(axis=-1).sum(axis=-1)
    values: dict[str, Any] = {**quick(cache), **_columns("noise", found), "growth": _growth(found, 0, 2)}
    values["diverged"] = far.tolist()
    pairs = [(f"proposed_{table}_{q}", f"plain_{table}_{q}") for table in ("rounding", "noise") for q in QUANTITIES]
    values["better"] = max(float(np.max(np.divide(values[ours], values[plain]))) for ours, plain in pairs)
    return Result(
        values,
        {"errors": draw_errors},
        notes={key: note for key in values if (note := _digits(key, values[key]))},
        settings={"element_set": GIVEN["elements"], "methods": METHODS, "draws": DRAWS},
    )


def _digits(key: str, value: Any) -> str:
    """Return which figures of a table agree to the printed digits, two decimals."""
    entry = SYSTEM.entry[key]
    if not isinstance(entry.printed, tuple):
        return ""
    same = [label for label, a, b in zip(entry.labels, entry.printed, value, strict=True) if round(b, 2) == a]
    return f"to the printed digits: {', '.join(same)}" if same else ""


def draw_errors() -> MplFigure:
    """Draw errors over the pass at each rounding."""
    figure = MplFigure(figsize=(8.0, 4.8), layout="constrained")
    panels = figure.subplots(3, 3, sharex=True)
    for column, quantum in zip(panels.T, GIVEN["rounding_deg"], strict=True):
        for k, method in enumerate(("plain", "proposed")):
            label = {"plain": "reference: least squares", "proposed": "proposed"}[method]
            for panel, series in zip(column, errors(rounded(quantum), method).T, strict=True):
                panel.plot(SECONDS, series, lw=(0.8, 1.4)[k], color=COLOURS[(5, 1)[k]], label=label)
        column[0].set_title(f"angles to {quantum:g}°")
        column[-1].set_xlabel("time [s]")
    for row, name in zip(panels, QUANTITIES.values(), strict=True):
        row[0].set_ylabel(name.replace(" [", "\n["))
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False)
    return figure
