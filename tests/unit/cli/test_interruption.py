"""What Ctrl-C leaves behind: one line that says what is kept, and the exit status of an interrupted program."""

from __future__ import annotations

import pytest

from horizonval.cli.work import resumable


@pytest.mark.parametrize(
    ("kept", "line"),
    [
        (None, "horizonval: interrupted; the same command goes on from here\n"),
        ("units", "horizonval: interrupted; finished units are kept, the same command goes on from here\n"),
    ],
)
def test_an_interruption_is_one_line_and_status_130(kept, line, capsys):
    with pytest.raises(SystemExit) as end, resumable("night", "units", kept=kept):
        raise KeyboardInterrupt
    assert end.value.code == 130
    assert capsys.readouterr().err == line


def test_other_errors_pass_unchanged():
    mistake = ValueError("a defect")
    with pytest.raises(ValueError, match="a defect") as end, resumable("night"):
        raise mistake
    assert end.value is mistake
