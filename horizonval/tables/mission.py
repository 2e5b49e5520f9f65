"""Which profiles of the limb the frames of a suite or scene need, as one table for a flight computer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from horizonval.core import atomic
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.progress import Progress, Silent
from horizonval.earth.atmosphere.climate import month_of
from horizonval.earth.spectral import bands
from horizonval.estimation.fit.templates import LimbTemplates, shipped_templates
from horizonval.geometry.camera import camera_from_spec, project
from horizonval.geometry.ellipsoid import geodetic_from_itrs, surface_normal
from horizonval.geometry.frames import rotate
from horizonval.geometry.horizon import horizon_directions, tangency_points
from horizonval.geometry.pose import pose_from_spec
from horizonval.spec.camera import Band
from horizonval.spec.load import Case
from horizonval.tables.modes import MONTHS
from horizonval.tables.onboard import CutTable, LimbPlaces, cut_down, header_text, months_around
from horizonval.tables.uniform_air import UniformAir, sunlit_in, thermal_in
from horizonval.truth.frame_truth import truth_of

AROUND = 180
"""Places of the horizon that are looked at in every frame."""
MARGIN = 0.1
"""Of the image's size: by so much the limb may lie elsewhere than a frame has it."""
INSIDE_PX = 9.0
"""How deep inside the limb a fit looks, and a pixel more."""


@dataclass(frozen=True)
class MissionTable:
    """A table, the band it is for, and what it was cut from."""

    cut: CutTable
    band: Band
    whole: LimbTemplates
    frames: int
    text: str


def mission_table(
    cases: Sequence[Case],
    target: str,
    band_name: str | None,
    error: float,
    air: str | None = None,
    clear: bool = False,
    progress: Progress | None = None,
) -> MissionTable:
    """Return the table that frames need; parameters as for :func:`horizonval.api.estimate.mission_table`."""
    band = _band_of(cases, band_name, target)
    cases = tuple(case for case in cases if any(b.name == band.name for b in case.camera.band))
    known = None if air is None else UniformAir.named(air, clear)
    if known is None and clear:
        raise UserError("--clear without --air", expected="the air that is known")
    places = places_of(cases, band)
    if known is not None and band.kind == "thermal" and len(places.second):
        whole = thermal_in(known, band, MONTHS[months_around(MONTHS, places.second)], progress or Silent())
    else:
        whole = _shipped(band, target)
        if known is not None:
            whole = sunlit_in(known, band, whole, progress or Silent())
    cut = cut_down(whole, places, error)
    a, b, k, h = cut.table.modes.shape
    text = (
        f"{cut.bytes} bytes in memory: {a} x {b} places, {k} modes, {h} heights from "
        f"{cut.table.height_m[0] / 1e3:g} km; "
        f"differs from the whole table by {100 * cut.error:.2g} % at most, {100 * cut.rms:.2g} % rms of a profile's "
        f"largest value"
    )
    return MissionTable(cut, band, whole, len(cases), text)


def _shipped(band: Band, target: str) -> LimbTemplates:
    low, high = bands.limits_um(band)
    whole = shipped_templates(band.kind, (low, high))
    if whole is None:
        thermal = band.kind == "thermal"
        raise UserError(
            f"no profiles for {band.name!r}, {low:g} to {high:g} um",
            where=f"{target}: band",
            expected="a visible band, or one of 14 to 16.3, 8 to 14 or 10.5 to 12.5 um",
            fix="with --air a table of any thermal band is made" if thermal else "",
        )
    return whole


def write_table(made: MissionTable, path: Path) -> None:
    """Write a table as ``.npz`` or ``.h``; ``UserError`` for another ending or a file that cannot be written."""
    if path.suffix == ".npz":
        made.cut.table.save(path)
        return
    if path.suffix != ".h":
        raise UserError(f"ends in {path.suffix!r}", where=str(path), expected="a name that ends in .npz or .h")
    comment = f"Band {made.band.name}: {made.text}. From {made.whole.made_by}."
    atomic.write_text(path, header_text(made.cut.table, comment))


def places_of(cases: Sequence[Case], band: Band) -> LimbPlaces:
    """Return where the limbs of frames are, on the axes of a band's table."""
    first, second, lowest = [], [], 0.0
    for case in cases:
        found = _places_of_frame(case, band)
        if found is None:
            continue
        first.append(found.first)
        second.append(found.second)
        lowest = min(lowest, found.lowest_m)
    if not first:
        return LimbPlaces(np.empty(0), np.empty(0), 0.0)
    return LimbPlaces(np.concatenate(first), np.concatenate(second), lowest)


def _places_of_frame(case: Case, band: Band) -> LimbPlaces | None:
    camera, pose = camera_from_spec(case.camera.camera), pose_from_spec(case.scene, case.camera)
    t = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    directions = horizon_directions(pose.r_itrs, pose.ellipsoid, t)
    uv, ahead = project(camera, rotate(pose.q_cam_from_itrs, directions))
    size = np.array([camera.width, camera.height])
    seen = ahead & np.all((uv > -MARGIN * size - 1.0) & (uv < (1.0 + MARGIN) * size + 1.0), axis=1)
    if not seen.any():
        return None
    points, directions = tangency_points(pose.r_itrs, pose.ellipsoid, t[seen]), directions[seen]
    distance = float(np.linalg.norm(points - pose.r_itrs, axis=1).max())
    lowest = -INSIDE_PX * distance / min(camera.fx, camera.fy)
    up = surface_normal(points, pose.ellipsoid)
    if band.kind == "thermal":
        latitude = geodetic_from_itrs(points, pose.ellipsoid)[0]
        return LimbPlaces(latitude, np.full(len(points), month_of(case.scene.platform.epoch_utc)), lowest)
    sun = np.array(truth_of(case.scene, case.camera, infrared=False).sun_itrs)
    return LimbPlaces(*sun_angles(up, directions, sun), lowest)


def sun_angles(up: FloatArray, direction: FloatArray, sun: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Sun's zenith angle and its azimuth from lines of sight (n, 3) over verticals (n, 3) [rad]."""
    cosine = np.clip(up @ sun, -1.0, 1.0)
    level = sun - cosine[:, None] * up
    side = np.cross(up, direction)
    ahead, across = np.sum(level * direction, axis=1), np.sum(level * side, axis=1)
    return np.arccos(cosine), np.abs(np.arctan2(across, ahead))


def _band_of(cases: Sequence[Case], name: str | None, target: str) -> Band:
    known = {band.name: band for case in cases for band in case.camera.band}
    if name is None and len(known) == 1:
        return next(iter(known.values()))
    if name in known:
        return known[name]
    if not known:
        raise UserError("the cameras have no bands", where=target, expected="at least one [[band]]")
    found = "several bands" if name is None else f"no band {name!r}"
    raise UserError(found, where=f"{target}: --band", expected=f"one of {', '.join(known)}")
