"""Which Dr.Jit back-end can render here, found out without risking this process.

Some LLVM libraries abort the whole process when a kernel is compiled (15 and 16 on CPUs with certain vector units), so
every candidate renders a small image in a subprocess first. The search ends at the first candidate that works: CUDA,
then LLVM. The verdict is cached per interpreter, package versions and library.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from horizonval.core import progress
from horizonval.core.cache import cached_json, keep_json
from horizonval.core.environment import (
    DRJIT_CAME_FIRST,
    LLVM_VARIABLE,
    OLDEST_LLVM,
    USERS_LIBRARY,
    cache_folder,
    llvm_candidates,
)
from horizonval.core.errors import UserError
from horizonval.core.json_types import typed

VARIANT_VARIABLE = "HORIZONVAL_VARIANT"
VARIANTS = ("cuda_ad_mono", "llvm_ad_mono")
PROBE_SECONDS = 180
_activated: set[str] = set()
"""Variants whose log level is set."""

_PROBE = """
import sys
import drjit as dr
import mitsuba as mi
mi.set_variant(sys.argv[1])
# the operations that broken LLVM versions cannot compile: float32 min/max in a render, Float64 loops
scene = mi.load_dict({
    "type": "scene", "integrator": {"type": "path"}, "light": {"type": "constant"}, "shape": {"type": "sphere"},
    "sensor": {"type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
               "film": {"type": "hdrfilm", "width": 4, "height": 4, "pixel_format": "luminance"}}})
dr.eval(mi.render(scene, spp=1))
i, x = dr.while_loop((mi.UInt32(0), mi.Float64([1.0, 2.0])), lambda i, x: i < 5,
                     lambda i, x: (i + 1, dr.minimum(dr.exp(-x), x)))
assert 0.0 < dr.sum(x)[0] < 2.0
sys.stdout.write("horizonval-probe-ok")
"""


@dataclass(frozen=True)
class Attempt:
    """One candidate back-end: what was tried and what came of it."""

    variant: str
    library: str
    works: bool
    detail: str


@dataclass(frozen=True)
class BackendReport:
    """All candidates tried, in order; the first that works is used."""

    attempts: tuple[Attempt, ...]

    @property
    def chosen(self) -> Attempt | None:
        """The back-end that renders, or None."""
        return next((a for a in self.attempts if a.works), None)


def probe(refresh: bool = False) -> BackendReport:
    """Try back-ends until one works; cached unless ``refresh``."""
    cache = cache_folder() / f"backend-{_fingerprint()}.json"
    if not refresh and (known := cached_json(cache, _report)) is not None:
        return known
    attempts: list[Attempt] = []
    named = os.environ.get(VARIANT_VARIABLE)
    for variant in [named] if named else VARIANTS:
        for library in llvm_candidates() if variant.startswith("llvm") else [""]:
            attempts.append(_try(variant, library))
            if attempts[-1].works:
                break
        if attempts and attempts[-1].works:
            break
    report = BackendReport(tuple(attempts))
    if report.chosen:
        keep_json(cache, {"attempts": [asdict(a) for a in attempts]})
    return report


def _report(content: Mapping[str, Any]) -> BackendReport:
    """Return a report from the cache; ``ValueError`` unless something works in it, as in all that are kept."""
    report = BackendReport(tuple(typed(Attempt(**attempt)) for attempt in content["attempts"]))
    if report.chosen is None:
        raise ValueError("nothing works")
    return report


def activate(threads: int | None = None) -> str:
    """Select the working variant in this process and return its name.

    ``threads`` of the LLVM back-end, all cores by default.

    Raises
    ------
    UserError
        No back-end works; the message says what to install.
    """
    chosen = probe().chosen
    if chosen is None:
        raise UserError(
            "no Dr.Jit back-end can render on this machine",
            fix="run `horizonval doctor` for what was tried and how to mend it",
        )
    if chosen.library and "drjit" not in sys.modules:
        os.environ[LLVM_VARIABLE] = chosen.library
    import drjit as dr
    import mitsuba as mi

    if chosen.library and chosen.variant.startswith("llvm"):
        _refuse_early_drjit(dr.detail.llvm_version(), chosen.library)
    if mi.variant() != chosen.variant:
        mi.set_variant(chosen.variant)
    if chosen.variant not in _activated:
        mi.set_log_level(mi.LogLevel.Warn)
        _activated.add(chosen.variant)
    if threads is not None:
        dr.set_thread_count(threads)
    return chosen.variant


def _refuse_early_drjit(version: tuple[int, int, int], library: str) -> None:
    """Raise ``UserError`` if Dr.Jit was imported before this package and loaded an LLVM library that cannot compile."""
    if not DRJIT_CAME_FIRST or USERS_LIBRARY or version[0] >= OLDEST_LLVM:
        return
    number = ".".join(map(str, version))
    loaded = "found no LLVM" if version[0] < 0 else f"loaded LLVM {number}, with which kernels abort the process"
    raise UserError(
        f"drjit was imported before horizonval and {loaded}",
        fix=f"import horizonval before drjit and mitsuba, or set {LLVM_VARIABLE}={library}",
    )


@cache
def _versions() -> tuple[str, ...]:
    return tuple(importlib.metadata.version(name) for name in ("mitsuba", "drjit", "horizonval"))


def _fingerprint() -> str:
    parts = [sys.executable, sys.version, USERS_LIBRARY, os.environ.get(VARIANT_VARIABLE, "")]
    parts += _versions()
    for library in llvm_candidates():
        if library and Path(library).exists():
            stat = Path(library).stat()
            parts.append(f"{library} {stat.st_size} {int(stat.st_mtime)}")
    parts.append(str(Path("/dev/nvidiactl").exists()))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _try(variant: str, library: str) -> Attempt:
    environment = dict(os.environ)
    environment.pop(LLVM_VARIABLE, None)
    if library:
        environment[LLVM_VARIABLE] = library
    label = library or ("system search" if variant.startswith("llvm") else "")
    try:
        run = subprocess.run(
            [sys.executable, "-c", _PROBE, variant],
            env=environment,
            capture_output=True,
            text=True,
            timeout=PROBE_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Attempt(variant, label, False, f"no answer within {PROBE_SECONDS} s")
    if run.returncode == 0 and "horizonval-probe-ok" in run.stdout:
        return Attempt(variant, library, True, "renders")
    if run.returncode < 0:
        return Attempt(variant, label, False, f"the process was killed by signal {-run.returncode} (unsuitable LLVM)")
    lines = [line.strip() for line in run.stderr.splitlines() if line.strip()]
    return Attempt(variant, label, False, lines[-1][:300] if lines else f"exit status {run.returncode}")


@contextmanager
def compiling_counted() -> Iterator[None]:
    """Count the kernels compiled inside (:mod:`horizonval.core.progress`), from Dr.Jit's own record of kernels."""
    drjit = sys.modules.get("drjit")
    if drjit is None:
        yield
        return
    before = drjit.flag(drjit.JitFlag.KernelHistory)
    drjit.set_flag(drjit.JitFlag.KernelHistory, True)
    drjit.kernel_history()
    try:
        yield
    finally:
        kernels = drjit.kernel_history()
        drjit.set_flag(drjit.JitFlag.KernelHistory, before)
        progress.count(
            progress.COMPILING, sum(k.get("backend_time", 0.0) + k.get("codegen_time", 0.0) for k in kernels) * 1e-3
        )
