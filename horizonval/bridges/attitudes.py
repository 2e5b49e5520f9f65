"""Inertial attitudes: states of simulators as requests for images, and claims of a run as messages of CCSDS.

Simulators give position, velocity and attitude in inertial axes ``N``, with the attitude as modified Rodrigues
parameters ``sigma_BN = e tan(phi / 4)``, which turn ``N`` about the axis ``e`` by ``phi`` into ``B``. The
matrix ``[BN]`` takes components in ``N`` to components in ``B``: it is our ``q_body_from_gcrs``, and the inverse of the
rotation of vectors that scipy makes of the same parameters. ``N`` is ``gcrs``; a simulator's J2000 axes
differ from it by 23 milliarcseconds.

A horizon sensor measures roll and pitch against the local vertical. In a message of claimed attitudes the turn about
the vertical is the true one, as a remark in it says. A message has one attitude for an instant: it counts the refusals
and the claims of other scenes, heads and draws that it leaves out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from horizonval.api.run import open_run
from horizonval.core import atomic
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt, printable
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


REMARK = (
    "Roll and pitch against the local vertical as {name} claims them; yaw is the exact one. Axes of the body as in the "
    "suite that was run."
)
LONGEST_NAMES = 100
"""Characters of the cases that a message names among those that it leaves out; a line of the format has 254."""
_UNFIT = re.compile(r"[^A-Za-z0-9._-]+")


def write_attitudes(run_folder: Path, store: Store, out: Path) -> dict[Path, str]:
    """Write the messages of a run into the folder ``out``; ``store`` has the true poses.

    Return the path of each message with what it holds and leaves out, as the message itself says.

    Raises
    ------
    UserError
        No results, no claims, or a frame of a result that the archive does not hold.
    """
    columns = "estimator, epoch_utc, roll_deg, pitch_deg, yaw_deg, roll_error_arcsec, pitch_error_arcsec, image_address"
    claim = f"status = '{Outcome.VALID}' AND roll_error_arcsec IS NOT NULL"
    results = open_run(run_folder).rows()
    rows = (
        results.filter(claim)
        .project(columns + ', "case"')
        .order('estimator, epoch_utc, "case", image_address')
        .fetchall()
    )
    if not rows:
        raise UserError("no estimator claimed an attitude", where=str(run_folder), fix="see its report")
    asked = dict(results.aggregate("estimator, count(*)").fetchall())
    truths: dict[str, FrameTruth] = {}
    written: dict[Path, str] = {}
    for name in dict.fromkeys(row[0] for row in rows):
        times: list[datetime] = []
        quaternions, left_out = [], []
        claims = [row for row in rows if row[0] == name]
        for _, epoch, roll, pitch, yaw, roll_error, pitch_error, address, case in claims:
            time = in_utc(datetime.fromisoformat(str(epoch)))
            if times and time <= times[-1]:
                left_out.append(case)
                continue
            if address not in truths:
                truths[address] = exr.read_image(store.path(address)).truth
            claimed = [yaw, pitch + pitch_error / 3600.0, roll + roll_error / 3600.0]
            times.append(time)
            quaternions.append(_claimed_body_from_gcrs(truths[address], time, [yaw, pitch, roll], claimed))
        remarks = [REMARK.format(name=name), *_counts(len(times), asked[name] - len(claims), left_out)]
        text = aem_text(times, np.array(quaternions), name="SATELLITE", created_utc=times[-1], comments=remarks)
        path = out / f"attitude-{_UNFIT.sub('_', name)}.aem"
        atomic.write_text(path, text)
        written[path] = " ".join(remarks[1:])
    return written


def _counts(lines: int, refused: int, left_out: Sequence[str]) -> Iterator[str]:
    """Yield how many claims a message has, and how many frames it leaves out and why."""
    yield f"Claims in this message: {lines}. Frames without a line because the estimator refused them: {refused}."
    if left_out:
        cases = printable(excerpt(", ".join(dict.fromkeys(left_out)), LONGEST_NAMES))
        yield (
            f"Claims left out because another scene, head or draw has the line of their instant: {len(left_out)} "
            f"({cases})."
        )


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
