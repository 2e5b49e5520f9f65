"""The whole chain on an Earth without air, whose edges are known in closed form: what sampling and lags leave."""

from __future__ import annotations

import itertools
import math

import numpy as np

from horizonval.core.outcome import Refusal
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.frames import body_from_lvlh, inverse, rotate
from horizonval.systems.f.attitude import attitude_over_ellipsoid
from horizonval.systems.f.electronics import ScanEdges, Threshold, find_edges
from horizonval.systems.f.scan_cone import ScanCone, ellipsoid_crossings
from horizonval.systems.f.settings import ALTITUDE_KM, ELECTRONICS, FRACTION, HALF_ANGLE_RAD, PHASE_STEP_RAD
from horizonval.systems.weather_viewpoints import WeatherPlace

TILTS_DEG = (0.0, 10.0, 20.0)
ATTITUDES_DEG = (-3.0, 0.0, 3.0)
LATITUDES_DEG = (0.0, 40.0, 70.0)


def worst_error_deg() -> float:
    """Return the largest error of roll and pitch over spin-axis tilts, attitudes and latitudes, without noise."""
    late, worst = ELECTRONICS.step_delays(FRACTION, PHASE_STEP_RAD), 0.0
    for tilt, roll, pitch, latitude in itertools.product(TILTS_DEG, ATTITUDES_DEG, ATTITUDES_DEG, LATITUDES_DEG):
        cone = ScanCone.to_the_right(HALF_ANGLE_RAD, math.radians(tilt))
        day = WeatherPlace(latitude, 0.0, 30.0, 1, 0, 0)
        r, lvlh = day.position(ALTITUDE_KM), day.lvlh()
        lvlh_from_body = inverse(body_from_lvlh(0.0, math.radians(pitch), math.radians(roll)))
        to_itrs = rotate(inverse(lvlh), rotate(lvlh_from_body, np.eye(3))).T
        exact = ellipsoid_crossings(cone, to_itrs, r, WGS84)
        assert exact is not None
        phase = np.arange(exact[0] - 0.5, exact[1] + 1.0, PHASE_STEP_RAD)
        # A sample is the share of its own step that lies on the Earth: any finer edge would be lost between samples.
        share = np.clip((np.minimum(phase - exact[0], exact[1] - phase)) / PHASE_STEP_RAD + 0.5, 0.0, 1.0)
        edges = find_edges(ELECTRONICS.respond(phase, share), Threshold(FRACTION), HALF_ANGLE_RAD)
        assert isinstance(edges, ScanEdges)
        fit = attitude_over_ellipsoid(
            cone, edges.entered_rad - late[0], edges.left_rad - late[1], r, lvlh, WGS84, (1e-4, 1e-4)
        )
        if isinstance(fit, Refusal):
            return math.inf
        off = math.degrees(fit.roll_rad) - roll, math.degrees(fit.pitch_rad) - pitch
        worst = max(worst, *(abs(o) for o in off))
    return worst
