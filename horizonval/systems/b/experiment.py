"""System B: the local vertical from two perpendicular visible cameras (Belokonov, Lomaka and others).

The error map of the two cameras over a sphere, the readings of "end points of the arc", an orbit in and out of the
shadow with an infrared pair of the same geometry, and the Sun in the forward frame. The test bench is in
:mod:`horizonval.systems.b.bench`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure as MplFigure
from scipy import stats

import horizonval as hv
from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.limb.arc import find_arc
from horizonval.estimation.methods.video_vertical import ESTIMATOR, ChordEnds, solve
from horizonval.geometry.rotation import angle_between
from horizonval.suites.observation import observation_of_heads
from horizonval.systems.b import bench
from horizonval.systems.entries import Result, Values
from horizonval.systems.task_cache import TaskCache
from horizonval.systems.weather_viewpoints import place_on_orbit

SHIPPED, WITH_GLARE = "vis-pair-1024-60deg", "vis-cmos-1024-60deg-full"
FIELD_DEG = 100.0
"""The source does not state its cameras. From 500 km the horizon is 22 deg below level boresights, and attitudes of 20
deg press it to 42 deg."""
REGION_DEG, LIMIT_DEG = 20.0, 1.0
STEP_DEG, LARGEST_DEG = 10.0, 30.0
ORBIT_PLACES, INCLINATION_DEG, NODE_DEG = 12, 97.4, 15.0
"""The node, an hour past local noon at 12:00 UTC, leaves a third of the orbit in shadow."""
ORBIT_KM, TILT_DEG = 400.0, 4.0
VIEWS, ZENITH_DEG = 24, (60.0, 111.0)
HEADING_DEG, AZIMUTH_DEG = 90.0, (60.0, 120.0)
"""The forward camera looks to 90 deg and sees 50 deg to either side."""
LENSES, EXPOSURES = ("clean", "good", "ordinary"), ("fixed", "automatic")
ORDINARY = {"scattered": 0.05, "ghost": 1e-3, "stray": 10.0}
"""5 % scatter (good lens: 0.3 %), ghosts of 1e-3 (1e-4), ten times the stray light."""
INFRARED: JsonObject = {
    "band": [{"name": "co2", "kind": "thermal", "lo_um": 14.0, "hi_um": 16.3}],
    "optics": {"f_number": 1.0, "transmission": 1.0, "psf_sigma_px": 0.6},
    "detector": {"kind": "microbolometer", "pixel_pitch_um": 12.0, "netd_k": 0.25, "bits": 14, "scene_min_k": 0.0,
                 "scene_max_k": 400.0},
}  # fmt: skip
"""A bolometer behind the same geometry; 0.25 K is what 0.05 K in 8 to 14 um become in this band."""
GUARDED = "guarded-video-vertical"
READINGS = (*(ends.name for ends in ChordEnds),)


def pair(width: int, **tables: Any) -> JsonObject:
    """Return the shipped pair with another size and the field of 100 deg; ``tables`` replace whole tables."""
    changed = hv.Camera.from_file(SHIPPED).changed(camera={"width": width, "height": width, "fov_deg": FIELD_DEG})
    return {**changed.to_dict(), **tables}


def images_of(item: JsonObject) -> list[hv.Frame]:
    """Return the rendered frames of both heads."""
    camera = hv.Camera.from_dict(item["camera"])
    return [hv.render(hv.Scene(camera=camera, head=head, **item["scene"]), progress=False) for head in camera.heads]


def error_deg(answer: hv.Fit | hv.Refusal, image: hv.Image) -> float | None:
    """Return the angle from the claimed to the geocentric nadir; None for a refusal."""
    if isinstance(answer, hv.Refusal):
        return None
    return math.degrees(angle_between(np.array(image.truth.nadir_geocentric_cam), answer.nadir_cam))


def attitude_view(item: JsonObject) -> JsonObject:
    """Return errors [deg] by reading of the end points, and how far circles miss the arcs' pixels [px]."""
    images = [frame.observe(seed=item["seed"]) for frame in images_of(item)]
    observation = observation_of_heads({str(one.truth.head): one for one in images}, ESTIMATOR)
    errors = {ends.name: error_deg(solve(observation, ends), images[0]) for ends in ChordEnds}
    arcs = [find_arc(one.dn.astype(np.float64), float(one.full_scale)) for one in images]
    off = [arc.circle.distance_px(arc.uv).tolist() for arc in arcs if not isinstance(arc, hv.Refusal)]
    return {"errors": errors, "circle": [px for arc in off for px in arc]}


def orbit_view(item: JsonObject) -> JsonObject:
    """Return errors [deg] at one place, as published and behind the guard, and how much of the Sun is visible."""
    images = [frame.observe(seed=item["seed"]) for frame in images_of(item)]
    found = {name: error_deg(hv.estimate(images, name), images[0]) for name in ("video-vertical", GUARDED)}
    return {**found, "lit": images[0].truth.sun_visible_fraction}


def sun_view(item: JsonObject) -> JsonObject:
    """Return error [deg], and saturated share of the forward frame, by lens and exposure."""
    frames = images_of(item)
    found: JsonObject = {}
    for name, camera in item["cameras"].items():
        images = [frame.observe(seed=item["seed"], camera=camera) for frame in frames]
        forward = images[-1]
        grey = forward.dn[::4, ::4] / forward.full_scale
        found[name] = {
            "error": error_deg(hv.estimate(images, "video-vertical"), images[0]),
            "saturated": float(np.mean(forward.dn >= forward.full_scale)),
            "picture": np.rint(255.0 * np.sqrt(grey)).astype(int).tolist() if item["picture"] else None,
        }
    return found


def lens_optics(lens: str) -> JsonObject:
    """Return the optics of the shipped camera with glare, or of an ordinary lens with a leaking baffle."""
    optics: JsonObject = hv.Camera.from_file(WITH_GLARE).to_dict()["optics"]
    if lens == "ordinary":
        optics["scatter"] |= {"tis": ORDINARY["scattered"]}
        optics["ghost"] = [one | {"ratio": ORDINARY["ghost"]} for one in optics["ghost"]]
        optics["stray"] |= {"pst": [ORDINARY["stray"] * share for share in optics["stray"]["pst"]]}
    return optics


def attitude_items(cache: TaskCache, attitudes: Sequence[tuple[float, float]], width: int = 1024) -> JsonObject:
    """Return views of an airless sphere under an overhead Sun, by attitude.

    The source's pitch tilts the longitudinal axis (body z) about y; its yaw, the tilt across that, is a roll about x.
    """
    sphere: JsonObject = {
        "altitude_km": 500.0,
        "earth": {"shape": "sphere"},
        "atmosphere": {"profile": "none"},
        "sun": {"zenith_deg": 0.0, "azimuth_deg": 0.0},
        "render": {"nodes": 8},
    }
    return {
        f"pitch {pitch:g}, yaw {yaw:g}": {
            "camera": pair(width),
            "scene": {**sphere, "pitch_deg": pitch, "roll_deg": yaw},
            "seed": cache.seed,
        }
        for pitch, yaw in attitudes
    }


def orbit_items(cache: TaskCache, camera: JsonObject) -> JsonObject:
    """Return views of a pair once round an orbit, roll and pitch within 4 deg, any yaw."""
    tilts = cache.rng("B", "orbit").uniform(-1.0, 1.0, (ORBIT_PLACES, 3)) * (TILT_DEG, TILT_DEG, 180.0)
    items = {}
    for k, (pitch, roll, yaw) in enumerate(tilts.tolist()):
        argument = 360.0 * k / ORBIT_PLACES
        place = place_on_orbit(*np.radians([argument, INCLINATION_DEG, NODE_DEG]).tolist())
        scene: JsonObject = {"altitude_km": ORBIT_KM, "epoch_utc": "2026-03-20T12:00:00Z", **place}
        scene |= {"pitch_deg": pitch, "roll_deg": roll, "yaw_deg": yaw, "render": {"nodes": 32}}
        items[f"{argument:g}"] = {"camera": camera, "scene": scene, "seed": cache.seed}
    return items


def sun_items(cache: TaskCache) -> JsonObject:
    """Return views with the Sun in the forward frame, 1 to 52 deg over the limb."""
    cameras = {}
    for lens, exposure in product(LENSES, EXPOSURES):
        camera = pair(512) if lens == "clean" else pair(512, optics=lens_optics(lens))
        if exposure == "automatic":
            camera["detector"] = {**camera["detector"], "auto_exposure": {"min_s": 2e-6, "max_s": 5e-3}}
        cameras[f"{lens} lens, {exposure} exposure"] = camera
    low, high = np.array([ZENITH_DEG, AZIMUTH_DEG, (-TILT_DEG, TILT_DEG), (-TILT_DEG, TILT_DEG)]).T
    drawn = cache.rng("B", "Sun").uniform(low, high, (VIEWS, 4))
    drawn[:, 0] = np.linspace(*ZENITH_DEG, VIEWS)
    items = {}
    for k, (zenith, azimuth, pitch, roll) in enumerate(drawn.tolist()):
        scene = {"altitude_km": 500.0, "heading_deg": HEADING_DEG, "pitch_deg": pitch, "roll_deg": roll}
        scene |= {"sun": {"zenith_deg": zenith, "azimuth_deg": azimuth}, "render": {"nodes": 32}}
        items[f"view {k}, Sun {zenith:.0f} deg from the zenith"] = {
            "camera": pair(512), "cameras": cameras, "scene": scene, "seed": cache.seed, "picture": k % 8 == 5,
        }  # fmt: skip
    return items


def quick(cache: TaskCache) -> Values:
    """Return the errors of a pair of 512 pixels in one attitude."""
    found = cache.each("B: one attitude", attitude_view, attitude_items(cache, [(10.0, -20.0)], 512))
    return {"ends": [one["errors"][name] for one in found.values() for name in READINGS]}


def reproduce(cache: TaskCache) -> Result:
    """Repeat the published experiments."""
    axis = np.arange(-LARGEST_DEG, LARGEST_DEG + 1.0, STEP_DEG).tolist()
    attitudes = list(product(axis, axis))
    found = cache.each("B: map", attitude_view, attitude_items(cache, attitudes))
    errors = {name: _errors([one["errors"][name] for one in found.values()]) for name in READINGS}
    reach = np.abs(attitudes).max(axis=1)
    inside = reach <= REGION_DEG
    wrong = ~(errors["PIXEL"] < LIMIT_DEG)
    circle = np.array([off for one, near in zip(found.values(), inside, strict=True) if near for off in one["circle"]])
    visible = cache.each("B: orbit, visible", orbit_view, orbit_items(cache, pair(512)))
    infrared = cache.each("B: orbit, infrared", orbit_view, orbit_items(cache, pair(512, **INFRARED)))
    dark = np.array([one["lit"] < 0.5 for one in visible.values()])
    laps = {
        (band, name): _errors([one[name] for one in lap.values()])
        for band, lap in (("visible", visible), ("infrared", infrared))
        for name in ("video-vertical", GUARDED)
    }
    suns = list(cache.each("B: Sun in the frame", sun_view, sun_items(cache)).values())
    bench_values, bench_figures, bench_tables = bench.measure(cache)
    published, guarded = laps["visible", "video-vertical"], laps["visible", GUARDED]
    claimed = published[~np.isnan(published)]
    sun_values, sun_note = sun_figures(suns)
    values: Values = {
        "model_rms": rms(errors["PIXEL"][inside]),
        "circle": float(np.sqrt(np.mean(circle**2))),
        "region": float(reach[reach < reach[wrong].min(initial=math.inf)].max(initial=0.0)),
        "ends": [rms(errors[name][inside]) for name in READINGS],
        "shadow": float(np.mean(np.isnan(published[dark]))),
        "infrared": rms(guarded) / rms(laps["infrared", "video-vertical"]),
        "infrared_answers": float(np.mean(~np.isnan(guarded))),
        "orbit_rms": [rms(one) for one in laps.values()],
        "orbit_answered": [float(np.mean(~np.isnan(one))) for one in laps.values()],
        "orbit_wrong": float(np.mean(claimed > LIMIT_DEG)),
        **sun_values,
        **bench_values,
    }
    return Result(
        values=values,
        figures={
            "map": partial(draw_map, attitudes, errors["PIXEL"]),
            "orbit": partial(draw_orbit, dark, laps),
            "sun": partial(draw_sun, suns),
            **bench_figures,
        },
        tables=bench_tables,
        notes={"sun": sun_note, "shadow": f"{int(dark.sum())} of {ORBIT_PLACES} places"},
        settings={"field_deg": FIELD_DEG, "places": ORBIT_PLACES, "views": VIEWS},
    )


def sun_figures(suns: Sequence[JsonObject]) -> tuple[Values, str]:
    """Return the shares of views lost to a lens that are right through the clean one, and saturated shares."""
    right = {name: _errors([one[name]["error"] for one in suns]) <= LIMIT_DEG for name in suns[0]}
    lost, bounds = [], []
    for lens, exposure in product(LENSES[1:], EXPOSURES):
        clean = right[f"clean lens, {exposure} exposure"]
        gone = int(np.sum(clean & ~right[f"{lens} lens, {exposure} exposure"]))
        lost.append(gone / max(1, int(clean.sum())))
        bounds.append(stats.binomtest(gone, max(1, int(clean.sum()))).proportion_ci(0.95).high)
    saturated = [float(np.mean([one[name]["saturated"] for one in suns])) for name in suns[0]]
    wrong = [float(np.mean(~right[name])) for name in suns[0]]
    note = f"of the views that are right through the clean lens; upper 95 % bounds at most {max(bounds):.2f}"
    return {"sun": lost, "sun_saturated": saturated, "sun_wrong": wrong}, note


def rms(values: FloatArray) -> float:
    """Return the root mean square of what is finite."""
    return float(np.sqrt(np.nanmean(values**2)))


def _errors(values: Sequence[float | None]) -> FloatArray:
    return np.array([math.nan if value is None else value for value in values])


def draw_map(attitudes: Sequence[tuple[float, float]], errors: FloatArray) -> MplFigure:
    """Error over the attitudes; empty where there is no answer."""
    figure = MplFigure(figsize=(5.6, 4.8), layout="constrained")
    axes = figure.subplots()
    side = math.isqrt(len(attitudes))
    half = LARGEST_DEG + STEP_DEG / 2
    ends = (-half, half, -half, half)
    norm = LogNorm(0.01, 10.0, clip=True)
    image = axes.imshow(errors.reshape(side, side), origin="lower", extent=ends, cmap="YlOrRd", norm=norm)
    for (pitch, yaw), error in zip(attitudes, errors, strict=True):
        text = "–" if math.isnan(error) else f"{error:.3f}"
        axes.text(yaw, pitch, text, ha="center", va="center", fontsize=8)
    axes.plot(*(REGION_DEG * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])), "k--", lw=1.0)
    axes.set(xlabel="yaw [deg]", ylabel="pitch [deg]")
    figure.colorbar(image, ax=axes, label="error of the vertical [deg]")
    axes.grid(False)
    return figure


def draw_orbit(dark: np.ndarray, laps: Mapping[tuple[str, str], FloatArray]) -> MplFigure:
    """Error of the vertical once round the orbit; the shadow is grey."""
    figure = MplFigure(figsize=(8.0, 3.8), layout="constrained")
    axes = figure.subplots()
    argument = 360.0 * np.arange(len(dark)) / len(dark)
    half = 180.0 / len(dark)
    for u in argument[dark]:
        axes.axvspan(u - half, u + half, color="#cccccc", lw=0)
    for ((band, method), error), mark in zip(laps.items(), "oxs+", strict=True):
        colour = "#d55e00" if band == "visible" else "#0072b2"
        axes.semilogy(argument, error, mark, color=colour, mfc="none", ms=7, label=f"{band}, {method}")
    axes.axhline(LIMIT_DEG, color="#555555", lw=0.9, ls="--")
    axes.set(xlabel="argument of latitude [deg]", ylabel="error of the vertical [deg]", xlim=(-half, 360.0 - half))
    figure.legend(loc="outside lower center", ncols=2, fontsize=8)
    return figure


def draw_sun(suns: Sequence[JsonObject]) -> MplFigure:
    """Frames of the forward camera of some views through every lens with the fixed exposure."""
    shown = [one for one in suns if next(iter(one.values()))["picture"] is not None]
    names = [name for name in shown[0] if "fixed" in name]
    figure = MplFigure(figsize=(2.6 * len(shown), 2.8 * len(names)), layout="constrained")
    for row, name in zip(figure.subplots(len(names), len(shown), squeeze=False), names, strict=True):
        for axes, one in zip(row, shown, strict=True):
            axes.imshow(np.array(one[name]["picture"]), cmap="gray", vmin=0, vmax=255)
            error, saturated = one[name]["error"], one[name]["saturated"]
            answer = "no answer" if error is None else f"{error:.2f} deg"
            axes.set_title(f"{answer}, {saturated:.1%} saturated", fontsize=8)
            axes.set(xticks=[], yticks=[])
        row[0].set_ylabel(name)
    return figure
