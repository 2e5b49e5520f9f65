"""What the frames of system E are worth: rows, tables and figures from the measured passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.tle import ElementSet
from horizonval.systems.e.frames import figures as figures
from horizonval.systems.e.frames.frames import (
    VALID,
    PassSetup,
    StationPass,
    dimmed_frames,
    measure_pass,
    rendered_skies,
)
from horizonval.systems.e.frames.tables import (
    budget_table,
    faint_table,
    sky_magnitude,
    sky_table,
    sun_elevation,
)
from horizonval.systems.e.ground.frames import ARCSEC
from horizonval.systems.e.ground.ground_camera import detector_of
from horizonval.systems.e.ground.satellite import ENVISAT, standard_magnitude
from horizonval.systems.e.ground.sky import Sky
from horizonval.systems.e.orbit.stations import Station, enu_directions
from horizonval.systems.result import ComparisonRow, Figure, Table
from horizonval.systems.task_cache import Plain, TaskCache

DIMMER_MAG = (0.0, 2.0, 4.0, 5.0, 5.5, 6.0, 6.5, 7.0, 8.0)
WRONG_PX = 3.0
"""A streak whose middle is farther than this from the satellite is something else."""
FINER_SKY = 65


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
    fainter = dimmed_frames(cache, passes, (*DIMMER_MAG, None))
    scene = PassSetup(elements, tuple(stations), epoch_utc, np.asarray(seconds, float), cache.seed)
    finer = rendered_skies(cache, scene, FINER_SKY)
    curve = faintness(passes, fainter)
    return FramePart(
        passes,
        tuple(_rows(passes, fainter, curve, finer)),
        (budget_table(passes), sky_table(passes), faint_table(curve)),
        figures.all_figures(passes, curve),
    )


def normalised(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the normalised error squared per degree of freedom, shape (n,), of errors (n, 2)."""
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0]) / 2.0)


def faintness(
    passes: Sequence[StationPass], fainter: dict[tuple[str, float | None], list[Plain]]
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


def _sky_error(one: StationPass, finer: Plain) -> float:
    """Return the largest relative difference between the sky used and one from a finer grid, above 45 deg."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 360, 5.0)), np.radians(np.arange(45.0, 90.0, 2.5)))
    towards = enu_directions(azimuth, elevation) @ one.station.itrs_from_enu.T
    second = float(np.mean(one.seconds))
    used, better = one.frames.sky.radiance(towards, second), Sky.of_plain(finer).radiance(towards, second)
    return float(np.max(np.abs(used / better - 1.0)))


def _rows(
    passes: Sequence[StationPass],
    fainter: dict[tuple[str, float | None], list[Plain]],
    curve: dict[str, FloatArray],
    finer: dict[str, Plain],
) -> list[ComparisonRow]:
    rows = []
    for one in passes:
        name, v = one.station.name, one.valid
        total = normalised(one.error_rad[v], one.covariance[v])
        middle = normalised(one.centroid_error_px[v], one.centroid_covariance_px2[v])
        empty = fainter[name, None]
        mags = curve[name]
        seen = mags[mags[:, 1] >= 0.5, 0]
        pixel = 1.0 / one.frames.geometry.fx / ARCSEC
        rows += [
            ComparisonRow(
                f"frames, {name}: share of exposures with a direction",
                None,
                float(np.mean(v)),
                "1",
                f"At magnitude {one.magnitude.min():.1f} to {one.magnitude.max():.1f} the matched filter answers "
                f"with at least {np.nanmin(one.significance):.0f} sigma against a threshold of 6.",
                limit=0.95,
                at_least=True,
            ),
            ComparisonRow(
                f"frames, {name}: false detections in exposures without the satellite",
                None,
                float(sum(f["status"] == VALID for f in empty)) / len(empty),
                "1",
                "Stars answer a filter for points more than that for the streak, and places near them are left out.",
                limit=0.05,
            ),
            ComparisonRow(
                f"frames, {name}: direction, rms of azimuth x cos(elevation) and elevation",
                None,
                _rms_arcsec(one.error_rad[v]),
                "arcsec",
                f"Pointing ({_rms_arcsec(one.pointing_rad[v]):.2f}) and clock ({_rms_arcsec(one.clock_rad[v]):.2f}) "
                f"make it; the middle of the streak adds {pixel * _rms(one.centroid_error_px[v]):.2f}.",
            ),
            ComparisonRow(
                f"frames, {name}: normalised error of the direction",
                None,
                float(np.mean(total)),
                "1",
                "1 for an honest covariance; the parts that stay the same for a pass make the mean scatter.",
                limit=0.75,
                against=1.25,
            ),
            ComparisonRow(
                f"frames, {name}: normalised error of the streak's middle",
                None,
                float(np.mean(middle)),
                "1",
                "1 for an honest covariance; faint stars under a streak, which it does not know of, raise it.",
                limit=0.75,
                against=1.25,
            ),
            ComparisonRow(
                f"frames, {name}: error of the streak's middle, rms",
                None,
                _rms(one.centroid_error_px[v]),
                "px",
                f"A pixel is {pixel:.1f} arcsec; {one.satellite_e.mean():.0f} electrons against a read noise of "
                f"{detector_of(one.frames.camera).read_noise_e:g}.",
            ),
            ComparisonRow(
                f"frames, {name}: faintest magnitude with half of the exposures measured",
                None,
                float(seen.max()) if seen.size else float(mags[0, 0]),
                "mag",
                "Read noise in the streak's area is the limit; in steps of the dimming."
                if seen.size
                else "At no magnitude were half of the exposures measured; this is the brightest one tried.",
            ),
            ComparisonRow(
                f"frames, {name}: sky at the zenith",
                None,
                sky_magnitude(one),
                "mag/arcsec2",
                f"The Sun stands at {np.degrees(sun_elevation(one)):.1f} deg; scattered sunlight of all orders, "
                "airglow and the sky behind.",
            ),
            ComparisonRow(
                f"frames, {name}: sky from the coarse grid against a finer one, largest difference above 45 deg",
                None,
                _sky_error(one, finer[name]),
                "1",
                f"Spline of the logarithm on {len(one.frames.sky.log_radiance[0])} against {FINER_SKY} pixels squared.",
                limit=0.01,
            ),
        ]
    rows.append(
        ComparisonRow(
            "frames: standard magnitude of the satellite (1000 km, half lit)",
            None,
            standard_magnitude(ENVISAT),
            "mag",
            "From its size, by a quarter of its surface, and albedos assumed so that it has what observers' lists say, "
            "about 3.7; no measurement of this suite.",
        )
    )
    return rows


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _rms_arcsec(error_rad: FloatArray) -> float:
    return _rms(error_rad) / ARCSEC
