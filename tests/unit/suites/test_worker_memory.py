"""Frames and workers that memory does not hold are refused before anything is rendered."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import horizonval as hv
from horizonval.api.check import check_scene, check_suite
from horizonval.core import memory
from horizonval.core.errors import UserError
from horizonval.jobs.pool import Execution
from horizonval.renderer.frame_cost import frame_bytes, refuse_too_large
from horizonval.spec.load import load_scene
from horizonval.suites.suite import load_suite
from horizonval.suites.worker_memory import largest_frame, within_memory

SUITE = """
[suite]
name = "two"
estimators = ["altitude-free"]
[defaults]
camera = { file = "vis-cmos-512-60deg" }
platform = { altitude_km = 500.0 }
[[frame]]
scene = { name = "coarse" }
[[frame]]
scene = { name = "fine" }
render = { subsamples = 16 }
"""


@pytest.fixture
def suite(tmp_path):
    (tmp_path / "two.toml").write_text(SUITE)
    return load_suite(tmp_path / "two.toml")


def test_a_check_and_a_refusal_know_the_same_memory(monkeypatch):
    scene, camera = load_scene("limb-noon-vis")
    cost = check_scene(scene, camera).cost
    assert cost is not None
    assert cost.memory_mb == pytest.approx(frame_bytes(scene, camera) / 1e6)
    monkeypatch.setattr(memory, "available_bytes", lambda: frame_bytes(scene, camera) - 1.0)
    with pytest.raises(UserError, match=r"a frame of .* takes about .* MB of memory; expected at most .* would fit"):
        refuse_too_large(scene, camera)
    assert check_scene(scene, camera).findings[0].code == "cannot-run"


def test_the_largest_frame_decides(suite, monkeypatch, tmp_path):
    largest = largest_frame(suite)
    assert largest is not None
    assert largest.name == "fine"
    needed = frame_bytes(largest.scene, largest.camera)
    monkeypatch.setattr(memory, "available_bytes", lambda: needed - 1.0)
    with pytest.raises(UserError, match=r"two\.toml: fine: .*of 16 x 16 cells, takes about 3"):
        hv.run(tmp_path / "two.toml", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert any("takes about" in finding.text for finding in check_suite(suite).findings)


def test_there_are_as_many_workers_as_memory_holds(suite, monkeypatch):
    largest = largest_frame(suite)
    assert largest is not None
    monkeypatch.setattr(memory, "available_bytes", lambda: 3.5 * frame_bytes(largest.scene, largest.camera))
    monkeypatch.setattr("horizonval.jobs.pool.available_cpus", lambda: 64)
    assert within_memory(Execution(), suite).workers == 3
    assert within_memory(Execution(3), suite) == Execution(3)
    assert within_memory(Execution(dask="local:9"), suite) == Execution(dask="local:9")
    with pytest.raises(UserError, match=r"--workers: 4 processes of .* expected at most 3"):
        within_memory(Execution(4), suite)
    assert within_memory(Execution(4), replace(suite, cases=())) == Execution(4)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of a process as Linux keeps them")
def test_a_large_camera_under_a_limit_is_refused_in_one_line(tmp_path):
    (tmp_path / "large.toml").write_text(
        "[camera]\nwidth = 16384\nheight = 16384\nfov_deg = 60\n"
        '[[band]]\nname = "vis"\nkind = "solar"\nlo_um = 0.45\nhi_um = 0.75\n'
    )
    (tmp_path / "scene.toml").write_text('[camera]\nfile = "large.toml"\n[platform]\naltitude_km = 500.0\n')
    limited = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (4 * 2**30, resource.RLIM_INFINITY));"
        "from horizonval.cli import main; sys.argv = ['horizonval', 'render', 'scene.toml', '-o', 'a.exr']; main()"
    )
    run = subprocess.run([sys.executable, "-c", limited], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert run.returncode == 2, run.stderr
    (line,) = (line for line in run.stderr.splitlines() if not line.endswith("is getting ready"))
    assert "a frame of 16384 x 16384 pixels" in line
    assert "would fit" in line


def test_a_control_group_is_obeyed(tmp_path, monkeypatch):
    group = tmp_path / "job"
    group.mkdir()
    for folder, limit in ((tmp_path, "max"), (group, "3000000000")):
        (folder / "memory.max").write_text(f"{limit}\n")
        (folder / "memory.current").write_text("1000000000\n")
        (folder / "memory.stat").write_text("anon 5\ninactive_file 500000000\n")
    read_text = Path.read_text

    def own_group(path, *args, **keywords):
        return "0::/job\n" if str(path) == "/proc/self/cgroup" else read_text(path, *args, **keywords)

    monkeypatch.setattr(Path, "read_text", own_group)
    monkeypatch.setattr(memory, "_CGROUPS", tmp_path)
    assert memory._group_bytes() == [2.5e9]
