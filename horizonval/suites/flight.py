"""Samples of an orbit as partial scenes: position, time, heading and attitude."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from sgp4.api import Satrec

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.formats.aem import attitude_of_aem
from horizonval.formats.attitude import AttitudeHistory, other_readings
from horizonval.formats.ndm import KINDS, kinds_of
from horizonval.formats.oem import orbit_of_oem
from horizonval.formats.omm import satellite_of_omm
from horizonval.formats.trajectory import SpiceOrbit, attitude_of_csv, orbit_of_csv, span_of
from horizonval.formats.two_lines import elements_of
from horizonval.geometry import attitude_profile, clock, orbit
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, geodetic_from_itrs
from horizonval.geometry.rotation import itrs_from_gcrs, itrs_from_teme
from horizonval.geometry.sun_and_moon import sun_itrs
from horizonval.spec.expand import seed_of
from horizonval.spec.orbit import OrbitAttitude, OrbitSpec

MAX_FILE_BYTES = 64 * 1024**2
"""Maximum size of a file of two-line elements, bytes; a catalogue of all satellites has 5 MB."""

_ANGLE_DIGITS, _RATE_DIGITS, _KM_DIGITS = 7, 9, 6
"""Decimals in scenes, about 1 cm on the ground and 0.001 arcsec: machine-dependent last bits stay out of identities."""


def fly(spec: OrbitSpec, ellipsoid: Ellipsoid, seed: int, name: str, beside: Path) -> tuple[list[JsonObject], str]:
    """Return a partial scene for every sample: ``platform`` and ``attitude``; and a warning, or nothing.

    ``ellipsoid``: reference of latitude and altitude. ``seed`` (of the suite) and ``name``: source of the pointing
    error. ``beside``: base folder of the orbit's files. Raises ``UserError``: invalid elements, or those that SGP4
    refuses.
    """
    track = _track(spec, beside)
    epoch, states, itrs = track.epoch_utc, track.states, track.itrs
    # Whole microseconds, the resolution of an epoch.
    seconds: FloatArray = np.round(np.arange(spec.n) * (_duration_s(spec, track) / spec.n), 6)
    r, v = states(seconds)
    matrices = itrs(seconds)
    r_itrs, v_itrs = (np.einsum("nij,nj->ni", matrices, x) for x in (r, v))
    latitude, longitude, height = geodetic_from_itrs(r_itrs, ellipsoid)
    if float(np.min(height)) <= 0.0:
        raise UserError("the orbit passes below the ground", expected="a perigee above it")
    course = orbit.heading(r_itrs, v_itrs)
    sun = itrs(np.zeros(1))[0].T @ sun_itrs(epoch)[0]
    if track.body_from_axes is not None:
        angles, rates = attitude_profile.angles_and_rates(partial(_body_from_lvlh, track), seconds, track.around)
    else:
        profile = _profile(spec.attitude, seed, name)
        angles, rates = attitude_profile.attitude_against_lvlh(profile, states, sun, seconds, track.around)
    degrees = [np.round(np.degrees(x), _ANGLE_DIGITS) + 0.0 for x in (latitude, longitude, course)]
    km = np.round(height / 1e3, _KM_DIGITS)
    turned = np.round(np.degrees(angles), _ANGLE_DIGITS) + 0.0
    turning = np.round(np.degrees(rates), _RATE_DIGITS) + 0.0
    samples = [
        {
            "platform": {
                "epoch_utc": clock.utc_after(epoch, float(t)),
                "latitude_deg": float(degrees[0][i]),
                "longitude_deg": float(degrees[1][i]),
                "altitude_km": float(km[i]),
                "heading_deg": float(degrees[2][i]),
            },
            "attitude": _attitude(turned[i], turning[i]),
        }
        for i, t in enumerate(seconds)
    ]
    return samples, "" if track.doubt is None else track.doubt(seconds)


def _attitude(angles_deg: FloatArray, rates_deg_s: FloatArray) -> JsonObject:
    yaw, pitch, roll = (float(x) for x in angles_deg)
    found: dict[str, Any] = {"yaw_deg": yaw, "pitch_deg": pitch, "roll_deg": roll}
    if np.any(rates_deg_s):
        found["rate_deg_s"] = [float(x) for x in rates_deg_s]
    return found


Doubt = Callable[[FloatArray], str]
"""From times [s] to a warning about them, or nothing."""


@dataclass(frozen=True)
class _Track:
    """Position of a satellite, and its attitude if a file gives it.

    ``states``: in celestial axes. ``itrs``, ``body_from_axes``: matrices from these to Earth-fixed and body axes, shape
    (n, 3, 3). ``period_s``: of a revolution, None without elements; ``end_s``: of the file. ``around``: begin and end
    of the files' coverage around times, None if unlimited. ``doubt``: returns a warning about times, or nothing.
    """

    epoch_utc: datetime
    states: attitude_profile.States
    itrs: Callable[[FloatArray], FloatArray]
    period_s: float | None = None
    end_s: float | None = None
    body_from_axes: Callable[[FloatArray], FloatArray] | None = None
    around: attitude_profile.Spans | None = None
    doubt: Doubt | None = None


def _duration_s(spec: OrbitSpec, track: _Track) -> float:
    """Return the time from the first sample to the (excluded) end."""
    if spec.duration_s is not None:
        return spec.duration_s
    if track.period_s is not None:
        return (spec.revolutions or 1.0) * track.period_s
    if spec.revolutions is not None:
        raise UserError("a file of states has no revolutions", where="revolutions", expected="duration_s, or neither")
    assert track.end_s is not None
    return track.end_s


def _body_from_lvlh(track: _Track, seconds: FloatArray) -> FloatArray:
    assert track.body_from_axes is not None
    lvlh = orbit.lvlh_matrices(*track.states(seconds))
    return np.asarray(track.body_from_axes(seconds) @ np.swapaxes(lvlh, -1, -2))


def _track(spec: OrbitSpec, beside: Path) -> _Track:
    """Return the orbit from elements, lines, or files relative to a folder."""
    if spec.kernels is not None:
        found = _track_of_kernels(spec, beside)
    elif spec.ephemeris is not None:
        found = _track_of_file(spec, beside / Path(spec.ephemeris).expanduser())
    elif spec.tle is not None:
        try:
            if isinstance(spec.tle, str):
                found = _track_of_file(spec, beside / Path(spec.tle).expanduser(), ("omm", "tle"), ELEMENTS)
            else:
                found = _track_of_lines(spec, spec.tle, "")
        except UserError as e:
            raise e.inside("tle") from e
    else:
        found = _track_of_elements(spec)
    if spec.attitude.file is None:
        return found
    path = beside / Path(spec.attitude.file).expanduser()
    kind = _kind_of(path, ("aem",), "an attitude: AEM, or a table of quaternions")
    if kind != "aem" and spec.satellite is not None and spec.tle is None and spec.ephemeris is None:
        raise UserError("a table of attitudes names no satellite", where="satellite", expected="it to be left out")
    history = attitude_of_aem(path, spec.satellite) if kind == "aem" else attitude_of_csv(path)

    def body_from_axes(seconds: FloatArray) -> FloatArray:
        # The file refers to celestial axes, the states may be in others.
        gcrs_from_axes = np.swapaxes(itrs_from_gcrs(found.epoch_utc, seconds), -1, -2) @ found.itrs(seconds)
        return np.asarray(history.body_from_gcrs(found.epoch_utc, seconds) @ gcrs_from_axes)

    def around(seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        begin, end = history.around(found.epoch_utc, seconds)
        if found.around is None:
            return begin, end
        first, last = found.around(seconds)
        return np.fmax(begin, first), np.fmin(end, last)

    turned = replace(found, body_from_axes=body_from_axes, around=around)
    doubts = (found.doubt, lambda _: history.doubt, lambda _: _steady_otherwise(turned, history))
    return replace(turned, doubt=partial(_joined, doubts))


SHORTEST_ARC, LARGEST_SWAY, STEADIER = math.radians(20.0), math.radians(3.0), 0.1
"""Arc of the orbit on which readings of quaternions are compared, largest turn against the local vertical of a reading
that holds still, and how large it may be, relative to the stated reading's."""
MOST_COMPARED = 50


def _steady_otherwise(track: _Track, history: AttitudeHistory) -> str:
    """Return a warning if a body that tumbles holds still against the local vertical in another reading of its file.

    Quaternions with the scalar at the wrong end, or of the inverse turn, are as smooth as the right ones.
    """
    seconds = np.concatenate([piece.seconds for piece in history.pieces])
    q = np.concatenate([piece.q_body_from_axes for piece in history.pieces])
    t = seconds + clock.elapsed_s(track.epoch_utc, history.epoch_utc)
    assert track.around is not None
    known = np.flatnonzero(np.isfinite(track.around(t)[0]))
    if len(known) < 3:
        return ""
    use = known[np.unique(np.linspace(0, len(known) - 1, MOST_COMPARED).astype(int))]
    up = track.states(t[use])[0]
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    stated = _body_from_lvlh(track, t[use])
    axes_from_lvlh = np.swapaxes(Rotation.from_quat(q[use]).as_matrix(), -1, -2) @ stated

    def sway(body_from_lvlh: FloatArray) -> float:
        turns = Rotation.from_matrix(body_from_lvlh)
        return float((turns * turns[0].inv()).magnitude().max())

    if float(np.min(up @ up[0])) > math.cos(SHORTEST_ARC) or sway(stated) < LARGEST_SWAY / STEADIER:
        return ""
    for text, other in other_readings(q[use]):
        if sway(Rotation.from_quat(other).as_matrix() @ axes_from_lvlh) < min(LARGEST_SWAY, STEADIER * sway(stated)):
            return f"{history.where}: the body tumbles, and would hold still against the local vertical if {text}"
    return ""


def _joined(doubts: Sequence[Doubt | None], seconds: FloatArray) -> str:
    """Return several warnings about times as one."""
    return "; ".join(text for doubt in doubts if doubt is not None and (text := doubt(seconds)))


def _kind_of(path: Path, known: Sequence[str], expected: str) -> str:
    """Return the kind of message in a file, empty for a table; UserError for a kind that is read elsewhere or not."""
    found = kinds_of(path, expected)
    fit = [kind for kind in found if kind in known]
    if found and len(fit) != 1:
        held = " and ".join(KINDS[kind] for kind in fit or found)
        raise UserError(f"holds {held}", where=str(path), expected=expected)
    return fit[0] if fit else ""


def _track_of_elements(spec: OrbitSpec) -> _Track:
    assert spec.epoch_utc is not None
    epoch = spec.epoch_utc
    elements = _elements(spec, epoch)
    if elements.semi_major_axis_m * (1.0 - elements.eccentricity) <= WGS84.b_m:
        raise UserError("the perigee lies inside the Earth", expected="a larger axis or a smaller eccentricity")

    def states(seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        return orbit.tod_states(elements, seconds)

    def itrs(seconds: FloatArray) -> FloatArray:
        return orbit.turn_about_pole(orbit.sidereal_time(epoch, seconds))

    # A revolution is counted from node to node.
    _, perigee_rate, mean_rate = orbit.secular_rates(elements)
    return _Track(epoch, states, itrs, 2.0 * math.pi / (mean_rate + perigee_rate))


def _track_of_lines(spec: OrbitSpec, lines: Sequence[str], where: str) -> _Track:
    try:
        return _track_of_satellite(spec, elements_of(lines, spec.satellite).satellite())
    except UserError as e:
        raise e.at(where) from e


def _track_of_satellite(spec: OrbitSpec, satellite: Satrec, doubt: str = "") -> _Track:
    epoch = spec.epoch_utc or orbit.epoch_of(satellite)

    def states(seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        return orbit.satellite_states(satellite, epoch, seconds)

    def itrs(seconds: FloatArray) -> FloatArray:
        return itrs_from_teme(epoch, seconds)

    # From node to node, as for elements; the satellite's mean motion counts from perigee to perigee.
    period_s = 60.0 * 2.0 * math.pi / (satellite.mdot + satellite.argpdot)
    doubts = (lambda _: doubt, partial(orbit.far_from_epoch, satellite, epoch))
    return _Track(epoch, states, itrs, period_s, doubt=partial(_joined, doubts))


ELEMENTS = "elements: two lines of 69 columns, an OMM, JSON or CSV"
ORBIT = "an orbit: OEM, mean elements as OMM, JSON, CSV or two lines, or a table of states"


def _track_of_file(
    spec: OrbitSpec, path: Path, known: Sequence[str] = ("oem", "omm", "tle"), expected: str = ORBIT
) -> _Track:
    kind = _kind_of(path, known, expected)
    if kind == "omm":
        return _track_of_satellite(spec, *satellite_of_omm(path, spec.satellite))
    if kind == "tle" or "oem" not in known:
        lines = files.read_text(path, largest=MAX_FILE_BYTES, expected=expected).splitlines()
        return _track_of_lines(spec, lines, str(path))
    if kind != "oem" and spec.satellite is not None:
        raise UserError("a table of states names no satellite", where="satellite", expected="it to be left out")
    trajectory = orbit_of_oem(path, spec.satellite) if kind == "oem" else orbit_of_csv(path)
    first, last = trajectory.span_s
    epoch = spec.epoch_utc or clock.utc_after(trajectory.epoch_utc, first)
    offset = clock.elapsed_s(trajectory.epoch_utc, epoch)

    def around(seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        begin, end = trajectory.coverage.around(seconds + offset)
        return begin - offset, end - offset

    return _Track(
        epoch,
        lambda seconds: trajectory.states(seconds + offset),
        partial(itrs_from_gcrs, epoch),
        end_s=last - offset,
        around=around,
    )


def _track_of_kernels(spec: OrbitSpec, beside: Path) -> _Track:
    assert spec.kernels is not None
    assert spec.spacecraft is not None
    paths = tuple(beside / Path(name).expanduser() for name in spec.kernels)
    first, last = span_of(paths, spec.spacecraft)
    epoch = spec.epoch_utc or clock.utc_at(first)
    found = SpiceOrbit(paths, spec.spacecraft, epoch, spec.attitude.body_axes)
    begin_s, end_s = clock.seconds_after(epoch, (first, last)).tolist()
    found.check(begin_s, end_s)
    return _Track(
        epoch,
        found.states,
        partial(itrs_from_gcrs, epoch),
        end_s=end_s,
        body_from_axes=None if spec.attitude.body_axes is None else partial(found.body_from_gcrs, epoch),
        around=lambda seconds: (np.full(len(seconds), begin_s), np.full(len(seconds), end_s)),
    )


def _elements(spec: OrbitSpec, epoch: datetime) -> orbit.Elements:
    radius = orbit.EARTH_RADIUS_M
    eccentricity = spec.eccentricity or 0.0
    if spec.altitude_km is not None:
        a = radius + spec.altitude_km * 1e3
    elif spec.semi_major_axis_km is not None:
        a = spec.semi_major_axis_km * 1e3
    else:
        assert spec.perigee_km is not None
        assert spec.apogee_km is not None
        low, high = radius + spec.perigee_km * 1e3, radius + spec.apogee_km * 1e3
        a, eccentricity = (low + high) / 2.0, (high - low) / (high + low)
    inclination = (
        orbit.sun_synchronous_inclination(a, eccentricity)
        if spec.inclination_deg is None
        else math.radians(spec.inclination_deg)
    )
    if spec.ltan_h is not None:
        node = orbit.raan_of_local_time(epoch, spec.ltan_h)
    elif spec.ltdn_h is not None:
        node = orbit.raan_of_local_time(epoch, spec.ltdn_h + 12.0)
    elif spec.node_longitude_deg is not None:
        node = math.radians(spec.node_longitude_deg) + float(orbit.sidereal_time(epoch))
    else:
        node = math.radians(spec.raan_deg or 0.0)
    mean = orbit.mean_from_true_anomaly(math.radians(spec.true_anomaly_deg), eccentricity)
    return orbit.Elements(a, eccentricity, inclination, node, math.radians(spec.argument_of_perigee_deg), mean)


def _profile(spec: OrbitAttitude, seed: int, name: str) -> attitude_profile.AttitudeProfile:
    def radians(angles: tuple[float, float, float]) -> tuple[float, float, float]:
        yaw, pitch, roll = (math.radians(x) for x in angles)
        return yaw, pitch, roll

    error = None
    if spec.error is not None:
        random = np.random.default_rng(np.random.SeedSequence(seed_of("pointing", seed, name)))
        error = attitude_profile.pointing_error(radians(spec.error.rms_deg), spec.error.correlation_s, random)
    slew = None
    if spec.slew is not None:
        slew = attitude_profile.Slew(radians(spec.slew.to_deg), spec.slew.start_s, spec.slew.duration_s)
    return attitude_profile.AttitudeProfile(
        reference=spec.pointing,
        offset_rad=radians(spec.offset_deg),
        slew=slew,
        tumble_rad_s=radians(spec.tumble_deg_s),
        error=error,
        sun_axis=spec.sun_axis,
    )
