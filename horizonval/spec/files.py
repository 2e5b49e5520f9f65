"""Where specification files are: a path, or the name of a file that is shipped with the package."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Literal

from horizonval.core.errors import UserError, nearest
from horizonval.core.files import ensure_file, kind_at, read_text

_LARGEST_BYTES = 1024**2

Kind = Literal["scene", "camera", "suite", "study", "atmosphere"]

_FOLDER: dict[Kind, str] = {
    "scene": "",
    "camera": "cameras",
    "suite": "suites",
    "study": "studies",
    "atmosphere": "atmospheres",
}


def _suffix(kind: Kind) -> str:
    return ".json" if kind == "atmosphere" else ".toml"


def shipped_root() -> Path:
    """Return the folder of the shipped files: inside an installed package, or beside it in a checkout."""
    package = Path(str(files("horizonval")))
    inside = package / "scenes"
    return inside if inside.is_dir() else package.parent / "scenes"


def shipped_names(kind: Kind) -> list[str]:
    """Return the names of the shipped files of one kind, sorted."""
    return sorted(p.stem for p in (shipped_root() / _FOLDER[kind]).glob("*" + _suffix(kind)) if p.is_file())


def shipped_path(kind: Kind, name: str) -> Path:
    """Return the path of a shipped file; it need not exist."""
    return shipped_root() / _FOLDER[kind] / (name + _suffix(kind))


def find(kind: Kind, path_or_name: str | Path, *, beside: Path | None = None, where: str = "") -> Path:
    """Return the path of a specification file: a path, which wins, or a shipped name.

    Relative paths start from the folder ``beside``, else the working folder. ``where`` is file and key for the error,
    which lists every shipped name, nearest first.
    """
    given = Path(path_or_name).expanduser()
    candidate = given if beside is None else beside / given
    if (lies_there := kind_at(candidate, links=True)) == "a file":
        # It is an input from now on, also where it is read much later.
        ensure_file(candidate, expected=f"{'an' if kind == 'atmosphere' else 'a'} {kind} file")
        return candidate
    name = str(path_or_name).removesuffix(_suffix(kind))
    if name in shipped_names(kind):
        return shipped_path(kind, name)
    if lies_there:
        raise UserError(
            f"{candidate} is {lies_there}", where=where, expected=f"{'an' if kind == 'atmosphere' else 'a'} {kind} file"
        )
    known = nearest(name.rsplit("/", 1)[-1], shipped_names(kind))
    raise UserError(
        f"no {kind} named {str(path_or_name)!r}" + (f", nor a file {candidate}" if beside is not None else ""),
        where=where,
        expected=f"a path or one of {', '.join(known)}" if known else "the path of a file",
    )


def head_comment(path: Path) -> str:
    """Return the comment at the head of a file as one paragraph."""
    lines = []
    for line in read_text(path, largest=_LARGEST_BYTES, expected="a TOML file").splitlines():
        if not line.startswith("#"):
            break
        if line.startswith("#:"):
            # A word to editors: where the schema is.
            continue
        lines.append(line.lstrip("# ").rstrip())
    return " ".join(lines)
