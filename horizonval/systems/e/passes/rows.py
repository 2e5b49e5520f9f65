"""What the frames of system E are worth: rows, tables and figures from the measured passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry import clock
from horizonval.geometry.orbit import ElementSet
from horizonval.geometry.sun_and_moon import sun_itrs
from horizonval.systems.e.ground.frames import ARCSEC, azimuth_elevation, detector_of
from horizonval.systems.e.ground.reduction import REFRACTION_RAD
from horizonval.systems.e.ground.sky import ENVISAT, Sky, magnitude, standard_magnitude, true_elevation
from horizonval.systems.e.localisation.stations import Station, enu_directions
from horizonval.systems.e.passes import figures as figures
from horizonval.systems.e.passes.measured_pass import (
    ALIKE,
    BLUR,
    VALID,
    PassSetup,
    StationPass,
    dimmed_frames,
    measure_pass,
    rendered_skies,
)
from horizonval.systems.published import page_text
from horizonval.systems.result import Cell, ComparisonRow, Figure, Table
from horizonval.systems.task_cache import TaskCache

TEXT = page_text("E")


def refraction_left(one: StationPass) -> tuple[float, float]:
    """Return the refraction's mean over a pass, and the rms of what the observer's correction leaves [rad]."""
    air, correction = one.frames.air
    geometric = one.frames.path.retarded_enu(one.seconds)
    distance = np.linalg.norm(geometric, axis=-1)
    _, elevation = azimuth_elevation(geometric)
    _, lifted = azimuth_elevation(one.frames.path.apparent_enu(air, one.seconds))
    left = true_elevation(correction, lifted, distance) - elevation
    return float(np.mean(lifted - elevation)), float(np.sqrt(np.mean(left**2)))


def light_time_shift(one: StationPass) -> float:
    """Return the rms angle [rad] that the light time moves the satellite by."""
    path = one.frames.path
    now, then = path.geometric_enu(one.seconds), path.retarded_enu(one.seconds)
    across = np.linalg.norm(np.cross(now, then), axis=-1) / np.linalg.norm(now, axis=-1) / np.linalg.norm(then, axis=-1)
    return float(np.sqrt(np.mean(across**2)))


def sky_magnitude(one: StationPass, elevation_rad: float = np.pi / 2, azimuth_rad: float = 0.0) -> float:
    """Return the sky's magnitude per square arcsecond in the band (the Sun's colour) in mid-pass."""
    second = float(np.mean(one.seconds[[0, -1]]))
    towards = one.station.itrs_from_enu @ enu_directions(azimuth_rad, elevation_rad)
    radiance = float(one.frames.sky.radiance(towards, second))
    band = one.frames.camera.band[0]
    model = one.frames.model
    sun = sum(n.weight * n.solar_irradiance for n in model.nodes if n.band == band.name)
    return float(magnitude(radiance * ARCSEC**2 / sun))


def sun_elevation(one: StationPass) -> float:
    """Return the Sun's elevation in mid-pass [rad], without refraction."""
    sun, _ = sun_itrs(clock.utc_after(one.frames.path.epoch_utc, float(np.mean(one.seconds))))
    return float(azimuth_elevation(sun @ one.station.itrs_from_enu)[1])


def budget_table(passes: Sequence[StationPass]) -> Table:
    """Return the error budget: claimed and measured, root mean square of the two axes."""
    lines: list[tuple[Cell, ...]] = []

    def add(name: str, of: Sequence[tuple[float | None, float]]) -> None:
        lines.append((name, *(None if x is None else round(float(x / ARCSEC), 3) for pair in of for x in pair)))

    def rms(error: FloatArray) -> float:
        return float(np.sqrt(np.mean(error**2)))

    centroid: list[tuple[float, float]] = []
    moment: list[tuple[None, float]] = []
    pointing, clock, air, total = [], [], [], []
    for one in passes:
        v, e, px = one.valid, one.frames.errors, 1.0 / one.frames.geometry.fx
        claim = np.sqrt(np.mean(np.trace(one.centroid_covariance_px2[v], axis1=1, axis2=2)) / 2)
        centroid.append((float(claim) * px, rms(one.centroid_error_px[v]) * px))
        moment.append((None, rms(one.moment_error_px[v]) * px))
        pointing.append((float(np.hypot(e.pointing_rad, e.pointing_common_rad)), rms(one.pointing_rad[v])))
        late = float(np.hypot(e.clock_s, e.clock_common_s))
        rate = rms(np.linalg.norm(np.gradient(_unit(one), one.seconds, axis=0), axis=1)[:, None])
        clock.append((late * rate / np.sqrt(2.0), rms(one.clock_rad[v])))
        air.append((REFRACTION_RAD / np.sqrt(2.0), refraction_left(one)[1] / np.sqrt(2.0)))
        total.append(
            (float(np.sqrt(np.mean(np.trace(one.covariance[v], axis1=1, axis2=2)) / 2)), rms(one.error_rad[v]))
        )
    add("middle of the streak, fit", centroid)
    add("(middle of the streak, first moment)", moment)
    add("pointing: encoder and mount model", pointing)
    add("clock", clock)
    add("refraction left", air)
    add("direction in all", total)
    first, second = (one.station.name for one in passes)
    return TEXT.table("direction", lines, first=first, second=second)


def sky_table(passes: Sequence[StationPass]) -> Table:
    """Return the circumstances of every station."""
    lines: list[tuple[Cell, ...]] = []
    for one in passes:
        elevation = np.degrees(one.true_elevation_rad)
        lines.append(
            (
                one.station.name,
                round(float(np.degrees(sun_elevation(one))), 2),
                round(sky_magnitude(one), 2),
                round(float(np.mean(one.sky_e)), 2),
                f"{elevation.min():.1f} to {elevation.max():.1f}",
                f"{one.magnitude.min():.2f} to {one.magnitude.max():.2f}",
                f"{one.satellite_e.min():.0f} to {one.satellite_e.max():.0f}",
                round(refraction_left(one)[0] / ARCSEC, 1),
                round(light_time_shift(one) / ARCSEC, 2),
            )
        )
    return TEXT.table("circumstances", lines)


def faint_table(curve: dict[str, FloatArray]) -> Table:
    """Return how the share detected and the error of the middle go with the satellite's magnitude."""
    lines: list[tuple[Cell, ...]] = []
    for name, values in curve.items():
        for mag, share, rms, claim, wrong in values:
            pair = (None, None) if np.isnan(rms) else (round(float(rms), 4), round(float(claim), 4))
            lines.append((name, round(float(mag), 2), round(float(share), 3), *pair, round(float(wrong), 3)))
    return TEXT.table("faint", lines)


def _unit(one: StationPass) -> FloatArray:
    d = one.frames.path.geometric_enu(one.seconds)
    return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))


DIMMER_MAG = (0.0, 2.0, 4.0, 5.0, 5.5, 6.0, 6.5, 7.0, 8.0)
WRONG_PX = 3.0
"""A streak whose middle is farther than this from the satellite is something else."""
FINER_SKY = 65
EMPTY = 100
"""Exposures without the satellite, of each station: none wrong is a share below 3 % with 95 % confidence."""
COMPARED = 24
"""Exposures of each station that are rendered with the calibrated point spread as well."""


@dataclass(frozen=True)
class FramePart:
    """The frames' part of the reproduction."""

    passes: tuple[StationPass, ...]
    rows: tuple[ComparisonRow, ...]
    tables: tuple[Table, ...]
    figures: tuple[Figure, ...]


def frame_part(
    cache: TaskCache,
    elements: ElementSet,
    stations: Sequence[Station],
    epoch_utc: datetime,
    seconds: FloatArray,
) -> FramePart:
    """Return the passes from :func:`measure_pass` with everything there is to say about them."""
    passes = measure_pass(cache, elements, stations, epoch_utc, seconds)
    fainter = dimmed_frames(cache, passes, DIMMER_MAG)
    empty = dimmed_frames(cache, passes, (None,), EMPTY)
    alike = dimmed_frames(cache, passes, (0.0,), COMPARED, ALIKE)
    scene = PassSetup(elements, tuple(stations), epoch_utc, np.asarray(seconds, float), cache.seed)
    finer = rendered_skies(cache, scene, FINER_SKY)
    curve = faintness(passes, fainter)
    return FramePart(
        passes,
        tuple(_rows(passes, empty, alike, curve, finer)),
        (budget_table(passes), sky_table(passes), faint_table(curve)),
        figures.all_figures(passes, curve),
    )


def normalised(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the normalised error squared per degree of freedom, shape (n,), of errors (n, 2)."""
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0]) / 2.0)


def faintness(
    passes: Sequence[StationPass], fainter: dict[tuple[str, float | None], list[JsonObject]]
) -> dict[str, FloatArray]:
    """Return magnitude, share detected, error and claim of the middle [px rms], share wrong, (k, 5), by station."""
    out = {}
    for one in passes:
        lines = []
        for dimmer in DIMMER_MAG:
            frames = fainter[one.station.name, dimmer]
            found = [f for f in frames if f["status"] == VALID]
            errors = np.array([f["centroid_error_px"] for f in found]).reshape(-1, 2)
            right = np.hypot(*errors.T) < WRONG_PX
            claims = np.array([np.diag(f["centroid_covariance_px2"]) for f in found]).reshape(-1, 2)
            rms, claim = (float(np.sqrt(np.mean(x[right]))) if right.any() else np.nan for x in (errors**2, claims))
            mag = float(np.mean([f["magnitude"] for f in frames]))
            lines.append([mag, right.sum() / len(frames), rms, claim, (~right).sum() / len(frames)])
        out[one.station.name] = np.array(lines)
    return out


def _sky_error(one: StationPass, finer: JsonObject) -> float:
    """Return the largest relative difference between the sky used and one from a finer grid, above 45 deg."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 360, 5.0)), np.radians(np.arange(45.0, 90.0, 2.5)))
    towards = enu_directions(azimuth, elevation) @ one.station.itrs_from_enu.T
    second = float(np.mean(one.seconds))
    used, better = one.frames.sky.radiance(towards, second), Sky.of_plain(finer).radiance(towards, second)
    return float(np.max(np.abs(used / better - 1.0)))


def _rows(
    passes: Sequence[StationPass],
    empty: dict[tuple[str, float | None], list[JsonObject]],
    alike: dict[tuple[str, float | None], list[JsonObject]],
    curve: dict[str, FloatArray],
    finer: dict[str, JsonObject],
) -> list[ComparisonRow]:
    rows = []
    for one in passes:
        station, v = one.station.name, one.valid
        without = empty[station, None]
        calibrated = [f["centroid_error_px"] for f in alike[station, 0.0] if f["status"] == VALID]
        magnitude, share = curve[station][:, 0], curve[station][:, 1]
        seen = magnitude[share >= 0.5]
        pixel = 1.0 / one.frames.geometry.fx / ARCSEC
        middle_px = _rms(one.centroid_error_px[v])
        rows += [
            TEXT.row(
                "detected",
                float(np.mean(v)),
                limit=0.95,
                at_least=True,
                station=station,
                brightest=one.magnitude.min(),
                faintest=one.magnitude.max(),
                significance=np.nanmin(one.significance),
            ),
            TEXT.row(
                "false_detections",
                float(sum(frame["status"] == VALID for frame in without)),
                limit=0.0,
                station=station,
                frames=len(without),
                below=1.0 - 0.05 ** (1.0 / len(without)),
            ),
            TEXT.row(
                "direction",
                _rms_arcsec(one.error_rad[v]),
                station=station,
                pointing=_rms_arcsec(one.pointing_rad[v]),
                clock=_rms_arcsec(one.clock_rad[v]),
                middle=pixel * middle_px,
            ),
            TEXT.row(
                "direction_covariance",
                float(np.mean(normalised(one.error_rad[v], one.covariance[v]))),
                limit=0.75,
                against=1.25,
                station=station,
            ),
            TEXT.row(
                "middle_covariance",
                float(np.mean(normalised(one.centroid_error_px[v], one.centroid_covariance_px2[v]))),
                limit=0.75,
                against=1.25,
                station=station,
            ),
            TEXT.row(
                "middle",
                middle_px,
                station=station,
                pixel=pixel,
                electrons=one.satellite_e.mean(),
                alike=_rms(np.array(calibrated)),
                compared=len(calibrated),
                core=BLUR[0][1],
                wing=BLUR[1][0],
                wing_width=BLUR[1][1],
                read_noise=detector_of(one.frames.camera).read_noise_e,
            ),
            TEXT.row(
                "faintest" if seen.size else "faintest_unseen",
                float(seen.max()) if seen.size else float(magnitude[0]),
                station=station,
            ),
            TEXT.row("sky", sky_magnitude(one), station=station, sun_deg=np.degrees(sun_elevation(one))),
            TEXT.row(
                "sky_grid",
                _sky_error(one, finer[station]),
                limit=0.01,
                station=station,
                coarse=len(one.frames.sky.log_radiance[0]),
                finer=FINER_SKY,
            ),
        ]
    return [*rows, TEXT.row("standard_magnitude", standard_magnitude(ENVISAT))]


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _rms_arcsec(error_rad: FloatArray) -> float:
    return _rms(error_rad) / ARCSEC
