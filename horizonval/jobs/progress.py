"""Progress of long work on standard error (a bar, or plain lines for log files), and seconds by stage."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from horizonval.core.progress import Progress, Silent
from horizonval.jobs.pool import hush

FEWEST_ALIKE = 3
"""Finished items before their mean gives an estimate of the time left."""


def about(seconds: float | None) -> str:
    """Return the time left in words, rounded to its accuracy; empty for None."""
    if seconds is None:
        return ""
    if seconds < 90:
        step = 1 if seconds < 10 else 5
        return f"about {max(1, step * round(seconds / step))} s left"
    if seconds < 5400:
        return f"about {round(seconds / 60)} min left"
    return f"about {seconds / 3600:.1f} h left"


@contextmanager
def shown(progress: bool | Progress, what: str = "", unit: str = "frames") -> Iterator[Progress]:
    """Return a listener of ``what``: the terminal for True, none for False, else the given one."""
    if isinstance(progress, bool):
        with Terminal(what, unit) if progress else nullcontext(Silent()) as listener:
            yield listener
    else:
        yield progress


class Terminal:
    """A bar with rate and time left on a terminal, else one line per item.

    A terminal shows steps of unknown length in a changing line, a log file their start. ``what``: the work. ``unit``:
    what is counted. ``log``: False for work that a log file need not mention.
    """

    def __init__(self, what: str = "", unit: str = "frames", *, log: bool = True) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
        from rich.progress import Progress as RichProgress

        self._what, self._unit, self._log = what, unit, log
        self._console = Console(stderr=True)
        self._bar = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TextColumn("{task.fields[left]}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._status = self._console.status("") if self._console.is_terminal else None
        self._finished = self._kept = self._total = 0
        self._left_s: float | None = None
        self._told = False
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
        self._left_s, self._told = None, False
        self._task = self._bar.add_task(self._what, total=total, completed=kept, rate="", left="")
        hush()
        if kept:
            self._line(f"{kept} of {total} {self._unit} are finished already")
        elif not self._console.is_terminal and self._log:
            self._line(f"{self._what}: {total} {self._unit}".removeprefix(": "))

    def done(self, name: str, *, failed: str | None = None) -> None:
        """Advance."""
        self._finished += 1
        elapsed = max(time.monotonic() - self._begin, 1e-9)
        rate = (self._finished - self._kept) / elapsed
        if not self._told:
            alike = self._finished - self._kept >= FEWEST_ALIKE
            self._left_s = (self._total - self._finished) / rate if alike else None
        left = about(self._left_s) if self._finished < self._total else ""
        self._bar.update(self._task, completed=self._finished, rate=f"{rate:.2f} {self._unit}/s", left=left)
        if failed:
            self._line(f"{name}: failed: {failed}")
        elif not self._console.is_terminal and self._log:
            line = f"[{self._finished}/{self._total}] {name}  {rate:.2f} {self._unit}/s  {left}"
            self._line(line.rstrip())

    def left(self, seconds: float | None) -> None:
        """Show an estimate of the time left in place of the mean rate."""
        self._left_s, self._told = seconds, True

    def step(self, what: str, state: str = "") -> None:
        """Show the current step, except next to a bar."""
        if self._bar.tasks:
            return
        hush()
        if self._status is None:
            if what != self._step and self._log:
                self._line(what)
        else:
            self._status.start()
            self._status.update(f"{what}: {state}" if state else what)
        self._step = what

    def note(self, text: str) -> None:
        """Print a permanent line."""
        self._end_step()
        hush()
        self._line(f"horizonval: {text}")

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


@dataclass
class Stopwatch:
    """Seconds by stage of an item."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time spent inside to a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add(name, time.perf_counter() - start)

    def add(self, name: str, seconds: float) -> None:
        """Add seconds to a stage."""
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds

    def rounded(self) -> dict[str, float]:
        """Return the seconds to a tenth of a millisecond."""
        return {stage: round(spent, 4) for stage, spent in self.seconds.items()}
