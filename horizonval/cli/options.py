"""Shared options, shell completions, and options that select entries of an archive.

Completions load nothing heavy: a key press must not take a second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, fields
from functools import wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from horizonval.core.errors import UserError
from horizonval.jobs.pool import MOST_WORKERS

if TYPE_CHECKING:
    from horizonval.spec.files import Kind
    from horizonval.store.index import Filter

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Workers = Annotated[
    int | None, typer.Option(min=1, max=MOST_WORKERS, help="Processes; by default as many as processors.")
]
Shard = Annotated[
    str | None, typer.Option(metavar="I/N", help="Only every N-th frame from the I-th on; then run without it.")
]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Say what would be made and what it takes; render and write nothing.")
]
Dask = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler in place of own processes, or local:N.")
]

Offer = Callable[[str], list[tuple[str, str]]]
"""Completions of the beginning of a word, each with a description."""


def shipped(*kinds: Kind) -> Offer:
    """Return the completion of shipped files of some kinds, TOML files and folders."""

    def offer(incomplete: str) -> list[tuple[str, str]]:
        from horizonval.api.info import first_sentence
        from horizonval.spec.files import head_comment, shipped_names, shipped_path

        names = [
            (name, first_sentence(head_comment(shipped_path(kind, name))))
            for kind in kinds
            for name in shipped_names(kind)
            if name.startswith(incomplete)
        ]
        return names + [(path, "") for path in _paths(incomplete, ".toml")]

    return offer


def files(suffix: str) -> Offer:
    """Return the completion of folders and of files with a suffix."""
    return lambda incomplete: [(path, "") for path in _paths(incomplete, suffix)]


def estimators(incomplete: str) -> list[tuple[str, str]]:
    """Complete installed estimators."""
    from importlib.metadata import entry_points

    names = {point.name for point in entry_points(group="horizonval.estimators")}
    return [(name, "") for name in sorted(names) if name.startswith(incomplete)]


def lists(incomplete: str) -> list[tuple[str, str]]:
    """Complete the names of lists."""
    from horizonval.api.info import LISTS

    return [(name, "") for name in LISTS if name.startswith(incomplete)]


def systems(incomplete: str) -> list[tuple[str, str]]:
    """Complete the letters of published systems."""
    return [
        (name, "") for name in ("A", "B", "C", "D", "E", "F", "G", "all") if name.lower().startswith(incomplete.lower())
    ]


def kinds_of_files(incomplete: str) -> list[tuple[str, str]]:
    """Complete the kinds of files with a schema."""
    return [(name, "") for name in ("scene", "camera", "suite", "study", "prior") if name.startswith(incomplete)]


def _paths(incomplete: str, suffix: str) -> Iterator[str]:
    """Yield files of a suffix and folders by prefix; hidden ones only on request."""
    folder, _, begin = incomplete.rpartition("/")
    try:
        entries = sorted(Path(f"{folder}/" if folder or incomplete.startswith("/") else ".").iterdir())
    except OSError:
        return
    for entry in entries:
        if entry.name.startswith(begin) and entry.name.startswith(".") <= begin.startswith("."):
            name = incomplete[: len(incomplete) - len(begin)] + entry.name
            if entry.is_dir():
                yield f"{name}/"
            elif entry.suffix == suffix:
                yield name


SuiteName = Annotated[
    str, typer.Argument(help="A suite file, or the name of a shipped suite.", autocompletion=shipped("suite"))
]
SceneName = Annotated[
    str, typer.Argument(help="A scene file, or the name of a shipped scene.", autocompletion=shipped("scene"))
]
CameraName = Annotated[
    str | None,
    typer.Option(
        "--camera", help="Camera file or shipped name; files of ours carry theirs.", autocompletion=shipped("camera")
    ),
]
PriorFile = Annotated[
    str | None,
    typer.Option(
        "--prior",
        metavar="FILE",
        help="File of a table [prior]: what is known in addition to the image; see `horizonval schema prior`.",
        autocompletion=files(".toml"),
    ),
]
Part = Annotated[
    str | None,
    typer.Option(metavar="NAME|N", help="The picture of a file of several: page, part, layer, plane or array."),
]
Orientation = Annotated[
    str | None,
    typer.Option(
        metavar="stored|shown",
        help="What the camera file describes if a picture's tag turns it: the stored pixels, or what viewers show.",
    ),
]
Merge = Annotated[
    list[Path] | None,
    typer.Option("--merge", metavar="DIR", help="Take over the results of another folder; repeatable."),
]


@dataclass(frozen=True)
class EntryOptions:
    """Entries of an archive by header values; None matches all."""

    scene: Annotated[str | None, typer.Option("--scene", help="Name of the scene; `*` and `?` stand for others.")] = (
        None
    )
    camera: Annotated[str | None, typer.Option("--camera", help="Name of the camera; `*` and `?` likewise.")] = None
    head: Annotated[str | None, typer.Option("--head", help="Name of the camera's head; `*` and `?` likewise.")] = None
    band: Annotated[str | None, typer.Option("--band", help="Name of a spectral band.")] = None
    seed: Annotated[str | None, typer.Option("--seed", help="Of an image's noise.")] = None
    since: Annotated[str | None, typer.Option("--since", help="Not before: a date or time, UTC by default.")] = None
    until: Annotated[str | None, typer.Option("--until", help="Not after.")] = None

    def filter(self, kind: str | None) -> Filter:
        """Return the filter of the archive's index for entries of one kind, or of any."""
        from horizonval.store.index import Filter

        if kind not in (None, "frame", "image"):
            raise UserError(f"found {kind!r}", where="--kind", expected="frame or image")
        return Filter(kind, *astuple(self))


ALL = EntryOptions()


def selects(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the fields of :class:`EntryOptions` as options in place of its argument ``options``."""
    hints = get_type_hints(EntryOptions, include_extras=True)
    choices = [
        Parameter(field.name, Parameter.POSITIONAL_OR_KEYWORD, default=field.default, annotation=hints[field.name])
        for field in fields(EntryOptions)
    ]
    command_signature = signature(command, eval_str=True)
    parameters = [
        parameter
        for own_parameter in command_signature.parameters.values()
        for parameter in (choices if own_parameter.name == "options" else [own_parameter])
    ]

    @wraps(command)
    def call(**values: Any) -> Any:
        return command(options=EntryOptions(**{option.name: values.pop(option.name) for option in choices}), **values)

    call.__signature__ = command_signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return call
