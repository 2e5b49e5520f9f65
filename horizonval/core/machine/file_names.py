"""Names that become names of files: what every system can have, long or short, alike in case or not."""

from __future__ import annotations

import hashlib
import re

LONGEST_FRAME_NAME = 150
"""Of a scene or frame. With the name of a head, the endings of files and what a file is called while it is written, it
stays within 255 bytes, the most that the usual file systems take."""

LONGEST_NAME = 50
"""Of what is part of a name: a head, a band, a table of cases, an entry of a list."""

LONGEST_GENERATED_NAME = 120
"""Of what a grid or a list of cases makes, before the number of an orbit's sample."""

_RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
_DIGITS = 12


def usable_name(name: str) -> str:
    """Return a name made of letters, digits, ``.``, ``_`` and ``-`` that can be a file's.

    Raises
    ------
    ValueError
        It is that of a folder or of a device, or ends with a dot, which some systems drop.
    """
    if name in (".", "..") or name.endswith("."):
        raise ValueError(f"the name {name!r} cannot be a file's: it must not end with a dot")
    if _RESERVED.fullmatch(name):
        raise ValueError(f"the name {name!r} cannot be a file's: some systems call a device so")
    return name


def shortened(name: str, longest: int) -> str:
    """Return a name of at most ``longest`` characters; of a longer one the beginning and a digest of all of it."""
    if len(name) <= longest:
        return name
    digest = hashlib.sha256(name.encode()).hexdigest()[:_DIGITS]
    return f"{name[: longest - _DIGITS - 1].rstrip('._-')}-{digest}"
