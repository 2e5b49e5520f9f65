"""Check whatever a user names: a scene, a suite or a study, by path or by the name of a shipped one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError, nearest
from horizonval.core.files import kind_at
from horizonval.precheck.report import Report
from horizonval.precheck.scene import check_scene
from horizonval.precheck.study import check_study
from horizonval.precheck.suite import check_suite
from horizonval.spec.camera import CameraSpec
from horizonval.spec.files import Kind, find, shipped_names
from horizonval.spec.load import Suite, load_frames, read_toml
from horizonval.spec.scene import SceneSpec
from horizonval.studies.trade.design import Study, expand, read_study
from horizonval.suites.suite import load_suite

KINDS: tuple[Kind, ...] = ("scene", "suite", "study")


def check(target: str | Path | tuple[SceneSpec, CameraSpec] | Suite | Study, *, frames: int | None = None) -> Report:
    """Say what a user ought to know of a scene, suite or study before anything is rendered.

    Parameters
    ----------
    target : str, Path, (SceneSpec, CameraSpec), Suite or Study
        A file, the name of a shipped one, or what is read from it. A name that is a scene's and a suite's is the
        scene's.
    frames : int, optional
        Of a suite or study, in place of the file's number.

    Raises
    ------
    UserError
        There is no such file, or it cannot be read. What a run would refuse later is a finding instead.

    Examples
    --------
    >>> check("limb-noon-vis").ok
    True
    """
    if isinstance(target, Suite):
        return check_suite(target)
    if isinstance(target, Study):
        return check_study(target)
    kind, path = ("scene", Path()) if isinstance(target, tuple) else kind_of(target)
    if kind == "suite":
        return check_suite(load_suite(path, frames))
    if kind == "study":
        return check_study(expand(*read_study(path, frames)))
    if frames is not None:
        raise UserError("a scene is one frame", where="--frames", expected="a suite or a study")
    if isinstance(target, tuple):
        return check_scene(*target)
    case = load_frames(path)[0]
    scene = case.scene
    if len(case.camera.head) > 1 and case.head is not None:
        scene = scene.model_copy(update={"camera": scene.camera.model_copy(update={"head": "all"})})
    return check_scene(scene, case.camera)


def kind_of(target: str | Path) -> tuple[Kind, Path]:
    """Return which kind of file is meant, and its path.

    Raises
    ------
    UserError
        There is none, or it has none of the tables that tell.
    """
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
    tables: dict[str, Any] = read_toml(given)
    for kind in KINDS:
        if kind in tables:
            return kind, given
    raise UserError("not a scene, suite or study", where=str(given), expected="a table [scene], [suite] or [study]")
