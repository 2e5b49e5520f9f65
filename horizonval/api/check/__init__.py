"""Problems of a scene, suite or study before rendering: exposure, arc in view, signal, determinability, cost.

A check needs specifications and truth only; it does not load the renderer.
"""

from __future__ import annotations

from pathlib import Path

from horizonval.api.check.findings import Finding, Level, Report
from horizonval.api.check.frames import check_before_run, check_scene, check_suite, expected_of
from horizonval.api.scene import Scene
from horizonval.core.errors import UserError, nearest
from horizonval.core.files import kind_at
from horizonval.spec.files import Kind, find, shipped_names
from horizonval.spec.load import Suite, load_frames, read_toml
from horizonval.studies.trade.design import Study, expand, read_study
from horizonval.suites.suite import load_suite

__all__ = [
    "Finding",
    "Level",
    "Report",
    "check",
    "check_before_run",
    "check_scene",
    "check_suite",
    "expected_of",
    "kind_of",
]

KINDS: tuple[Kind, ...] = ("scene", "suite", "study")


def check(target: Scene | Suite | Study | str | Path, *, frames: int | None = None) -> Report:
    """Return the expected problems of a scene, suite or study, without rendering.

    Exposure, arc of the horizon in view, signal, Sun and Moon, eclipse, indeterminate frames, bands outside the tables;
    time, memory and disk. Raises ``UserError``: no such file, or it cannot be read. Errors that a run would raise later
    are findings instead.

    Parameters
    ----------
    target : Scene, Suite, Study, str or Path
        A scene, or the file or shipped name of a scene, suite or study. A scene goes before a suite of the same name.
    frames : int, optional
        Replaces the number of frames of a suite or study.

    Returns
    -------
    Report
        ``print`` shows it; ``ok`` is False if there is an error or a warning; ``findings`` has code, value, limit and
        what to change.

    Examples
    --------
    >>> import horizonval as hv
    >>> report = hv.check(hv.Scene(camera="mycam.toml", altitude_km=550, mount_roll_deg=20))
    >>> report
    <Report of scene scene: 1 warning>
    >>> report.findings[0].line()
    "warning: no horizon in view; turn the camera's mount towards it"
    """
    if isinstance(target, Suite | Study):
        return check_suite(target)
    kind, path = ("scene", Path()) if isinstance(target, Scene) else kind_of(target)
    if kind == "suite":
        return check_suite(load_suite(path, frames))
    if kind == "study":
        return check_suite(expand(*read_study(path, frames)))
    if frames is not None:
        raise UserError("a scene is one frame", where="--frames", expected="a suite or a study")
    if isinstance(target, Scene):
        return check_scene(target.spec, target.camera.spec)
    case = load_frames(path)[0]
    scene = case.scene
    if len(case.camera.head) > 1 and case.head is not None:
        scene = scene.model_copy(update={"camera": scene.camera.model_copy(update={"head": "all"})})
    return check_scene(scene, case.camera)


def kind_of(target: str | Path) -> tuple[Kind, Path]:
    """Return the kind of a file or shipped name, and its path; ``UserError`` if there is none."""
    given = Path(target).expanduser()
    if (lies_there := kind_at(given, links=True)) not in ("a file", "a folder", ""):
        raise UserError(f"is {lies_there}", where=str(given), expected="a scene, suite or study file")
    if lies_there != "a file":
        name = str(target).removesuffix(".toml")
        for kind in KINDS:
            if name in shipped_names(kind):
                return kind, find(kind, name)
        known = nearest(name.rsplit("/", 1)[-1], [name for kind in KINDS for name in shipped_names(kind)])
        raise UserError(
            f"no scene, suite or study named {str(target)!r}", expected=f"a path or one of {', '.join(known[:8])}"
        )
    tables = read_toml(given)
    for kind in KINDS:
        if kind in tables:
            return kind, given
    raise UserError("not a scene, suite or study", where=str(given), expected="a table [scene], [suite] or [study]")
