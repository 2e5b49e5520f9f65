"""No command replaces an input, nor a file in a folder that is not its own; every refusal is one line, before work."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from horizonval.api import gallery
from horizonval.cli.app import run_command_line
from horizonval.core import files
from horizonval.core.errors import UserError
from horizonval.store.folder import OWN, RunFolder, write_json

SCENE = """
[camera]
file = "vis-cmos-512-60deg"
[platform]
altitude_km = 500.0
"""
PROFILE = "altitude_km,temperature_K\n0,288\n100,200\n"
TABLES = {
    "atm.json": '[atmosphere]\nfile = "atm.json"\n',
    "air.csv": '[atmosphere]\nprofile_file = "air.csv"\n',
    "climate.npz": '[prior]\nclimate = "climate.npz"\n',
    "boom.obj": '[[part]]\nname = "boom"\nshape = "mesh"\nfile = "boom.obj"\n',
}


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert run_command_line(list(words)) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0].removeprefix("horizonval: error: ")


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("spelling", ["{}", "./{}", "link", "hard"])
def test_what_a_scene_names_is_refused_before_the_render(
    here: Path, capsys: pytest.CaptureFixture[str], name: str, spelling: str
) -> None:
    (here / "s.toml").write_text(SCENE + TABLES[name])
    (here / name).write_text(PROFILE)
    (here / "link").symlink_to(name)
    os.link(here / name, here / "hard")
    out = spelling.format(name)
    expected = f"{out.removeprefix('./')}: is read by this command, which would replace it; name another file"
    assert _refused(capsys, "render", "s.toml", "-o", out) == expected
    assert (here / name).read_text() == PROFILE


@pytest.mark.parametrize(
    ("out", "line"),
    [
        ("full/x.exr", "full: is a file; expected a folder"),
        ("full/deep/x.exr", "full: is a file; expected a folder"),
        ("none/x.exr", "none: no such folder; create it first"),
        ("", "-o .: is a folder, or an empty name; expected the path of a file"),
    ],
)
def test_the_true_cause_is_named(here: Path, capsys: pytest.CaptureFixture[str], out: str, line: str) -> None:
    (here / "full").touch()
    assert _refused(capsys, "render", "limb-noon-vis", "-o", out) == line
    if out.startswith("full"):
        assert _refused(capsys, "run", "quick", "--out", out) == line


def test_rays_are_no_output(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "rays.csv").touch()
    line = _refused(capsys, "radiance", "rays.csv", "--atmosphere", "us76", "-o", "rays.csv")
    assert line.startswith("rays.csv: is read by this command")


@pytest.mark.parametrize("name", OWN)
def test_a_run_keeps_out_of_folders_of_others(tmp_path: Path, name: str) -> None:
    folder = RunFolder(tmp_path / "out")
    file = folder.root / name if "." in name else folder.root / name / "mine"
    file.parent.mkdir(parents=True)
    file.write_text("{}")
    (folder.root / "suite.toml").touch()
    with pytest.raises(UserError, match=re.escape(f"{folder.root}: holds {name}, which no command")):
        folder.create()
    assert file.read_text() == "{}"
    assert sorted(path.name for path in folder.root.iterdir()) == sorted([name, "suite.toml"])


def _own(mark: Callable[[RunFolder], object], root: Path) -> None:
    folder = RunFolder(root)
    folder.create()
    mark(folder)
    (root / "report").mkdir(exist_ok=True)
    (root / "report" / "index.html").touch()
    folder.create()


def _lock(folder: RunFolder) -> None:
    with folder.locked():
        pass


def test_a_run_goes_on_in_its_own_folder(tmp_path: Path) -> None:
    _own(_lock, tmp_path / "locked")
    _own(lambda folder: write_json(folder.suite, {}), tmp_path / "sealed")
    folder = RunFolder(tmp_path / "cut off before the lock")
    folder.create()
    folder.create()


def test_a_gallery_keeps_out_of_folders_of_others(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(UserError, match="is not empty; expected a new or empty folder, or one of this command"):
        gallery.make_gallery(tmp_path, ["glint"])
    (tmp_path / "index.html").write_text(f"<title>{gallery.GALLERY_TITLE}</title>")
    files.check_folder(tmp_path, ours=gallery._is_gallery(tmp_path))


def test_an_export_keeps_out_of_the_archive(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    RunFolder(here / "run").create()
    (here / "run" / "archive" / "ab").mkdir()
    line = _refused(capsys, "archive", "export", "run", "--png", "-o", "run/archive/ab")
    assert line.startswith("run/archive/ab: lies inside the archive; expected a folder outside it")
