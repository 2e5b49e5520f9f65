"""YAML as people write it, read by PyYAML without its objects."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from horizonval.core import files
from horizonval.core.errors import UserError

MAX_FILE_BYTES = 1024 * 1024
"""A camera has some dozen numbers."""


def read_yaml(path: Path, expected: str) -> Mapping[str, Any]:
    """Return the mapping that a YAML file holds.

    Parameters
    ----------
    path : Path
    expected : str
        What kind of file it should be, for messages.

    Raises
    ------
    UserError
        No such file, no YAML, no mapping; PyYAML is not installed.
    """
    try:
        import yaml
    except ImportError:
        raise UserError(
            "PyYAML is not installed", where=str(path), fix='run `pip install "horizonval[formats]"`'
        ) from None
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=expected)
    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f" (line {mark.line + 1})" if mark is not None else ""
        raise UserError(f"not valid YAML{place}", where=str(path), expected=expected) from error
    if not isinstance(data, Mapping):
        raise UserError("holds no keys", where=str(path), expected=expected)
    return data
