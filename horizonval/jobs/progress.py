"""Progress of long work on the terminal: a bar for people, plain lines for log files. Written to standard error."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Self


class Terminal:
    """A bar with rate and time left where standard error is a terminal, else one line per item.

    Steps of unknown length are shown in a line that changes; in a log file, when they begin.

    Parameters
    ----------
    what : str
        The work that is shown.
    unit : str
        What is counted of it.
    log : bool
        False for work of which a log file need say nothing.
    """

    def __init__(self, what: str = "", unit: str = "frames", *, log: bool = True) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as RichProgress

        self._what, self._unit, self._log = what, unit, log
        self._console = Console(stderr=True)
        self._bar = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._status = self._console.status("") if self._console.is_terminal else None
        self._finished = self._kept = self._total = 0
        self._step = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end_step()
        self._bar.stop()

    def start(self, total: int, kept: int, *, unit: str = "", what: str = "") -> None:
        """Begin; the clock of the rate starts here."""
        self._end_step()
        self._bar.start()
        self._unit, self._what = unit or self._unit, what or self._what
        self._total, self._kept, self._finished, self._begin = total, kept, kept, time.monotonic()
        self._task = self._bar.add_task(self._what, total=total, completed=kept, rate="")
        if kept:
            self._line(f"{kept} of {total} {self._unit} are finished already")

    def done(self, name: str, *, failed: str | None = None) -> None:
        """Advance."""
        self._finished += 1
        elapsed = max(time.monotonic() - self._begin, 1e-9)
        rate = (self._finished - self._kept) / elapsed
        left = (self._total - self._finished) / rate
        self._bar.update(self._task, completed=self._finished, rate=f"{rate:.2f} {self._unit}/s")
        if failed:
            self._line(f"{name}: failed: {failed}")
        elif not self._console.is_terminal and self._log:
            self._line(f"[{self._finished}/{self._total}] {name}  {rate:.2f} {self._unit}/s  {left:.0f} s left")

    def step(self, what: str, state: str = "") -> None:
        """Show what is under way; beside a bar there is no place for it."""
        if self._bar.tasks:
            return
        if self._status is None:
            if what != self._step and self._log:
                self._line(what)
        else:
            self._status.start()
            self._status.update(f"{what}: {state}" if state else what)
        self._step = what

    def _end_step(self) -> None:
        if self._status is not None:
            self._status.stop()
        self._step = ""

    def _line(self, text: str) -> None:
        if self._console.is_terminal:
            self._console.print(text, markup=False, highlight=False)
        else:
            sys.stderr.write(text + "\n")
            sys.stderr.flush()
