"""The command line starts without what only single commands need."""

from __future__ import annotations

import subprocess
import sys

LATE = {"mitsuba", "drjit", "numpy", "scipy", "cv2", "OpenEXR", "pydantic", "rich", "duckdb", "matplotlib"}
"""numpy also because the number of its threads is fixed after this import, before numpy's own."""


def test_import_loads_nothing_heavy():
    code = "import sys, horizonval.cli; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert "typer" in loaded
    assert not loaded & LATE
