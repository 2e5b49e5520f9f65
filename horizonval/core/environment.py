"""What the environment gives before anything is imported: the LLVM library for Dr.Jit, folders for caches.

Dr.Jit loads its LLVM library once, when it is first imported, and takes that of the system where none is named; some of
those abort the process at the first kernel. This module imports nothing that takes time: it runs when the package is
imported.

A home that is read-only, or a cache folder that is none, stops no work: what would be kept goes to a temporary folder,
which processes of the same run share and which goes with it. This is said once.
"""

from __future__ import annotations

import atexit
import logging
import os
import shutil
import sys
import sysconfig
import tempfile
from pathlib import Path

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
OLDEST_LLVM = 17
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


def llvm_candidates() -> list[str]:
    """Return LLVM libraries to try, best first: the user's alone, else the wheel's, else empty for Dr.Jit's search."""
    return [USERS_LIBRARY] if USERS_LIBRARY else [*wheel_libraries(), ""]


def name_library() -> None:
    """Name the library that came as a wheel, unless the user named one; must run before Dr.Jit is imported."""
    library = llvm_candidates()[0]
    if library:
        os.environ.setdefault(LLVM_VARIABLE, library)


_STAND_IN = "HORIZONVAL_TEMPORARY_CACHE"
"""Environment variable that tells child processes the folder that cannot be used and the one that replaces it."""

_LOG = logging.getLogger("horizonval")
_warned: set[str] = set()


def configured_folder() -> Path:
    """Return the folder for caches that the user's environment names (``XDG_CACHE_HOME`` respected)."""
    return _base("XDG_CACHE_HOME", ".cache") / "horizonval"


def cache_folder() -> Path:
    """Return the folder for caches: the configured one, or a temporary one where that cannot be used."""
    folder = configured_folder()
    return folder if is_usable(folder) else _stand_in(folder)


def is_usable(folder: Path) -> bool:
    """Whether files can be made in a folder, which need not exist; nothing is made."""
    if not folder.is_absolute():
        return False
    there = next((place for place in (folder, *folder.parents) if os.path.lexists(place)), None)
    return there is not None and there.is_dir() and os.access(there, os.W_OK | os.X_OK)


def settle_libraries() -> None:
    """Give Matplotlib (fonts) and Dr.Jit (kernels) a temporary cache folder if theirs is unusable, before import."""
    config, cache, home = _base("XDG_CONFIG_HOME", ".config"), _base("XDG_CACHE_HOME", ".cache"), _home()
    for variable, folders in (
        ("MPLCONFIGDIR", (config / "matplotlib", cache / "matplotlib")),
        ("DRJIT_CACHE_DIR", (home / ".drjit",)),
    ):
        unusable = next((folder for folder in folders if not is_usable(folder)), None)
        if variable not in os.environ and unusable is not None:
            place = _stand_in(configured_folder(), because=unusable) / folders[0].name.lstrip(".")
            os.environ[variable] = str(place)


def warn_once(what: str) -> None:
    """Log that something cannot be stored, the first time that this process meets it."""
    if not _warned:
        _LOG.warning("horizonval: warning: %s; nothing is stored for the next run", what)
    _warned.add(what)


def _stand_in(folder: Path, because: Path | None = None) -> Path:
    """Return the temporary folder that replaces one that cannot be used; the first call says so."""
    known, _, place = os.environ.get(_STAND_IN, "").partition(os.pathsep)
    if known == str(folder) and Path(place).is_dir():
        return Path(place)
    try:
        made = tempfile.mkdtemp(prefix="horizonval-cache-")
    except OSError:
        # Writing there fails as well, which costs time and nothing else.
        return folder
    atexit.register(_remove, made, os.getpid())
    os.environ[_STAND_IN] = f"{folder}{os.pathsep}{made}"
    warn_once(f"the folder {because or folder} cannot be used, a temporary one replaces it")
    return Path(made)


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


def _base(variable: str, below_home: str) -> Path:
    named = os.environ.get(variable)
    return Path(named) if named else _home() / below_home


def _home() -> Path:
    # Without a home the path stays relative, which is not usable.
    return Path(os.path.expanduser("~"))
