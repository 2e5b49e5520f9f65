"""What a night ran on, for its record: versions and kinds, no paths and no names of machines."""

from __future__ import annotations

import importlib.metadata
import platform
import subprocess
from pathlib import Path
from typing import Any

import horizonval
from horizonval.core.code import code_version

PACKAGES = (
    "mitsuba", "drjit", "karellen-llvm-core", "numpy", "scipy", "opencv-python-headless", "OpenEXR", "pyerfa",
)  # fmt: skip
"""Those that make the numbers."""


def environment() -> dict[str, Any]:
    """Return version, commit, packages, renderer and processor as plain data."""
    from horizonval.renderer.plugin.backend import probe

    chosen = probe().chosen
    return {
        "version": code_version(),
        "commit": _commit(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "packages": {name: _version(name) for name in PACKAGES},
        "variant": None if chosen is None else chosen.variant,
        "processor_flags": _flags(),
    }


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    """Return the commit of the checkout that runs, with ``-dirty`` if files differ; None where there is none."""
    folder = Path(horizonval.__file__).parent.parent
    if not (folder / ".git").exists():
        return None
    try:
        made = subprocess.run(
            ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=12"],
            capture_output=True,
            text=True,
            timeout=30,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return made.stdout.strip() or None


def _flags() -> list[str]:
    """Return the processor's vector extensions: they decide how the renderer's kernels are compiled."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return []
    line = next((line for line in text.splitlines() if line.startswith("flags")), "")
    return sorted(flag for flag in line.partition(":")[2].split() if flag.startswith(("avx", "fma", "sse4")))
