"""What an estimate may use."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from horizonval.spec.suite import ProgramSpec


@dataclass(frozen=True)
class Limits:
    """What an estimate may use, and the programs that are estimators here.

    Attributes
    ----------
    time_s : float
        Wall-clock time of one estimate.
    memory_mb : int
        Address space beyond what the process has before its first estimate.
    programs : tuple of ProgramSpec
    folder : Path
        Relative paths of programs start here.
    hidden : tuple of Path
        Folders that estimators of other packages and programs must not read. With one they have no network either, and
        where the system does not grant it they are not asked.
    """

    time_s: float = 60.0
    memory_mb: int = 4096
    programs: tuple[ProgramSpec, ...] = ()
    folder: Path = Path()
    hidden: tuple[Path, ...] = ()


def limit_memory(memory_mb: int) -> None:
    """Limit the address space of this process and its children to so much more than it has now."""
    try:
        import resource

        with open("/proc/self/statm") as file:
            used = int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        most = used + memory_mb * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except (ImportError, OSError, ValueError):
        # Without Linux's limits memory is the user's care, as for every other program.
        return
