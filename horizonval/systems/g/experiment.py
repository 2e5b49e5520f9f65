"""System G: a static quadrant sensor as a rain-measuring satellite had one, designed for 350 km and flown at 402.5 km.

Requirement and altitudes are the mission's. Layout (:mod:`horizonval.sensor.quadrant`) and sizes are ours, by rules
that see 350 km only:

*Middle.* Field A is where a level body sees the raised ellipsoid on average; the height is where the mean profile has
half of its plateau.

*Width.* The narrowest field in which the limb stays on the straight part of the curve. To either side it must hold a
tilt of 1 deg in both axes (sqrt 2 in a quadrant at 45 deg), 10 km of altitude with what they move the limb, and half of
the limb itself, from 90 to 10 % of its plateau::

    w / 2 = sqrt(2) tilt + |d eta / d h| dh + (eta_10 - eta_90) / 2

*Radiance* is marched in the vertical plane of each quadrant; over the quadrant's 20 deg of azimuth the profile is the
same function of the angle above the ellipsoid's horizon, which is exact at every azimuth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.figure import Figure as MplFigure
from scipy.interpolate import PchipInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, geocentric_nadir
from horizonval.geometry.frames import body_from_lvlh, inverse, north_east, rotate
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.sensor.quadrant import AZIMUTH_RAD, HALF_AZIMUTH_RAD, QuadrantFit, QuadrantSensor
from horizonval.systems.entries import Result, Table, Values, system
from horizonval.systems.task_cache import TaskCache
from horizonval.systems.weather_viewpoints import WeatherPlace, weather_places

GIVEN = system("G").given
DESIGN_KM, RAISED_KM = ALTITUDES_KM = GIVEN["altitude_km"], GIVEN["raised_km"]
REQUIREMENT_DEG = 0.18
PLACES, QUICK_PLACES = 96, 4
BAND_UM, NODES, HIGHEST_KM = (14.0, 16.0), 128, 410.0
OFFSET_DEG = np.array(
    [
        *(-14.0, -11.0, -9.0, -7.5, -6.0, -5.0, -4.0, -3.0, -2.25, -1.5, -1.0, -0.6, -0.3),
        *np.linspace(0.0, 2.6, 27),
        *(2.8, 3.0, 3.4),
    ]
)
"""Offsets of rays from the ellipsoid's horizon; above them is space, below them the disc continues unchanged."""
ETA_RAD = np.radians(np.arange(60.0, 84.001, 0.05))
"""Nadir angles in the body at which sectors are computed."""
ACROSS = np.array([-0.8, -0.4, 0.0, 0.4, 0.8]) * HALF_AZIMUTH_RAD
"""Middles of five equal parts of a quadrant."""
TILT_RAD, ALTITUDE_RANGE_M = math.radians(1.0), 10e3
PLATEAU_DEG = (-3.0, -0.3)
TILTS_DEG = ((0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5))
"""Pitch and roll: level, and half a degree in each axis."""
WIDTHS_DEG = (2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0, 8.0)
DRAWS = 500


def limb_profiles(item: JsonObject) -> JsonObject:
    """Return radiances (altitudes, quadrants, rays) of one day, by rays of :data:`OFFSET_DEG`."""
    from horizonval.renderer.rays import thermal_radiance

    place = WeatherPlace.of(item)
    observers, directions = [], []
    for altitude in ALTITUDES_KM:
        r = place.position(altitude)
        eta = expected_limb(place, altitude, WGS84)[:, None] + np.radians(OFFSET_DEG)
        d = np.cos(eta)[..., None] * geocentric_nadir(r) + np.sin(eta)[..., None] * _level(place)[:, None, :]
        directions.append(d)
        observers.append(np.broadcast_to(r, d.shape))
    shape = np.shape(directions)[:-1]
    rays = (np.reshape(one, (-1, 3)) for one in (observers, directions))
    model = place.model(HIGHEST_KM, BAND_UM)
    found = thermal_radiance(model, WGS84.a_m, *rays, polar_radius_m=WGS84.b_m, nodes=NODES)["band"]
    return {"radiance": np.reshape([float(f"{v:.7g}") for v in found], shape).tolist()}


def expected_limb(place: WeatherPlace, altitude_km: float, ellipsoid: Ellipsoid) -> FloatArray:
    """Return the nadir angles, shape (4,), at which a level body sees an ellipsoid's horizon in its quadrants."""
    r = place.position(altitude_km)
    north, east = north_east(r)
    level = _level(place)
    return horizon_by_azimuth(r, ellipsoid, np.arctan2(level @ east, level @ north))


def sectors(place: WeatherPlace, altitude_km: float, radiance: FloatArray, tilt_deg: tuple[float, float]) -> FloatArray:
    """Return the mean radiance over azimuth, shape (4, n), at the body's nadir angles :data:`ETA_RAD`.

    ``radiance``: shape (4, rays), of :func:`limb_profiles`; ``tilt_deg``: pitch and roll of the body.
    """
    r, lvlh = place.position(altitude_km), place.lvlh()
    north, east = north_east(r)
    pitch, roll = np.radians(tilt_deg)
    to_lvlh = inverse(body_from_lvlh(0.0, pitch, roll))
    out = np.empty((len(AZIMUTH_RAD), len(ETA_RAD)))
    places = np.radians(OFFSET_DEG)
    for k, azimuth in enumerate(AZIMUTH_RAD):
        eta, alpha = np.meshgrid(ETA_RAD, azimuth + ACROSS, indexing="ij")
        d_body = np.stack([np.sin(eta) * np.cos(alpha), np.sin(eta) * np.sin(alpha), np.cos(eta)], axis=-1)
        d = rotate(inverse(lvlh), rotate(to_lvlh, d_body.reshape(-1, 3)))
        x, y, z = d @ north, d @ east, d @ geocentric_nadir(r)
        offset = np.arctan2(np.hypot(x, y), z) - horizon_by_azimuth(r, WGS84, np.arctan2(y, x))
        seen = PchipInterpolator(places, radiance[k])(np.clip(offset, places[0], places[-1]))
        out[k] = np.where(offset > places[-1], 0.0, seen).reshape(eta.shape).mean(axis=1)
    return out


def _level(place: WeatherPlace) -> FloatArray:
    """Return the level unit vectors, shape (4, 3), of the quadrants of a level body, Earth-fixed."""
    lvlh = np.stack([np.cos(AZIMUTH_RAD), np.sin(AZIMUTH_RAD), np.zeros_like(AZIMUTH_RAD)], axis=-1)
    return rotate(inverse(place.lvlh()), lvlh)


@dataclass(frozen=True)
class MeanLimb:
    """Mean of level profiles at the design altitude.

    ``height_m``: at half of ``plateau`` [W m-2 sr-1]; ``half_rad``: half of the angle between 90 and 10 %.
    """

    height_m: float
    plateau: float
    half_rad: float

    @classmethod
    def of(cls, profiles: FloatArray) -> MeanLimb:
        """Return the mean limb of profiles (..., rays)."""
        mean = profiles.reshape(-1, len(OFFSET_DEG)).mean(axis=0)
        plateau = float(np.mean(mean[(PLATEAU_DEG[0] <= OFFSET_DEG) & (PLATEAU_DEG[1] >= OFFSET_DEG)]))
        # Above the ground the profile falls; np.interp wants rising values.
        limb = OFFSET_DEG >= 0.0
        tenth, half, most = np.interp(-plateau * np.array([0.1, 0.5, 0.9]), -mean[limb], np.radians(OFFSET_DEG[limb]))
        distance = WGS84.a_m + 1e3 * DESIGN_KM
        height = distance * math.sin(math.asin(WGS84.a_m / distance) + half) - WGS84.a_m
        return cls(float(height), plateau, 0.5 * float(tenth - most))

    @property
    def width_rad(self) -> float:
        """Narrowest width of field A by the rule."""
        distance = WGS84.a_m + 1e3 * DESIGN_KM
        per_m = WGS84.a_m / distance / math.sqrt(distance**2 - WGS84.a_m**2)
        return 2.0 * (math.sqrt(2.0) * TILT_RAD + per_m * ALTITUDE_RANGE_M + self.half_rad)


@dataclass(frozen=True)
class Days:
    """Places, and at each altitude [km] the sectors they see, shape (places, tilts, 4, n); the mean limb at 350 km."""

    places: Sequence[WeatherPlace]
    seen: Mapping[float, FloatArray]
    limb: MeanLimb

    def sensor(self, width_rad: float) -> QuadrantSensor:
        """Return the sensor of a width, calibrated on level bodies at 350 km."""
        raised = WGS84.raised(self.limb.height_m)
        true = np.array([expected_limb(place, DESIGN_KM, raised) for place in self.places])
        made = QuadrantSensor(float(np.mean(true)), width_rad, width_rad / 2.0 - self.limb.half_rad)
        return made.calibrated(ETA_RAD, self.seen[DESIGN_KM][:, 0], true)

    def fly(self, sensor: QuadrantSensor, altitude_km: float, *, all_quadrants: bool = False) -> Flight:
        """Return the errors at an altitude; ``all_quadrants``: also those out of range."""
        raised, sigma = WGS84.raised(self.limb.height_m), sensor.sigma_rad(self.limb.plateau)
        used = QuadrantSensor(sensor.limb_rad, sensor.width_rad, math.inf, sensor.gain_rad, sensor.zero)
        angles = (used if all_quadrants else sensor).limb_angles(ETA_RAD, self.seen[altitude_km])
        error = np.full((*angles.shape[:2], 2), np.nan)
        for i, place in enumerate(self.places):
            expected = expected_limb(place, altitude_km, raised)
            for j, tilt in enumerate(TILTS_DEG):
                fit = sensor.attitude(angles[i, j], expected, sigma)
                if isinstance(fit, QuadrantFit):
                    error[i, j] = np.degrees([fit.pitch_rad, fit.roll_rad]) - tilt
        return Flight(error, math.degrees(sigma) / math.sqrt(2.0), float(np.mean(np.isnan(angles))))


@dataclass(frozen=True)
class Flight:
    """Errors [deg] of pitch and roll, shape (places, tilts, 2), NaN where refused; noise; share of unused quadrants."""

    error_deg: FloatArray
    sigma_deg: float
    out_of_range: float

    @property
    def refused(self) -> float:
        """Share of readings without an answer."""
        return float(np.mean(np.isnan(self.error_deg[..., 0])))

    def three_sigma_deg(self, which: slice = slice(None)) -> float:
        """Return three times the rms error of the worse axis, noise included, of some tilts; NaN without answers."""
        return _three_sigma(self.error_deg[:, which], self.sigma_deg)

    def interval_deg(self) -> tuple[float, float]:
        """Return the 2.5 and 97.5 % points over sets of places sampled with replacement."""
        rng = np.random.default_rng(0)
        count = len(self.error_deg)
        drawn = [_three_sigma(self.error_deg[rng.integers(0, count, count)], self.sigma_deg) for _ in range(DRAWS)]
        low, high = np.nanpercentile(drawn, [2.5, 97.5])
        return float(low), float(high)

    @property
    def excess(self) -> float:
        """Factor by which the sensor misses the requirement, or the 1 % of refusals that it may have."""
        return max(np.nan_to_num(self.three_sigma_deg(), nan=math.inf) / REQUIREMENT_DEG, self.refused / 0.01)


def _three_sigma(error: FloatArray, sigma: float) -> float:
    squares = error.reshape(-1, 2) ** 2
    if np.isnan(squares).all():
        return math.nan
    return 3.0 * math.sqrt(float(np.nanmean(squares, axis=0).max()) + sigma**2)


def measured_days(cache: TaskCache, count: int) -> Days:
    """Return what the fields see on some days."""
    items = weather_places(count, GIVEN["inclination_deg"], cache.seed)
    made = cache.each("G: limbs", limb_profiles, items)
    profiles = np.array([one["radiance"] for one in made.values()])
    places = [WeatherPlace.of(item) for item in items.values()]
    seen = {
        km: np.array([[sectors(p, km, profiles[i, k], tilt) for tilt in TILTS_DEG] for i, p in enumerate(places)])
        for k, km in enumerate(ALTITUDES_KM)
    }
    return Days(places, seen, MeanLimb.of(profiles[:, 0]))


def quick(cache: TaskCache) -> Values:
    """Return all figures of a few days."""
    return _values(measured_days(cache, QUICK_PLACES))


def reproduce(cache: TaskCache) -> Result:
    """Design at 350 km, fly at both altitudes, and return figures, tables and pictures."""
    days = measured_days(cache, PLACES)
    flights = {
        (km, width): days.fly(days.sensor(math.radians(width)), km) for km in ALTITUDES_KM for width in WIDTHS_DEG
    }
    lines = [
        (
            km,
            width,
            *(None if math.isnan(x) else x for x in (one.three_sigma_deg(slice(1)), one.three_sigma_deg())),
            100.0 * one.out_of_range,
            100.0 * one.refused,
        )
        for (km, width), one in flights.items()
    ]
    table = Table(
        "Other widths of the field across the limb, designed for 350 km",
        (
            "altitude [km]",
            "width [deg]",
            "3 sigma, level [deg]",
            "3 sigma, up to 0.5 deg",
            "out of range [%]",
            "refused [%]",
        ),
        tuple(lines),
        "The range of a quadrant is half the width less half of the limb. A dash: no answer at all.",
    )
    sensor = days.sensor(days.limb.width_rad)
    low, high = days.fly(sensor, DESIGN_KM).interval_deg()
    return Result(
        values=_values(days),
        figures={"fields": partial(draw_fields, sensor, days.seen), "widths": partial(draw_widths, flights)},
        tables=(table,),
        notes={"requirement": f"95 % of such sets of days: {low:.3f} to {high:.3f}"},
        settings={"band_um": BAND_UM, "places": PLACES, "tilts_deg": TILTS_DEG},
    )


def _values(days: Days) -> Values:
    sensor = days.sensor(days.limb.width_rad)
    low, high = (days.fly(sensor, km) for km in ALTITUDES_KM)
    return {
        "requirement": low.three_sigma_deg(),
        "fate": high.excess,
        "width": math.degrees(sensor.width_rad),
        "middle": math.degrees(sensor.limb_rad),
        "raised": [high.three_sigma_deg(), days.fly(sensor, RAISED_KM, all_quadrants=True).three_sigma_deg()],
        "level": [one.three_sigma_deg(slice(1)) for one in (low, high)],
        "out_of_range": [low.out_of_range, high.out_of_range],
        "refused": [low.refused, high.refused],
    }


def draw_fields(sensor: QuadrantSensor, seen: Mapping[float, FloatArray]) -> MplFigure:
    """The mean limb in the body at both altitudes, over the fields."""
    figure = MplFigure(figsize=(9.0, 3.4), layout="constrained")
    axes = figure.subplots()
    for name, (low, high) in sensor.fields().items():
        axes.axvspan(*np.degrees([low, high]), color="#bbbbbb", alpha=0.6 if name == "A" else 0.3, lw=0.0)
        axes.annotate(name, (np.degrees(0.5 * (low + high)), 0.35), ha="center", fontsize=11)
    for (altitude, radiance), colour in zip(seen.items(), ("#0072b2", "#d55e00"), strict=True):
        low, mean, high = np.percentile(radiance[:, 0], [5, 50, 95], axis=(0, 1))
        axes.plot(np.degrees(ETA_RAD), mean, color=colour, label=f"{altitude:g} km")
        axes.fill_between(np.degrees(ETA_RAD), low, high, color=colour, alpha=0.2, lw=0.0)
    axes.set(xlabel="nadir angle in the body [deg]", ylabel="W m⁻² sr⁻¹", ylim=(0.0, None))
    axes.legend(frameon=False, fontsize=8)
    return figure


def draw_widths(flights: Mapping[tuple[float, float], Flight]) -> MplFigure:
    """Error and refusals against the width of the field across the limb."""
    figure = MplFigure(figsize=(9.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for km, colour in zip(ALTITUDES_KM, ("#0072b2", "#d55e00"), strict=True):
        shown = [flights[km, width] for width in WIDTHS_DEG]
        left.plot(WIDTHS_DEG, [one.three_sigma_deg() for one in shown], "o-", color=colour, label=f"{km:g} km")
        right.plot(WIDTHS_DEG, [100.0 * one.refused for one in shown], "s-", color=colour)
    left.axhline(REQUIREMENT_DEG, color="#000000", lw=0.9, ls="-.")
    left.set(xlabel="width of field A [deg]", ylabel="3 sigma [deg]", ylim=(0.0, None))
    right.set(xlabel="width of field A [deg]", ylabel="refused [%]")
    left.legend(frameon=False, fontsize=8)
    return figure
