"""System E from frames: a pass of ENVISAT photographed from both stations, streak by streak, to directions.

``measure_pass`` renders both skies, exposes and measures every frame in worker processes, and hands back directions
with their covariances beside the exact ones. ``dimmed_frames`` finds out how faint the satellite may be. How good
they are, and why, is in :mod:`horizonval.systems.e.passes.rows`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry.orbit import ElementSet
from horizonval.spec.camera import CameraSpec
from horizonval.systems.e.ground import frames as cam
from horizonval.systems.e.ground.detection import NoDetection
from horizonval.systems.e.ground.frames import Frames, Pass, StationErrors, azimuth_elevation
from horizonval.systems.e.ground.reduction import measure, tangents
from horizonval.systems.e.ground.sky import ENVISAT, Sky, render_sky
from horizonval.systems.e.localisation.stations import Station
from horizonval.systems.task_cache import TaskCache

FRAMES_PER_ITEM = 24
VALID = "valid"
ALIKE = ((1.0, 1.0),)
"""Point spread as calibrated, a Gaussian as in the fit."""
BLUR = ((0.8, 1.1), (0.2, 2.2))
"""Shares of light and widths of the rendered point spread: a core a tenth wider than calibrated, a fifth in a wing of
twice that width. Set before any fit."""


@dataclass(frozen=True)
class StationPass:
    """Measurements of one station; NaN where ``status`` is not ``valid``.

    ``frames``: renders any exposure again; ``seconds``: shape (n,), nominal middles after the epoch; ``azimuth_rad``,
    ``elevation_rad``: shape (n,), without refraction and light time; ``covariance``: shape (n, 2, 2), claimed, and
    ``error_rad``: shape (n, 2), measured minus true, of (azimuth x cos elevation, elevation); ``centroid_error_px``,
    ``centroid_covariance_px2``, ``moment_error_px``: of the streak's middle, by the fit and by the first moment;
    ``pointing_rad``, ``clock_rad``: shape (n, 2), effects of mount and clock alone.
    """

    frames: Frames
    seconds: FloatArray
    status: tuple[str, ...]
    azimuth_rad: FloatArray
    elevation_rad: FloatArray
    covariance: FloatArray
    true_azimuth_rad: FloatArray
    true_elevation_rad: FloatArray
    error_rad: FloatArray
    centroid_error_px: FloatArray
    centroid_covariance_px2: FloatArray
    moment_error_px: FloatArray
    pointing_rad: FloatArray
    clock_rad: FloatArray
    magnitude: FloatArray
    satellite_e: FloatArray
    sky_e: FloatArray
    significance: FloatArray

    @property
    def station(self) -> Station:
        """Where it stands."""
        return self.frames.path.station

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which frames gave a direction, shape (n,)."""
        return np.array([s == VALID for s in self.status])


@dataclass(frozen=True)
class PassSetup:
    """A pass as plain data for worker processes."""

    elements: ElementSet
    stations: tuple[Station, ...]
    epoch_utc: datetime
    seconds: FloatArray
    seed: int


def measure_pass(
    cache: TaskCache,
    elements: ElementSet,
    stations: Sequence[Station],
    epoch_utc: datetime,
    seconds: FloatArray,
) -> tuple[StationPass, ...]:
    """Return every station's measurements in its frames.

    ``elements``: the true orbit; ``seconds``: shape (n,), middles of the exposures after the epoch.
    """
    scene = PassSetup(elements, tuple(stations), epoch_utc, np.asarray(seconds, float), cache.seed)
    skies = rendered_skies(cache, scene)
    items = {}
    for station in stations:
        for first in range(0, len(seconds), FRAMES_PER_ITEM):
            part = scene.seconds[first : first + FRAMES_PER_ITEM].tolist()
            items[f"{station.name} from {part[0]:g} s"] = frames_item(scene, station, skies[station.name], part)
    done = list(cache.each("satellite frames", expose_and_measure, items).values())
    per_station = len(done) // len(scene.stations)
    return tuple(
        _gathered(scene, station, skies[station.name], done[k * per_station : (k + 1) * per_station])
        for k, station in enumerate(scene.stations)
    )


def dimmed_frames(
    cache: TaskCache,
    passes: Sequence[StationPass],
    dimmer_mag: Sequence[float | None],
    frames: int = 8,
    blur: tuple[tuple[float, float], ...] = BLUR,
) -> dict[tuple[str, float | None], list[JsonObject]]:
    """Return results of some frames with a fainter satellite or none (None), by station and dimming.

    Each frame is as :func:`expose_and_measure` gives it.
    """
    items, keys = {}, []
    for one in passes:
        path, sky = one.frames.path, one.frames.sky.plain()
        scene = PassSetup(path.elements, (path.station,), path.epoch_utc, one.seconds, cache.seed)
        some = one.seconds[np.linspace(0, len(one.seconds) - 1, frames).round().astype(int)].tolist()
        for dimmer in dimmer_mag:
            keys.append((path.station.name, dimmer))
            items[f"{path.station.name} fainter by {dimmer}"] = frames_item(
                scene, path.station, sky, some, dimmer, blur
            )
    done = cache.each("fainter satellites", expose_and_measure, items).values()
    return {key: part["frames"] for key, part in zip(keys, done, strict=True)}


def rendered_skies(cache: TaskCache, scene: PassSetup, pixels: int = 33) -> dict[str, JsonObject]:
    """Return every station's sky as plain data, by the station's name; ``pixels`` squared."""
    times = [float(scene.seconds[0]), float(np.mean(scene.seconds[[0, -1]])), float(scene.seconds[-1])]
    items = {s.name: {**_place(scene, s), "times": times, "pixels": pixels} for s in scene.stations}
    return cache.each("twilight skies", sky_of, items)


def frames_item(
    scene: PassSetup,
    station: Station,
    sky: JsonObject,
    seconds: Sequence[float],
    dimmer_mag: float | None = 0.0,
    blur: tuple[tuple[float, float], ...] = BLUR,
) -> JsonObject:
    """Return the item of :func:`expose_and_measure` for some exposures; ``dimmer_mag`` None: no satellite."""
    return {
        **_place(scene, station),
        "sky": sky,
        "camera": cam.TRACKER,
        "seed": scene.seed,
        "seconds": list(seconds),
        "dimmer_mag": dimmer_mag,
        "blur": [list(part) for part in blur],
    }


def sky_of(item: JsonObject) -> JsonObject:
    """Render a station's sky."""
    path = _pass(item)
    return render_sky(path.station, path.epoch_utc, item["times"], cam.tracker().band[0], item["pixels"]).plain()


def expose_and_measure(item: JsonObject) -> JsonObject:
    """Expose and measure the frames of an item; per frame one list of numbers in the order of its ``columns``."""
    frames = frames_of(item)
    return {"frames": [_one(frames, second) for second in item["seconds"]]}


def frames_of(item: JsonObject) -> Frames:
    """Return the exposures an item describes."""
    camera = CameraSpec.model_validate(item["camera"])
    dimmer = float("inf") if item["dimmer_mag"] is None else item["dimmer_mag"]
    blur = tuple((float(share), float(width)) for share, width in item["blur"])
    return Frames(_pass(item), Sky.of_plain(item["sky"]), camera, ENVISAT, StationErrors(), item["seed"], dimmer, blur)


def _one(frames: Frames, second: float) -> JsonObject:
    exposure = frames.expose(second)
    known = {
        "second": second,
        "magnitude": min(exposure.magnitude, 99.0),
        "satellite_e": exposure.satellite_e,
        "sky_e": exposure.sky_e,
    }
    sighting = measure(frames, exposure)
    if isinstance(sighting, NoDetection):
        return {**known, "status": sighting.why.value, "significance": sighting.significance}
    true = frames.path.geometric_enu(second)
    azimuth, elevation = (float(a) for a in azimuth_elevation(true))
    across = np.stack(tangents(azimuth, elevation))
    seen = np.stack(tangents(*map(float, exposure.read_az_el_rad)))
    # A turn w of the camera's axes moves what is on the boresight by w x z = (w_y, -w_x): to the right, and upwards.
    turn_x, turn_y = exposure.pointing_rad[:2]
    pointing = across @ (seen.T @ np.array([turn_y, turn_x]))
    fit = sighting.detection.fit
    middle = exposure.path_uv[1]
    return {
        **known,
        "status": VALID,
        "significance": sighting.detection.significance,
        "azimuth_rad": sighting.azimuth_rad,
        "elevation_rad": sighting.elevation_rad,
        "covariance": sighting.covariance.tolist(),
        "centroid_error_px": (np.array(fit.middle_uv) - middle).tolist(),
        "centroid_covariance_px2": fit.covariance[:2, :2].tolist(),
        "moment_error_px": (np.array(sighting.detection.moment_uv) - middle).tolist(),
        "pointing_rad": pointing.tolist(),
        "clock_rad": (sighting.rate_rad_s * exposure.clock_s).tolist(),
    }


def _gathered(scene: PassSetup, station: Station, sky: JsonObject, parts: list[JsonObject]) -> StationPass:
    frames = [frame for part in parts for frame in part["frames"]]
    n = len(frames)

    def column(name: str, *shape: int) -> FloatArray:
        return np.array([frame.get(name, np.full(shape, np.nan)) for frame in frames], float).reshape(n, *shape)

    path = Pass(scene.elements, station, scene.epoch_utc)
    azimuth, elevation = azimuth_elevation(path.geometric_enu(scene.seconds))
    measured_az, measured_el, covariance = column("azimuth_rad"), column("elevation_rad"), column("covariance", 2, 2)
    turn = np.mod(measured_az - azimuth + np.pi, 2 * np.pi) - np.pi
    return StationPass(
        frames=frames_of(frames_item(scene, station, sky, [])),
        seconds=scene.seconds,
        status=tuple(frame["status"] for frame in frames),
        azimuth_rad=measured_az,
        elevation_rad=measured_el,
        covariance=covariance,
        true_azimuth_rad=azimuth,
        true_elevation_rad=elevation,
        error_rad=np.stack([turn * np.cos(elevation), measured_el - elevation], axis=1),
        centroid_error_px=column("centroid_error_px", 2),
        centroid_covariance_px2=column("centroid_covariance_px2", 2, 2),
        moment_error_px=column("moment_error_px", 2),
        pointing_rad=column("pointing_rad", 2),
        clock_rad=column("clock_rad", 2),
        magnitude=column("magnitude"),
        satellite_e=column("satellite_e"),
        sky_e=column("sky_e"),
        significance=column("significance"),
    )


def _place(scene: PassSetup, station: Station) -> JsonObject:
    return {
        "elements": [scene.elements.line1, scene.elements.line2],
        "station": {field.name: getattr(station, field.name) for field in fields(station)},
        "epoch_utc": scene.epoch_utc.isoformat(),
    }


def _pass(item: JsonObject) -> Pass:
    place: dict[str, Any] = item["station"]
    return Pass(ElementSet(*item["elements"]), Station(**place), datetime.fromisoformat(item["epoch_utc"]))
