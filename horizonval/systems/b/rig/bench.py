"""Where everything on the bench is: the camera's and the panel's pose, with the errors of their mounting.

The camera sits on a stage that turns by the tilt ``t`` about an axis. On a perfect bench the axis is level and hits the
picture's middle squarely, the lens lies on it and looks along it, at the distance ``D`` from which the picture has the
angles of the scene that it shows::

    bench from camera   Rz(t) Ry(axis_yaw) Rx(axis_pitch)
    lens                (shift_x, shift_y, -distance) + Rz(t) (eccentric_x, eccentric_y, 0)
    panel's middle      (0, 0, D),      bench from panel   Rz(panel_roll) Ry(panel_yaw) Rx(panel_pitch)

Sizes. The published text gives none. These are what a careful student reaches on a bench with a ruler, a square, a
spirit level and parts from a printer. They were
chosen before anything was rendered, but not blind: the published RMS was known, and a sum by hand gave about 0.8 deg.

* lens on the picture's middle to 3 mm, its entrance pupil on the stage's axis to 2 mm, its distance to 5 mm: a ruler
  does better, but where a small lens has its entrance pupil is known to millimetres only;
* boresight along the stage's axis to 1 deg in both directions: a printed bracket, a lens that sits askew in its thread;
* optical centre 5 pixels (27 um) from the image's middle in both directions: nobody has calibrated the camera;
* panel level to 0.25 deg (spirit level), square to the axis to 1 deg in both directions (by the eye);
* accelerometer against the image's rows: 0.3 deg (glued on); its zero to 5 mg after a calibration in two positions.

*The reference* is a two-axis accelerometer on the stage. It measures gravity across the stage's axis, ``(sin t, cos
t)`` g at the tilt ``t``, with an error of its zero, noise and the steps of its converter, and is mounted with a turn
against the image's rows::

    reading = atan2(mean a_x, mean a_y),     a = step * round((g(t + roll) + zero + noise) / step)

Its figures are those of the ten-bit parts on hobby boards: steps of 3.9 mg, noise of one step, a zero that a
calibration in two positions brings to some milligrams. The noise is larger than half a step and so smooths the steps
away in a mean.

Neglected: cross-axis sensitivity (1 %: at 20 deg, 0.2 deg times the level axis's error, below 0.01 deg) and an error of
scale, which both axes share and which drops out of their ratio.

*Sixteen benches* have every error at its stated size: a two-level design of experiments. The signs of the errors are
unknown, and the RMS of one bench depends on them: errors add up or cancel. So sixteen
benches are rendered whose signs are the columns of a Hadamard matrix (Plackett and Burman, Biometrika 33, 305, 1946).
Any two columns are orthogonal. To first order the mean square over the benches is then the sum of the squares that the
errors cause one by one, whatever the signs; and the mean of ``sign * error of the tilt`` over the benches is what one
error alone does, so that one run of the design gives all sensitivities.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.linalg import hadamard
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


STEP_MG = 3.9
NOISE_MG = 4.0
SAMPLES = 64


@dataclass(frozen=True)
class Accelerometer:
    """One accelerometer: ``roll_rad``, turn against the camera's rows; ``zero_mg``, zero error of x."""

    roll_rad: float = 0.0
    zero_mg: float = 0.0

    def tilt_rad(self, true_rad: float, rng: np.random.Generator | None) -> float:
        """Return the tilt that a mean of 64 samples gives; without random numbers no noise and no steps."""
        angle = true_rad + self.roll_rad
        gravity_mg = 1e3 * np.array([math.sin(angle), math.cos(angle)]) + np.array([self.zero_mg, 0.0])
        if rng is not None:
            samples = gravity_mg + NOISE_MG * rng.standard_normal((SAMPLES, 2))
            gravity_mg = STEP_MG * np.rint(samples / STEP_MG).mean(axis=0)
        return math.atan2(gravity_mg[0], gravity_mg[1])


BENCHES = 16
NAMES = tuple(f.name for f in fields(BenchErrors))


def signs() -> FloatArray:
    """Return the sign of every error on every bench, shape (16, 14), in the order of :data:`NAMES`."""
    return np.asarray(hadamard(BENCHES)[:, 1 : 1 + len(NAMES)], dtype=float)


def benches(stated: BenchErrors) -> list[BenchErrors]:
    """Return the sixteen benches, equal ones included."""
    return [stated.times(row) for row in signs()]


def main_effects(values: FloatArray) -> FloatArray:
    """Return the effect of each error at its stated, positive size, (14, ...), from ``values`` (16, ...).

    Products of two errors remain: second order, 0.02 deg at the stated sizes.
    """
    return np.asarray(np.tensordot(signs(), values, axes=(0, 0)) / BENCHES)


def unused_effect(values: FloatArray) -> FloatArray:
    """Return the contrast of the one column that no error has, shape (...): noise, and products of errors."""
    return np.asarray(np.tensordot(hadamard(BENCHES)[:, -1].astype(float), values, axes=(0, 0)) / BENCHES)
