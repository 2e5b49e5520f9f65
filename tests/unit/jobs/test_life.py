"""A command that loads for long says so, and one that has said something does not."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

from horizonval.jobs.pool import hush, sign_of_life
from horizonval.jobs.progress import Terminal

SLOW = """
import sys, time
from horizonval.cli import app
app.run_command_line = lambda arguments: time.sleep(20)
sys.argv = ["horizonval", "archive", "verify", "out"]
app.main()
"""


def test_a_line_comes_while_a_command_still_loads():
    """Long before the command has done anything, from the program itself."""
    with subprocess.Popen([sys.executable, "-c", SLOW], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "horizonval: archive verify is getting ready\n"
        assert process.poll() is None
        process.kill()


@pytest.mark.parametrize("hushed", [False, True])
def test_who_has_said_something_needs_no_sign(capsys, hushed):
    with sign_of_life("here", 0.05):
        if hushed:
            hush()
        time.sleep(0.3)
    assert capsys.readouterr().err == ("" if hushed else "here\n")


def test_progress_is_a_sign_of_life(capsys):
    with Terminal("work", "frames") as terminal, sign_of_life("here", 0.5):
        terminal.start(3, 0)
        time.sleep(0.8)
        terminal.left(400.0)
        terminal.done("first")
    first, second = capsys.readouterr().err.splitlines()
    assert first == "work: 3 frames"
    assert second.startswith("[1/3] first")
    assert second.endswith("about 7 min left")
