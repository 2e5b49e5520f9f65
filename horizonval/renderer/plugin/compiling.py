"""How long kernels take to compile, which is done once for all frames that are alike, and kept on the disk."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from horizonval.core import progress


@contextmanager
def compiling_counted() -> Iterator[None]:
    """Count the compilation of the kernels inside (:mod:`horizonval.core.progress`).

    Dr.Jit keeps a record of every kernel for it, some hundred for a frame, and is not slower.
    """
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
