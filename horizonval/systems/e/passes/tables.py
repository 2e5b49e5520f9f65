"""Tables of system E's frames: the error budget, what the stations see, fainter satellites; and what is in them."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.sun_and_moon import sun_itrs
from horizonval.systems.e.ground.frames import ARCSEC
from horizonval.systems.e.ground.ground_pass import azimuth_elevation
from horizonval.systems.e.ground.reduction import REFRACTION_RAD
from horizonval.systems.e.ground.refraction import true_elevation
from horizonval.systems.e.ground.satellite import magnitude
from horizonval.systems.e.localisation.stations import enu_directions
from horizonval.systems.e.passes.measured_pass import StationPass
from horizonval.systems.result import Cell, Table
from horizonval.systems.text import page_text

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
    sun, _ = sun_itrs(one.frames.path.epoch_utc + timedelta(seconds=float(np.mean(one.seconds))))
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
