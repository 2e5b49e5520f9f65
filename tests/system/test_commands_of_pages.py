"""Every command that a report prints runs as it stands there, in the folder that the page names."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from conftest import MINI_CAMERA, MINI_SUITE
from page_commands import cards_of, commands_of, words_of

from horizonval import cli
from horizonval.spec import files
from horizonval.suites.record import target_of

SUITE = MINI_SUITE.partition("[[frame]]")[0].replace(
    "[defaults]", '[defaults]\nrender = { subsamples = 1, nodes = 16, orders = "single" }'
)
FRAME = '[[frame]]\nscene.name = "first"\nplatform.latitude_deg = 10.0\n'
PROGRAM = """
[[estimator]]
name = "my program"
command = "sh ./refuse.sh"
"""
FIGURE = '[[figure]]\nkind = "sweep"\nx = "platform.latitude_deg"\n'
CASES = '[[cases]]\nname = "sweep"\ngrid = { "platform.latitude_deg" = [10.0] }\n'
STUDY = """
[study]
name = "mine"
keep = "all"
seed = 3
estimators = ["altitude-free", "ideal", "my-program"]
[[requirement]]
id = "R1"
error_deg = 0.5
availability = 0.9
[[estimator]]
name = "my-program"
command = "sh ./refuse.sh"
[frames.sobol]
n = 1
ranges = { "platform.latitude_deg" = [-20.0, 20.0] }
[design.grid]
"camera.optics.psf_sigma_px" = [0.5, 1.0]
[defaults]
""" + SUITE.partition("[defaults]\n")[2]
REFUSE = 'echo \'{"status": "dark", "reason": "it is night"}\'\n'


def run(*arguments: object) -> None:
    """Run a command line inside this process."""
    assert cli.run_command_line([str(argument) for argument in arguments]) == 0, arguments


@pytest.fixture(scope="module")
def files_of_a_user(here, tmp_path_factory):
    """A folder with a space in its name: a suite, one with a program, a study, and their camera."""
    folder = tmp_path_factory.mktemp("of a user")
    (folder / "mini-camera.toml").write_text(MINI_CAMERA)
    (folder / "refuse.sh").write_text(REFUSE)
    (folder / "ext.toml").write_text(SUITE + CASES + FIGURE)
    with_program = SUITE.replace('"ideal"]', '"my-program"]') + FRAME + PROGRAM.replace("my program", "my-program")
    (folder / "with-program.toml").write_text(with_program)
    (folder / "my study.toml").write_text(STUDY)
    return folder


def pages_of(out: Path) -> list[Path]:
    return sorted((out / "report").glob("*.html"))


def give_every_command(out: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> list[str]:
    """Give the commands of all pages of a run in its folder, and of every card in a folder inside; return them."""
    monkeypatch.chdir(out)
    commands = [command for page in pages_of(out) for command in commands_of(page)]
    rows = json.loads((out / "summary.json").read_text())["n_rows"]
    for command in commands:
        run(*words_of(command))
    assert json.loads((out / "summary.json").read_text())["n_rows"] == rows
    cards = [card for page in pages_of(out) for card in cards_of(page)]
    for number, card in enumerate(cards):
        folder = out / f"again-{number}"
        folder.mkdir()
        monkeypatch.chdir(folder)
        for name, text in card.files.items():
            Path(name).write_text(text)
        for command in card.commands:
            capfd.readouterr()
            run(*words_of(command), *(["--json"] if " estimate " in command else []))
            if "--suite" in command:
                assert json.loads(capfd.readouterr().out)["reason"] == "it is night"
        commands += card.commands
    return commands


@pytest.mark.slow
def test_of_a_users_suite(files_of_a_user, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(files_of_a_user)
    out = tmp_path / "my runs" / "out"
    run("run", "ext.toml", "--out", out, "--workers", 1, "--keep", "all", "--time-limit", 30)
    commands = give_every_command(out, monkeypatch, capfd)
    relative = os.path.relpath(files_of_a_user / "ext.toml", out)
    assert f"horizonval run '{relative}' --time-limit 30 --keep all --out ." in commands
    assert len(pages_of(out)) == 2
    assert sum("../archive/" in command for command in commands) == 1


def test_of_a_users_suite_with_a_program(files_of_a_user, tmp_path, monkeypatch, capfd):
    out = tmp_path / "out"
    run("run", files_of_a_user / "with-program.toml", "--out", out, "--workers", 1)
    commands = give_every_command(out, monkeypatch, capfd)
    assert sum("--estimator my-program --suite" in command for command in commands) == 1


@pytest.mark.slow
def test_of_a_study_of_a_users_file(files_of_a_user, tmp_path, monkeypatch, capfd):
    out = tmp_path / "out"
    run("study", files_of_a_user / "my study.toml", "--out", out, "--workers", 1)
    commands = give_every_command(out, monkeypatch, capfd)
    assert {command.split()[1] for command in commands} >= {"study", "render", "observe", "estimate"}
    assert any("--compare" in command for command in commands)


@pytest.mark.slow
def test_of_images_scored_again(files_of_a_user, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    run("run", files_of_a_user / "ext.toml", "--out", "made", "--workers", 1)
    run("archive", "rescore", "made", "-o", "again", "--estimator", "altitude-free-published", "--scene", "sweep*")
    commands = give_every_command(tmp_path / "again", monkeypatch, capfd)
    assert commands[0].startswith("horizonval archive rescore ../made/archive --estimator altitude-free-published")


@pytest.mark.slow
def test_of_a_shipped_suite(files_of_a_user, tmp_path, monkeypatch, capfd):
    """By its name, wherever the package is."""
    scenes = tmp_path / "scenes"
    shutil.copytree(files.shipped_root(), scenes)
    shutil.copy(files_of_a_user / "ext.toml", scenes / "suites" / "ext.toml")
    shutil.copy(files_of_a_user / "mini-camera.toml", scenes / "suites")
    monkeypatch.setattr(files, "shipped_root", lambda: scenes)
    run("run", "ext", "--out", tmp_path / "out", "--workers", 1)
    assert "horizonval run ext --out ." in give_every_command(tmp_path / "out", monkeypatch, capfd)


def test_a_users_file_is_not_taken_for_the_shipped_one_of_its_name(tmp_path):
    (tmp_path / "quick.toml").touch()
    assert target_of("suite", str(tmp_path / "quick.toml"), tmp_path / "out") == "../quick.toml"
    assert target_of("suite", str(files.shipped_path("suite", "quick")), tmp_path) == "quick"
    assert target_of("suite", str(tmp_path / "-x.toml"), tmp_path) == "./-x.toml"


def test_a_program_of_a_suite_is_estimated_with_outside_of_it(files_of_a_user, program):
    done: subprocess.CompletedProcess[str] = program(
        "estimate", "x.exr", "--estimator", "my-progam", "--suite", files_of_a_user / "with-program.toml"
    )
    assert done.returncode == 2
    assert "no estimator 'my-progam'; expected one of my-program" in done.stderr
