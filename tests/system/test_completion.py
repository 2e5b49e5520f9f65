"""What bash offers after <Tab>, asked from bash itself."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from conftest import PROGRAM

from horizonval.cli.options import shipped
from horizonval.spec.files import shipped_names

ASK = """
eval "$(_HORIZONVAL_COMPLETE=source_bash horizonval)"
COMP_WORDS=({words})
COMP_CWORD={last}
$(complete -p horizonval | sed 's/.*-F \\([^ ]*\\).*/\\1/') horizonval
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


def offered(words: str, folder: Path) -> list[str]:
    """The words that bash would offer in place of the last one."""
    script = ASK.format(words=words, last=len(words.replace("''", "x").split()) - 1)
    done = subprocess.run(
        ["bash", "--norc", "-c", script],
        cwd=folder,
        env=os.environ | {"PATH": os.pathsep.join([str(PROGRAM.parent), os.environ["PATH"]])},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    return sorted(done.stdout.split("\n")[:-1])


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("horizonval re", ["regress", "render", "report", "reproduce"]),
        ("horizonval render my", ["my.toml", "mydir/"]),
        ("horizonval estimate i.png --estimator guarded-v", ["guarded-video-vertical"]),
    ],
)
def test_names_are_offered(tmp_path, words, expected):
    (tmp_path / "my.toml").touch()
    (tmp_path / "my.txt").touch()
    (tmp_path / "mydir").mkdir()
    assert offered(words, tmp_path) == expected


def test_every_name_that_a_command_takes_is_offered(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for kind in ("scene", "camera", "suite", "study"):
        words = shipped(kind)("")
        assert [name for name, _ in words] == shipped_names(kind)
        assert all(description for _, description in words)


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_a_script(shell):
    done = subprocess.run(
        [str(PROGRAM)],
        env=os.environ | {"_HORIZONVAL_COMPLETE": f"source_{shell}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "_HORIZONVAL_COMPLETE=complete_" + shell in done.stdout
    assert done.stderr == ""
