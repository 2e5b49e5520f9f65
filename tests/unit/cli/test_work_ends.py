"""Work that is ended early is never a success, whoever ends it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from horizonval import cli
from horizonval.cli.work import interruptible


@pytest.mark.parametrize(
    ("end", "status"),
    [(SystemExit(0), 1), (SystemExit(None), 1), (SystemExit(3), 3), (BrokenPipeError(), 1), (KeyboardInterrupt(), 130)],
)
def test_who_ends_work_early_does_not_say_that_it_is_done(end: BaseException, status: int) -> None:
    with pytest.raises(SystemExit) as ended, interruptible():
        raise end
    assert ended.value.code == status


def test_a_run_that_somebody_ends_with_status_0_has_not_succeeded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("horizonval.commands.run.run", lambda *_, **__: sys.exit(0))
    with pytest.raises(SystemExit) as ended:
        cli.run_command_line(["run", "quick", "--out", str(tmp_path / "out")])
    assert ended.value.code == 1
    assert "before the work was done" in capsys.readouterr().err
