"""The key ``render.method``: a scene that does not use it keeps its identity, one that does gets another."""

from __future__ import annotations

from pathlib import Path

from horizonval.renderer.description import describe
from horizonval.renderer.frame import render_frame
from horizonval.spec.load import Case, load_scene
from horizonval.store.exr import read_frame, write_frame
from horizonval.suites.identity import frame_identity
from horizonval.truth.frame_truth import truth_of

CAMERA = """
[camera]
width = 8
height = 6
fov_deg = 60.0
[[band]]
name = "vis"
kind = "solar"
lo_um = 0.5
hi_um = 0.6
nodes = 1
"""


def _case(folder: Path, render: str) -> Case:
    (folder / "camera.toml").write_text(CAMERA)
    path = folder / "scene.toml"
    path.write_text(
        '[camera]\nfile = "camera.toml"\nmount_roll_deg = 66.0\n[platform]\naltitude_km = 500.0\n'
        f'[sun]\nzenith_deg = 40.0\n[render]\nsubsamples = 1\nnodes = 16\norders = "single"\n{render}'
    )
    scene, camera = load_scene(path)
    return Case(scene, camera)


def test_a_scene_keeps_its_identity_unless_it_is_marched(tmp_path: Path) -> None:
    silent, table, march = (_case(tmp_path, text) for text in ("", 'method = "table"', 'method = "march"'))
    assert "method" not in silent.scene.model_dump()["render"]
    for identity in (frame_identity, lambda case: truth_of(case.scene, case.camera).scene_id):
        assert identity(silent) == identity(table)
        assert identity(march) != identity(table)


def test_the_renderer_and_the_file_know_the_method(tmp_path: Path) -> None:
    case = _case(tmp_path, 'method = "march"')
    assert describe(case.scene, case.camera).limb.method == "march"
    write_frame(tmp_path / "frame.exr", render_frame(case.scene, case.camera))
    assert read_frame(tmp_path / "frame.exr").render["method"] == "march"
