"""What works on this machine, and what to do about what does not."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
from pathlib import Path
from typing import Any

PACKAGES = (
    "horizonval", "mitsuba", "drjit", "karellen-llvm-core", "numpy", "scipy", "opencv-python-headless", "OpenEXR",
    "pyerfa", "pydantic", "typer", "rich", "duckdb", "matplotlib", "jinja2",
)  # fmt: skip
"""What the package depends on. The LLVM wheel exists for Linux on x86-64 only; elsewhere the system's LLVM serves."""

LLVM_HELP = {
    "Linux": "install LLVM 17 or newer (`pip install karellen-llvm-core`, or the system package libllvm19), "
    "or set DRJIT_LIBLLVM_PATH to a libLLVM.so of that version",
    "Darwin": "install LLVM 17 or newer (`brew install llvm`) and set DRJIT_LIBLLVM_PATH to its libLLVM.dylib",
    "Windows": "install LLVM 17 or newer from llvm.org and set DRJIT_LIBLLVM_PATH to its LLVM-C.dll",
}


def examine() -> dict[str, Any]:
    """Return what is found, as plain data: ``facts`` (label, text), ``problems`` (text, fix), ``can_render``."""
    from horizonval.core.environment import configured_folder, is_usable
    from horizonval.jobs.execution import available_cpus
    from horizonval.renderer.plugin.backend import probe

    facts: list[tuple[str, str]] = [
        ("Python", f"{platform.python_version()} ({sys.executable})"),
        ("system", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("processors", f"{available_cpus()} usable of {os.cpu_count()}"),
    ]
    problems: list[tuple[str, str]] = []
    for name in PACKAGES:
        try:
            facts.append((name, importlib.metadata.version(name)))
        except importlib.metadata.PackageNotFoundError:
            if name == "karellen-llvm-core":
                facts.append((name, "not installed"))
            else:
                problems.append((f"package {name} is not installed", "pip install ."))
    report = probe(refresh=True)
    for attempt in report.attempts:
        library = f" with {attempt.library}" if attempt.library else ""
        facts.append((attempt.variant, f"{'works' if attempt.works else 'does not work'}{library}: {attempt.detail}"))
    if report.chosen is None:
        problems.append(("no back-end can render", LLVM_HELP.get(platform.system(), LLVM_HELP["Linux"])))
    else:
        facts.append(("renders with", f"{report.chosen.variant} {report.chosen.library}".strip()))
    facts.append(("GPU", _gpu()))
    cache = configured_folder()
    facts.append(("cache", str(cache)))
    if not is_usable(cache):
        problems.append((f"cannot write to {cache}", "set XDG_CACHE_HOME to a folder you can write to"))
    return {"facts": facts, "problems": problems, "can_render": report.chosen is not None}


def _gpu() -> str:
    driver = Path("/proc/driver/nvidia/gpus")
    files = sorted(driver.glob("*/information")) if driver.is_dir() else []
    for path in files:
        for line in path.read_text().splitlines():
            if line.startswith("Model:"):
                return line.removeprefix("Model:").strip()
    return "none found (not needed)"
