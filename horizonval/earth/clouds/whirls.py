r"""The stirring of clouds: whirls that wind bands up to fronts, and the fronts themselves.

Every whirl turns the sphere about its own axis c by an angle that falls off with distance r from it::

    alpha(r) = alpha_0 exp(-(r / R)^2)

A turn keeps areas, and so does a chain of turns: a random field that is looked up at the turned places keeps its
distribution and gets filaments, hooks and spirals, as air does in two dimensions. There are two sorts: cyclones in the
storm tracks, which turn with the Earth (counterclockwise in the north), and lesser whirls of either sense everywhere.

Through each cyclone runs a front: a ridge of cloud, wound up with everything else to a comma, with a clear slot behind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray

CYCLONES = 11
"""In each hemisphere, as a map of the weather shows."""
CYCLONE_RADIUS_KM, CYCLONE_TURN_RAD = (450.0, 950.0), (1.0, 3.3)
CYCLONE_LATITUDE_DEG, CYCLONE_SPREAD_DEG = 51.0, 7.0
LESSER, LESSER_RADIUS_KM, LESSER_TURN_RAD = 120, (250.0, 1100.0), 0.8
FRONT_LENGTH_KM, FRONT_WIDTH_KM, FRONT_HEIGHT, SLOT_DEPTH = 1500.0, 170.0, 1.5, 1.1
"""Half length and half width (standard deviations), and heights in standard deviations of the noise."""
EARTH_RADIUS_KM = 6371.0
REACH = 3.0
"""Radii beyond which a whirl turns nothing."""


@dataclass(frozen=True)
class Whirl:
    """One whirl: its axis, and the R and alpha_0 of the module text; positive turns are counterclockwise."""

    axis: FloatArray
    radius_rad: float
    turn_rad: float
    front: bool


def whirls(seed: int) -> list[Whirl]:
    """Draw the whirls of a seed: cyclones last."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x57484952]))
    found = []
    for _ in range(LESSER):
        z, longitude = rng.uniform(-1.0, 1.0), rng.uniform(-math.pi, math.pi)
        radius = rng.uniform(*LESSER_RADIUS_KM) / EARTH_RADIUS_KM
        found.append(Whirl(_unit(math.asin(z), longitude), radius, rng.normal() * LESSER_TURN_RAD, False))
    for sense in (1.0, -1.0):
        first = rng.uniform(-math.pi, math.pi)
        for k in range(CYCLONES):
            latitude = math.radians(CYCLONE_LATITUDE_DEG + CYCLONE_SPREAD_DEG * float(np.clip(rng.normal(), -2.0, 2.0)))
            longitude = first + 2.0 * math.pi * (k + rng.uniform(-0.35, 0.35)) / CYCLONES
            radius = rng.uniform(*CYCLONE_RADIUS_KM) / EARTH_RADIUS_KM
            turn = sense * rng.uniform(*CYCLONE_TURN_RAD)
            found.append(Whirl(_unit(sense * latitude, longitude), radius, turn, True))
    return found


def stirred(position: FloatArray, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return where the air of places came from, and what fronts add to the noise.

    Parameters
    ----------
    position : ndarray, shape (n, 3)
        Unit vectors.
    seed : int

    Returns
    -------
    origin : ndarray, shape (n, 3)
        Unit vectors.
    lift : ndarray, shape (n,)
        In standard deviations of the noise.
    """
    origin, lift = np.array(position), np.zeros(len(position))
    for whirl in reversed(whirls(seed)):
        near = np.flatnonzero(origin @ whirl.axis > math.cos(REACH * whirl.radius_rad))
        turned = _turned(origin[near], whirl)
        if whirl.front:
            lift[near] += _front(turned, whirl)
        origin[near] = turned
    return origin, lift


def _turned(p: FloatArray, whirl: Whirl) -> FloatArray:
    """Return places turned back about the axis (Rodrigues' formula)."""
    along = p @ whirl.axis
    distance = np.arccos(np.clip(along, -1.0, 1.0))
    # nothing jumps where the whirl ends
    fade = np.exp(-((distance / whirl.radius_rad) ** 2)) - math.exp(-(REACH**2))
    angle = -whirl.turn_rad * np.maximum(fade, 0.0)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return p * cosine + np.cross(whirl.axis, p) * sine + whirl.axis * (along[:, None] * (1.0 - cosine))


def _front(p: FloatArray, whirl: Whirl) -> FloatArray:
    """Return the ridge of a cyclone's front before it was wound up, and the slot to its west."""
    east = np.cross([0.0, 0.0, 1.0], whirl.axis)
    east /= np.linalg.norm(east)
    north = np.cross(whirl.axis, east)
    # from the centre towards the equator and back west, as cold fronts trail
    poleward = math.copysign(1.0, float(whirl.axis[2]))
    x, y = p @ east * EARTH_RADIUS_KM, poleward * (p @ north) * EARTH_RADIUS_KM
    along, across = 0.8 * y + 0.6 * x, 0.8 * x - 0.6 * y
    end = 1.0 - np.clip(np.hypot(x, y) / (REACH * whirl.radius_rad * EARTH_RADIUS_KM), 0.0, 1.0) ** 4
    length = np.exp(-0.5 * (along / FRONT_LENGTH_KM) ** 2) * end

    def ridge(middle_km: float, width_km: float) -> FloatArray:
        return np.exp(-0.5 * ((across - middle_km) / width_km) ** 2)

    slot = ridge(-2.2 * FRONT_WIDTH_KM, 1.2 * FRONT_WIDTH_KM)
    return length * (FRONT_HEIGHT * ridge(0.0, FRONT_WIDTH_KM) - SLOT_DEPTH * slot)


def _unit(latitude_rad: float, longitude_rad: float) -> FloatArray:
    c = math.cos(latitude_rad)
    return np.array([c * math.cos(longitude_rad), c * math.sin(longitude_rad), math.sin(latitude_rad)])
