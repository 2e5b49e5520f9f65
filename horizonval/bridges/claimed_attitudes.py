"""The attitudes that the estimators of a run claimed, as messages of CCSDS, one for each estimator.

A horizon sensor sees roll and pitch against the local vertical. The turn about the vertical is the truth's, which the
message says in a remark; refusals leave a gap.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.api.run import open_run
from horizonval.core import atomic
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome
from horizonval.formats.motion.aem import aem_text
from horizonval.frame import FrameTruth
from horizonval.geometry.rotation import itrs_from_gcrs
from horizonval.store import exr
from horizonval.store.store import Store

REMARKS = (
    "Roll and pitch against the local vertical as {name} claims them; yaw is the exact one.",
    "Frames that it refused have no line. Axes of the body as in the suite that was run.",
)
_UNFIT = re.compile(r"[^A-Za-z0-9._-]+")


def write_attitudes(run_folder: Path, store: Store, out: Path) -> list[Path]:
    """Write the messages into a folder and return their paths.

    Parameters
    ----------
    run_folder : Path
    store : Store
        The run's archive, which has the true pose of every frame.
    out : Path

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
            time = datetime.fromisoformat(str(epoch))
            time = time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)
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
