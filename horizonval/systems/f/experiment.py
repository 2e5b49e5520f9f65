"""System F: a conical scanner of the seventies, in the carbon dioxide band and in a window, clear and under clouds.

The publication names cold clouds as the principal cause of its two scanners' noise. Here the same scan is made with and
without clouds, so that what they add is a difference. The scanner is calibrated once, on clear scans: the fixed level
is its fraction of their mean plateau, and the height of the horizon is the one that leaves no mean roll error.

*Radiance.* The beam is three lines, each a third of its width. Rays are dense where the horizon is.

*Noise.* A thermistor bolometer of detectivity 2e8 cm Hz^0.5 / W behind 5 cm2 of aperture at f/1 and half of the light:
a field of 1 deg has 3e-4 sr, so that 5 W m-2 sr-1 bring 3.8e-7 W; the flake is 0.44 mm wide (0.0019 cm2), and in the
band ``1 / (4 tau)`` of the electronics, 250 Hz, the noise is ``sqrt(0.0019 * 250) / 2e8 = 3.4e-9 W``: 1 / 110 of the
plateau in one sample. Edges are averaged over 16 turns, 8 s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.figure import Figure as MplFigure
from scipy.optimize import brentq

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Refusal
from horizonval.earth.clouds.earth_pattern import BASE_M
from horizonval.earth.clouds.relief import CloudField, top_m
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, geodetic_height, line_intersections, surface_normal
from horizonval.geometry.frames import inverse, rotate
from horizonval.sensor.conical_scanner import ConicalScanner, ScanEdges, ScannerFit, ScanSignal
from horizonval.systems.entries import Result, Table, Values
from horizonval.systems.task_cache import TaskCache
from horizonval.systems.weather_viewpoints import WeatherPlace, weather_places

ALTITUDE_KM, INCLINATION_DEG = 800.0, 108.0
BANDS = {"window, 10.5 to 12.5 um": (10.5, 12.5), "carbon dioxide, 14 to 16 um": (14.0, 16.0)}
WINDOW, CO2 = BANDS
SKIES, THRESHOLDS = ("clear", "clouds"), ("fixed", "fraction")
PLACES, QUICK_PLACES = 24, 4
SCANNER = ConicalScanner()
LINES = tuple(SCANNER.beam_rad * share for share in (-1 / 3, 0.0, 1 / 3))
NOISE_SHARE = 1.0 / 110.0 / math.sqrt(16)
LIMB_M, NODES = 40e3, 128
STEP_RAD, MARGIN_RAD = math.radians(0.05), math.radians(12.0)
REACH_RAD, FINE_RAD, COARSE_RAD = np.radians([6.0, 0.2, 0.5])
"""The limb is crossed at about a third of a right angle: 0.2 deg of phase are 6 km of height."""
LOWEST_M, HIGHEST_M = -20e3, 80e3
"""Range of the calibrated height of the horizon."""
CLOUD_STEPS = 96
COLOURS = {CO2: "#0072b2", WINDOW: "#d55e00"}


def distance_to_clouds(
    field: CloudField, observer_m: FloatArray, direction: FloatArray, ellipsoid: Ellipsoid = WGS84
) -> FloatArray:
    """Return how far [m] the first cloud is along rays (n, 3) from one observer (3,); NaN where there is none.

    Rays are sampled in even steps from the highest tops to the ground, and the crossing of the relief is linear between
    two steps: 5 km on rays that graze the ground. Narrow tops between two steps are missed.
    """
    first, last = line_intersections(observer_m, direction, ellipsoid.raised(field.top_m))
    ground, _ = line_intersections(observer_m, direction, ellipsoid)
    last = np.where(np.isfinite(ground), ground, last)
    out = np.full(len(direction), np.nan)
    low = np.flatnonzero(first > 0.0)
    t = first[low, None] + (last - first)[low, None] * np.linspace(0.0, 1.0, CLOUD_STEPS)
    place = observer_m + t[..., None] * direction[low, None, :]
    top = top_m(field, surface_normal(place, ellipsoid).reshape(-1, 3)).reshape(t.shape)
    above = geodetic_height(place, ellipsoid) - np.where(top > BASE_M, top, -1e9)
    met = np.flatnonzero((above < 0.0).any(axis=1))
    k = np.maximum(np.argmax(above[met] < 0.0, axis=1), 1)
    before, after = above[met, k - 1], above[met, k]
    # Between clear sky and a cloud there is no slope: the cloud's wall is at the step inside it.
    part = np.where(before < 1e8, before / np.where(before > after, before - after, 1.0), 1.0)
    out[low[met]] = t[met, k - 1] + np.clip(part, 0.0, 1.0) * (t[met, k] - t[met, k - 1])
    return out


def scan(item: JsonObject) -> JsonObject:
    """Return phases, and the mean radiance of the beam's lines there with and without clouds."""
    from horizonval.renderer.rays import cloud_top_radiance, thermal_radiance

    place = WeatherPlace.of(item)
    r, lvlh = place.position(ALTITUDE_KM), place.lvlh()
    edges = SCANNER.crossings(rotate(inverse(lvlh), np.eye(3)).T, r, WGS84.raised(LIMB_M))
    assert edges is not None, "the level scanner misses the Earth"
    fine = np.arange(-REACH_RAD, REACH_RAD + 0.5 * FINE_RAD, FINE_RAD)
    inner = np.arange(edges[0] + REACH_RAD + COARSE_RAD, edges[1] - REACH_RAD, COARSE_RAD)
    phase = np.concatenate([edges[0] + fine, inner, edges[1] + fine])
    direction = rotate(inverse(lvlh), np.concatenate([SCANNER.directions(phase, off) for off in LINES]))
    observer = np.broadcast_to(r, direction.shape)
    model = place.model(ALTITUDE_KM, BANDS[item["band"]])
    clear = thermal_radiance(model, WGS84.a_m, observer, direction, polar_radius_m=WGS84.b_m, nodes=NODES)["band"]
    away = distance_to_clouds(place.clouds_of(ALTITUDE_KM), r, direction)
    cloudy, met = clear.copy(), np.isfinite(away)
    cloudy[met] = cloud_top_radiance(
        model, WGS84.a_m, observer[met], direction[met], away[met], polar_radius_m=WGS84.b_m, nodes=NODES
    )["band"]
    means = {sky: v.reshape(len(LINES), -1).mean(axis=0) for sky, v in zip(SKIES, (clear, cloudy), strict=True)}
    rounded = {name: [float(f"{x:.7g}") for x in v] for name, v in {"phase_rad": phase, **means}.items()}
    return {**rounded, "covered": float(np.mean(met[direction @ r < 0.0]))}


def signal_of(scan: JsonObject, sky: str) -> ScanSignal:
    """Return the amplifier's output for one scan, zero beyond its ends."""
    phase = np.array(scan["phase_rad"])
    steps = np.arange(phase[0] - MARGIN_RAD, phase[-1] + 2.0 * MARGIN_RAD, STEP_RAD)
    return SCANNER.signal(steps, np.interp(steps, phase, np.array(scan[sky]), left=0.0, right=0.0))


@dataclass(frozen=True)
class BandErrors:
    """Errors of one threshold in one band.

    ``error_deg``: by sky, shape (places, 2), pitch and roll, NaN for refused scans; ``sigma_deg``: claimed, the worse
    axis; ``spare``: cloudy scans with more than two crossings; ``fall``: shape (places, 2), by how much clouds lower
    the plateaus, as shares.
    """

    error_deg: dict[str, FloatArray]
    sigma_deg: float
    spare: int
    fall: FloatArray

    @property
    def added_deg(self) -> FloatArray:
        """What clouds add to the errors, scan by scan."""
        return self.error_deg["clouds"] - self.error_deg["clear"]

    @property
    def axis(self) -> int:
        """The axis to which clouds add more: 0 pitch, 1 roll."""
        return int(np.argmax(np.nanstd(self.added_deg, axis=0)))

    def deviation_deg(self, errors: FloatArray) -> float:
        """Return the standard deviation in that axis."""
        return float(np.nanstd(errors[:, self.axis]))


def band_errors(scans: list[JsonObject], days: list[WeatherPlace], kind: str) -> BandErrors:
    """Return the errors of all scans of a band with a threshold of a kind of :data:`THRESHOLDS`."""
    signals = {sky: [signal_of(one, sky) for one in scans] for sky in SKIES}
    scanner = SCANNER
    if kind == "fixed":
        seen = [edges.plateaus for s in signals["clear"] if isinstance(edges := scanner.edges(s), ScanEdges)]
        scanner = scanner.with_level(scanner.fraction * float(np.mean(seen)))
    found = {sky: [scanner.edges(s) for s in those] for sky, those in signals.items()}

    def fits(sky: str, height_m: float) -> list[ScannerFit | Refusal]:
        earth = WGS84.raised(height_m)
        return [
            e if isinstance(e, Refusal) else scanner.attitude(
                e, day.position(ALTITUDE_KM), day.lvlh(), earth, NOISE_SHARE * float(np.max(s.value))
            )
            for e, day, s in zip(found[sky], days, signals[sky], strict=True)
        ]  # fmt: skip

    def mean_roll(height_m: float) -> float:
        return float(np.mean([f.roll_rad for f in fits("clear", height_m) if isinstance(f, ScannerFit)]))

    height = float(brentq(mean_roll, LOWEST_M, HIGHEST_M, xtol=1.0))
    answers = {sky: fits(sky, height) for sky in SKIES}
    claimed = [np.sqrt(np.diag(f.covariance)) for f in answers["clear"] if isinstance(f, ScannerFit)]
    nothing = (math.nan, math.nan)
    plateaus = {
        sky: np.array([e.plateaus if isinstance(e, ScanEdges) else nothing for e in those])
        for sky, those in found.items()
    }
    return BandErrors(
        error_deg={
            sky: np.degrees([(f.pitch_rad, f.roll_rad) if isinstance(f, ScannerFit) else nothing for f in fitted])
            for sky, fitted in answers.items()
        },
        sigma_deg=float(np.degrees(np.mean(claimed, axis=0)).max()),
        spare=sum(isinstance(e, ScanEdges) and e.spare > 0 for e in found["clouds"]),
        fall=1.0 - plateaus["clouds"] / plateaus["clear"],
    )


def quick(cache: TaskCache) -> Values:
    """Return all figures of a few places."""
    return _values(_measured(cache, QUICK_PLACES)[1])


def reproduce(cache: TaskCache) -> Result:
    """Make the scans and return figures, tables and pictures."""
    scans, errors = _measured(cache, PLACES)
    lines: list[tuple[str | float, ...]] = []
    for (band, kind), one in errors.items():
        clear, added = one.error_deg["clear"], one.added_deg
        for k, axis in enumerate(("pitch", "roll")):
            spread = (np.mean(clear[:, k]), np.std(clear[:, k]), np.nanmean(added[:, k]), np.nanstd(added[:, k]))
            lines.append((band, kind, axis, *map(float, spread), float(np.nanmax(np.abs(added[:, k])))))
    table = Table(
        f"Errors of {PLACES} scans [deg]",
        ("band", "threshold", "axis", "clear: mean", "clear: 1 sigma", "clouds add: mean", "1 sigma", "largest"),
        tuple(lines),
        "The mean of pitch in clear air is what the soft limb does to time constants that were calibrated on a step. "
        "Standard deviations of so few scans are good to 15 %.",
    )
    return Result(
        values=_values(errors),
        figures={"scans": partial(draw_scans, scans), "errors": partial(draw_errors, errors)},
        tables=(table,),
        settings={"altitude_km": ALTITUDE_KM, "inclination_deg": INCLINATION_DEG, "places": PLACES},
    )


Errors = Mapping[tuple[str, str], BandErrors]


def _measured(cache: TaskCache, places: int) -> tuple[dict[str, list[JsonObject]], Errors]:
    items = weather_places(places, INCLINATION_DEG, cache.seed)
    scans = {}
    for band in BANDS:
        wanted = {f"{name}, {band}": {**place, "band": band} for name, place in items.items()}
        scans[band] = list(cache.each(f"F: scans, {band}", scan, wanted).values())
    days = [WeatherPlace.of(item) for item in items.values()]
    return scans, {(band, kind): band_errors(scans[band], days, kind) for band in BANDS for kind in THRESHOLDS}


def _values(errors: Errors) -> Values:
    added = {key: one.deviation_deg(one.added_deg) for key, one in errors.items()}
    clear = {key: one.deviation_deg(one.error_deg["clear"]) for key, one in errors.items()}
    window = [(WINDOW, kind) for kind in THRESHOLDS]
    fall, pitch = errors[WINDOW, "fraction"].fall, errors[WINDOW, "fraction"].added_deg[:, 0]
    known = np.isfinite(pitch) & np.isfinite(fall).all(axis=1)
    correlation = float(np.corrcoef(pitch[known], (fall[:, 0] - fall[:, 1])[known])[0, 1])
    felt = [added[key] / errors[key].sigma_deg for key in window]
    return {
        "principal": [added[key] / clear[key] for key in window],
        "fixed": felt[0],
        "fraction": felt[1],
        "size": added[WINDOW, "fraction"],
        "added": list(added.values()),
        "clear": list(clear.values()),
        "ratio": [added[WINDOW, kind] / max(added[CO2, kind], 1e-9) for kind in THRESHOLDS],
        "correlation": abs(correlation),
        "spare": [float(errors[band, "fixed"].spare) for band in BANDS],
    }


def draw_scans(scans: Mapping[str, list[JsonObject]]) -> MplFigure:
    """The signal of the cloudiest scan in both bands, clear and under clouds."""
    figure = MplFigure(figsize=(9.0, 5.0), layout="constrained")
    cloudiest = int(np.argmax([one["covered"] for one in scans[WINDOW]]))
    panels = figure.subplots(2, 1, sharex=True)
    for axes, band in zip(panels, BANDS, strict=True):
        one = scans[band][cloudiest]
        for sky, style in (("clear", "--"), ("clouds", "-")):
            signal = signal_of(one, sky)
            axes.plot(np.degrees(signal.phase_rad), signal.value, style, color=COLOURS[band], lw=1.2, label=sky)
        axes.axhline(SCANNER.fraction * max(one["clear"]), color="#000000", lw=0.7, ls=":")
        axes.set(title=band, ylabel="W m⁻² sr⁻¹", ylim=(0.0, None))
        axes.legend(frameon=False, fontsize=8, loc="lower center")
    first, last = np.degrees([one["phase_rad"][0], one["phase_rad"][-1]])
    axes.set(xlabel="phase of the scan from the nadir's [deg]", xlim=(first - 6.0, last + 11.0))
    return figure


def draw_errors(errors: Errors) -> MplFigure:
    """Errors of all scans, clear and under clouds, pitch against roll."""
    figure = MplFigure(figsize=(9.0, 7.2), layout="constrained")
    for axes, ((band, kind), one) in zip(figure.subplots(2, 2).ravel(), errors.items(), strict=True):
        for sky, mark in (("clear", "o"), ("clouds", "x")):
            axes.plot(*one.error_deg[sky].T, mark, ms=4, mfc="none", color=COLOURS[band], label=sky)
        axes.axhline(0.0, color="#000000", lw=0.5)
        axes.axvline(0.0, color="#000000", lw=0.5)
        axes.set(title=f"{band}: {kind}", xlabel="pitch error [deg]", ylabel="roll error [deg]")
        axes.legend(frameon=False, fontsize=8)
    return figure
