"""What a suite may ask for beside its frames: made into the same folder, told of in the same summary.

Rooms above this one offer such parts, and who runs a suite says which of them there are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from horizonval.core.progress import Progress
from horizonval.jobs.execution import Execution
from horizonval.spec.load import Suite
from horizonval.store.folder import RunFolder


@dataclass(frozen=True)
class PartOutcome:
    """What became of a part.

    Attributes
    ----------
    digest : dict, or None
        For the summary; ``None`` where something failed, and there is no result.
    failed : dict
        Items without a result, by name, and why.
    seconds : dict
        Of the items that were made, by name and stage.
    files : tuple of Path
        What it made in the run's folder.
    """

    digest: dict[str, Any] | None
    failed: dict[str, str]
    seconds: dict[str, Mapping[str, float]]
    files: tuple[Path, ...] = ()


class Part(Protocol):
    """A part of a run that is no frame."""

    @property
    def name(self) -> str:
        """The key of the summary, and what goes before the names of failures."""

    def is_asked_for(self, suite: Suite) -> bool:
        """Whether a suite has this part."""

    def check(self, suite: Suite) -> None:
        """Find mistakes that the file's model cannot know; raise ``UserError`` for one."""

    def run(self, suite: Suite, folder: RunFolder, execution: Execution, progress: Progress) -> PartOutcome:
        """Make what is missing of it, and its result."""


def asked_for(suite: Suite, parts: Sequence[Part]) -> list[Part]:
    """Return the parts that a suite asks for.

    Raises
    ------
    ValueError
        It asks for one that is not there: a defect of the caller.
    """
    chosen = [part for part in parts if part.is_asked_for(suite)]
    if suite.stability is not None and not any(part.name == "stability" for part in chosen):
        raise ValueError("the suite asks for a study of the infrared horizon, and nobody offers it")
    return chosen
