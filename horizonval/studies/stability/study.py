"""From the profiles of all months to heights of the horizon and errors of attitude.

The sensors are calibrated once, over the whole study with equal weight for every month, position and head: edge
sensors to the mean height of their own edge, the field sensor's centre to the mean half-plateau height, its gain and
zero to the mean slope and output there. What is left after that is what the air does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.earth.spectral.thermal_accuracy import thermal_accuracy
from horizonval.spec.stability import EdgeSensor, FieldSensor, StabilityBand, StabilitySpec
from horizonval.studies.stability.locate import Horizon, highest_crossing, locate
from horizonval.studies.stability.orbit import Heads, offsets_of_heights
from horizonval.studies.stability.profiles import LATITUDE_DEG, Profiles, heads_of
from horizonval.studies.stability.published import PUBLISHED
from horizonval.studies.stability.sensors import attitude_error, edge_excess, field_excess, field_output, interpolate

RESULT_SCHEMA = 1
_DECIMALS = 6
"""1 mm, 4 milliarcsec, 1e-6 W m-2 sr-1."""


def conclude(spec: StabilitySpec, profiles: Mapping[tuple[str, int], Profiles]) -> JsonObject:
    """Return the study's result as plain data, rounded to six decimals.

    Parameters
    ----------
    spec : StabilitySpec
    profiles : mapping of (band, month) to Profiles
        All of them.
    """
    heads = heads_of(spec)
    some = next(iter(profiles.values()))
    offset = offsets_of_heights(heads, some.height_m)
    latitude = np.degrees(np.arcsin(heads.r_itrs[:, 2] / np.linalg.norm(heads.r_itrs, axis=-1)))
    bands = [
        _band(spec, band, [profiles[band.name, month] for month in spec.months], heads, offset) for band in spec.band
    ]
    return {
        "schema": RESULT_SCHEMA,
        "altitude_km": spec.altitude_km,
        "inclination_deg": spec.inclination_deg,
        "first_head_deg": spec.first_head_deg,
        "requirement_deg": list(spec.requirement_deg),
        "months": list(spec.months),
        "latitude_deg": LATITUDE_DEG.tolist(),
        "height_km": _plain(some.height_m / 1e3),
        "argument_deg": _plain(np.degrees(heads.argument_rad)),
        "satellite_latitude_deg": _plain(latitude),
        "deg_per_km": _plain(np.degrees(np.mean(_slope_rad_per_m(some.height_m, offset))) * 1e3),
        "bands": bands,
        "published": [asdict(item) for item in PUBLISHED if item.altitude_km in (None, spec.altitude_km)],
    }


def digest(result: Mapping[str, Any]) -> JsonObject:
    """Return the few figures of a result that a summary holds."""
    return {
        "bands": [
            {
                "name": band["name"],
                "kind": band["kind"],
                "half_km": band["half_statistics"],
                "gradient_km": band["gradient_statistics"],
                "plateau_w_m2_sr": band["plateau_statistics"],
                "sensors": [
                    {key: value for key, value in sensor.items() if key not in ("pitch_deg", "roll_deg")}
                    for sensor in band["sensors"]
                ],
            }
            for band in result["bands"]
        ],
        "published": [{key: item[key] for key in ("text", "low", "high", "source")} for item in result["published"]],
    }


def rows(result: Mapping[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """Return the header and the lines of a table with every position: one line per band, month and position."""
    names = [sensor["name"] for sensor in result["bands"][0]["sensors"]]
    header = ["band", "month", "argument_deg", "latitude_deg"]
    header += [f"{axis}_{name}_deg" for name in names for axis in ("pitch", "roll")]
    lines = []
    for band in result["bands"]:
        for i, month in enumerate(result["months"]):
            for j, argument in enumerate(result["argument_deg"]):
                errors = [s[axis][i][j] for s in band["sensors"] for axis in ("pitch_deg", "roll_deg")]
                lines.append([band["name"], month, argument, result["satellite_latitude_deg"][j], *errors])
    return header, lines


def _band(
    spec: StabilitySpec, band: StabilityBand, months: Sequence[Profiles], heads: Heads, offset: FloatArray
) -> JsonObject:
    height = months[0].height_m
    seen = np.stack([p.orbit for p in months])
    orbit = locate(height, seen)
    parallels = locate(height, np.stack([p.parallels for p in months]))
    return {
        "name": band.name,
        "lo_um": band.lo_um,
        "hi_um": band.hi_um,
        "kind": orbit.kind,
        "examples": _examples(spec, np.stack([p.parallels for p in months])),
        "half_km": _plain(parallels.half_m / 1e3),
        "gradient_km": _plain(parallels.gradient_m / 1e3),
        "plateau_w_m2_sr": _plain(parallels.plateau),
        "half_statistics": _statistics(parallels.half_m / 1e3),
        "gradient_statistics": _statistics(parallels.gradient_m / 1e3),
        "plateau_statistics": _statistics(parallels.plateau),
        "spectroscopy_km": thermal_accuracy(band.band).half_height_km,
        "variation": _plain(_variation(parallels.plateau)),
        "sensors": [_sensor(sensor, height, seen, orbit, heads, offset) for sensor in spec.sensor],
    }


def _sensor(
    sensor: EdgeSensor | FieldSensor,
    height: FloatArray,
    radiance: FloatArray,
    orbit: Horizon,
    heads: Heads,
    offset: FloatArray,
) -> JsonObject:
    """Errors of one sensor in one band; ``radiance`` and ``orbit`` are per month, position and head."""
    every = np.broadcast_to(offset, radiance.shape)
    calibration: dict[str, float]
    if isinstance(sensor, EdgeSensor):
        calibration = {}
        if sensor.locator == "threshold":
            level = 0.5 * float(np.mean(orbit.plateau))
            edge = highest_crossing(height, radiance, level)
            calibration["threshold_w_m2_sr"] = level
        else:
            edge = orbit.half_m if sensor.locator == "half" else orbit.gradient_m
        nominal = float(np.mean(edge))
        excess = edge_excess(edge, nominal, height, every)
        calibration["height_km"] = nominal / 1e3
        calibration["std_km"] = float(np.std(edge)) / 1e3
    else:
        nominal = float(np.mean(orbit.half_m))
        centre = interpolate(nominal, height, every)
        output, slope = field_output(centre, math.radians(sensor.field_deg), every, radiance)
        zero, gain = float(np.mean(output)), float(np.mean(slope))
        excess = field_excess(output, zero, gain)
        calibration = {"height_km": nominal / 1e3, "output_w_m2_sr": zero, "slope_w_m2_sr_per_deg": math.radians(gain)}
    pitch, roll = (np.degrees(angle) for angle in attitude_error(excess, heads.azimuth_rad))
    return {
        "name": sensor.name,
        **sensor.model_dump(exclude={"name"}),
        "calibration": {key: _plain(value) for key, value in calibration.items()},
        "max_pitch_deg": _plain(np.max(np.abs(pitch))),
        "rms_pitch_deg": _plain(np.sqrt(np.mean(pitch**2))),
        "max_roll_deg": _plain(np.max(np.abs(roll))),
        "rms_roll_deg": _plain(np.sqrt(np.mean(roll**2))),
        "pitch_deg": _plain(pitch),
        "roll_deg": _plain(roll),
    }


def _examples(spec: StabilitySpec, parallels: FloatArray) -> list[JsonObject]:
    """Profiles over the equator and at 60 deg north, in the first month and half a year later where there is one."""
    first = spec.months[0]
    later = (first + 5) % 12 + 1
    places = [(0.0, first), (60.0, first), *([(60.0, later)] if later in spec.months else [])]
    rows = LATITUDE_DEG.tolist()
    return [
        {
            "latitude_deg": latitude,
            "month": month,
            "radiance_w_m2_sr": _plain(parallels[spec.months.index(month), rows.index(latitude)]),
        }
        for latitude, month in places
    ]


def _variation(plateau: FloatArray) -> float:
    """Largest less smallest, over the mean."""
    return float((plateau.max() - plateau.min()) / plateau.mean())


def _slope_rad_per_m(height: FloatArray, offset: FloatArray) -> FloatArray:
    """Angle per height between the ground and 60 km."""
    low, high = (interpolate(h, height, offset) for h in (0.0, 6e4))
    return (high - low) / 6e4


def _statistics(values: FloatArray) -> JsonObject:
    return {
        "min": _plain(values.min()),
        "max": _plain(values.max()),
        "mean": _plain(values.mean()),
        "std": _plain(values.std()),
    }


def _plain(values: Any) -> Any:
    """Return numbers as Python's own, rounded: the last bits depend on the machine, and nobody needs them."""
    rounded = np.round(np.asarray(values, dtype=np.float64), _DECIMALS) + 0.0
    return rounded.tolist()
