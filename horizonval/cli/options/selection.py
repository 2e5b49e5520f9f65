"""Options that choose entries of an archive, the same for every command that takes some of them.

The parser knows single options only. A command that has an argument ``options`` of type :class:`EntryOptions` and is
decorated with :func:`selects` gets one option for every field, in that argument's place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, fields
from functools import wraps
from inspect import Parameter, signature
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from horizonval.core.errors import UserError

if TYPE_CHECKING:
    from horizonval.store.index import Filter


@dataclass(frozen=True)
class EntryOptions:
    """Entries of an archive by what their headers say; what is None does not matter."""

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
    """Give a command the fields of :class:`EntryOptions` as options, in the place of its argument ``options``."""
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
