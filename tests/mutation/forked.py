"""pytest in children of one process that has the libraries imported: seconds saved for every mutant.

Nothing of this package is imported before the child starts, so that it sees the mutant.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
import time
from pathlib import Path

LIBRARIES = (
    "numpy", "scipy.stats", "scipy.optimize", "scipy.spatial.transform", "scipy.interpolate", "scipy.ndimage",
    "scipy.signal", "cv2", "OpenEXR", "erfa", "pydantic", "typer", "rich", "duckdb", "jinja2", "hypothesis", "pytest",
    "astropy.io.fits", "matplotlib.pyplot",
)  # fmt: skip


def prepare(tree: Path) -> None:
    """Import what the tests need and what no mutant changes; from here on imports find the copy of the source."""
    os.environ |= {"MPLBACKEND": "agg", "PYTHONPATH": str(tree), "XDG_CACHE_HOME": str(tree.parent / "cache")}
    os.environ |= {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "PYTHONDONTWRITEBYTECODE")}
    sys.dont_write_bytecode = True
    for name in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    sys.path.insert(0, str(tree))
    os.chdir(tree)


def run(arguments: list[str], output: Path, limit_s: float) -> int | None:
    """Return the status of pytest in a child, None if it took too long; it goes with all that it started."""
    child = os.fork()
    if child == 0:
        os.setsid()
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        with output.open("wb") as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        import pytest

        status = 70
        try:
            status = int(pytest.main(arguments))
        finally:
            sys.stdout.flush()
            os._exit(status)
    deadline = time.monotonic() + limit_s
    status: int | None = None
    try:
        while time.monotonic() < deadline:
            ended, code = os.waitpid(child, os.WNOHANG)
            if ended:
                status = os.waitstatus_to_exitcode(code)
                break
            time.sleep(0.02)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
    if status is None:
        os.waitpid(child, 0)
    return status
