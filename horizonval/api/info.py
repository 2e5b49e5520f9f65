"""Names that other functions take, each with one sentence, and the state of this machine."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

from horizonval.spec.files import Kind, head_comment, shipped_names, shipped_path

ATMOSPHERES = {
    "tropical": "15 deg north, annual mean (AFGL 1986).",
    "midlatitude_summer": "45 deg north in July (AFGL 1986).",
    "midlatitude_winter": "45 deg north in January (AFGL 1986).",
    "subarctic_summer": "60 deg north in July (AFGL 1986).",
    "subarctic_winter": "60 deg north in January (AFGL 1986).",
    "us_standard": "US standard climate (AFGL 1986); the default.",
    "us76": "US Standard Atmosphere 1976 with the gases of AFGL 1986.",
    "by_latitude_month": "Zonal mean climate: every latitude's own air, in the month of the epoch.",
    "weather": "The air of one day, drawn from a seed: it varies with latitude, longitude and height.",
    "none": "No air.",
}

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


def list_cameras() -> list[str]:
    """Return the names of the shipped cameras, for :meth:`horizonval.Camera.from_file`.

    >>> import horizonval as hv
    >>> "vis-cmos-512-60deg" in hv.list_cameras()
    True
    """
    return shipped_names("camera")


def list_scenes() -> list[str]:
    """Return the names of the shipped scenes, for :meth:`horizonval.Scene.from_file` and :func:`horizonval.render`.

    >>> import horizonval as hv
    >>> "limb-noon-vis" in hv.list_scenes()
    True
    """
    return shipped_names("scene")


def list_suites() -> list[str]:
    """Return the names of the shipped suites, for :func:`horizonval.run`.

    >>> import horizonval as hv
    >>> "quick" in hv.list_suites()
    True
    """
    return shipped_names("suite")


def list_estimators() -> list[str]:
    """Return the names of all installed estimators, of this and of other packages.

    >>> import horizonval as hv
    >>> "guarded-altitude-free" in hv.list_estimators()
    True
    """
    from horizonval.plugins import registry

    return registry.names()


def _shipped(kind: Kind) -> Callable[[], dict[str, str]]:
    return lambda: {name: first_sentence(head_comment(shipped_path(kind, name))) for name in shipped_names(kind)}


def _estimators() -> dict[str, str]:
    from horizonval.plugins import registry

    # Nothing of other packages is imported here.
    return {
        name: f"Of another package, in {registry.module_of(name)}."
        if registry.is_foreign(name)
        else f"{registry.get(name).title.removesuffix('.')}."
        for name in registry.names()
    }


def _atmospheres() -> dict[str, str]:
    from horizonval.earth.atmosphere import climate, profiles
    from horizonval.earth.atmosphere.air import WEATHER
    from horizonval.earth.weather import real_states

    known = (*profiles.names(), climate.BY_LATITUDE_MONTH, WEATHER, "none")
    states = {f"{real_states.PREFIX}{name}": real_states.description(name) for name in real_states.names()}
    return {name: ATMOSPHERES[name] for name in known} | states


def _detectors() -> dict[str, str]:
    from horizonval.spec.detector import Cmos, LinearArray, Microbolometer, Thermopile

    return {
        get_args(model.model_fields["kind"].annotation)[0]: first_sentence(" ".join((model.__doc__ or "").split()))
        for model in (Cmos, Microbolometer, Thermopile, LinearArray)
    }


def first_sentence(text: str) -> str:
    """Return the first sentence of a text."""
    sentence = text.split(". ")[0].rstrip(" .:;")
    return f"{sentence}." if sentence else ""


LISTS: dict[str, Callable[[], dict[str, str]]] = {
    "cameras": _shipped("camera"),
    "suites": _shipped("suite"),
    "studies": _shipped("study"),
    "estimators": _estimators,
    "atmospheres": _atmospheres,
    "scenes": _shipped("scene"),
    "detectors": _detectors,
}
"""Lists of ``horizonval list``, each as a function that returns names and descriptions."""


def examine() -> dict[str, Any]:
    """Return the state of this machine: ``facts`` (label, text), ``problems`` (text, fix), ``can_render``."""
    from horizonval.core.environment import configured_folder, is_usable
    from horizonval.jobs.pool import available_cpus
    from horizonval.renderer.backend import probe

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
