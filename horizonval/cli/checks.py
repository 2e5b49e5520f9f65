"""Where output goes is checked before the work is done."""

from __future__ import annotations

from pathlib import Path

from horizonval.core.errors import UserError


def check_target(out: Path, source: Path | None = None) -> None:
    """Refuse a file that cannot be written before the work is done, not after."""
    if not out.parent.is_dir():
        raise UserError("no such folder", where=str(out.parent), fix="create it first")
    if out.is_dir():
        raise UserError("is a folder", where=str(out), expected="the path of a file")
    if source is not None and out.exists() and out.samefile(source):
        raise UserError("input and output are the same file", where=str(out))


def check_folder(out: Path) -> None:
    """Refuse a folder that is not new or empty: what lies there is not ours to overwrite."""
    if not out.parent.is_dir():
        raise UserError("no such folder", where=str(out.parent), fix="create it first")
    if out.exists() and not out.is_dir():
        raise UserError("is a file", where=str(out), expected="a new or empty folder")
    if out.is_dir() and any(out.iterdir()):
        raise UserError("is not empty", where=str(out), expected="a new or empty folder")
