"""How a body turns along its orbit: a reference that it points at, and motions on top of it.

With rotations of the frame, the last one first::

    R_body_from_lvlh(t) = E(t) T(t) S(t) P(t)

``P`` is the reference: the local vertical, the Sun (an axis of the body towards it, x as near to the velocity as that
allows), or the stars (the local vertical of the first instant). ``S`` is a fixed offset, and a slew from it to another
attitude about one axis with the smooth step 10 s^3 - 15 s^4 + 6 s^5. ``T`` is a tumble at a constant rate about an axis
of the body. ``E`` is a pointing error about each axis: a stationary Gaussian process of correlation
``exp(-(dt / tau)^2 / 2)``, a sum of cosines with frequencies drawn from its spectrum and normal amplitudes, so that it
has a value and a rate at every instant.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry.orbit import lvlh_matrices

States = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
Spans = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Positions [m] and velocities [m/s], shape (n, 3) each, at times (n,), in celestial axes."""

_TONES = 64
"""Of an error; given the frequencies the process is exactly Gaussian, and they follow the spectrum to 1/sqrt(64)."""
_RATE_STEP_S = 0.05
"""Half the interval of central differences: the rate of an error of tau = 1 s is right to 1e-3."""


@dataclass(frozen=True)
class Slew:
    """A turn from the offset to another attitude; angles yaw, pitch, roll [rad] against the reference."""

    to_rad: tuple[float, float, float]
    start_s: float
    duration_s: float


@dataclass(frozen=True)
class PointingError:
    """One sample of a Gaussian process about yaw, pitch and roll: frequencies and amplitudes, shape (3, k) each."""

    frequency_rad_s: FloatArray
    cosine_rad: FloatArray
    sine_rad: FloatArray

    def at(self, seconds: FloatArray) -> FloatArray:
        """Return yaw, pitch and roll [rad], shape (n, 3)."""
        phase = seconds[:, None, None] * self.frequency_rad_s
        return np.sum(self.cosine_rad * np.cos(phase) + self.sine_rad * np.sin(phase), axis=-1)


def pointing_error(
    rms_rad: tuple[float, float, float], correlation_s: float, rng: np.random.Generator
) -> PointingError:
    """Draw a pointing error of given rms about yaw, pitch and roll, and of one correlation time."""
    frequency = rng.standard_normal((3, _TONES)) / correlation_s
    scale = np.asarray(rms_rad, dtype=np.float64)[:, None] / math.sqrt(_TONES)
    cosine, sine = (scale * rng.standard_normal((3, _TONES)) for _ in range(2))
    return PointingError(frequency, cosine, sine)


@dataclass(frozen=True)
class AttitudeProfile:
    """What the body does; see the module. Angles are yaw, pitch and roll, the tumble is about x, y, z.

    ``sun_axis`` is the axis of the reference that points at the Sun.
    """

    reference: Literal["nadir", "sun", "inertial"] = "nadir"
    offset_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    slew: Slew | None = None
    tumble_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    error: PointingError | None = None
    sun_axis: tuple[float, float, float] = (0.0, 0.0, -1.0)


def attitude_against_lvlh(
    profile: AttitudeProfile, states: States, sun: FloatArray, seconds: FloatArray, around: Spans | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return attitude and rate of the body at some times.

    Parameters
    ----------
    profile : AttitudeProfile
    states : callable
    sun : ndarray, shape (3,)
        Direction of the Sun in the axes of the states; it stands still.
    seconds : ndarray, shape (n,)
    around : callable, optional
        Begin and end, shape (n,) each, of the spans of states that times lie in; rates ask for none outside.

    Returns
    -------
    angles_rad : ndarray, shape (n, 3)
        Yaw, pitch and roll of ``R = Rx(roll) Ry(pitch) Rz(yaw)``.
    rates_rad_s : ndarray, shape (n, 3)
        Angular velocity against ``lvlh``, in body axes.
    """
    return angles_and_rates(lambda t: _matrices(profile, states, sun, t), seconds, around)


def angles_and_rates(
    body_from_lvlh: Callable[[FloatArray], FloatArray], seconds: FloatArray, around: Spans | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return what :func:`attitude_against_lvlh` does, of matrices (n, 3, 3) as a function of time."""
    t = np.asarray(seconds, dtype=np.float64)
    matrices = body_from_lvlh(t)
    earlier, later, span = t - _RATE_STEP_S, t + _RATE_STEP_S, np.full(len(t), 2.0 * _RATE_STEP_S)
    if around is not None:
        # At an end of what is known the difference is that of one side.
        begin, end = around(t)
        earlier, later = np.fmax(earlier, begin), np.fmin(later, end)
        span = later - earlier
        if (alone := span <= 0.0).any():
            raise UserError(
                f"a single state or attitude at {t[np.flatnonzero(alone)[0]]:g} s, of which no rate is told",
                expected="neighbours near enough to be no gap",
            )
    before, after = body_from_lvlh(earlier), body_from_lvlh(later)
    # A frame that turns by the rate w maps fixed vectors by exp(-w dt).
    step = Rotation.from_matrix(after @ np.swapaxes(before, -1, -2)).as_rotvec()
    m = matrices
    cos_pitch = np.hypot(m[:, 0, 0], m[:, 0, 1])
    yaw = np.where(cos_pitch < 1e-12, np.arctan2(-m[:, 1, 0], m[:, 1, 1]), np.arctan2(m[:, 0, 1], m[:, 0, 0]))
    roll = np.where(cos_pitch < 1e-12, 0.0, np.arctan2(m[:, 1, 2], m[:, 2, 2]))
    return np.stack([yaw, np.arctan2(-m[:, 0, 2], cos_pitch), roll], axis=-1), -step / span[:, None]


def _matrices(profile: AttitudeProfile, states: States, sun: FloatArray, t: FloatArray) -> FloatArray:
    lvlh = lvlh_matrices(*states(t))
    match profile.reference:
        case "nadir":
            reference = np.broadcast_to(np.eye(3), (len(t), 3, 3))
        case "inertial":
            reference = lvlh_matrices(*states(np.zeros(1))) @ np.swapaxes(lvlh, -1, -2)
        case "sun":
            reference = _towards(np.einsum("nij,j->ni", lvlh, sun), np.asarray(profile.sun_axis, dtype=np.float64))
    body = _turned(profile, t).as_matrix() @ reference
    if profile.error is not None:
        body = _frame_turn(profile.error.at(t)).as_matrix() @ body
    return np.asarray(body, dtype=np.float64)


def _turned(profile: AttitudeProfile, t: FloatArray) -> Rotation:
    """Return T S: offset or slew, then tumble, as rotations that act on components."""
    start = _frame_turn(np.asarray(profile.offset_rad, dtype=np.float64)[None])
    if profile.slew is None:
        attitude = start
    else:
        end = _frame_turn(np.asarray(profile.slew.to_rad, dtype=np.float64)[None])
        s = np.clip((t - profile.slew.start_s) / profile.slew.duration_s, 0.0, 1.0)
        smooth = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        attitude = Rotation.from_rotvec(smooth[:, None] * (end * start.inv()).as_rotvec()) * start
    tumble = Rotation.from_rotvec(-t[:, None] * np.asarray(profile.tumble_rad_s, dtype=np.float64))
    return tumble * attitude


def _frame_turn(yaw_pitch_roll: FloatArray) -> Rotation:
    # SciPy rotates vectors; a rotation of the frame is the inverse of it.
    return Rotation.from_euler("ZYX", yaw_pitch_roll).inv()


def _towards(sun_lvlh: FloatArray, axis: FloatArray) -> FloatArray:
    """Return matrices from lvlh to a reference whose ``axis`` points at the Sun, the rest as near to lvlh as it can be.

    The second direction is the velocity, seen across the Sun's; the axis's own second direction is its counterpart in
    the reference. Where the Sun stands along the velocity, the orbit's normal takes its place.
    """
    axis = axis / np.linalg.norm(axis)
    helper = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    second = np.where(np.abs(sun_lvlh @ helper)[:, None] < 1.0 - 1e-12, helper, np.array([0.0, 0.0, 1.0]))

    def triad(first: FloatArray, other: FloatArray) -> FloatArray:
        third = np.cross(first, other)
        third /= np.linalg.norm(third, axis=-1, keepdims=True)
        return np.stack([first, np.cross(third, first), third], axis=-1)

    here = triad(sun_lvlh, second)
    there = triad(np.broadcast_to(axis, sun_lvlh.shape), np.broadcast_to(helper, sun_lvlh.shape))
    return there @ np.swapaxes(here, -1, -2)
