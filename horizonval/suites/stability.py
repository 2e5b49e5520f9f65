"""Stability of the infrared horizon around an orbit and through the year, and its effect on a horizon sensor.

A suite with a table ``[stability]`` gets, besides the rows of its frames, the clear limb for every month: along
parallels, and as seen by four heads (forward, right, aft, left) from positions around the orbit. The radiances come
from the renderer's march; half plateau and steepest fall are defined as in a frame's truth
(:mod:`horizonval.truth.infrared_horizon`). The Earth does not rotate below the orbit: nothing depends on longitude.
Each month is a separate record, so that an interrupted run resumes::

    stability/<month>.json     profiles of all bands
    stability/result.json      for the report; its statistics are also in the summary

A horizon that a head sees too high by a small angle acts like a rotation of the body. Least squares over four heads, a
quarter turn apart, give::

    pitch = (aft - forward) / 2,    roll = (right - left) / 2

*Edge sensors* locate half of their plateau, the steepest fall, or a fixed radiance (half of the mean plateau). They
know the ellipsoid; the mean height of their edge is calibrated out. A *field sensor* measures the mean radiance in a
square field centred on the mean horizon; mean output and mean slope are calibrated out. All calibrations hold for the
whole year, so the variation of the air remains.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.core.code import code_digest
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.progress import Progress
from horizonval.earth.spectral.thermal_absorption import thermal_accuracy
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.frames import north_east
from horizonval.geometry.horizon import rays_along_parallels
from horizonval.jobs.engine import Done, Record, Recorded, do
from horizonval.jobs.pool import Execution
from horizonval.jobs.progress import Stopwatch
from horizonval.spec.camera import Band, CameraGeometry, CameraSpec
from horizonval.spec.earth import Atmosphere
from horizonval.spec.load import Suite
from horizonval.spec.pose import CameraUse, Platform
from horizonval.spec.scene import SceneName, SceneSpec
from horizonval.spec.suite import StabilitySpec
from horizonval.store.folder import RunFolder, write_json
from horizonval.truth import infrared_horizon
from horizonval.truth.infrared_radiance import angle_of_height, directions

if TYPE_CHECKING:
    from horizonval.earth.column import OpticalModel

LATITUDE_DEG = np.arange(-90.0, 91.0, 2.5)
"""Latitudes of the parallels."""
NODES = 128
"""Nodes of the march; half heights differ from those with 512 by at most 4 m."""
_HEIGHT_KM = (
    *(-10.0, -6.0, -3.0, -1.0, -0.05, 0.05, 0.5, 1.0, 1.5, 2.0, 2.5),
    *range(3, 56),
    *range(57, 72, 2),
    *(75.0, 80.0, 85.0, 90.0, 95.0, 100.0),
)
"""Lowest heights of the rays: four times as many move the half height by 4 m in carbon dioxide, 24 m in the windows.

Two rays straddle the ground, where a window's radiance may jump.
"""
_FAR_KM = 2e6
"""Range within which a scene's air includes every latitude."""
_DECIMALS = 6
"""Decimals for 1 mm, 4 milliarcsec, 1e-6 W m-2 sr-1: the last bits depend on the machine."""
_DIGITS = 8


class StabilityWork(Recorded[int]):
    """Months of a suite's study, in the folder of its run."""

    def __init__(self, spec: StabilitySpec, run: RunFolder) -> None:
        self.spec, self.run, self.folder = spec, run, run.root

    def name(self, item: int) -> str:
        return f"{item:02d}"

    def path(self, item: int) -> Path:
        return self.run.stability_case(self.name(item))

    def identity(self, item: int) -> str:
        content = json.dumps([self.spec.model_dump_json(), item, code_digest(__name__)])
        return hashlib.sha256(content.encode()).hexdigest()

    def record(self, item: int, watch: Stopwatch) -> Record:
        """March the profiles of a month."""
        with watch.stage("march"):
            found = month_profiles(self.spec, item)
        return {"month": item, "profiles": {name: [_digits(part) for part in parts] for name, parts in found.items()}}


def check(suite: Suite) -> None:
    """Refuse bands outside the absorption tables. Raises ``UserError``: naming the suite and the table."""
    if suite.stability is not None:
        try:
            month_model(suite.stability, suite.stability.months[0])
        except UserError as e:
            raise e.at(f"{suite.source}: stability.band") from e


def run_stability(
    spec: StabilitySpec, folder: RunFolder, execution: Execution, progress: Progress
) -> tuple[JsonObject | None, dict[str, Done[Record]]]:
    """March the missing months and write the result; return its statistics and the outcome of every month.

    The statistics are None if a month failed.
    """
    done = do(StabilityWork(spec, folder), spec.months, execution, progress, unit="months", what="infrared horizon")
    path = folder.stability / "result.json"
    records = [one.result for one in done.values() if one.result is not None]
    if len(records) < len(spec.months):
        path.unlink(missing_ok=True)
        return None, done
    result = conclude(spec, [record["profiles"] for record in records])
    write_json(path, result, indent=None)
    bands = [{key: value for key, value in band.items() if key != "profiles"} for band in result["bands"]]
    for band in bands:
        band["sensors"] = [{k: v for k, v in s.items() if not k.endswith("round_orbit_deg")} for s in band["sensors"]]
    return {"bands": bands}, done


def month_model(spec: StabilitySpec, month: int) -> OpticalModel:
    """Return the optical properties of all bands in mid-month. Raises ``UserError``: a band outside the tables."""
    from horizonval.earth.optical import optical_model

    scene = SceneSpec(
        scene=SceneName(name=f"stability-{month:02d}"),
        camera=CameraUse(file="stability"),
        platform=Platform(epoch_utc=datetime(2026, month, 16, tzinfo=UTC), altitude_km=_FAR_KM),
        atmosphere=Atmosphere(profile="by_latitude_month", month=month),
    )
    bands = [Band(name=band.name, kind="thermal", lo_um=band.lo_um, hi_um=band.hi_um) for band in spec.band]
    return optical_model(scene, CameraSpec(camera=CameraGeometry(width=1, height=1, fov_deg=1.0), band=bands))


def month_profiles(spec: StabilitySpec, month: int) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return clear limb radiances [W m-2 sr-1] of every band: round the orbit (p, 4, n), along parallels (m, n)."""
    from horizonval.renderer.rays import thermal_radiance

    position, azimuth = heads_round_orbit(spec)
    height, angle = heights_m(spec), nadir_angles(spec)
    direction = np.stack([directions(r, a[:, None], eta) for r, a, eta in zip(position, azimuth, angle, strict=True)])
    origin = np.broadcast_to(position[:, None, None, :], direction.shape)
    parallel_origin, parallel_direction = rays_along_parallels(np.radians(LATITUDE_DEG), height)
    # The Sun is across the orbit, outside all heads.
    inclination = math.radians(spec.inclination_deg)
    found = thermal_radiance(
        month_model(spec, month),
        WGS84.a_m,
        np.concatenate([origin.reshape(-1, 3), parallel_origin.reshape(-1, 3)]),
        np.concatenate([direction.reshape(-1, 3), parallel_direction.reshape(-1, 3)]),
        sun_itrs=(0.0, -math.sin(inclination), math.cos(inclination)),
        polar_radius_m=WGS84.b_m,
        nodes=NODES,
    )
    count = direction[..., 0].size
    return {
        name: (values[:count].reshape(direction.shape[:-1]), values[count:].reshape(len(LATITUDE_DEG), len(height)))
        for name, values in found.items()
    }


def heights_m(spec: StabilitySpec) -> FloatArray:
    """Return the lowest heights of a profile's rays, from below the field sensor's field to the top of the air."""
    distance_km = math.sqrt((spec.altitude_km + 6378.0) ** 2 - 6357.0**2)
    # Half a field below a horizon above the ground, plus a tenth.
    depth_km = 0.55 * math.radians(spec.field_deg) * distance_km
    # The disc is smooth below the horizon: six steps are enough.
    below = -np.linspace(depth_km, 10.0, 7)[:-1] if depth_km > 10.0 else np.zeros(0)
    return 1e3 * np.array([*below, *_HEIGHT_KM])


def heads_round_orbit(spec: StabilitySpec) -> tuple[FloatArray, FloatArray]:
    """Return positions [m], shape (p, 3), from the ascending node on, and the heads' azimuths [rad], (p, 4).

    Azimuths run from north to east about the geocentric nadir.
    """
    u = _arguments_rad(spec)
    inclination = math.radians(spec.inclination_deg)
    c, s, ci, si = np.cos(u), np.sin(u), math.cos(inclination), math.sin(inclination)
    up = np.stack([c, s * ci, s * si], axis=-1)
    forward = np.stack([-s, c * ci, c * si], axis=-1)
    right = np.cross(-up, forward)
    position = (WGS84.a_m + 1e3 * spec.altitude_km) * up
    azimuth = []
    for r, ahead, across in zip(position, forward, right, strict=True):
        north, east = north_east(r)
        level = np.stack([ahead, across, -ahead, -across])
        azimuth.append(np.arctan2(level @ east, level @ north))
    return position, np.array(azimuth)


def nadir_angles(spec: StabilitySpec) -> FloatArray:
    """Return the angles from the nadir [rad], shape (p, 4, n), of rays with the lowest heights of :func:`heights_m`."""
    heights = heights_m(spec)
    return np.stack(
        [angle_of_height(r, WGS84, a[:, None], heights) for r, a in zip(*heads_round_orbit(spec), strict=True)]
    )


def conclude(spec: StabilitySpec, months: Sequence[Mapping[str, Any]]) -> JsonObject:
    """Return the result as plain data, six decimals; ``months`` has the arrays of :func:`month_profiles` by band."""
    height, angle = heights_m(spec), nadir_angles(spec)
    bands = []
    for band in spec.band:
        orbit, parallels = (np.array([month[band.name][part] for month in months]) for part in (0, 1))
        kind, plateau, half, gradient = locate(height, parallels)
        thermal = Band(name=band.name, kind="thermal", lo_um=band.lo_um, hi_um=band.hi_um)
        bands.append(
            {
                "name": band.name,
                "lo_um": band.lo_um,
                "hi_um": band.hi_um,
                "kind": kind,
                "half_km": _statistics(half / 1e3),
                "gradient_km": _statistics(gradient / 1e3),
                "plateau_w_m2_sr": _statistics(plateau),
                "spectroscopy_km": thermal_accuracy(thermal).half_height_km,
                "sensors": sensors_of(height, angle, orbit, math.radians(spec.field_deg)),
                "profiles": {"half_km": _plain(half / 1e3), "gradient_km": _plain(gradient / 1e3)},
            }
        )
    return {
        "altitude_km": spec.altitude_km,
        "inclination_deg": spec.inclination_deg,
        "field_deg": spec.field_deg,
        "months": list(spec.months),
        "latitude_deg": LATITUDE_DEG.tolist(),
        "argument_deg": _plain(np.degrees(_arguments_rad(spec))),
        "bands": bands,
    }


def locate(height_m: FloatArray, radiance: FloatArray) -> tuple[str, FloatArray, FloatArray, FloatArray]:
    """Return the kind of horizon in profiles (months, ..., n); plateau, half height, steepest fall (months, ...).

    The kind, air or ground, is decided once for all profiles of a month; "mixed" if months differ.
    """
    shape = radiance.shape[:-1]
    below, above = int(np.argmin(np.abs(height_m - infrared_horizon.GROUND_RAY_M))), height_m > 0.0
    blocks = radiance.reshape(shape[0], -1, len(height_m))
    found = [infrared_horizon.locate(height_m[above], block[:, above], block[:, below]) for block in blocks]
    kinds = {one.kind for one in found}
    plateau, half, gradient = (
        np.stack([getattr(one, name) for one in found]).reshape(shape)
        for name in ("plateau", "half_plateau_m", "maximum_gradient_m")
    )
    return kinds.pop() if len(kinds) == 1 else "mixed", plateau, half, gradient


def highest_crossing(height_m: FloatArray, radiance: FloatArray, level: ArrayLike) -> FloatArray:
    """Return the largest height [m], shape (...), at which profiles (..., n) cross a level of shape (...).

    Profiles are monotone cubics between rays. One entirely below or above its level has the lowest or highest ray.
    """
    profiles = radiance.reshape(-1, len(height_m))
    found = np.empty(len(profiles))
    for i, goal in enumerate(np.broadcast_to(np.asarray(level, dtype=np.float64), radiance.shape[:-1]).ravel()):
        roots = PchipInterpolator(height_m, profiles[i]).solve(goal, extrapolate=False)
        # A constant interval at the level gives its start and a NaN.
        found[i] = np.nanmax(roots) if len(roots) else height_m[-1 if profiles[i, -1] >= goal else 0]
    return found.reshape(radiance.shape[:-1])


def sensors_of(height_m: FloatArray, angle_rad: FloatArray, radiance: FloatArray, field_rad: float) -> list[JsonObject]:
    """Return the attitude errors of three edge sensors and a field sensor in one band.

    Shapes: ``height_m`` (n,), ``angle_rad`` from the nadir (p, 4, n), ``radiance`` (months, p, 4, n). ``field_rad``:
    side of the field.
    """
    _, plateau, half, gradient = locate(height_m, radiance)
    threshold = highest_crossing(height_m, radiance, 0.5 * float(np.mean(plateau)))
    sensors = []
    for name, edge in (("edge-half", half), ("edge-gradient", gradient), ("edge-threshold", threshold)):
        mean = float(np.mean(edge))
        excess = _angles(edge, height_m, angle_rad) - _angles(np.full_like(edge, mean), height_m, angle_rad)
        sensors.append(_errors(name, excess) | {"height_km": _plain(mean / 1e3), "std_km": _plain(np.std(edge) / 1e3)})
    mean = float(np.mean(half))
    centre = _angles(np.full_like(half, mean), height_m, angle_rad)
    output, slope = field_output(centre, field_rad, np.broadcast_to(angle_rad, radiance.shape), radiance)
    # A raised field sees less Earth: its slope is negative.
    excess = (output - float(np.mean(output))) / -float(np.mean(slope))
    return [*sensors, _errors("field", excess) | {"height_km": _plain(mean / 1e3)}]


def field_output(
    centre_rad: FloatArray, width_rad: float, angle_rad: FloatArray, radiance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the mean radiance in square fields and its slope against the field's centre, shapes (...).

    Profiles, shape (..., n), are monotone cubics, integrated exactly; radiance above the last ray is 0. Neglected:
    curvature of the horizon across the field, 0.005 deg for 2 deg at 900 km, the same in all heads.
    """
    mean, slope = np.empty(centre_rad.shape), np.empty(centre_rad.shape)
    for i in np.ndindex(centre_rad.shape):
        angle, low, high = angle_rad[i], centre_rad[i] - width_rad / 2, centre_rad[i] + width_rad / 2
        if low < angle[0]:
            raise ValueError(f"the field reaches {angle[0] - low:g} rad below the profile")
        curve = PchipInterpolator(angle, radiance[i])
        mean[i] = curve.integrate(low, min(high, angle[-1])) / width_rad if low < angle[-1] else 0.0
        ends = [float(curve(end)) if end <= angle[-1] else 0.0 for end in (low, high)]
        slope[i] = (ends[1] - ends[0]) / width_rad
    return mean, slope


def attitude_error(excess_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return pitch and roll errors [rad], shape (...), of heads (..., 4) that see the horizon too high."""
    forward, right, aft, left = np.moveaxis(excess_rad, -1, 0)
    return (aft - forward) / 2, (right - left) / 2


def _errors(name: str, excess_rad: FloatArray) -> JsonObject:
    errors: JsonObject = {"name": name}
    for axis, angle in zip(("pitch", "roll"), np.degrees(attitude_error(excess_rad)), strict=True):
        errors[f"max_{axis}_deg"] = _plain(np.max(np.abs(angle)))
        errors[f"rms_{axis}_deg"] = _plain(np.sqrt(np.mean(angle**2)))
        errors[f"{axis}_round_orbit_deg"] = _plain(angle)
    return errors


def _angles(edge_m: FloatArray, height_m: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Return the nadir angles of edges (months, p, 4), linear between the rays of each head."""
    found = np.empty(edge_m.shape)
    for p, head in np.ndindex(edge_m.shape[1:]):
        found[:, p, head] = np.interp(edge_m[:, p, head], height_m, angle_rad[p, head])
    return found


def _arguments_rad(spec: StabilitySpec) -> FloatArray:
    return np.arange(spec.positions, dtype=np.float64) * (math.tau / spec.positions)


def _statistics(values: FloatArray) -> JsonObject:
    return {name: _plain(getattr(values, name)()) for name in ("min", "max", "mean", "std")}


def _plain(values: Any) -> Any:
    return (np.round(np.asarray(values, dtype=np.float64), _DECIMALS) + 0.0).tolist()


def _digits(values: FloatArray) -> Any:
    return [_digits(row) for row in values] if values.ndim > 1 else [float(f"{value:.{_DIGITS}g}") for value in values]
