"""System E from rendered frames: the measured directions of both stations through the same pipeline, and its budget.

The budget: the pipeline is run again on exact angles with one kind of error alone. What an error makes of the orbit is
linear at this size, so the squares of the parts add up to that of the whole but for their chance products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.systems.e import figures as pictures
from horizonval.systems.e.case import EPOCH_UTC, METHODS, QUANTITIES, STATIONS, exact_pass
from horizonval.systems.e.localisation.pipeline import PassPositions, TwoStationPass, locate
from horizonval.systems.e.localisation.stations import ARCSEC, celestial_errors, normalised_squares, rms
from horizonval.systems.e.passes.measured_pass import StationPass
from horizonval.systems.published import page_text
from horizonval.systems.result import Cell, ComparisonRow, Figure, Table

TEXT = page_text("E")
SHOWN_METHODS = ("plain", "proposed", "batch")


def located_from(passes: Sequence[StationPass]) -> tuple[PassPositions, TwoStationPass, NDArray[np.bool_]]:
    """Return the pipeline's result, what went in, and at which instants both stations had a direction, shape (n,)."""
    both = np.logical_and(*(one.valid for one in passes))
    angles = np.concatenate([np.stack([one.azimuth_rad, one.elevation_rad], axis=1) for one in passes], axis=1)
    measured = _pass_of(passes, both, angles[both])
    return locate(measured), measured, both


def _pass_of(passes: Sequence[StationPass], both: NDArray[np.bool_], angles: FloatArray) -> TwoStationPass:
    n = int(both.sum())
    spread, considered = np.zeros((n, 4, 4)), np.zeros((n, 4, 6))
    for i, one in enumerate(passes):
        constant = _consider_partials(one)[both]
        to_angle = np.eye(2) * np.stack([1.0 / np.cos(one.true_elevation_rad[both]), np.ones(n)], axis=1)[:, None, :]
        claimed = one.covariance[both] - constant @ np.swapaxes(constant, -1, -2)
        part = slice(2 * i, 2 * i + 2)
        spread[:, part, part] = to_angle @ claimed @ to_angle
        considered[:, part, 3 * i : 3 * i + 3] = to_angle @ constant
    return TwoStationPass(STATIONS, EPOCH_UTC, passes[0].seconds[both], angles, spread, considered)


def _consider_partials(one: StationPass) -> FloatArray:
    """Return the effect of a station's lasting errors on (azimuth x cos elevation, elevation), shape (n, 2, 3) [rad].

    They are the mount's model on both axes, and the clock along the satellite's motion.
    """
    errors = one.frames.errors
    rate = np.stack(
        [
            np.gradient(np.unwrap(one.true_azimuth_rad), one.seconds) * np.cos(one.true_elevation_rad),
            np.gradient(one.true_elevation_rad, one.seconds),
        ],
        axis=1,
    )
    mount = np.broadcast_to(errors.pointing_common_rad * np.eye(2), (len(rate), 2, 2))
    return np.concatenate([mount, errors.clock_common_s * rate[..., None]], axis=2)


def parts_of(one: StationPass) -> dict[str, FloatArray]:
    """Return a station's errors of direction by their cause, shape (n, 2) each [rad]."""
    pixel = np.array([1.0 / one.frames.geometry.fx, -1.0 / one.frames.geometry.fy])
    centroid = one.centroid_error_px * pixel
    rest = one.error_rad - centroid - one.pointing_rad - one.clock_rad
    return {
        "middle of the streak": centroid,
        "pointing": one.pointing_rad,
        "clock": one.clock_rad,
        "refraction, roll and the rest": rest,
    }


def budget(passes: Sequence[StationPass], both: NDArray[np.bool_]) -> dict[str, dict[str, FloatArray]]:
    """Return, for every cause, each method's errors, shape (3,), when nothing else is wrong."""
    truth = exact_pass()
    parts = [parts_of(one) for one in passes]
    out = {}
    for cause in parts[0]:
        angles = truth.angles_rad[both].copy()
        for i, one in enumerate(passes):
            error = parts[i][cause][both]
            angles[:, 2 * i] += error[:, 0] / np.cos(one.true_elevation_rad[both])
            angles[:, 2 * i + 1] += error[:, 1]
        out[cause] = errors_of(locate(_pass_of(passes, both, angles)), both)
    return out


def errors_of(located: PassPositions, both: NDArray[np.bool_]) -> dict[str, FloatArray]:
    """Return each method's root mean square errors, shape (3,)."""
    truth = exact_pass().r_gcrs[both]
    return {method: rms(celestial_errors(getattr(located, method), truth)) for method in METHODS}


def expected(r_gcrs: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return the root mean square errors, shape (3,), that covariances of positions (n, 3, 3) claim."""
    r = np.asarray(r_gcrs, float)
    distance, level = np.linalg.norm(r, axis=-1), np.hypot(r[:, 0], r[:, 1])
    up = r / distance[:, None]
    east = np.stack([-r[:, 1], r[:, 0], np.zeros(len(r))], axis=-1) / level[:, None]
    north = np.cross(up, east)
    # right ascension about the axis, declination on the meridian
    rows = np.stack([east / (level * ARCSEC)[:, None], north / (distance * ARCSEC)[:, None], up / 1e3], axis=1)
    return np.sqrt(np.mean(np.einsum("nij,njk,nik->ni", rows, covariances, rows), axis=0))


@dataclass(frozen=True)
class FromFrames:
    """What there is to say; ``summary`` are the numbers of the page's summary."""

    rows: tuple[ComparisonRow, ...]
    table: Table
    figure: Figure
    summary: dict[str, Any]


def frames_part_of(passes: Sequence[StationPass]) -> FromFrames:
    """Return the localisation from two stations' measured passes, with its budget."""
    located, _, both = located_from(passes)
    truth = exact_pass().r_gcrs[both]
    measured = errors_of(located, both)
    causes = budget(passes, both)
    claimed = {method: expected(truth, getattr(located, f"{method}_covariances")) for method in ("proposed", "batch")}
    rows = []
    for method in SHOWN_METHODS:
        for i, (quantity, unit) in enumerate(QUANTITIES):
            cause = max(causes, key=lambda cause: causes[cause][method][i])
            fields: dict[str, Any] = {"method": method, "quantity": quantity, "unit": unit, "cause": cause}
            fields["alone"] = causes[cause][method][i]
            key = "frames"
            if method in claimed:
                key, fields["claimed"] = "frames_claimed", claimed[method][i]
            rows.append(TEXT.row(key, float(measured[method][i]), **fields))
    squares = normalised_squares(located.batch, located.batch_covariances, truth)
    limit, residuals = float(stats.chi2.ppf(0.99, 3)), located.orbit.chi2_per_dof
    rows.append(
        TEXT.row("frames_covariance", float(squares[len(truth) // 2]), limit=limit, bound=limit, residuals=residuals)
    )
    errors = {m: celestial_errors(getattr(located, m), truth) for m in SHOWN_METHODS}
    times_s = passes[0].seconds[both]
    draw = partial(pictures.errors_against_time, errors, "directions from rendered frames", times_s)
    summary = {
        "used": int(both.sum()),
        "instants": len(both),
        "proposed": measured["proposed"],
        "batch": measured["batch"],
        "causes": sorted(causes, key=lambda cause: -float(causes[cause]["proposed"][0])),
    }
    return FromFrames(
        tuple(rows), _causes_table(causes, measured, claimed), TEXT.figure("frames-errors", draw), summary
    )


def _causes_table(
    causes: dict[str, dict[str, FloatArray]], measured: dict[str, FloatArray], claimed: dict[str, FloatArray]
) -> Table:
    def line(name: str, columns: dict[str, FloatArray]) -> list[Cell]:
        errors = [float(f"{columns[m][i]:.3g}") if m in columns else None for m in SHOWN_METHODS for i in range(3)]
        return [name, *errors]

    return TEXT.table(
        "causes",
        [
            *(line(f"{cause} alone", columns) for cause, columns in causes.items()),
            line("sum of squares", {m: np.sqrt(sum(c[m] ** 2 for c in causes.values())) for m in SHOWN_METHODS}),
            line("measured, all together", measured),
            line("claimed by the covariance", claimed),
        ],
    )
