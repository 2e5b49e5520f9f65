"""Which LLVM library Dr.Jit is to load: named in its environment variable before anything imports Dr.Jit.

Dr.Jit loads the library once, when it is first imported, and takes the system's own where none is named; some of those
abort the process at the first kernel. This module imports nothing that takes time: it runs with the package itself.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from pathlib import Path

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
OLDEST = 17
"""First version that compiles everywhere; 14 is refused by Dr.Jit, 15 and 16 abort the process on some processors."""


def wheel_libraries() -> list[str]:
    """Return LLVM libraries that came as a wheel, the best first."""
    libraries: list[str] = []
    for folder in dict.fromkeys([Path(sys.prefix, "lib"), Path(sysconfig.get_path("data"), "lib")]):
        for pattern in ("libLLVM.so", "libLLVM*.so", "libLLVM.dylib"):
            libraries += [str(path) for path in sorted(folder.glob(pattern))]
    return list(dict.fromkeys(libraries))[:2]


def _users_library() -> str:
    """Return what the user named; a library that a parent process of this package named is no choice of the user."""
    named = os.environ.get(LLVM_VARIABLE, "")
    return "" if named in wheel_libraries()[:1] else named


USERS_LIBRARY = _users_library()
DRJIT_CAME_FIRST = "drjit" in sys.modules
"""Whether Dr.Jit had been imported before this package could name a library."""


def candidates() -> list[str]:
    """Return LLVM libraries to try, best first: the user's choice alone, else the wheel's, else what Dr.Jit finds.

    An empty string stands for Dr.Jit's own search of the system.
    """
    return [USERS_LIBRARY] if USERS_LIBRARY else [*wheel_libraries(), ""]


def name_library() -> None:
    """Name the library that came as a wheel, unless the user named one; must run before Dr.Jit is imported."""
    library = candidates()[0]
    if library:
        os.environ.setdefault(LLVM_VARIABLE, library)
