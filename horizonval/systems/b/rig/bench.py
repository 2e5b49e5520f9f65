"""Where everything on the bench is: the camera's and the panel's pose, with the errors of their mounting.

The camera sits on a stage that turns by the tilt ``t`` about an axis. On a perfect bench the axis is level and hits the
picture's middle squarely, the lens lies on it and looks along it, at the distance ``D`` from which the picture has the
angles of the scene that it shows::

    bench from camera   Rz(t) Ry(axis_yaw) Rx(axis_pitch)
    lens                (shift_x, shift_y, -distance) + Rz(t) (eccentric_x, eccentric_y, 0)
    panel's middle      (0, 0, D),      bench from panel   Rz(panel_roll) Ry(panel_yaw) Rx(panel_pitch)

Sizes. The published text gives none. These are what a careful student reaches on a bench with a ruler, a square, a
spirit level and parts from a printer; they were written down before anything was rendered, and not changed since. They
were not chosen blind: a sum by hand while choosing them came to about 0.8 deg, and the published RMS was known.

* lens on the picture's middle to 3 mm, its entrance pupil on the stage's axis to 2 mm, its distance to 5 mm: a ruler
  does better, but where a small lens has its entrance pupil is known to millimetres only;
* boresight along the stage's axis to 1 deg in both directions: a printed bracket, a lens that sits askew in its thread;
* optical centre 5 pixels (27 um) from the image's middle in both directions: nobody has calibrated the camera;
* panel level to 0.25 deg (spirit level), square to the axis to 1 deg in both directions (by the eye);
* accelerometer against the image's rows: 0.3 deg (glued on); its zero to 5 mg after a calibration in two positions.

Each has its size, and a sign that nobody knows: see :mod:`horizonval.systems.b.rig.design`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray


@dataclass(frozen=True)
class BenchErrors:
    """Errors of one bench; zero everywhere is a perfect one. See the module text."""

    shift_x_mm: float = 0.0
    shift_y_mm: float = 0.0
    eccentric_x_mm: float = 0.0
    eccentric_y_mm: float = 0.0
    distance_mm: float = 0.0
    axis_yaw_deg: float = 0.0
    axis_pitch_deg: float = 0.0
    centre_x_px: float = 0.0
    centre_y_px: float = 0.0
    panel_roll_deg: float = 0.0
    panel_yaw_deg: float = 0.0
    panel_pitch_deg: float = 0.0
    accelerometer_roll_deg: float = 0.0
    accelerometer_zero_mg: float = 0.0

    def times(self, signs: FloatArray) -> BenchErrors:
        """Return the errors with the signs (or any factors) of shape (14,), in the order of the fields."""
        return BenchErrors(
            **{f.name: getattr(self, f.name) * float(s) for f, s in zip(fields(self), signs, strict=True)}
        )

    def without(self, *names: str) -> BenchErrors:
        """Return the errors with some of them zero."""
        return replace(self, **dict.fromkeys(names, 0.0))


STATED = BenchErrors(
    shift_x_mm=3.0,
    shift_y_mm=3.0,
    eccentric_x_mm=2.0,
    eccentric_y_mm=2.0,
    distance_mm=5.0,
    axis_yaw_deg=1.0,
    axis_pitch_deg=1.0,
    centre_x_px=5.0,
    centre_y_px=5.0,
    panel_roll_deg=0.25,
    panel_yaw_deg=1.0,
    panel_pitch_deg=1.0,
    accelerometer_roll_deg=0.3,
    accelerometer_zero_mg=5.0,
)


@dataclass(frozen=True)
class BenchPose:
    """A body on the bench: its origin [mm], shape (3,), and the rotation of its components to the bench's, (3, 3)."""

    r_bench_mm: FloatArray
    bench_from_body: FloatArray


def camera_pose(tilt_rad: float, errors: BenchErrors) -> BenchPose:
    """Return the pose of the lens, whose body axes are the camera's."""
    turn = Rotation.from_euler("Z", tilt_rad)
    mount = Rotation.from_euler("YX", [math.radians(errors.axis_yaw_deg), math.radians(errors.axis_pitch_deg)])
    eccentric = turn.apply([errors.eccentric_x_mm, errors.eccentric_y_mm, 0.0])
    lens = np.array([errors.shift_x_mm, errors.shift_y_mm, -errors.distance_mm]) + eccentric
    return BenchPose(lens, (turn * mount).as_matrix())


def panel_pose(distance_mm: float, errors: BenchErrors) -> BenchPose:
    """Return the pose of the panel: its origin is the picture's middle, its x and y run along rows and columns."""
    angles = np.radians([errors.panel_roll_deg, errors.panel_yaw_deg, errors.panel_pitch_deg])
    return BenchPose(np.array([0.0, 0.0, distance_mm]), Rotation.from_euler("ZYX", angles).as_matrix())


def seen_from(camera: BenchPose, panel: BenchPose, on_panel_mm: FloatArray) -> FloatArray:
    """Return places on the panel, shape (n, 2), in camera axes [mm], shape (n, 3)."""
    places = np.column_stack([on_panel_mm, np.zeros(len(on_panel_mm))])
    on_bench = panel.r_bench_mm + places @ panel.bench_from_body.T
    return np.asarray((on_bench - camera.r_bench_mm) @ camera.bench_from_body)
