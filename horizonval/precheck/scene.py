"""Check a scene: one frame, or one of every head of its camera."""

from __future__ import annotations

from horizonval.core.errors import UserError
from horizonval.precheck.findings import Finding, sorted_findings
from horizonval.precheck.frames import Group, Watcher, cannot_run, total_cost
from horizonval.precheck.report import Report
from horizonval.precheck.rules import findings_of
from horizonval.precheck.text import joined, view_line
from horizonval.renderer.scene.frame_memory import refuse_too_large
from horizonval.sensor.observe import check_camera
from horizonval.spec.camera import ALL_HEADS, CameraSpec
from horizonval.spec.load import Case
from horizonval.spec.scene import SceneSpec


def check_scene(scene: SceneSpec, camera: CameraSpec) -> Report:
    """Say what a user ought to know of a scene before it is rendered.

    Parameters
    ----------
    scene, camera
        Resolved specifications, as :func:`horizonval.spec.load.load_scene` returns them. With several heads and none
        chosen every head is checked.

    Returns
    -------
    Report
        Its facts are one line for every band: arc in view, level and signal-to-noise ratio of the limb.

    Notes
    -----
    A second for a solar camera, up to two more for every thermal band. The renderer is not loaded.

    Examples
    --------
    >>> from horizonval.spec.load import load_scene
    >>> report = check_scene(*load_scene("night"))
    >>> [finding.code for finding in report.warnings]
    ['eclipse']
    """
    findings: list[Finding] = []
    facts: dict[str, str] = {}
    try:
        refuse_too_large(scene, camera)
        if camera.detector is not None:
            check_camera(camera)
    except UserError as e:
        findings.append(cannot_run(e))
    groups = _heads(scene, camera)
    watcher = Watcher()
    looks = [watcher.look(group, 1, infrared=True) for group in groups]
    for group, look in zip(groups, looks, strict=True):
        head = group.subject if len(groups) > 1 else ""
        findings += look.errors
        for band, views in look.views.items():
            facts[joined(head, band)] = view_line(views[0])
            findings += findings_of(views, joined(head, band if len(look.views) > 1 else ""), single=True)
    return Report(
        "scene",
        scene.scene.name,
        sorted_findings(findings),
        facts,
        len(groups),
        len(groups),
        total_cost(groups, looks, "all"),
    )


def _heads(scene: SceneSpec, camera: CameraSpec) -> list[Group]:
    """Return a group of one frame for every head that the scene has chosen, named after it."""
    if not camera.head or scene.camera.head not in (None, ALL_HEADS):
        return [Group(scene.scene.name, (Case(scene, camera),))]
    groups = []
    for head in camera.head:
        chosen = scene.camera.model_copy(update={"head": head.name})
        case = Case(scene.model_copy(update={"camera": chosen}), camera, head.name)
        groups.append(Group(head.name, (case,), needs="heads" if len(camera.head) > 1 else "image"))
    return groups
