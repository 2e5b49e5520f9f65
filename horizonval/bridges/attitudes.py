"""Inertial attitudes: states of simulators as requests for images, and claims of a run as messages of CCSDS.

Simulators give position, velocity and attitude in inertial axes ``N``, with the attitude as modified Rodrigues
parameters ``sigma_BN = e tan(phi / 4)``, which turn ``N`` about the axis ``e`` by ``phi`` into ``B``. The
matrix ``[BN]`` takes components in ``N`` to components in ``B``: it is our ``q_body_from_gcrs``, and the inverse of the
rotation of vectors that scipy makes of the same parameters. ``N`` is ``gcrs``; a simulator's J2000 axes
differ from it by 23 milliarcseconds.

A horizon sensor measures roll and pitch against the local vertical. In a message of claimed attitudes the turn about
the vertical is the true one, as a remark in it says; a refusal leaves a gap.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from horizonval.api.run import open_run
from horizonval.core import atomic
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome
from horizonval.formats.aem import aem_text
from horizonval.frame import FrameTruth
from horizonval.geometry.orbit import EARTH_RATE_RAD_S
from horizonval.geometry.rotation import itrs_from_gcrs
from horizonval.spec.base import in_utc
from horizonval.store import exr
from horizonval.store.store import Store


def quaternion_of_mrp(sigma_bn: ArrayLike) -> FloatArray:
    """Return ``q_body_from_gcrs``, shape (4,), scalar last, of modified Rodrigues parameters, shape (3,)."""
    return Rotation.from_mrp(np.asarray(sigma_bn, float)).inv().as_quat(canonical=True)


def mrp_of_quaternion(q_body_from_gcrs: ArrayLike) -> FloatArray:
    """Return the modified Rodrigues parameters of the shorter turn, shape (3,), of a quaternion, shape (4,)."""
    return Rotation.from_quat(np.asarray(q_body_from_gcrs, float)).inv().as_mrp()


def request_of_state(
    epoch_utc: datetime,
    r_gcrs: ArrayLike,
    v_gcrs: ArrayLike,
    sigma_bn: ArrayLike,
    omega_bn_body: ArrayLike = (0.0, 0.0, 0.0),
) -> dict[str, Any]:
    """Return the pose keywords of :meth:`horizonval.Client.image` for a spacecraft's state at ``epoch_utc``.

    ``r_gcrs``, ``v_gcrs``: position [m] from the Earth's centre and velocity [m/s]; ``sigma_bn``: modified Rodrigues
    parameters; ``omega_bn_body``: inertial angular velocity in body axes [rad/s], which blurs the exposure.
    ``UserError`` for an epoch outside 1960 to 2099.
    """
    turn = itrs_from_gcrs(epoch_utc)
    r_itrs = turn @ np.asarray(r_gcrs, float)
    v_itrs = turn @ np.asarray(v_gcrs, float) - np.cross([0.0, 0.0, EARTH_RATE_RAD_S], r_itrs)
    body_from_gcrs = Rotation.from_quat(quaternion_of_mrp(sigma_bn))
    return {
        "epoch_utc": epoch_utc,
        "position_itrs_km": [x / 1e3 for x in r_itrs.tolist()],
        "velocity_itrs_km_s": [x / 1e3 for x in v_itrs.tolist()],
        "q_body_from_itrs": (body_from_gcrs * Rotation.from_matrix(turn.T)).as_quat(canonical=True).tolist(),
        "rate_deg_s": [math.degrees(float(x)) for x in np.asarray(omega_bn_body, float)],
        "hold": "inertial",
    }


REMARKS = (
    "Roll and pitch against the local vertical as {name} claims them; yaw is the exact one.",
    "Frames that it refused have no line. Axes of the body as in the suite that was run.",
)
_UNFIT = re.compile(r"[^A-Za-z0-9._-]+")


def write_attitudes(run_folder: Path, store: Store, out: Path) -> list[Path]:
    """Write the messages of a run into the folder ``out`` and return their paths; ``store`` has the true poses.

    Raises
    ------
    UserError
        No results, no claims, or a frame of a result that the archive does not hold.
    """
    columns = "estimator, epoch_utc, roll_deg, pitch_deg, yaw_deg, roll_error_arcsec, pitch_error_arcsec, image_address"
    rows = (
        open_run(run_folder)
        .rows()
        .filter(f"status = '{Outcome.VALID}' AND roll_error_arcsec IS NOT NULL")
        .project(columns)
        .order("estimator, epoch_utc, image_address")
        .fetchall()
    )
    if not rows:
        raise UserError("no estimator claimed an attitude", where=str(run_folder), fix="see its report")
    truths: dict[str, FrameTruth] = {}
    written = []
    for name in dict.fromkeys(row[0] for row in rows):
        times: list[datetime] = []
        quaternions = []
        for _, epoch, roll, pitch, yaw, roll_error, pitch_error, address in (row for row in rows if row[0] == name):
            time = in_utc(datetime.fromisoformat(str(epoch)))
            if times and time <= times[-1]:
                # Several heads or draws of one instant: a message has one attitude for each.
                continue
            if address not in truths:
                truths[address] = exr.read_image(store.path(address)).truth
            claimed = [yaw, pitch + pitch_error / 3600.0, roll + roll_error / 3600.0]
            times.append(time)
            quaternions.append(_claimed_body_from_gcrs(truths[address], time, [yaw, pitch, roll], claimed))
        remarks = [text.format(name=name) for text in REMARKS]
        text = aem_text(times, np.array(quaternions), name="SATELLITE", created_utc=times[-1], comments=remarks)
        path = out / f"attitude-{_UNFIT.sub('_', name)}.aem"
        atomic.write_text(path, text)
        written.append(path)
    return written


def _claimed_body_from_gcrs(
    truth: FrameTruth, time: datetime, true_deg: Sequence[float], claimed_deg: Sequence[float]
) -> np.ndarray:
    """Return the quaternion of a body whose yaw, pitch and roll against the vertical are others than the true ones."""
    body_from_itrs = (
        Rotation.from_quat(truth.q_cam_from_body).inv() * Rotation.from_quat(truth.q_cam_from_itrs)
    ).as_matrix()
    true, claimed = (
        Rotation.from_euler("ZYX", [math.radians(x) for x in angles]).inv().as_matrix()
        for angles in (true_deg, claimed_deg)
    )
    return Rotation.from_matrix(claimed @ true.T @ body_from_itrs @ itrs_from_gcrs(time)).as_quat(canonical=True)
