"""The peak memory of a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def peak_bytes() -> int:
    """Return the peak resident memory of this process, interpreter and compiler included."""
    # On Linux getrusage also counts what the parent held when it started this process.
    status = Path("/proc/self/status")
    if status.exists():
        return int(status.read_text().split("VmHWM:")[1].split()[0]) * 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def run_apart(module: str, call: str) -> tuple[str, int]:
    """Return what a call of a module of this folder gives, as text, and the peak memory of the process that made it."""
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        f"import {module} as t; from peak_memory import peak_bytes\n"
        f"print('result', t.{call}, 'peak', peak_bytes())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    result, peak = run.stdout.split("result")[1].split("peak")
    return result.strip(), int(peak)
