"""What a user ought to know of a scene, suite or study before anything is rendered."""

from __future__ import annotations

from pathlib import Path

from horizonval.api.scene import Scene
from horizonval.precheck import Report
from horizonval.precheck import check as check_target


def check(target: Scene | str | Path, *, frames: int | None = None) -> Report:
    """Say what would go wrong with a scene, suite or study, without rendering any of it.

    Exposure, arc of the horizon in view, signal, Sun and Moon, eclipse, frames of which nothing can be determined,
    bands outside the tables; time, memory and disk.

    Parameters
    ----------
    target : Scene, str or Path
        A scene, or the file or shipped name of a scene, suite or study.
    frames : int, optional
        Of a suite or study, in place of the file's number.

    Returns
    -------
    Report
        ``print`` shows it; ``ok`` is False if there is an error or a warning; ``findings`` has code, value, limit and
        what to change.

    Raises
    ------
    UserError
        There is no such file, or it cannot be read. What a run would refuse later is a finding instead.

    Examples
    --------
    >>> import horizonval as hv
    >>> report = hv.check(hv.Scene(camera="mycam.toml", altitude_km=550, mount_roll_deg=20))
    >>> report
    <Report of scene scene: 1 warning>
    >>> report.findings[0].line()
    "warning: no horizon in view; turn the camera's mount towards it"
    """
    if isinstance(target, Scene):
        return check_target((target.spec, target.camera.spec), frames=frames)
    return check_target(target, frames=frames)
