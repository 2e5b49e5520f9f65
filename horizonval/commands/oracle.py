"""What the ideal horizon sensor reads where an image or a frame was taken: the oracle, from the pose in the header."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.estimation.methods.ideal import ReadingStatus, ideal_horizon_sensor
from horizonval.frame import FrameTruth
from horizonval.store import exr
from horizonval.suites.observation import oracle_pose


def oracle_of_file(path: Path) -> dict[str, Any]:
    """Return the reading of a file of ours; see :func:`oracle_of`. Raises as
    :func:`horizonval.store.exr.read_header`."""
    return {"file": str(path), **oracle_of(FrameTruth.from_dict(exr.read_header(path)["truth"]))}


def oracle_of(truth: FrameTruth) -> dict[str, Any]:
    """Return what the ideal sensor reads, by both readings of its documentation [deg]; None where it reads nothing.

    ``roll_error_deg``, ``pitch_error_deg``: between the sensor's axes and those of the nearest horizon point;
    ``roll_elevation_deg``, ``pitch_elevation_deg``: of the sensor's axes over the tangent plane there. The Earth is the
    sphere whose angular radius is the mean over the horizon; ``horizon_cam`` leads to the point.
    """
    pose = oracle_pose(truth)
    found = ideal_horizon_sensor(pose.r_itrs, pose.q_cam_from_itrs, pose.radius_m)
    defined = found.status is ReadingStatus.DEFINED

    def degrees(angle_rad: float) -> float | None:
        return math.degrees(angle_rad) if defined else None

    return {
        "status": str(found.status),
        "roll_error_deg": degrees(found.roll_error_rad),
        "pitch_error_deg": degrees(found.pitch_error_rad),
        "roll_elevation_deg": degrees(found.roll_elevation_rad),
        "pitch_elevation_deg": degrees(found.pitch_elevation_rad),
        "horizon_cam": np.asarray(found.horizon_cam).tolist() if defined else None,
        "nadir_cam": list(truth.nadir_geocentric_cam),
        "angular_radius_deg": math.degrees(truth.angular_radius_rad),
        "roll_deg": math.degrees(truth.roll_rad),
        "pitch_deg": math.degrees(truth.pitch_rad),
        "altitude_km": truth.altitude_m / 1e3,
    }
