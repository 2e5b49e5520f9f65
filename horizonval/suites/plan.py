"""Plan of a run for every case, and the grouping of cases into units."""

from __future__ import annotations

import contextlib
import itertools
import json
import shlex
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from horizonval.core import files
from horizonval.core.errors import UserError
from horizonval.estimation.observation import Estimator
from horizonval.plugins import supervisor
from horizonval.plugins.supervisor import Limits
from horizonval.spec.load import Case, Suite
from horizonval.spec.suite import Keep

LARGEST_PROGRAM = 1 << 32
"""Size of a program [bytes]."""
FRAME_LIMIT_S = 3600.0
"""Time limit of everything about one frame, against a hanging renderer; scattering tables take minutes at most."""


@dataclass(frozen=True)
class CasePlan:
    """Estimators in the suite's order, their limits, what the archive keeps; ``draws`` noise samples of every frame."""

    estimators: tuple[str, ...]
    limits: Limits = field(default_factory=Limits)
    keep: Keep = "all"
    frame_limit_s: float = FRAME_LIMIT_S
    draws: int = 1

    def estimator(self, name: str) -> Estimator:
        """Return an estimator of the suite, a program or an installed one. Raises ``UserError``: no such estimator."""
        return supervisor.get(name, self.limits)

    def of(self, case: Case) -> tuple[str, ...]:
        """Return the estimators of a case, in the suite's order."""
        return self.estimators if case.estimators is None else case.estimators

    def alone(self, case: Case) -> tuple[str, ...]:
        """Return the estimators of a case that use one image."""
        return tuple(name for name in self.of(case) if self.estimator(name).needs != "heads")

    def together(self, case: Case) -> tuple[str, ...]:
        """Return the estimators of a case that use the images of all heads."""
        return tuple(name for name in self.of(case) if self.estimator(name).needs == "heads")

    def content(self, estimators: Sequence[str] | None = None) -> str:
        """Return the part of the plan that results depend on, for ``estimators`` (default all); limits do not count."""
        names = self.estimators if estimators is None else estimators
        programs = [
            [spec.model_dump(mode="json"), _digests(spec.command, self.limits.folder)]
            for spec in self.limits.programs
            if spec.name in names
        ]
        # Only a number above 1 enters the digest.
        return json.dumps([names, self.keep, programs, *([self.draws] if self.draws != 1 else [])])


def plan_of(suite: Suite) -> CasePlan:
    folder = Path(suite.source).resolve().parent
    limits = Limits(suite.time_limit_s, suite.memory_limit_mb, suite.programs, folder)
    return CasePlan(suite.estimators, limits, suite.keep, draws=suite.draws)


def _digests(command: str, folder: Path) -> list[str]:
    """Digest of every file that a command names, since programs change results.

    Words inside quoted words, values of options, modules of ``-m``, a script found on the path, and the Python files
    beside a named one count too. What a program reads beyond them is unknown.
    """
    try:
        words = [part for word in shlex.split(command) for part in (word, *word.split(), word.rpartition("=")[2])]
    except ValueError:
        return []
    modules = [after for before, after in itertools.pairwise(words) if before == "-m"]
    paths = [folder / word for word in words] + [folder / f"{name.replace('.', '/')}.py" for name in modules]
    paths += [folder / name.replace(".", "/") / "__main__.py" for name in modules]
    if (found := shutil.which(words[0])) is not None and files.read_bytes(
        found, largest=LARGEST_PROGRAM, first=2
    ) == b"#!":
        paths.append(Path(found))
    paths = [path for path in paths if files.kind_at(path, links=True) == "a file"]
    paths += [other for path in paths if path.suffix == ".py" for other in sorted(path.parent.glob("*.py"))]
    digests = []
    for path in dict.fromkeys(paths):
        with contextlib.suppress(UserError):
            digests.append(files.sha256_of(path))
    return digests


@dataclass(frozen=True)
class Unit:
    """Work of one worker at a time: a case, or all heads of a scene with a common result.

    ``name`` is the case's, or the scene's where ``heads`` is set.
    """

    name: str
    cases: tuple[Case, ...]
    heads: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all results: the cases', and the scene's for a common result of the heads."""
        return tuple(case.name for case in self.cases) + ((self.name,) if self.heads else ())


def units_of(cases: Iterable[Case], plan: CasePlan) -> list[Unit]:
    units: list[Unit] = []
    for (name, of_all_heads), group in itertools.groupby(cases, lambda case: (case.scene_name, of_heads(case))):
        members = tuple(group)
        if of_all_heads and plan.together(members[0]):
            units.append(Unit(name, members, heads=True))
        else:
            units += [Unit(case.name, (case,)) for case in members]
    return units


def of_heads(case: Case) -> bool:
    """Whether a case is one of all heads of a scene."""
    return case.head is not None
