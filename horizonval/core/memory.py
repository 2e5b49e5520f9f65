"""The memory that this process can allocate, and the refusal of work that needs more.

The size of work (pixels, samples, columns) is estimated before anything is allocated, because a process without memory
is killed by its host, or dies inside a library.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import psutil

from horizonval.core.errors import UserError

MB = 1e6
RESERVE_BYTES = 6e8
"""Address space that libraries reserve and do not use (stacks of threads, pools, compiled code), which limits of a
process count: 0.45 to 0.6 GB measured between address space and memory of a process that renders on two threads."""

_CGROUPS = Path("/sys/fs/cgroup")


def available_bytes() -> float:
    """Return what this process can still allocate: the least of what machine, container and process limits leave.

    Swap is not counted. Of a control group all levels count, and the files that it keeps in memory as free.
    """
    return max(0.0, min([float(psutil.virtual_memory().available), *_group_bytes(), *_process_bytes()]))


def refuse_beyond(needed_bytes: float, what: str, *, where: str = "", fix: str = "") -> None:
    """Raise ``UserError``, with both figures, where work needs more memory than there is.

    ``needed_bytes`` is the estimated peak of new allocations; ``what`` their purpose, as ``"a frame of 16384 x 16384
    pixels"``; ``where`` and ``fix`` as of :class:`UserError`.
    """
    free = available_bytes()
    if needed_bytes > free:
        raise UserError(
            f"{what} takes about {size_text(needed_bytes)} of memory",
            where=where,
            expected=f"at most {size_text(free)}, what is free here",
            fix=fix,
        )


def size_text(size_bytes: float) -> str:
    """Return a size as text: ``830 MB``, ``12.3 GB``."""
    if size_bytes < 1e9:
        return f"{size_bytes / MB:.0f} MB"
    return f"{size_bytes / 1e9:.1f} GB" if size_bytes < 1e11 else f"{size_bytes / 1e9:.0f} GB"


def peak_mebibytes() -> float | None:
    """Return the most memory that this process or one of its children that have ended had; None on Windows."""
    if sys.platform == "win32":
        return None
    import resource

    # Kilobytes, on macOS bytes.
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return peak / (1024.0**2 if sys.platform == "darwin" else 1024.0)


def _process_bytes() -> list[float]:
    """Return what the limits of the process leave (``ulimit -v``, ``ulimit -d``); nothing where there are none."""
    if sys.platform == "win32":
        return []
    import resource

    used = psutil.Process().memory_info()
    left = []
    for limit, size in ((resource.RLIMIT_AS, used.vms), (resource.RLIMIT_DATA, getattr(used, "data", used.rss))):
        soft, _ = resource.getrlimit(limit)
        if soft != resource.RLIM_INFINITY:
            left.append(float(soft - size) - RESERVE_BYTES)
    return left


def _group_bytes() -> list[float]:
    """Return what the control groups of the process leave, of version 2 or 1; nothing where there are none."""
    try:
        lines = Path("/proc/self/cgroup").read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        return []
    left = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root, names = _CGROUPS, ("memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):
            root, names = _CGROUPS / "memory", ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        else:
            continue
        folder = root / path.lstrip("/")
        # Inside a container the path is the host's, and its own group is the root.
        levels = [folder, *folder.parents] if folder.is_dir() else [root]
        for level in levels[: levels.index(root) + 1]:
            with contextlib.suppress(OSError, ValueError, KeyError):
                limit = (level / names[0]).read_text(encoding="ascii").strip()
                if limit != "max":
                    used = float((level / names[1]).read_text(encoding="ascii"))
                    statistics = (level / "memory.stat").read_text(encoding="ascii").splitlines()
                    kept = dict(entry.split() for entry in statistics)
                    left.append(float(limit) - used + float(kept[names[2]]))
    return left
