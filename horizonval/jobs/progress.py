"""Progress of long work on the terminal: a bar for people, plain lines for log files. Written to standard error."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Protocol, Self


class Progress(Protocol):
    """What a run tells about itself."""

    def start(self, total: int, kept: int, *, unit: str = "", what: str = "") -> None:
        """``total`` cases, of which ``kept`` are finished already; ``unit`` and ``what`` name another kind of them."""

    def done(self, name: str, *, failed: str | None = None) -> None:
        """One more case is finished; ``failed`` says why it has no result."""


class Silent:
    """No progress at all."""

    def start(self, total: int, kept: int, *, unit: str = "", what: str = "") -> None:
        """Ignore."""

    def done(self, name: str, *, failed: str | None = None) -> None:
        """Ignore."""


class Terminal:
    """A bar with rate and time left where standard error is a terminal, else one line per case (or other ``unit``)."""

    def __init__(self, what: str, unit: str = "frames") -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as RichProgress

        self._what, self._unit = what, unit
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
        self._finished = self._kept = self._total = 0

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()

    def start(self, total: int, kept: int, *, unit: str = "", what: str = "") -> None:
        """Begin; the clock of the rate starts here."""
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
        elif not self._console.is_terminal:
            self._line(f"[{self._finished}/{self._total}] {name}  {rate:.2f} {self._unit}/s  {left:.0f} s left")

    def _line(self, text: str) -> None:
        if self._console.is_terminal:
            self._console.print(text, markup=False, highlight=False)
        else:
            sys.stderr.write(text + "\n")
            sys.stderr.flush()


class Tables:
    """One line that says which table of multiple scattering is being solved; cached tables are not mentioned."""

    def __init__(self) -> None:
        from rich.console import Console

        self._console = Console(stderr=True)
        self._status = self._console.status("") if self._console.is_terminal else None
        self._shown = False
        self._name = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status is not None and self._shown:
            self._status.stop()

    def advance(self, name: str, order: int, share: float) -> None:
        """Tell that ``order`` of scattering is done for spectral node ``name``; it added ``share`` of the light."""
        text = f"multiple scattering at {name}: order {order}, adding {share:.1%}"
        if self._status is None:
            if name != self._name:
                self._console.print(f"multiple scattering at {name}: solving", highlight=False)
        else:
            if not self._shown:
                self._status.start()
            self._status.update(text)
        self._shown, self._name = True, name
