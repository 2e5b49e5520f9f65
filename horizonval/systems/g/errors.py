"""A design flown at an altitude: errors, lift, gain, and quadrants out of range, level and tilted.

*Pitch and roll* from the limb in four quadrants. A limb at nadir angle eta_k in quadrant k, where ``eta0_k`` is
expected of a level body at a known place::

    eta_k - eta0_k = -pitch cos a_k + roll sin a_k + lift

Least squares over the quadrants that are within the range the sensor was calibrated for; three are enough. The lift is
what altitude and air have in common all round. With four there is one condition to spare: its residual is the guard.
Second-order terms are 0.004 deg at half a degree of tilt.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.geometry.ellipsoid import WGS84
from horizonval.systems.g.design import AZIMUTH_RAD, QuadrantDesign, expected_limb
from horizonval.systems.weather_viewpoints import WeatherPlace

LEAST_QUADRANTS = 3
RESIDUAL_RAD = math.radians(0.5)
"""Oblateness is expected and taken off; air of two hemispheres spends a tenth of a degree of it."""


@dataclass(frozen=True)
class QuadrantFit:
    """An attitude; ``covariance``: shape (3, 3), of its three angles [rad2]."""

    roll_rad: float
    pitch_rad: float
    lift_rad: float
    covariance: FloatArray


def attitude_of_quadrants(
    limb_rad: FloatArray, expected_rad: FloatArray, azimuth_rad: FloatArray, sigma_rad: float
) -> QuadrantFit | Refusal:
    """Return roll and pitch from the limb's nadir angles (4,), nan where a quadrant is out of range.

    ``expected_rad``, ``azimuth_rad``: shape (4,), of a level body; from forward to the right; ``sigma_rad``: of a
    quadrant.
    """
    valid = np.isfinite(limb_rad)
    if valid.sum() < LEAST_QUADRANTS:
        return Refusal(Outcome.SATURATED, f"{int(valid.sum())} of 4 quadrants are in range, three are needed")
    alpha = azimuth_rad[valid]
    design = np.stack([np.sin(alpha), -np.cos(alpha), np.ones_like(alpha)], axis=1)
    gain = np.linalg.pinv(design)
    excess = (limb_rad - expected_rad)[valid]
    solution = gain @ excess
    residual = float(np.max(np.abs(excess - design @ solution)))
    if residual > RESIDUAL_RAD:
        return Refusal(Outcome.AMBIGUOUS, f"the quadrants disagree by {math.degrees(residual):.2f} deg")
    roll, pitch, lift = (float(x) for x in solution)
    return QuadrantFit(roll, pitch, lift, sigma_rad**2 * gain @ gain.T)


TILTS_DEG = ((0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5))
"""Pitch and roll: level, and half a degree in each axis."""
LEVEL = 0
DRAWS = 500


@dataclass(frozen=True)
class AltitudeErrors:
    """A design at one altitude.

    ``level_deg``, ``tilted_deg``: three times the rms error with noise of the worse axis, of level and of all bodies;
    ``unchecked_deg``: the same as ``tilted_deg`` with all quadrants; ``worst_deg``: largest error without noise;
    ``low_deg``, ``high_deg``: 95 % interval of ``tilted_deg`` over places; ``refused``, ``refused_level``: share of
    refused readings, of all and of level bodies; ``out_of_range``: share of quadrants; ``lift_deg``: mean common error;
    ``scale``: reading of a tilt of half a degree, over that tilt; ``month_deg``: shape (12,), as ``level_deg`` by
    month.
    """

    altitude_km: float
    level_deg: float
    tilted_deg: float
    unchecked_deg: float
    worst_deg: float
    low_deg: float
    high_deg: float
    refused: float
    refused_level: float
    out_of_range: float
    lift_deg: float
    scale: float
    month_deg: FloatArray


def fly(design: QuadrantDesign, places: Sequence[WeatherPlace], altitude_km: float, seen: FloatArray) -> AltitudeErrors:
    """Return the errors of a design at an altitude, from sectors of shape (places, tilts, 4, n)."""
    stands, inside = design.limb_angles(seen)
    error, lift = _errors(design, places, altitude_km, np.where(inside, stands, np.nan))
    unchecked, _ = _errors(design, places, altitude_km, stands)
    sigma = math.degrees(design.sigma_rad) / math.sqrt(2.0)
    low, high = _interval(error, sigma)
    months = np.array([place.month for place in places])
    missing = np.isnan(error[..., 0])
    return AltitudeErrors(
        altitude_km,
        _three_sigma(error[:, LEVEL], sigma),
        _three_sigma(error, sigma),
        _three_sigma(unchecked, sigma),
        float(np.nanmax(np.abs(error), initial=0.0)),
        low,
        high,
        float(np.mean(missing)),
        float(np.mean(missing[:, LEVEL])),
        float(np.mean(~inside)),
        _mean(lift[:, LEVEL]),
        _scale(error),
        np.array([_three_sigma(error[months == m, LEVEL], sigma) for m in range(1, 13)]),
    )


def _errors(
    design: QuadrantDesign, places: Sequence[WeatherPlace], altitude_km: float, stands: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return errors of pitch and roll, shape (places, tilts, 2), and the lift, shape (places, tilts), all [deg]."""
    raised = WGS84.raised(design.limb.height_m)
    error, lift = np.full((*stands.shape[:2], 2), np.nan), np.full(stands.shape[:2], np.nan)
    for i, place in enumerate(places):
        expected = expected_limb(place, altitude_km, raised)
        for j, tilt in enumerate(TILTS_DEG):
            fit = attitude_of_quadrants(stands[i, j], expected, AZIMUTH_RAD, design.sigma_rad)
            if isinstance(fit, QuadrantFit):
                error[i, j] = np.degrees([fit.pitch_rad, fit.roll_rad]) - tilt
                lift[i, j] = math.degrees(fit.lift_rad)
    return error, lift


def by_altitude(
    design: QuadrantDesign, places: Sequence[WeatherPlace], seen: Mapping[float, FloatArray]
) -> list[AltitudeErrors]:
    """Return the errors at every altitude [km] of ``seen``."""
    return [fly(design, places, altitude, sectors) for altitude, sectors in seen.items()]


def _three_sigma(error: FloatArray, sigma: float) -> float:
    """Return three times the rms of errors (..., 2) in the worse axis; nan where there is no answer at all."""
    squares = error.reshape(-1, 2) ** 2
    return 3.0 * math.sqrt(max(_mean(squares[:, 0]), _mean(squares[:, 1])) + sigma**2)


def _interval(error: FloatArray, sigma: float) -> tuple[float, float]:
    """Return the 2.5 and 97.5 % points of :func:`_three_sigma` over places drawn anew."""
    if np.isnan(error).all():
        return math.nan, math.nan
    rng = np.random.default_rng(0)
    drawn = [_three_sigma(error[rng.integers(0, len(error), len(error))], sigma) for _ in range(DRAWS)]
    low, high = np.nanpercentile(drawn, [2.5, 97.5])
    return float(low), float(high)


def _mean(values: FloatArray) -> float:
    """Return the mean of what is known, nan where nothing is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def _scale(error: FloatArray) -> float:
    """Return the mean reading of tilts over the tilts."""
    shares = []
    for j, tilt in enumerate(TILTS_DEG):
        if j != LEVEL:
            axis = int(np.argmax(np.abs(tilt)))
            shares.append(1.0 + _mean(error[:, j, axis] - error[:, LEVEL, axis]) / tilt[axis])
    return float(np.mean(shares))
