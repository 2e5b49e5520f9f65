"""What a user ought to know of a scene, suite or study before anything is rendered."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from horizonval.api.scene import Scene

if TYPE_CHECKING:
    from horizonval.precheck import Report


def check(target: Scene | str | Path, *, frames: int | None = None) -> Report:
    """Say what would go wrong, before rendering: exposure, arc in view, Sun, determinability, time and memory.

    Made from specifications and truth alone; the renderer is not loaded.

    Parameters
    ----------
    target : Scene, str or Path
        A scene; or the file or shipped name of a scene, suite or study.
    frames : int, optional
        Of a suite or study, in place of the file's number.

    Returns
    -------
    horizonval.precheck.Report
        ``print`` shows it; ``ok`` is False with any warning or error, ``findings`` has them one by one, ``cost`` the
        expected time and memory.

    Raises
    ------
    UserError
        There is no such file, or it cannot be read. What a run would refuse later is a finding instead.

    Examples
    --------
    >>> import horizonval as hv
    >>> scene = hv.Scene.from_file("limb-noon-vis")
    >>> hv.check(scene)
    <Report scene limb-noon-vis: nothing wrong>
    >>> exposed = scene.camera.changed(detector={"exposure_s": 0.01})
    >>> [finding.code for finding in hv.check(scene.changed(camera=exposed)).findings]
    ['saturated']
    """
    from horizonval.precheck import check as checked

    if isinstance(target, Scene):
        return checked((target.spec, target.camera.spec), frames=frames)
    return checked(target, frames=frames)
